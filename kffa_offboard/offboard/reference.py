"""Where setpoints come from: a scenario is a sequence of segments, a segment a reference over time.

Everything is a pure function of time and of a frozen state. Times are seconds since engaging. A
segment of fixed length ends at its nominal end, whenever the next sample comes, so a scenario
keeps its timing; take-off and landing end when the vehicle has got there (`flight.py` decides
about lift-off and touch-down).
"""

from __future__ import annotations

from math import floor, pi, sin, sqrt
from typing import Literal, TypeAlias

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.offboard.profile import Profile, plan_profile, profile_altitude
from kffa_offboard.offboard.segments import (
    Altitude,
    Channel,
    Gripper,
    Hold,
    Land,
    Move,
    Segment,
    Sine,
    Step,
    Takeoff,
    Triangle,
    Wave,
    check_scenario,
    starts_on_ground,
)
from kffa_offboard.offboard.settings import FlightSettings

__all__ = [
    "Altitude",
    "Channel",
    "Gripper",
    "Hold",
    "Land",
    "Move",
    "Profile",
    "Reference",
    "ScenarioOutput",
    "ScenarioState",
    "Segment",
    "Sine",
    "Step",
    "Takeoff",
    "Triangle",
    "Wave",
    "begin_takeoff",
    "check_scenario",
    "current_segment",
    "plan_profile",
    "profile_altitude",
    "starts_on_ground",
    "step_scenario",
    "wave",
    "wave_duration",
]

Reference: TypeAlias = tuple[float, float, float, float]
Offset: TypeAlias = tuple[float, float]
_CHANNELS: tuple[Channel, ...] = ("roll", "pitch", "yaw", "altitude")


def wave_duration(segment: Wave) -> float:
    """How long a step, triangle or sine lasts, s."""
    if isinstance(segment, Step):
        return segment.duration_s
    return segment.period_s * segment.cycles


def wave(segment: Wave, time_s: float) -> float:
    """Deviation (rad or m) of a step, triangle or sine `time_s` after its beginning."""
    match segment:
        case Step():
            return segment.amplitude
        case Sine():
            return segment.amplitude * sin(2.0 * pi * time_s / segment.period_s)
        case Triangle():
            phase = time_s / segment.period_s + 0.25
            return segment.amplitude * (1.0 - abs(4.0 * (phase - floor(phase)) - 2.0))


# --------------------------------------------------------------------------- the player


class ScenarioState(Struct, frozen=True, gc=False):
    """Where a scenario is.

    Attributes
    ----------
    hold_altitude : m, kept by holds, base of altitude waves
    yaw : rad, heading at engaging
    ground : m, altitude that take-off and landing count from
    segment_index, started_s : current segment and its nominal beginning
    profile : of the current take-off or change of altitude
    near_since_s : since when the vehicle is where that ends
    descent_rate : m/s, momentary speed of the landing reference, positive down
    last_s : time of the last step
    offset : m, x and y of the set point from where the position was captured (position ring)
    origin : m, the same when the current segment began
    """

    hold_altitude: float
    yaw: float
    ground: float
    segment_index: int = 0
    started_s: float = 0.0
    profile: Profile | None = None
    near_since_s: float | None = None
    descent_rate: float = 0.0
    last_s: float = 0.0
    offset: Offset = (0.0, 0.0)
    origin: Offset = (0.0, 0.0)


class ScenarioOutput(Struct, frozen=True, gc=False):
    """What the scenario wants now.

    Attributes
    ----------
    reference : roll, pitch, yaw [rad], altitude [m]
    gripper : actions that fall due in this step
    done : the last segment has ended
    fault : why the scenario cannot go on
    """

    reference: Reference
    gripper: tuple[Literal["grab", "release"], ...] = ()
    done: bool = False
    fault: str | None = None


def current_segment(segments: tuple[Segment, ...], state: ScenarioState) -> Segment | None:
    """The segment that is being flown; None after the last one."""
    return segments[state.segment_index] if state.segment_index < len(segments) else None


def begin_takeoff(
    settings: FlightSettings,
    segment: Takeoff | Altitude,
    state: ScenarioState,
    now_s: float,
    altitude: float,
    climb_rate: float,
) -> ScenarioState:
    """Start to go to another altitude at `now_s` from `altitude` [m] and `climb_rate` [m/s]."""
    profile = plan_profile(
        altitude,
        state.ground + segment.altitude_m,
        segment.climb_rate_m_s,
        settings.acceleration_m_s2,
        climb_rate,
    )
    return replace(state, started_s=now_s, profile=profile, near_since_s=None, hold_altitude=altitude)


def step_scenario(
    settings: FlightSettings,
    segments: tuple[Segment, ...],
    state: ScenarioState,
    now_s: float,
    altitude: float,
    grounded: bool = False,
) -> tuple[ScenarioState, ScenarioOutput]:
    """Advance the scenario to `now_s`; `altitude` is the measured one.

    On the ground (`grounded`) it stops before a take-off: lift-off is `flight.py`'s.
    """
    actions: list[Literal["grab", "release"]] = []
    while True:
        segment = current_segment(segments, state)
        if segment is None or (grounded and isinstance(segment, Takeoff)):
            level = _level(state)
            done = segment is None and len(segments) > 0
            return replace(state, last_s=now_s), ScenarioOutput(level, tuple(actions), done)
        if isinstance(segment, Gripper):
            actions.append(segment.action)
            state = _next(state, state.started_s)
            continue
        if isinstance(segment, (Takeoff, Altitude)) and state.profile is None:
            state = begin_takeoff(settings, segment, state, state.started_s, state.hold_altitude, 0.0)
        state, reference, ended_s, fault = _step_segment(settings, segment, state, now_s, altitude)
        if ended_s is None or fault is not None:
            state = replace(state, last_s=now_s)
            return state, ScenarioOutput(reference, tuple(actions), False, fault)
        state = _next(state, ended_s)


def _level(state: ScenarioState) -> Reference:
    return (0.0, 0.0, state.yaw, state.hold_altitude)


def _next(state: ScenarioState, ended_s: float) -> ScenarioState:
    return replace(
        state,
        segment_index=state.segment_index + 1,
        started_s=ended_s,
        profile=None,
        near_since_s=None,
        descent_rate=0.0,
        origin=state.offset,
    )


_Progress: TypeAlias = tuple[ScenarioState, Reference, float | None, str | None]


def _step_segment(
    settings: FlightSettings, segment: Segment, state: ScenarioState, now_s: float, altitude: float
) -> _Progress:
    """State, reference, time at which the segment ended (None: it goes on), fault."""
    match segment:
        case Hold():
            ends = state.started_s + segment.duration_s
            return state, _level(state), ends if now_s >= ends else None, None
        case Takeoff() | Altitude():
            return _step_takeoff(settings, segment, state, now_s, altitude)
        case Land():
            return _step_land(settings, segment, state, now_s, altitude)
        case Move():
            return _step_move(settings, segment, state, now_s)
        case Step() | Triangle() | Sine():
            ends = state.started_s + wave_duration(segment)
            if now_s >= ends:
                return state, _level(state), ends, None
            reference = list(_level(state))
            reference[_CHANNELS.index(segment.channel)] += wave(segment, now_s - state.started_s)
            return state, (reference[0], reference[1], reference[2], reference[3]), None, None
        case Gripper():
            return state, _level(state), now_s, None


def _step_move(settings: FlightSettings, segment: Move, state: ScenarioState, now_s: float) -> _Progress:
    """The set point goes its straight line and stays at the end; it is there when the segment ends."""
    ends = state.started_s + segment.duration_s
    profile = segment.profile(settings.acceleration_m_s2)
    elapsed = min(now_s, ends) - state.started_s
    share = profile_altitude(profile, elapsed) / profile.target if profile.target > 0.0 else 0.0
    offset = (state.origin[0] + share * segment.north_m, state.origin[1] - share * segment.east_m)
    state = replace(state, offset=offset)
    return state, _level(state), ends if now_s >= ends else None, None


def _step_takeoff(
    settings: FlightSettings, segment: Takeoff | Altitude, state: ScenarioState, now_s: float, altitude: float
) -> _Progress:
    profile = state.profile
    assert profile is not None
    elapsed = now_s - state.started_s
    near_since: float | None = now_s if state.near_since_s is None else state.near_since_s
    if elapsed < profile.duration or abs(altitude - profile.target) > settings.arrival_tolerance_m:
        near_since = None
    state = replace(state, hold_altitude=profile_altitude(profile, elapsed), near_since_s=near_since)
    if near_since is not None and now_s - near_since >= settings.arrival_time_s:
        return state, _level(state), now_s, None
    fault = None
    if near_since is None and elapsed > profile.duration + settings.arrival_timeout_s:
        what = "take-off" if isinstance(segment, Takeoff) else "altitude"
        fault = f"{what} stuck at {altitude:.1f} of {profile.target:.1f} m"
    return state, _level(state), None, fault


def _step_land(
    settings: FlightSettings, segment: Land, state: ScenarioState, now_s: float, altitude: float
) -> _Progress:
    """Descend, slowing down in time for the last metre; never ends by itself."""
    dt = max(now_s - max(state.last_s, state.started_s), 0.0)
    height = max(state.hold_altitude - state.ground - settings.slow_height_m, 0.0)
    slow = min(settings.slow_descent_rate_m_s, segment.descent_rate_m_s)
    allowed = min(segment.descent_rate_m_s, sqrt(slow**2 + 2.0 * settings.acceleration_m_s2 * height))
    rate = min(state.descent_rate + settings.acceleration_m_s2 * dt, allowed)
    wanted = max(state.hold_altitude - rate * dt, altitude - settings.landing_lead_m)
    # The lead bound may not raise the reference again.
    wanted = min(wanted, state.hold_altitude)
    state = replace(state, hold_altitude=wanted, descent_rate=rate)
    return state, _level(state), None, None
