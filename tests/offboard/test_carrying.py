"""The thrust that carries the vehicle, as it is left to the autopilot at the end."""

from math import pi, sin

import pytest

from kffa_offboard.offboard.carrying import Carrying, follow


def after(thrusts, dt=0.01, balance_of=lambda thrust: thrust):
    state = None
    for thrust in thrusts:
        state = follow(state, thrust, balance_of(thrust), dt)
    return state


def test_a_load_that_comes_or_goes_is_followed_within_a_second():
    state = after([0.4] * 300 + [0.6] * 100)
    assert not state.swings and state.thrust == pytest.approx(0.6, abs=0.01)
    state = after([0.4] * 300 + [0.6] * 100 + [0.4] * 100)
    assert not state.swings and state.thrust == pytest.approx(0.4, abs=0.01)


@pytest.mark.parametrize("phase", [k * pi / 4.0 for k in range(8)])
@pytest.mark.parametrize("omega", [5.0, 8.0])
def test_in_a_swing_the_phase_of_the_last_setpoints_does_not_matter(phase, omega):
    swing = [0.4 + 0.3 * sin(omega * 0.01 * k + phase) for k in range(500)]
    state = after([0.4] * 300 + swing)
    assert state.swings
    assert state.thrust == pytest.approx(0.4, abs=0.035)


def test_the_first_setpoint_is_all_that_is_known():
    assert follow(None, 0.35, 0.34, 0.01) == Carrying(0.34, 0.35, 0.35)


def test_thrust_that_accelerates_does_not_carry():
    """On the way to another height; half a second of the setpoints' mean moved a vehicle by metres."""
    state = after([0.6] * 300 + [0.9] * 20, balance_of=lambda thrust: 0.6)
    assert not state.swings and state.thrust == pytest.approx(0.6)


def test_loads_that_come_and_go_are_no_swing_at_any_time():
    state, turns = None, []
    for thrust in ([0.4] * 300 + [0.6] * 100) * 2 + [0.4] * 300:
        state = follow(state, thrust, thrust, 0.01)
        turns.append(state.swings)
    assert not any(turns[:800])
    assert follow(Carrying(0.4, 0.4, 0.4), 4.0, 4.0, 0.01).turns == 0.0, "the first side is no change of it"
    assert not any(after(([0.4] * 1000 + [0.6] * 1000) * count).swings for count in (1, 2, 4, 8))


def test_a_swing_by_a_quarter_of_the_thrust_is_one():
    assert after([0.4] * 300 + [0.4 + 0.1 * sin(0.05 * k) for k in range(500)]).swings
