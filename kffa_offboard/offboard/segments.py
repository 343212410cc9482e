"""What a scenario is made of: frozen segments, checked before anything flies.

Roll and pitch amplitudes are absolute (zero is level); yaw and altitude amplitudes count from
the heading at engaging and from the altitude that the previous segment left.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, isfinite
from typing import Literal, TypeAlias

from kffa_offboard.offboard.profile import Profile, plan_profile

Channel: TypeAlias = Literal["roll", "pitch", "yaw", "altitude"]


@dataclass(frozen=True, slots=True)
class Takeoff:
    """Go to `altitude_m` (above the ground on a ground start, else above the estimator's origin)."""

    altitude_m: float
    climb_rate_m_s: float = 1.0


@dataclass(frozen=True, slots=True)
class Altitude:
    """Climb or descend to `altitude_m`, which counts as a take-off's; only in the air."""

    altitude_m: float
    speed_m_s: float = 1.0

    @property
    def climb_rate_m_s(self) -> float:
        """The same under a take-off's name."""
        return self.speed_m_s


@dataclass(frozen=True, slots=True)
class Hold:
    """Keep attitude level, heading and altitude for `duration_s`."""

    duration_s: float


@dataclass(frozen=True, slots=True)
class External(Hold):
    """A hold during which setpoints from outside are followed."""


@dataclass(frozen=True, slots=True)
class Step:
    """Step one channel by `amplitude` (rad or m) for `duration_s`, then step back."""

    channel: Channel
    amplitude: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class Triangle:
    """Triangular wave from zero: up first, `amplitude` (rad or m) at a quarter of `period_s`."""

    channel: Channel
    amplitude: float
    period_s: float
    cycles: float = 1.0


@dataclass(frozen=True, slots=True)
class Sine:
    """Sine wave from zero: up first, `amplitude` (rad or m) at a quarter of `period_s`."""

    channel: Channel
    amplitude: float
    period_s: float
    cycles: float = 1.0


@dataclass(frozen=True, slots=True)
class Move:
    """Go from the present set point `north_m` and `east_m` further, in a straight line, within `duration_s`.

    At most `speed_m_s` fast; needs the position ring.
    """

    north_m: float
    east_m: float
    duration_s: float
    speed_m_s: float = 2.0

    def profile(self, acceleration_m_s2: float) -> Profile:
        """The way along the line, m."""
        distance = hypot(self.north_m, self.east_m)
        return plan_profile(0.0, distance, self.speed_m_s, acceleration_m_s2, 0.0)


@dataclass(frozen=True, slots=True)
class Gripper:
    """Work the gripper; takes no time."""

    action: Literal["grab", "release"]


@dataclass(frozen=True, slots=True)
class Land:
    """Descend at `descent_rate_m_s` until touch-down; the last segment."""

    descent_rate_m_s: float = 0.7


Wave: TypeAlias = Step | Triangle | Sine
Segment: TypeAlias = Takeoff | Altitude | Hold | Wave | Move | Gripper | Land


def _numbers(segment: Segment) -> list[tuple[str, float]]:
    """Names and values of a segment that must be positive."""
    match segment:
        case Takeoff():
            return [("altitude_m", segment.altitude_m), ("climb_rate_m_s", segment.climb_rate_m_s)]
        case Altitude():
            return [("altitude_m", segment.altitude_m), ("speed_m_s", segment.speed_m_s)]
        case Hold() | Step():
            return [("duration_s", segment.duration_s)]
        case Move():
            return [("duration_s", segment.duration_s), ("speed_m_s", segment.speed_m_s)]
        case Triangle() | Sine():
            return [("period_s", segment.period_s), ("cycles", segment.cycles)]
        case Land():
            return [("descent_rate_m_s", segment.descent_rate_m_s)]
        case Gripper():
            return []


def check_scenario(segments: tuple[Segment, ...]) -> None:
    """Refuse a scenario that cannot be flown.

    Raises
    ------
    ValueError
        One line that names the segment (counted from 1), the value and the remedy.
    """
    for k, segment in enumerate(segments, start=1):
        kind = type(segment).__name__.lower()
        for name, value in _numbers(segment):
            if not isfinite(value) or value <= 0.0:
                raise ValueError(f"scenario segment {k} ({kind}): {name} = {value} must be positive")
        if isinstance(segment, (Step, Triangle, Sine)) and not isfinite(segment.amplitude):
            raise ValueError(f"scenario segment {k} ({kind}): amplitude = {segment.amplitude} must be finite")
        if isinstance(segment, Move) and not (isfinite(segment.north_m) and isfinite(segment.east_m)):
            raise ValueError(f"scenario segment {k} (move): north_m and east_m must be finite")
        if isinstance(segment, Land) and k < len(segments):
            raise ValueError(f"scenario segment {k} (land): must be the last one; remove what follows")


def starts_on_ground(segments: tuple[Segment, ...]) -> bool:
    """True if the scenario can begin on the ground: nothing but holds and gripper before a take-off."""
    for segment in segments:
        if isinstance(segment, Takeoff):
            return True
        if not isinstance(segment, (Hold, Gripper)):
            return False
    return False
