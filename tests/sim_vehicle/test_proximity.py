"""Ground and ceiling effect: numbers by hand, limits, and what they do to a flight."""

import numpy as np
import pytest

from sim_vehicle import airframe, config
from sim_vehicle.airframe import AirframeParameters
from sim_vehicle.errors import SimulatorError
from sim_vehicle.proximity import Proximity, ceiling_ratio, ground_ratio, thrust_ratio
from sim_vehicle.vehicle import SimulatedVehicle

NEAR = Proximity(rotor_radius=0.2, rotor_spacing=0.6, rotor_height=0.1)


def test_the_ground_effect_has_the_published_value() -> None:
    # z = 0.4: (0.2/1.6)^2 = 0.015625; 0.04*0.4 / (0.36+0.64)^1.5 = 0.016;
    # 0.5*0.04*0.4 / (0.72+0.64)^1.5 = 0.008 / 1.586010 = 0.0050441
    assert ground_ratio(NEAR, 0.4) == pytest.approx(1.0 / (1.0 - 0.015625 - 0.016 - 0.0050441), abs=1e-6)


def test_a_lone_rotor_has_the_value_of_cheeseman_and_bennett() -> None:
    alone = Proximity(rotor_radius=0.2, rotor_spacing=1e6)
    # R/4z = 1/4 at z = R, 1/2 at z = R/2
    assert ground_ratio(alone, 0.2) == pytest.approx(16.0 / 15.0)
    assert ground_ratio(alone, 0.1) == pytest.approx(4.0 / 3.0)


def test_the_ceiling_effect_has_the_published_value() -> None:
    # D = R/4: sqrt(1 + 16/8) = 1.7320508, g = 1.3660254, g^(2/3) = 1.231143
    assert ceiling_ratio(NEAR, 0.05) == pytest.approx(1.3660254 ** (2.0 / 3.0), abs=1e-7)
    assert ceiling_ratio(NEAR, 0.05) == pytest.approx(1.2311, abs=5e-5)


@pytest.mark.parametrize("ratio", [ground_ratio, ceiling_ratio])
def test_far_away_nothing_changes_and_nearer_is_always_more_and_never_infinite(ratio) -> None:
    distance = np.concatenate([[-1.0, 0.0], np.geomspace(1e-6, 100.0, 400)])
    values = ratio(NEAR, distance)
    assert values[-1] == pytest.approx(1.0, abs=1e-5)
    assert np.all(np.diff(values) <= 1e-15)
    assert np.all(np.isfinite(values)) and values.max() < 2.0
    assert [float(ratio(NEAR, float(d))) for d in distance[::40]] == pytest.approx(values[::40].tolist())


def test_both_surfaces_multiply() -> None:
    room = Proximity(0.2, 0.6, 0.1, ceiling_height=1.0)
    expected = float(ground_ratio(room, 0.5)) * float(ceiling_ratio(room, 0.5))
    assert thrust_ratio(room, 0.4) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"rotor_radius": 0.4}, "must not overlap; give at most 0.311 m"),
        ({"rotor_radius": 0.0}, "rotor radius of 0 m"),
        ({"rotor_height": -0.1}, "rotor height of -0.1 m"),
        ({"ceiling_height": 0.2}, "ceiling height of 0.2 m"),
    ],
)
def test_impossible_surfaces_are_refused(values, message) -> None:
    with pytest.raises(ValueError, match=message):
        Proximity(**values)


# --------------------------------------------------------------------------------------- flight


def lifted_after(
    proximity: Proximity | None, thrust: float, seconds: float = 1.0, height: float = 0.0
) -> float:
    """Height after `seconds` under a constant thrust 0..1."""
    parameters = AirframeParameters(proximity=proximity)
    rigid = np.zeros(12)
    rigid[2] = height
    state = airframe.initial_state(rigid)
    for _ in range(round(seconds / 0.0025)):
        state = airframe.step(parameters, state, np.full(4, thrust))
    return float(state.rigid[2])


def test_the_ground_lifts_a_vehicle_that_its_thrust_alone_would_not() -> None:
    thrust = 0.95 * AirframeParameters().hover_thrust()
    assert lifted_after(None, thrust) == 0.0
    assert 0.02 < lifted_after(Proximity(), thrust, 4.0) < 1.0  # and it stops where the effect has faded


def test_a_ceiling_draws_the_vehicle_to_it_and_holds_it_there() -> None:
    hover = AirframeParameters().hover_thrust()
    room = Proximity(ceiling_height=3.0, ground_effect=False)
    assert lifted_after(room, 1.3 * hover, 3.0, height=2.0) == pytest.approx(2.75)


def test_a_batch_feels_each_its_own_height() -> None:
    parameters = AirframeParameters(proximity=Proximity(ceiling_height=4.0))
    heights = np.array([0.05, 1.0, 3.5])
    rigid = np.zeros((12, 3))
    rigid[2] = heights
    state = airframe.initial_state(rigid)
    singles = []
    for height in heights:
        alone = np.zeros(12)
        alone[2] = height
        singles.append(airframe.initial_state(alone))
    for _ in range(40):
        state = airframe.step(parameters, state, np.full((4, 3), 0.5))
        singles = [airframe.step(parameters, single, np.full(4, 0.5)) for single in singles]
    np.testing.assert_allclose(state.rigid, np.array([single.rigid for single in singles]).T, atol=1e-12)


# ---------------------------------------------------------------------------------- configuration


def test_surfaces_are_off_unless_asked_for() -> None:
    assert SimulatedVehicle(config.build({}, "test")).body.proximity is None
    vehicle = SimulatedVehicle(
        config.build({"environment": {"ground_effect": True, "ceiling_height_m": 3.0}}, "test")
    )
    assert vehicle.body.proximity == Proximity(ceiling_height=3.0)
    below = SimulatedVehicle(config.build({"environment": {"ceiling_height_m": 3.0}}, "test"))
    assert below.body.proximity == Proximity(ground_effect=False, ceiling_height=3.0)


def test_an_impossible_environment_is_one_line() -> None:
    with pytest.raises(SimulatorError, match=r"environment.*ceiling height of 0\.1 m"):
        config.build({"environment": {"ceiling_height_m": 0.1}}, "test")


def test_drag_is_the_papers_unless_asked_for() -> None:
    assert SimulatedVehicle(config.build({}, "test")).body.drag == 0.15
    assert SimulatedVehicle(config.build({"vehicle": {"drag_n_s_m": 0.6}}, "test")).body.drag == 0.6
