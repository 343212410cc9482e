"""Other numbers in flight: what the vehicle is commanded does not jump."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from kffa_offboard.control import controllers
from kffa_offboard.control.design import DesignSettings, design
from kffa_offboard.control.retuning import retuned

H = 0.01
AT_REST = np.array([0.0, 0.0, 0.3, 5.0])
HOVER = np.array([0.0, 0.0, 0.0, 0.5])
BEFORE = DesignSettings(
    b0=np.array([12.5, 12.5, 3.3, 20.0]),
    damping=np.array([12.5, 12.5, 3.3, 0.0]),
    omega_c=np.array([8.0, 8.0, 2.5, 8.0]),
    omega_o=np.array([25.0, 25.0, 10.0, 40.0]),
    omega_c_range=np.array([2.0, 2.0, 0.5, 2.0]),
    lower=np.array([-3.5, -3.5, -1.5, 0.0]),
    upper=np.array([3.5, 3.5, 1.5, 1.0]),
    delay=np.full(4, 0.04),
    lag=np.array([0.0, 0.0, 0.0, 0.05]),
    prediction=np.full(4, 0.04),
    trim=HOVER,
    rate_variance=np.full(4, 4e-4),
)
INPUTS = controllers.ControllerInput(AT_REST, AT_REST, np.full(4, True), np.zeros(4))


def hovering(name, settings=BEFORE):
    """A controller that has found its balance, at thrust 0.5."""
    parameters = design(name, settings)
    state = controllers.initial_state(parameters, AT_REST, HOVER)
    for _ in range(300):
        state, output = controllers.step(parameters, state, INPUTS, H)
    return parameters, state, output.command


@pytest.mark.parametrize("name", controllers.NAMES)
@pytest.mark.parametrize(
    "change",
    [
        {"b0": np.array([10.0, 10.0, 3.0, 25.0])},
        {"damping": np.array([10.0, 10.0, 3.0, 0.5])},
        {"stiffness": np.array([5.0, 5.0, 2.0, 0.0])},
        {"omega_c": np.array([6.0, 6.0, 2.0, 6.0]), "omega_o": np.array([30.0, 30.0, 12.0, 50.0])},
        {"delay": np.full(4, 0.1)},
        {"delay": np.zeros(4), "lag": np.full(4, 0.1)},
    ],
    ids=lambda change: "+".join(change),
)
def test_a_hovering_vehicle_does_not_feel_other_numbers(name, change):
    before, state, command = hovering(name)
    after = design(name, replace(BEFORE, **change))
    state, output = controllers.step(after, retuned(before, after, state), INPUTS, H)
    np.testing.assert_allclose(output.command, command, atol=2e-3)


def test_another_plant_model_alone_would_be_felt():
    before, state, command = hovering("kffa-ladrc")
    after = design("kffa-ladrc", replace(BEFORE, b0=np.array([12.5, 12.5, 3.3, 25.0])))
    heavy = structs.replace(
        state, observer=structs.replace(state.observer, disturbance=np.array([0.0, 0.0, 0.0, -10.0]))
    )
    _, output = controllers.step(after, heavy, INPUTS, H)
    assert abs(output.command[3] - command[3]) > 0.05
    _, output = controllers.step(after, retuned(before, after, heavy), INPUTS, H)
    assert abs(output.command[3] - command[3]) < 0.01


def test_a_bandwidth_changes_the_command_by_what_it_makes_of_the_present_error():
    before, state, _ = hovering("ladrc")
    after = design("ladrc", replace(BEFORE, omega_c=np.array([8.0, 8.0, 2.5, 4.0])))
    low = structs.replace(INPUTS, measurement=AT_REST - np.array([0.0, 0.0, 0.0, 0.002]))
    commands = []
    for parameters in (before, after):
        _, output = controllers.step(parameters, retuned(before, parameters, state), low, H)
        commands.append(output.command)
    np.testing.assert_allclose(commands[0][:3], commands[1][:3], atol=1e-12)
    assert commands[0][3] > commands[1][3] > 0.5


def test_a_delay_can_grow_and_shrink_while_commands_are_under_way():
    rng = np.random.default_rng(3)
    parameters, state, _ = hovering("kffa-ladrc")
    for delay in (0.3, 0.0, 0.5, 0.01, 0.2, 0.0):
        changed = design("kffa-ladrc", replace(BEFORE, delay=np.full(4, delay)))
        state, parameters = retuned(parameters, changed, state), changed
        for _ in range(20):
            noisy = structs.replace(INPUTS, measurement=AT_REST + rng.normal(0.0, 0.01, 4))
            state, output = controllers.step(parameters, state, noisy, H)
            assert np.all(np.isfinite(output.command))
        assert len(state.actuator.ages) <= max(0.5, delay) / H + 2


def test_another_controller_cannot_go_on_from_this_state():
    before, state, _ = hovering("kffa-ladrc")
    with pytest.raises(ValueError, match="controller ladrc cannot go on from the state of kffa-ladrc"):
        retuned(before, design("ladrc", BEFORE), state)
    literal = design("kffa-ladrc", replace(BEFORE, literal_filter=True))
    with pytest.raises(ValueError, match="model cannot be changed"):
        retuned(before, literal, state)
