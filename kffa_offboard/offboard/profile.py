"""Going from one place to another with limited speed and acceleration, along one line."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt


@dataclass(frozen=True, slots=True)
class Profile:
    """Altitude change with limited speed and acceleration (trapezoid of speed).

    Attributes
    ----------
    start, target : m
    initial : m/s, speed at the beginning towards the target
    peak : m/s, speed that is reached
    acceleration : m/s^2
    """

    start: float
    target: float
    initial: float
    peak: float
    acceleration: float

    @property
    def times(self) -> tuple[float, float, float]:
        """Durations of speeding up, cruise and slowing down, s."""
        rise = (self.peak - self.initial) / self.acceleration
        fall = self.peak / self.acceleration
        ramps = (self.peak**2 - self.initial**2 + self.peak**2) / (2.0 * self.acceleration)
        left = abs(self.target - self.start) - ramps
        return rise, max(0.0, left) / self.peak if self.peak > 0.0 else 0.0, fall

    @property
    def duration(self) -> float:
        """Time from start to target, s."""
        return sum(self.times)


def plan_profile(
    start: float, target: float, speed: float, acceleration: float, climb_rate: float
) -> Profile:
    """Plan a change of altitude that begins with the present `climb_rate` (m/s, up positive).

    A speed away from the target, or more than can be braked in time, is left to the controller: the
    profile then begins with the nearest speed that it can have.
    """
    distance = abs(target - start)
    towards = climb_rate if target >= start else -climb_rate
    initial = min(max(towards, 0.0), speed, sqrt(2.0 * acceleration * distance))
    peak = min(speed, sqrt(acceleration * distance + 0.5 * initial**2))
    return Profile(start, target, initial, max(peak, initial), acceleration)


def profile_altitude(profile: Profile, time_s: float) -> float:
    """Altitude of the profile `time_s` after its beginning, m."""
    rise, cruise, fall = profile.times
    if time_s >= rise + cruise + fall:
        return profile.target
    up = min(max(time_s, 0.0), rise)
    level = min(max(time_s - rise, 0.0), cruise)
    down = max(time_s - rise - cruise, 0.0)
    moved = profile.initial * up + 0.5 * profile.acceleration * up**2
    moved += profile.peak * (level + down) - 0.5 * profile.acceleration * down**2
    return profile.start + (moved if profile.target >= profile.start else -moved)


def profile_speed(profile: Profile, time_s: float) -> float:
    """Speed of the profile `time_s` after its beginning, m/s, up positive."""
    rise, cruise, fall = profile.times
    if time_s >= rise + cruise + fall:
        return 0.0
    if time_s < rise:
        speed = profile.initial + profile.acceleration * max(time_s, 0.0)
    else:
        speed = profile.peak - profile.acceleration * max(time_s - rise - cruise, 0.0)
    return speed if profile.target >= profile.start else -speed
