"""One vehicle in plain numbers is the same controller as in arrays, whichever steps it makes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kffa_offboard.config import bundled, load
from kffa_offboard.control import controllers, vehicle
from kffa_offboard.control.plain import PlainInput, PlainState, array_state, plain_state

LADRC = load(bundled("demo-px4.toml")).service.controller
PARAMETERS = {
    "rates": LADRC,
    "attitude": load(bundled("demo-ardupilot.toml")).service.controller,
    "without Kalman filter": replace(LADRC, kalman=None),
}


def told(random):
    """Inputs of one step, noisy; a position that comes with two of three attitudes."""
    position = bool(random.random() < 0.67)
    reference, measured, rate = (tuple(row) for row in random.normal(0.0, 0.1, (3, 4)).tolist())
    return PlainInput(reference, measured, (True, True, True, position), rate)


def event(random, parameters, arrays, plain):
    """What happens to a controller between two steps, to both."""
    command = tuple(random.normal(0.0, 0.1, 4).tolist())
    after = float(random.choice([0.0, 0.004, 0.03]))
    match random.integers(8):
        case 0:
            arrays = controllers.align_reference(parameters, arrays)
            plain = vehicle.align_reference(parameters, plain)
        case 1 | 2:
            arrays = controllers.with_applied(parameters, arrays, np.array(command), after)
            plain = vehicle.with_applied(parameters, plain, command, after)
        case 3:
            arrays = controllers.with_disturbance_step(parameters, arrays, np.array(command), after)
            plain = vehicle.with_disturbance_step(parameters, plain, command, after)
    return arrays, plain


@pytest.mark.parametrize("name", PARAMETERS)
@settings(max_examples=25)
@given(seed=st.integers(0, 10_000))
def test_whatever_happens_the_numbers_are_those_of_the_arrays(leaves, name, seed):
    parameters, random = PARAMETERS[name], np.random.default_rng(seed)
    arrays = controllers.initial_state(parameters, np.zeros(4), np.full(4, 0.1))
    plain = vehicle.initial_state(parameters, (0.0,) * 4, (0.1,) * 4)
    kinds = set()
    for _ in range(40):
        dt, inputs = float(random.choice([0.004, 0.01, 0.011, 0.0371, 0.2])), told(random)
        arrays, output = controllers.step(parameters, arrays, inputs.arrays(), dt)
        plain, said = vehicle.step(parameters, plain, inputs, dt)
        kinds.add(type(plain))
        np.testing.assert_array_equal(leaves(output), leaves(said))
        np.testing.assert_array_equal(leaves(arrays), leaves(vehicle.as_arrays(plain)))
        assert vehicle.expects_step(plain) == (arrays.expected is not None)
        arrays, plain = event(random, parameters, arrays, plain)
        seen = arrays.observer
        for part, want in zip(
            vehicle.estimates(plain), (seen.estimate, seen.rate, seen.disturbance), strict=True
        ):
            assert part == tuple(want.tolist())
    assert PlainState in kinds


def test_ordinary_steps_leave_no_arrays_behind():
    """They are made hundreds of times a second: this is what the representation is for."""
    state = vehicle.initial_state(LADRC, (0.0,) * 4, (0.1,) * 4)
    for _ in range(3):
        state, output = vehicle.step(LADRC, state, told(np.random.default_rng(0)), 0.01)
        state = vehicle.with_applied(LADRC, state, output.command)
        state = vehicle.align_reference(LADRC, state)
        assert type(state) is PlainState
        assert all(type(number) is float for number in (*state.numbers, *output.command, *output.estimate))


def test_a_controller_that_is_not_written_out_stays_in_arrays():
    parameters = replace(LADRC, differentiator=None)
    state = vehicle.initial_state(parameters, (0.0,) * 4, (0.1,) * 4)
    state, _ = vehicle.step(parameters, state, told(np.random.default_rng(0)), 0.01)
    assert not isinstance(state, PlainState)


def test_a_state_comes_back_from_plain_numbers_as_it_was(leaves):
    state = vehicle.initial_state(LADRC, (0.1, 0.2, 0.3, 4.0), (0.0, 0.0, 0.0, 0.4))
    for dt in (0.01, 0.01, 0.02):
        state, _ = vehicle.step(LADRC, state, told(np.random.default_rng(1)), dt)
    arrays = array_state(state)
    assert plain_state(arrays) == state
    np.testing.assert_array_equal(leaves(arrays), leaves(array_state(plain_state(arrays))))


@pytest.mark.parametrize("dt", [0.0, -0.01, np.nan, np.inf])
def test_a_step_without_a_length_is_refused(dt):
    state = vehicle.initial_state(LADRC, (0.0,) * 4, (0.1,) * 4)
    with pytest.raises(ValueError, match="dt must be positive"):
        vehicle.step(LADRC, state, told(np.random.default_rng(0)), dt)
