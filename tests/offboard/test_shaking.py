"""Thrust that goes from end to end several times a second ends control; noise and slow swings do not."""

import numpy as np
import pytest

from kffa_offboard.offboard.settings import LimitSettings
from kffa_offboard.offboard.shaking import watch_thrust
from kffa_offboard.offboard.turns import NO_TURNS

DT = 0.01
LIMITS = LimitSettings()
"""Thrust from 0.05 to 0.95."""


def shows_after(thrust, seconds=10.0, limits=LIMITS):
    """When it is a fault, s, or None."""
    turns = NO_TURNS
    for k in range(round(seconds / DT)):
        turns, fault = watch_thrust(turns, limits, float(thrust(k * DT)), DT)
        if fault is not None:
            assert fault == "thrust shakes from end to end"
            return k * DT
    return None


def square(size, omega):
    return lambda t: 0.5 + size * np.sign(np.sin(omega * t) + 1e-9)


@pytest.mark.parametrize("omega", [17.0, 25.0, 60.0])
def test_from_limit_to_limit_shows_within_ten_turns(omega):
    assert shows_after(square(0.45, omega)) == pytest.approx(10.0 * np.pi / omega, abs=1.5 * np.pi / omega)


def test_half_of_the_range_and_less_does_not():
    assert shows_after(square(0.22, 25.0)) is None
    assert shows_after(square(0.22, 25.0), limits=LimitSettings(thrust_min=0.3, thrust_max=0.9)) is not None


def test_nor_does_what_turns_more_slowly():
    """A height that swings on a slow link."""
    assert shows_after(square(0.45, 10.0), 30.0) is None


def test_nor_do_a_few_turns_when_a_load_comes_and_goes():
    assert shows_after(lambda t: square(0.45, 25.0)(t) if t % 2.0 < 0.6 else 0.5, 30.0) is None


def test_nor_does_noise():
    """Of 0.1 rms in each setpoint, twice what the quickest gains of the comparison send."""
    generator = np.random.default_rng(0)
    assert shows_after(lambda _: 0.45 + 0.1 * generator.standard_normal(), 120.0) is None
