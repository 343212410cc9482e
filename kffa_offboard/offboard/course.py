"""Where a scenario leads: whether it would leave the limits of height, climb rate or place, in advance."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import hypot, pi

from kffa_offboard.offboard.segments import Altitude, Land, Move, Segment, Sine, Step, Takeoff, Triangle


@dataclass(frozen=True, slots=True)
class Bounds:
    """Limits of what may be asked for: height [m above ground], its change [m/s], places [m from the start].

    `fence` is the radius that people gave, `reach` how far places may lie.
    """

    lowest: float
    highest: float
    climb_rate: float
    fence: float
    reach: float


def course_problem(segments: tuple[Segment, ...], bounds: Bounds, height: float | None) -> str | None:
    """The first segment that would leave the bounds, in a line for people, or None.

    `height` [m] is where the scenario begins; None: not known, heights then count from the first take-off on.
    """
    north = east = 0.0
    for k, segment in enumerate(segments, start=1):
        where = f"segment {k} ({type(segment).__name__.lower()}):"
        rate = _climb_rate(segment)
        if rate > bounds.climb_rate:
            limit = f"limits.climb_rate_setpoint_max_m_s = {bounds.climb_rate:g}"
            return f"{where} climbs or sinks at {rate:.3g} m/s, {limit}"
        if isinstance(segment, Move):
            north, east = north + segment.north_m, east + segment.east_m
            if hypot(north, east) > bounds.reach:
                away = f"leads {hypot(north, east):.1f} m away"
                return (
                    f"{where} {away}, {bounds.reach:g} possible with limits.fence_radius_m = {bounds.fence:g}"
                )
        if isinstance(segment, (Takeoff, Altitude)):
            height = segment.altitude_m
        if height is None:
            continue
        for asked in _heights(segment, height):
            if not bounds.lowest < asked < bounds.highest:
                return f"{where} goes to {asked:.1f} m, outside {bounds.lowest:g} .. {bounds.highest:g} m"
    return None


def _climb_rate(segment: Segment) -> float:
    """Fastest change of height that a segment asks for, m/s; a step has none of its own."""
    match segment:
        case Takeoff() | Altitude():
            return segment.climb_rate_m_s
        case Land():
            return segment.descent_rate_m_s
        case Sine(channel="altitude"):
            return abs(2.0 * pi * segment.amplitude / segment.period_s)
        case Triangle(channel="altitude"):
            return abs(4.0 * segment.amplitude / segment.period_s)
        case _:
            return 0.0


def _heights(segment: Segment, height: float) -> Iterator[float]:
    """Heights that a segment asks for, m."""
    match segment:
        case Takeoff() | Altitude():
            yield segment.altitude_m
        case Step(channel="altitude"):
            yield height + segment.amplitude
        case Sine(channel="altitude") | Triangle(channel="altitude"):
            yield height + abs(segment.amplitude)
            yield height - abs(segment.amplitude)
        case _:
            yield from ()
