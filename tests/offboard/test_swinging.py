"""A load that swings shows in the disturbance that the position ring finds; wind does not."""

import numpy as np
import pytest

from kffa_offboard.offboard.swinging import (
    LONGEST_TURN_S,
    NO_SWING,
    TURN_M_S2,
    steady_part,
    watch_swing,
    watch_whirl,
    whirls,
)
from kffa_offboard.offboard.turns import NO_PLANE_TURNS

DT = 0.01


def watched(disturbance, seconds):
    """When the swing shows [s], or None, and what was remembered then."""
    swing = NO_SWING
    for k in range(round(seconds / DT)):
        swing = watch_swing(swing, np.array(disturbance(k * DT)), DT)
        if swing.shows:
            return k * DT, swing
    return None, swing


def swings(size, period, wind=(0.0, 0.0), direction=(1.0, 0.0)):
    def disturbance(time_s):
        pull = size * np.sin(2.0 * np.pi * time_s / period)
        return wind[0] + direction[0] * pull, wind[1] + direction[1] * pull

    return disturbance


@pytest.mark.parametrize("period", [1.0, 2.0, 6.0, 11.0])
@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.0, -1.0), (0.6, 0.8), (-0.71, 0.71)])
def test_a_swing_shows_within_three_periods(period, direction):
    shows_s, _ = watched(swings(0.85, period, direction=direction), 5.0 * period)
    assert shows_s is not None and period < shows_s < 3.0 * period


def test_a_small_one_does_not():
    assert watched(swings(0.49 * TURN_M_S2, 2.0), 60.0)[0] is None


def test_nor_does_what_turns_round_more_slowly():
    assert watched(swings(3.0, 2.2 * LONGEST_TURN_S), 120.0)[0] is None


def test_nor_do_loads_that_come_and_go_beside_the_centre():
    """A step every ten seconds, to one side and back."""
    assert watched(lambda t: (2.0 * (int(t / 10.0) % 2), 0.0), 120.0)[0] is None


@pytest.mark.parametrize("seed", range(20))
def test_nor_do_gusts(seed):
    """Of 4 m/s that last a second, at a drag of 1 N s/m on 10 kg, as an observer of 6 rad/s finds them."""
    generator, lags = np.random.default_rng(seed), np.zeros((4, 2))
    keep, follow = np.exp(-DT), 1.0 - np.exp(-6.0 * DT)

    def disturbance(_):
        lags[0] = keep * lags[0] + 0.4 * np.sqrt(1.0 - keep**2) * generator.standard_normal(2)
        for k in (1, 2, 3):
            lags[k] += follow * (lags[k - 1] - lags[k])
        return 1.0 + lags[3, 0], lags[3, 1]

    assert watched(disturbance, 120.0)[0] is None


@pytest.mark.parametrize("direction", [(1.0, 0.0), (0.71, -0.71)])
def test_a_quick_one_shows_when_it_is_smaller(direction):
    """On half a metre of rope the observer shows a third of the pull."""
    shows_s, swing = watched(swings(0.45, 1.2, (0.4, -0.7), direction), 10.0)
    assert shows_s is not None and shows_s < 4.0 * 1.2
    assert swing.slow.count == 0
    now = np.array(swings(0.45, 1.2, (0.4, -0.7), direction)(shows_s))
    assert steady_part(swing, now) == pytest.approx([0.4, -0.7], abs=0.1)


@pytest.mark.parametrize(("size", "period"), [(0.39, 1.2), (0.45, 1.7)])
def test_a_small_one_and_a_slow_one_do_not(size, period):
    assert watched(swings(size, period), 60.0)[0] is None


def test_what_does_not_swing_is_told_apart():
    """The wind along both axes, of which one swings."""
    shows_s, swing = watched(swings(1.2, 2.0, wind=(0.4, -0.7)), 20.0)
    now = np.array(swings(1.2, 2.0, wind=(0.4, -0.7))(shows_s))
    assert abs(now[0] - 0.4) > 0.2  # the moment itself would not do
    assert steady_part(swing, now) == pytest.approx([0.4, -0.7], abs=0.05)
    assert steady_part(NO_SWING, now) == pytest.approx(now)


def test_and_from_a_swing_between_the_axes():
    """Along neither axis would it show."""
    push = swings(0.9, 2.0, wind=(0.4, -0.7), direction=(0.71, 0.71))
    shows_s, swing = watched(push, 20.0)
    assert shows_s is not None and max(swing.slow.x.count, swing.slow.y.count) == 0
    assert steady_part(swing, np.array(push(shows_s))) == pytest.approx([0.4, -0.7], abs=0.05)


@pytest.mark.parametrize(
    ("speed", "period", "ends_s"), [(1.6, 1.0, 4.5), (4.0, 0.4, 2.0), (1.45, 1.0, None), (3.0, 1.5, None)]
)
@pytest.mark.parametrize("course", [(0.0, 0.0), (3.0, -2.0)])
def test_a_vehicle_that_is_thrown_in_circles_is_told_from_one_that_swings(speed, period, ends_s, course):
    """Eight turns by 3 m/s, each within 0.7 s, wherever the vehicle is going."""
    whirl, found_s = NO_PLANE_TURNS, None
    for k in range(3000):
        angle = 2.0 * np.pi * k * DT / period
        velocity = course[0] + speed * np.cos(angle), course[1] + speed * np.sin(angle), 0.0
        whirl = watch_whirl(whirl, velocity, DT)
        if found_s is None and whirls(whirl):
            found_s = k * DT
    assert found_s is None if ends_s is None else found_s is not None and found_s < ends_s
