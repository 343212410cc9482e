"""One flight from engaging to the end of its scenario: ground, thrust ramp, air, touch-down.

A pure step function. On the ground and in both thrust ramps the collective thrust is given here
and the attitude is held level; in the air the controller flies the scenario's reference.
"""

from __future__ import annotations

from enum import Enum
from typing import Literal

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.offboard.reference import (
    Land,
    Offset,
    Reference,
    ScenarioState,
    Segment,
    Takeoff,
    begin_takeoff,
    current_segment,
    step_scenario,
)
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.state import Finished


class Phase(Enum):
    """Who decides about thrust."""

    GROUND = "ground"  # thrust zero
    RAMP = "ramp"  # thrust grows until lift-off
    AIR = "air"  # the controller
    TOUCHDOWN = "touchdown"  # thrust goes to zero


GROUND, RAMP, AIR, TOUCHDOWN = Phase
"""The same, see `state.WAITING`."""


class Ending(Enum):
    """How a flight ends."""

    LANDED = "landed"
    IN_AIR = "in air"
    FAULT = "fault"


class FlightState(Struct, frozen=True, gc=False):
    """Where a flight is.

    Attributes
    ----------
    scenario : reference state
    started_us : engaging; scenario time counts from here
    phase, phase_us : and since when
    seen_in_air : the autopilot has reported "in the air" during this flight
    slow_since_us : since when everything looks like touch-down
    touchdown_thrust : where the final ramp began
    outcome : how a flight whose take-off was abandoned has ended, None for as its scenario says
    """

    scenario: ScenarioState
    started_us: int
    phase: Phase
    phase_us: int
    seen_in_air: bool = False
    slow_since_us: int | None = None
    touchdown_thrust: float = 0.0
    outcome: Finished | None = None


class FlightSample(Struct, frozen=True, gc=False):
    """What a flight needs to know in each step.

    Attributes
    ----------
    time_us : arrival time
    altitude, climb_rate : m (estimate: one noisy sample must not set the ground level), m/s (measured)
    thrust, vertical_thrust : last command, collective and its vertical part
    on_ground : the autopilot's landed state, None if it never said
    powered_us : from when thrust reaches the motors (armed and spooled up), None while disarmed
    """

    time_us: int
    altitude: float
    climb_rate: float
    thrust: float
    vertical_thrust: float
    on_ground: bool | None
    powered_us: int | None


class Directive(Struct, frozen=True, gc=False):
    """What is to be done in this step.

    Attributes
    ----------
    reference : for the controller
    ground_thrust : collective thrust with level attitude instead of the controller's command
    align : the reference generators start from the estimates, the position is captured
    offset : m, x and y of the set point from where the position was captured (position ring)
    gripper : actions that fall due
    ending : the flight is over
    reason : why, if it ended in a fault
    """

    reference: Reference
    ground_thrust: float | None = None
    align: bool = False
    gripper: tuple[Literal["grab", "release"], ...] = ()
    ending: Ending | None = None
    reason: str | None = None
    offset: Offset = (0.0, 0.0)


def begin_flight(time_us: int, airborne: bool, altitude: float, yaw: float) -> FlightState:
    """A flight that begins here: on the ground at `altitude`, or in the air (ground level then is 0)."""
    ground = 0.0 if airborne else altitude
    scenario = ScenarioState(hold_altitude=altitude, yaw=yaw, ground=ground)
    return FlightState(scenario, time_us, AIR if airborne else GROUND, time_us)


def start_scenario(state: FlightState, time_us: int) -> FlightState:
    """Count scenario time from now."""
    return replace(state, started_us=time_us, phase_us=time_us)


def hold_here(state: FlightState, altitude: float, offset: Offset) -> FlightState:
    """Keep this altitude and horizontal set point from now on (fly it with an empty scenario)."""
    return replace(state, scenario=replace(state.scenario, hold_altitude=altitude, offset=offset))


def abandon_takeoff(state: FlightState, time_us: int, thrust: float, outcome: Finished) -> FlightState:
    """Take thrust back from `thrust` to zero; the flight then ends on the ground, with `outcome`."""
    return replace(state, phase=TOUCHDOWN, phase_us=time_us, touchdown_thrust=thrust, outcome=outcome)


def stands(state: FlightState, on_ground: bool | None) -> bool:
    """On the ground, as far as can be told: not lifted off yet, in a thrust ramp, or touch-down shows.

    `on_ground` is the autopilot's landed state.
    """
    touched_down = state.slow_since_us is not None and state.seen_in_air and on_ground is True
    return state.phase is not AIR or touched_down


def step_flight(
    settings: ServiceSettings, segments: tuple[Segment, ...], state: FlightState, sample: FlightSample
) -> tuple[FlightState, Directive]:
    """One step; `segments` is the scenario, or empty to hold."""
    if state.phase is AIR:
        return _step_air(settings, segments, state, sample)
    if state.phase is TOUCHDOWN:
        return _step_touchdown(settings, state, sample)
    step = _step_ground if state.phase is GROUND else _step_ramp
    return step(settings, segments, state, sample)


def _level(state: FlightState) -> Reference:
    return (0.0, 0.0, state.scenario.yaw, state.scenario.hold_altitude)


def _seconds(state: FlightState, time_us: int) -> float:
    return (time_us - state.started_us) * 1e-6


def _step_ground(
    settings: ServiceSettings, segments: tuple[Segment, ...], state: FlightState, sample: FlightSample
) -> tuple[FlightState, Directive]:
    scenario, wanted = step_scenario(
        settings.flight,
        segments,
        state.scenario,
        _seconds(state, sample.time_us),
        sample.altitude,
        grounded=True,
    )
    state = replace(state, scenario=scenario)
    powered = sample.powered_us is not None and sample.time_us >= sample.powered_us
    if powered and isinstance(current_segment(segments, scenario), Takeoff):
        # Ground level is taken at the last moment: estimates drift while standing.
        scenario = replace(scenario, ground=sample.altitude, hold_altitude=sample.altitude)
        state = replace(state, scenario=scenario, phase=RAMP, phase_us=sample.time_us)
    ending = Ending.LANDED if wanted.done else None
    return state, Directive(_level(state), 0.0, align=True, gripper=wanted.gripper, ending=ending)


def _step_ramp(
    settings: ServiceSettings, segments: tuple[Segment, ...], state: FlightState, sample: FlightSample
) -> tuple[FlightState, Directive]:
    flight, scenario = settings.flight, state.scenario
    elapsed = (sample.time_us - state.phase_us) * 1e-6
    thrust = min(flight.ramp_rate_per_s * elapsed, settings.limits.thrust_max)
    lifted = thrust >= flight.liftoff_thrust_fraction * settings.hover_thrust and (
        sample.climb_rate > flight.liftoff_climb_rate_m_s
        or sample.altitude > scenario.ground + flight.liftoff_height_m
    )
    if lifted:
        segment = current_segment(segments, scenario)
        assert isinstance(segment, Takeoff)
        climb_rate = max(sample.climb_rate, 0.0)
        start = sample.altitude + settings.reference_lag_s * climb_rate
        now_s = _seconds(state, sample.time_us)
        scenario = begin_takeoff(flight, segment, scenario, now_s, start, climb_rate)
        state = replace(state, scenario=scenario, phase=AIR, phase_us=sample.time_us)
        return state, Directive(_level(state), align=True)
    if elapsed > flight.liftoff_timeout_s:
        outcome = Finished(False, f"no lift-off at thrust {thrust:.2f}")
        state = abandon_takeoff(state, sample.time_us, thrust, outcome)
    return state, Directive(_level(state), thrust, align=True)


def _step_air(
    settings: ServiceSettings, segments: tuple[Segment, ...], state: FlightState, sample: FlightSample
) -> tuple[FlightState, Directive]:
    if sample.on_ground is False and not state.seen_in_air:
        state = replace(state, seen_in_air=True)
    scenario, wanted = step_scenario(
        settings.flight, segments, state.scenario, _seconds(state, sample.time_us), sample.altitude
    )
    state = replace(state, scenario=scenario)
    if wanted.fault is not None:
        return state, Directive(wanted.reference, ending=Ending.FAULT, reason=wanted.fault)
    if isinstance(current_segment(segments, scenario), Land):
        state = _watch_touchdown(settings, state, sample)
        if state.phase is TOUCHDOWN:
            return state, Directive(wanted.reference, state.touchdown_thrust, align=True)
    ending = Ending.IN_AIR if wanted.done else None
    directive = Directive(wanted.reference, gripper=wanted.gripper, ending=ending, offset=scenario.offset)
    return state, directive


def _watch_touchdown(settings: ServiceSettings, state: FlightState, sample: FlightSample) -> FlightState:
    """Touch-down: little thrust (or the autopilot says so) and no movement, for a while.

    "On ground" of the autopilot counts only after it has said "in the air" in this flight: an old report
    from before take-off must not stop the motors in the air.
    """
    flight = settings.flight
    landed = sample.vertical_thrust < flight.touchdown_thrust_fraction * settings.hover_thrust or (
        state.seen_in_air and sample.on_ground is True
    )
    if not landed or abs(sample.climb_rate) >= flight.touchdown_climb_rate_m_s:
        return replace(state, slow_since_us=None)
    since = state.slow_since_us if state.slow_since_us is not None else sample.time_us
    if sample.time_us - since < round(flight.touchdown_time_s * 1e6):
        return replace(state, slow_since_us=since)
    return replace(state, phase=TOUCHDOWN, phase_us=sample.time_us, touchdown_thrust=sample.thrust)


def _step_touchdown(
    settings: ServiceSettings, state: FlightState, sample: FlightSample
) -> tuple[FlightState, Directive]:
    left = 1.0 - (sample.time_us - state.phase_us) * 1e-6 / settings.flight.touchdown_ramp_s
    thrust = max(0.0, state.touchdown_thrust * left)
    ending = Ending.LANDED if thrust <= 0.0 else None
    return state, Directive(_level(state), thrust, align=True, ending=ending)
