"""The position ring in the service: where it holds, what it is told, and when it has gone astray.

Without `ServiceSettings.position` nothing here does anything, and the scenario's roll and pitch references
pass. With it the ring runs at every control step, in shadow, too. Whatever aligns the reference generators
(standing on the ground, lift-off, engaging in the air) also captures the place where the vehicle would
come to rest; from then on that place, moved by the scenario, is held.

A load that swings on a rope would be driven by the ring (`control/pendulum.py`). Where a rope is told, or
the swing shows, another one holds the place while the daemon's setpoints act; at other times the first one
observes. With a rope that is told, the set point moves so that the load does not begin to swing (`sway.py`).
"""

from __future__ import annotations

from math import hypot

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.control import Array, controllers, position
from kffa_offboard.offboard.events import PositionReceived
from kffa_offboard.offboard.flight import Directive
from kffa_offboard.offboard.reference import Offset, Reference
from kffa_offboard.offboard.settings import PositionSettings
from kffa_offboard.offboard.sway import Sway, without_sway
from kffa_offboard.offboard.swinging import (
    NO_SWING,
    Swing,
    steady_part,
    watch_swing,
    watch_whirl,
    whirls,
)
from kffa_offboard.offboard.telemetry import Telemetry
from kffa_offboard.offboard.turns import NO_PLANE_TURNS, PlaneTurns


class HorizontalState(Struct, frozen=True, gc=False):
    """What one step of the ring leaves for the next.

    Attributes
    ----------
    ring : state of the two channels
    captured : m, x and y of the place that was captured
    hold_offset : m, where the vehicle comes to rest if it is told to hold now, from `captured`
    error : m, distance between the tracked set point and the estimate while it is being held, else 0
    swing : the disturbance as far as it may be a load that swings
    whirl : the vehicle's speed as far as a load may throw it to and fro
    swings : there is such a load
    damps : `ring` is the state of the ring that damps
    offset : m, where the ring is told to be, from `captured`
    sway : what keeps that from making a load swing; None without a rope
    """

    ring: controllers.ControllerState
    captured: Offset
    hold_offset: Offset = (0.0, 0.0)
    error: float = 0.0
    swing: Swing = NO_SWING
    whirl: PlaneTurns = NO_PLANE_TURNS
    swings: bool = False
    damps: bool = False
    offset: Offset = (0.0, 0.0)
    sway: Sway | None = None


def flown_ring(settings: PositionSettings, state: HorizontalState) -> position.PositionParameters:
    """Of the two rings the one that `state.ring` is of."""
    return settings.damping if state.damps and settings.damping is not None else settings.ring


def begin_horizontal(settings: PositionSettings | None, known: Telemetry) -> HorizontalState | None:
    """Start the ring at rest at the present measurement; None if there is no ring."""
    if settings is None:
        return None
    assert known.attitude is not None and known.position is not None
    place = known.position.position[:2]
    ring = position.initial_state(settings.ring, np.array(place), _acceleration(settings, known))
    return HorizontalState(ring, place)


def step_horizontal(
    settings: PositionSettings | None,
    state: HorizontalState | None,
    known: Telemetry,
    directive: Directive,
    acting: bool,
    fresh: bool,
    dt: float,
) -> tuple[HorizontalState | None, Reference]:
    """One step of the ring, and the reference of the four channels with its roll and pitch.

    Parameters
    ----------
    acting : the daemon's setpoints act, not the autopilot's own
    fresh : the position is a new sample
    """
    if settings is None or state is None:
        return state, directive.reference
    assert known.attitude is not None and known.position is not None
    grounded = directive.ground_thrust is not None
    # On the ground the gear takes what the attitude gives.
    acceleration = np.zeros(2) if grounded else _acceleration(settings, known)
    state = _with_fitting_ring(settings, state, known, acting)
    parameters = flown_ring(settings, state)
    state = _with_set_point(settings, parameters, state, directive, dt)
    captured = state.captured
    inputs = position.PositionInput(
        reference=np.add(captured, state.offset),
        measurement=np.array(known.position.position[:2]),
        fresh=np.full(2, fresh),
        yaw=known.attitude.attitude[2],
        measured_rate=np.array(known.position.velocity[:2]),
        acceleration=acceleration,
    )
    ring, output = position.step(parameters, state.ring, inputs, dt)
    swing, whirl = NO_SWING, NO_PLANE_TURNS
    if grounded or not acting:
        ring = position.with_applied(parameters, ring, acceleration)
    else:
        whirl = watch_whirl(state.whirl, known.position.velocity, dt)
        if not state.damps and settings.damping is not None:
            swing = watch_swing(state.swing, output.ring.disturbance, dt)
    stop = _stop(settings, parameters, ring)
    away = output.ring.reference - output.ring.estimate
    state = HorizontalState(
        ring,
        captured,
        hold_offset=(stop[0] - captured[0], stop[1] - captured[1]),
        error=0.0 if grounded or not acting else hypot(*away.tolist()),
        swing=swing,
        whirl=whirl,
        swings=state.swings or swing.shows,
        damps=state.damps,
        offset=state.offset,
        sway=state.sway,
    )
    _, _, yaw, altitude = directive.reference
    roll, pitch = (0.0, 0.0) if grounded else output.attitude.tolist()
    return state, (roll, pitch, yaw, altitude)


def _with_set_point(
    settings: PositionSettings,
    parameters: position.PositionParameters,
    state: HorizontalState,
    directive: Directive,
    dt: float,
) -> HorizontalState:
    """Where the ring is to be: from the place that was captured, or is now."""
    ring, captured, offset = state.ring, state.captured, directive.offset
    if directive.align:
        ring = position.align_reference(parameters, ring)
        stop = _stop(settings, parameters, ring)
        captured = (stop[0] - offset[0], stop[1] - offset[1])
    sway = state.sway
    if settings.sway_rad_s > 0.0:
        sway = Sway(offset) if directive.align or sway is None else sway
        sway, offset = without_sway(sway, settings.sway_rad_s, offset, dt)
    return replace(state, ring=ring, captured=captured, offset=offset, sway=sway)


def _with_fitting_ring(
    settings: PositionSettings, state: HorizontalState, known: Telemetry, acting: bool
) -> HorizontalState:
    """The ring that damps goes on from the other one, which begins anew when setpoints act no more."""
    damps = acting and settings.damping is not None and (settings.on_rope or state.swings)
    if damps == state.damps:
        return state
    if settings.damping is None or not damps:
        assert known.position is not None
        place, acceleration = np.array(known.position.position[:2]), _acceleration(settings, known)
        return replace(state, ring=position.initial_state(settings.ring, place, acceleration), damps=False)
    wind = steady_part(state.swing, state.ring.observer.disturbance)
    return replace(state, ring=position.going_on(settings.damping, state.ring, wind), damps=True)


def _acceleration(settings: PositionSettings, known: Telemetry) -> Array:
    """What the measured attitude gives, (2,) m/s^2."""
    assert known.attitude is not None
    return position.acceleration_of(settings.ring.gravity, np.array(known.attitude.attitude))


def _stop(
    settings: PositionSettings, parameters: position.PositionParameters, ring: controllers.ControllerState
) -> Offset:
    """Where the vehicle comes to rest with the braking that is reckoned with, m."""
    (x, y), (vx, vy) = ring.observer.estimate.tolist(), ring.observer.rate.tolist()
    differentiator = parameters.controller.differentiator
    lag = 0.0 if differentiator is None else 2.0 * differentiator.filter_time
    time = lag + 0.5 * hypot(vx, vy) / settings.braking_m_s2
    return x + time * vx, y + time * vy


def position_reference(state: HorizontalState | None) -> tuple[float, float] | None:
    """Where the ring was told to be in the last step, m; None without one."""
    if state is None:
        return None
    return state.captured[0] + state.offset[0], state.captured[1] + state.offset[1]


def astray(settings: PositionSettings | None, state: HorizontalState | None) -> str | None:
    """Say so if the vehicle is too far from its set point (a wrong compass or estimate), or thrown about."""
    if settings is None or state is None:
        return None
    if whirls(state.whirl):
        return "thrown to and fro: the load swings too much"
    return f"{state.error:.1f} m from the set point" if state.error > settings.error_max_m else None


def position_jump(
    settings: PositionSettings | None, last: PositionReceived | None, new: PositionReceived
) -> str | None:
    """Say so if the vehicle is faster, or was moved farther, than it can be."""
    if settings is None:
        return None
    speed = hypot(new.velocity[0], new.velocity[1])
    if speed > settings.speed_max_m_s:
        return f"speed {speed:.3g} m/s, {settings.speed_max_m_s:g} possible"
    if last is None:
        return None
    dt = (new.sample_time_us - last.sample_time_us) * 1e-6
    jump = hypot(new.position[0] - last.position[0], new.position[1] - last.position[1])
    allowed = settings.jump_m + settings.speed_max_m_s * max(dt, 0.0)
    return f"position jumped {jump:.1f} m, {allowed:.1f} possible" if jump > allowed else None
