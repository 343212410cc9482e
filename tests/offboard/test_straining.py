"""Full thrust that lifts nothing ends control; falling, climbing and short bursts do not."""

import pytest

from kffa_offboard.offboard.settings import LimitSettings
from kffa_offboard.offboard.straining import LONGEST_S, watch_strain

DT = 0.01
LIMITS = LimitSettings(thrust_max=0.9)


def shows_after(thrust, climb_rate, seconds=20.0):
    """When it is a fault, s, or None; both are functions of time."""
    strained_s = 0.0
    for k in range(round(seconds / DT)):
        now = k * DT
        strained_s, fault = watch_strain(strained_s, LIMITS, thrust(now), climb_rate(now), DT)
        if fault is not None:
            assert fault == "full thrust lifts nothing for 3 s"
            return now
    return None


@pytest.mark.parametrize("climb_rate", [0.0, 0.08, -0.08])
def test_full_thrust_without_motion_shows_after_its_time(climb_rate):
    assert shows_after(lambda t: 0.9, lambda t: climb_rate) == pytest.approx(LONGEST_S, abs=0.03)


def test_the_limit_is_that_of_the_configuration():
    assert shows_after(lambda t: 0.89, lambda t: 0.0) is None


@pytest.mark.parametrize("climb_rate", [-0.5, 0.2, 2.0])
def test_falling_and_climbing_are_no_strain(climb_rate):
    assert shows_after(lambda t: 0.9, lambda t: climb_rate) is None


def test_time_counts_anew_when_it_lets_up():
    assert shows_after(lambda t: 0.5 if t % 2.0 < 0.02 else 0.9, lambda t: 0.0) is None
