"""Setpoints from outside: how a place is gone to, and how long an attitude lasts.

A place is approached on profiles with the same acceleration as the moves of a scenario, from the present set
point and, if that is moving, with its speed. From rest the way is a straight line.
"""

from __future__ import annotations

from math import hypot, isfinite
from typing import TypeAlias

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.offboard.events import AttitudeSetpoint, PositionSetpoint, Vector3
from kffa_offboard.offboard.flight import Directive
from kffa_offboard.offboard.profile import Profile, plan_profile, profile_altitude, profile_speed
from kffa_offboard.offboard.reference import Offset, ScenarioState
from kffa_offboard.offboard.settings import FlightSettings, ServiceSettings

Axes: TypeAlias = tuple[Profile | None, Profile | None, Profile | None]
_AT_REST_M_S = 0.01
_SAME_M = 1e-3


class External(Struct, frozen=True, gc=False):
    """What was asked for last.

    Attributes
    ----------
    axes, begun_us : ways along x, y and z [m from the estimator's origin], and when they began
    yaw : rad, heading; None leaves it
    attitude, attitude_us : rad, and when it arrived; None for level
    """

    axes: Axes = (None, None, None)
    begun_us: int = 0
    yaw: float | None = None
    attitude: Vector3 | None = None
    attitude_us: int = 0


def refusal(
    settings: ServiceSettings,
    setpoint: PositionSetpoint | AttitudeSetpoint,
    ground: float,
    centre: tuple[float, float],
) -> str | None:
    """Why a setpoint cannot be flown.

    `ground` [m] is what the limits of altitude count from, `centre` [m] what the fence does.
    """
    if isinstance(setpoint, AttitudeSetpoint):
        if not all(map(isfinite, setpoint.attitude)):
            return "attitude is not finite"
        ring = settings.position is not None
        return "roll and pitch are the position ring's" if ring else None
    x, y, z = setpoint.position
    numbers = [value for value in (x, y, z, setpoint.yaw) if value is not None]
    if not all(map(isfinite, numbers)):
        return "position is not finite"
    if x is not None and settings.position is None:
        return "x and y need [position] enabled"
    if x is not None and y is not None:
        away, limits = hypot(x - centre[0], y - centre[1]), settings.limits
        if away > limits.fence_radius_m - limits.fence_margin_m:
            return f"{away:.0f} m away, fence at {limits.fence_radius_m:g}"
    lowest, highest = settings.limits.altitude_min_m, settings.limits.altitude_max_m
    if z is not None and not lowest < z - ground < highest:
        return f"altitude {z - ground:.0f} m is outside {lowest:g} .. {highest:g}"
    return None


def go_to(
    settings: FlightSettings,
    before: External | None,
    setpoint: PositionSetpoint,
    here: Vector3,
    time_us: int,
) -> External:
    """Go there from the set point `here` [m]. The place that is being gone to already changes nothing."""
    yaw = setpoint.yaw if setpoint.yaw is not None or before is None else before.yaw
    axes = (None, None, None) if before is None else before.axes
    if before is not None and _same(before.axes, setpoint):
        return replace(before, yaw=yaw, attitude=None)
    elapsed = 0.0 if before is None else (time_us - before.begun_us) * 1e-6
    speeds = [0.0 if axis is None else profile_speed(axis, elapsed) for axis in axes]
    goals = [
        wish if wish is not None else _goal(axis) for wish, axis in zip(setpoint.position, axes, strict=True)
    ]
    ways = [0.0 if goal is None else goal - start for goal, start in zip(goals, here, strict=True)]
    across = hypot(ways[0], ways[1])
    # From rest both share one profile along the line; in motion each brakes for itself.
    straight = across > 0.0 and max(map(abs, speeds[:2])) < _AT_REST_M_S
    planned: list[Profile | None] = []
    for k, goal in enumerate(goals):
        if goal is None:
            planned.append(None)
            continue
        share = abs(ways[k]) / across if straight and k < 2 else 1.0
        speed = settings.setpoint_climb_rate_m_s if k == 2 else settings.setpoint_speed_m_s
        share = max(share, 1e-6)
        planned.append(
            plan_profile(here[k], goal, share * speed, share * settings.acceleration_m_s2, speeds[k])
        )
    return External((planned[0], planned[1], planned[2]), time_us, yaw)


def _goal(axis: Profile | None) -> float | None:
    return None if axis is None else axis.target


def _same(axes: Axes, setpoint: PositionSetpoint) -> bool:
    """All that is asked for is being gone to."""
    wishes = [(axis, wish) for axis, wish in zip(axes, setpoint.position, strict=True) if wish is not None]
    return all(axis is not None and abs(axis.target - wish) < _SAME_M for axis, wish in wishes)


def lean(before: External | None, setpoint: AttitudeSetpoint, time_us: int) -> External:
    """Fly with this attitude from now on; the way to a height goes on."""
    before = before or External()
    return replace(before, yaw=setpoint.attitude[2], attitude=setpoint.attitude, attitude_us=time_us)


def hold(external: External, scenario: ScenarioState, captured: Offset, time_us: int) -> ScenarioState:
    """The scenario's hold, moved to where the set point is at `time_us`; x and y count from `captured`."""
    elapsed = (time_us - external.begun_us) * 1e-6
    x, y, z = (None if axis is None else profile_altitude(axis, elapsed) for axis in external.axes)
    offset = scenario.offset
    if x is not None and y is not None:
        offset = (x - captured[0], y - captured[1])
    return replace(
        scenario,
        offset=offset,
        hold_altitude=scenario.hold_altitude if z is None else z,
        yaw=scenario.yaw if external.yaw is None else external.yaw,
    )


def leaning(settings: ServiceSettings, external: External, directive: Directive) -> Directive:
    """The directive with the attitude that was asked for, within the limit of tilt."""
    if external.attitude is None:
        return directive
    most = settings.limits.tilt_max_rad
    roll, pitch, yaw = external.attitude
    _, _, _, altitude = directive.reference
    wanted = (min(max(roll, -most), most), min(max(pitch, -most), most), yaw, altitude)
    return replace(directive, reference=wanted)


def expired(settings: FlightSettings, external: External, time_us: int) -> bool:
    """No attitude has come for too long."""
    limit_us = round(settings.setpoint_timeout_s * 1e6)
    return external.attitude is not None and time_us - external.attitude_us > limit_us
