"""Does a scenario fit the limits, and who commands what? Checked before anything flies."""

from __future__ import annotations

from math import ceil, degrees
from typing import TYPE_CHECKING

from kffa_offboard.offboard.course import course_problem
from kffa_offboard.offboard.segments import (
    Altitude,
    Land,
    Move,
    Segment,
    Sine,
    Step,
    Takeoff,
    Triangle,
    check_scenario,
)
from kffa_offboard.offboard.sway import ARRIVING

if TYPE_CHECKING:
    from kffa_offboard.offboard.settings import FlightSettings, LimitSettings, PositionSettings


def check_fits(
    segments: tuple[Segment, ...],
    limits: LimitSettings,
    flight: FlightSettings,
    ring: PositionSettings | None,
) -> None:
    """Refuse a scenario that the service would not fly.

    Raises
    ------
    ValueError
        One line that names the segment or key, the value and the remedy.
    """
    check_scenario(segments)
    for segment in segments:
        _check_altitude(segment, limits)
    problem = course_problem(segments, limits.bounds, None)
    if problem is not None:
        raise ValueError(f"scenario {problem}")
    if ring is not None and ring.tilt_max_rad > limits.tilt_max_rad + 1e-9:
        raise ValueError(
            f"position.tilt_max_deg = {degrees(ring.tilt_max_rad):g}: is above limits.tilt_max_deg "
            f"= {degrees(limits.tilt_max_rad):g}; lower the one or raise the other"
        )
    for k, segment in enumerate(segments, start=1):
        _check_roll_and_pitch(k, segment, flight, ring)


def _check_altitude(segment: Segment, limits: LimitSettings) -> None:
    if isinstance(segment, (Takeoff, Altitude)) and segment.altitude_m >= limits.altitude_max_m:
        name = "take-off altitude" if isinstance(segment, Takeoff) else "altitude"
        raise ValueError(
            f"{name} {segment.altitude_m} m is not below limits.altitude_max_m = "
            f"{limits.altitude_max_m} m; lower the one or raise the other"
        )
    if isinstance(segment, Land) and limits.altitude_min_m >= 0.0:
        raise ValueError(
            f"limits.altitude_min_m = {limits.altitude_min_m} m makes landing a failsafe; set it below zero"
        )


def _check_roll_and_pitch(
    k: int, segment: Segment, flight: FlightSettings, ring: PositionSettings | None
) -> None:
    """Who commands them: the position ring or the scenario, never both."""
    if isinstance(segment, Move):
        if ring is None:
            raise ValueError(
                f"scenario segment {k} (move): needs the position ring; set [position] enabled = true"
            )
        needed, why = segment.profile(flight.acceleration_m_s2).duration, ""
        if ring.sway_rad_s > 0.0:
            needed, why = needed + ARRIVING / ring.sway_rad_s, " on that rope"
        if segment.duration_s < needed:
            raise ValueError(
                f"scenario segment {k} (move): duration_s = {segment.duration_s:g} is too short at "
                f"speed_m_s = {segment.speed_m_s:g} and flight.acceleration_m_s2 = "
                f"{flight.acceleration_m_s2:g}{why}; give at least {ceil(10.0 * needed) / 10.0:g}"
            )
    if ring is None or not isinstance(segment, (Step, Triangle, Sine)):
        return
    if segment.channel in ("roll", "pitch"):
        raise ValueError(
            f"scenario segment {k}: {segment.channel} is commanded by the position ring; remove the "
            "segment or set [position] enabled = false"
        )
