"""A set point without what would make a load swing: gone at its frequency, there in the end, never beyond."""

from math import cos, pi, sin

import numpy as np
import pytest

from kffa_offboard.offboard.profile import plan_profile, profile_altitude
from kffa_offboard.offboard.sway import ARRIVING, Sway, without_sway

W = 1.8
DT = 0.01


def moved(offsets, frequency=W, dt=DT):
    """The set points (n, 2) that come of these (n, 2)."""
    sway, out = Sway(tuple(offsets[0])), []
    for offset in offsets:
        sway, smooth = without_sway(sway, frequency, tuple(offset), dt)
        out.append(smooth)
    return np.array(out)


def test_what_moves_with_the_loads_own_frequency_is_taken_out():
    times = np.arange(0.0, 40.0, DT)
    swaying = np.array([[cos(W * t), 0.5 * sin(W * t)] for t in times])
    assert np.abs(moved(swaying)[2000:]).max() < 0.02
    slow = np.array([[sin(0.1 * W * t), 0.0] for t in times])
    assert np.abs(moved(slow)[2000:, 0]).max() == pytest.approx((1 - 0.01) / (1 + 0.01), rel=0.01)


def test_a_move_arrives_without_going_beyond_and_without_turning_back():
    profile = plan_profile(0.0, 10.0, 2.0, 1.0, 0.0)
    way = np.array([profile_altitude(profile, t) for t in np.arange(0.0, 20.0, DT)])
    out = moved(np.stack([way, -0.5 * way], axis=1))
    assert out[-1] == pytest.approx([10.0, -5.0], abs=1e-6)
    assert out[:, 0].max() <= 10.0 + 1e-9 and out[:, 1].min() >= -5.0 - 1e-9
    arrived = np.flatnonzero(out[:, 0] > 9.9)[0] * DT
    assert profile.duration < arrived < profile.duration + ARRIVING / W


def test_a_load_on_a_rope_that_hangs_from_it_swings_a_third_and_rests_when_it_has_arrived():
    """Pendulum below a hook that moves exactly so: theta'' = -(g/L) theta - x''/L."""
    length = 9.81 / W**2
    profile = plan_profile(0.0, 10.0, 2.0, 1.0, 0.0)
    dt = 0.002
    way = np.array([[profile_altitude(profile, t), 0.0] for t in np.arange(0.0, 16.0, dt)])
    largest = []
    for hook in (way[:, 0], moved(way, dt=dt)[:, 0]):
        acceleration = np.diff(hook, 2) / dt**2
        angle = rate = 0.0
        angles = []
        for a in acceleration:
            rate -= dt * (W**2 * angle + a / length)
            angle += dt * rate
            angles.append(abs(angle))
        largest.append((max(angles), max(angles[-round(2.0 * pi / W / dt) :])))
    (swung, left), (swings, rests) = largest
    assert swings < 0.45 * swung and rests < 0.02 * left


def test_samples_that_come_late_make_no_difference():
    offsets = np.repeat([[0.0, 0.0], [1.0, 2.0]], 50, axis=0)
    twice = np.repeat(offsets, 2, axis=0)
    assert moved(offsets, dt=0.02)[-1] == pytest.approx(moved(twice, dt=0.01)[-1], abs=1e-12)
