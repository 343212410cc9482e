"""One control step: from telemetry and a wish to a checked setpoint, and what the observer is told of it.

While the daemon is not in control the same step runs in shadow: the observer is then told what the autopilot
itself applies.
"""

from __future__ import annotations

from math import exp, isfinite

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.control import vehicle
from kffa_offboard.control.plain import PlainInput, PlainOutput, Vector
from kffa_offboard.offboard.carrying import Carrying, balancing, follow
from kffa_offboard.offboard.channels import (
    as_measured,
    autopilot_command,
    command_of,
    level_target,
    measured_rate,
    measurement,
    target_of,
)
from kffa_offboard.offboard.events import AttitudeTarget, Signals
from kffa_offboard.offboard.flight import Directive
from kffa_offboard.offboard.guard import check_target
from kffa_offboard.offboard.horizontal import (
    HorizontalState,
    begin_horizontal,
    position_reference,
    step_horizontal,
)
from kffa_offboard.offboard.reference import Offset
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.shaking import watch_thrust
from kffa_offboard.offboard.straining import watch_strain
from kffa_offboard.offboard.telemetry import Telemetry, before_silence
from kffa_offboard.offboard.turns import NO_TURNS, Turns

_FRESH = (True, True, True, True)
_FRESH_ATTITUDE = (True, True, True, False)
_NOTHING = (0.0, 0.0, 0.0, 0.0)
ROUNDING = 1e-9  # what a setpoint may change by on its way through body rates and back


class Blend(Struct, frozen=True, gc=False):
    """Difference between the autopilot's vertical thrust and the controller's at engaging; it fades."""

    offset: float
    since_us: int


class LoopState(Struct, frozen=True, gc=False):
    """What one step leaves for the next.

    Attributes
    ----------
    controller : controller state
    position_us : sample time of the position that was used last
    altitude : m, estimate
    hold_altitude : m, where the vehicle comes to rest if it is told to hold now
    vertical_thrust : last command on the altitude channel
    carrying : what thrust carries the vehicle; None before the first of an engagement
    sent, sent_us : last setpoint of this engagement and when; None before the first
    blend : None outside an engagement in the air
    horizontal : the position ring, None without one
    shaking : turns of the thrust that is sent in the air
    strained_s : how long full thrust has lifted nothing
    """

    controller: vehicle.State
    position_us: int
    altitude: float
    hold_altitude: float
    vertical_thrust: float
    carrying: Carrying | None = None
    sent: AttitudeTarget | None = None
    sent_us: int = 0
    blend: Blend | None = None
    horizontal: HorizontalState | None = None
    shaking: Turns = NO_TURNS
    strained_s: float = 0.0

    @property
    def hold_offset(self) -> Offset:
        """Where the vehicle comes to rest if it is told to hold now, from the captured position, m."""
        return (0.0, 0.0) if self.horizontal is None else self.horizontal.hold_offset

    @property
    def swings(self) -> bool:
        """A load swings that nobody has told of."""
        return self.horizontal is not None and self.horizontal.swings

    def with_controller(self, controller: vehicle.State) -> LoopState:
        """Another controller state."""
        return replace(self, controller=controller)

    def resent(self, target: AttitudeTarget, time_us: int) -> LoopState:
        """A setpoint went out at `time_us` without a control step."""
        carrying = self.carrying
        if carrying is not None:
            carrying = self.carrying_until(time_us, target.thrust, carrying.balance)
        return replace(self, carrying=carrying, sent=target, sent_us=time_us)

    def carrying_until(self, time_us: int, thrust: float, balance: float) -> Carrying:
        """What carries when a setpoint with this `thrust` follows the last one."""
        acted = thrust if self.sent is None else self.sent.thrust
        return follow(self.carrying, acted, balance, (time_us - self.sent_us) * 1e-6)


class Order(Struct, frozen=True, gc=False):
    """How this step is to be made.

    Attributes
    ----------
    directive : reference, or thrust on the ground
    state_name : for the log
    sending : a setpoint goes out
    acting : it is the daemon's setpoint that acts, not the autopilot's own command
    capture : begin the thrust blend anew
    airborne : lower thrust limit applies
    """

    directive: Directive
    state_name: str
    sending: bool = False
    acting: bool = False
    capture: bool = False
    airborne: bool = False

    def controls(self) -> bool:
        """The daemon's command acts, and has from the step before."""
        return self.acting and not self.capture


class Trace(Struct, frozen=True, gc=False):
    """What a step leaves for those who watch; `signals` puts it into the order of the log, later.

    Attributes
    ----------
    place : m, the position ring's set point, see `Signals.position_reference`
    command : what was sent (or, in shadow, what would have been)
    applied : what the observer was told
    """

    time_us: int
    dt: float
    place: tuple[float, float] | None
    measured: Vector
    output: PlainOutput
    command: Vector
    applied: Vector


class LoopStep(Struct, frozen=True, gc=False):
    """Result of a step: what goes out (None in shadow or on a fault), its trace, and the fault."""

    target: AttitudeTarget | None
    trace: Trace
    fault: str | None = None


def begin_loop(settings: ServiceSettings, known: Telemetry, time_us: int) -> LoopState | None:
    """Start the controller at rest at the present measurement; None while a sample is missing."""
    if known.attitude is None or known.position is None:
        return None
    measured = measurement(settings, known)
    applied = autopilot_command(settings, known, time_us, measured)
    controller = vehicle.initial_state(settings.controller, measured, applied)
    altitude, thrust = measured[3], applied[3]
    horizontal = begin_horizontal(settings.position, known)
    return LoopState(
        controller, known.position.sample_time_us, altitude, altitude, thrust, horizontal=horizontal
    )


def forget_sent(loop: LoopState) -> LoopState:
    """Nothing has been sent in the engagement that begins, or the one that was has ended."""
    return replace(loop, sent=None, blend=None, carrying=None, shaking=NO_TURNS, strained_s=0.0)


def step_loop(
    settings: ServiceSettings,
    loop: LoopState,
    known: Telemetry,
    order: Order,
    time_us: int,
    dt: float,
    *,
    flown: Vector | None = None,
) -> tuple[LoopState, LoopStep]:
    """One control step for the attitude sample that has just been accepted, `dt` s after the last one.

    `flown` is the command that really acted, where that is not the one
    made here: a recorded flight replayed with other gains. The observer is told of it, because the samples
    answer to it; NaN where it is not known in this output, which takes what is measured.
    """
    loop, measured, output = _step_controller(settings, loop, known, order, dt, replayed=flown is not None)
    near = output.estimate
    if flown is not None and not all(map(isfinite, flown)):
        pairs = zip(flown, as_measured(settings, known, near), strict=True)
        flown = tuple(command if isfinite(command) else instead for command, instead in pairs)
    own = _NOTHING if order.controls() else autopilot_command(settings, known, time_us, near)
    place = position_reference(loop.horizontal)
    if order.sending:
        trace = Trace(time_us, dt, place, measured, output, output.command, own)
        return _send(settings, loop, known, order, trace, flown)
    own = own if flown is None else flown
    controller = vehicle.with_applied(settings.controller, loop.controller, own)
    loop = replace(loop, controller=controller, vertical_thrust=own[3])
    return loop, LoopStep(None, Trace(time_us, dt, place, measured, output, output.command, own))


def _step_controller(
    settings: ServiceSettings, loop: LoopState, known: Telemetry, order: Order, dt: float, *, replayed: bool
) -> tuple[LoopState, Vector, PlainOutput]:
    """Position ring and controller take the sample; returns the measurement, too."""
    assert known.position is not None
    parameters, controller = settings.controller, loop.controller
    if order.directive.align:
        controller = vehicle.align_reference(parameters, controller)
    measured, position_us = measurement(settings, known), known.position.sample_time_us
    new_position = position_us != loop.position_us and not before_silence(settings.telemetry, known, dt)
    horizontal, reference = loop.horizontal, order.directive.reference
    if horizontal is not None:
        acting = order.controls() and not replayed
        horizontal, reference = step_horizontal(
            settings.position, horizontal, known, order.directive, acting, new_position, dt
        )
    fresh = _FRESH if new_position else _FRESH_ATTITUDE
    inputs = PlainInput(reference, measured, fresh, measured_rate(known))
    controller, output = vehicle.step(parameters, controller, inputs, dt)
    altitude, climb_rate = output.estimate[3], output.estimate_rate[3]
    loop = LoopState(  # by place, in a third of the time of `_replace`
        controller,
        position_us,
        altitude,
        altitude + settings.reference_lag_s * climb_rate,
        loop.vertical_thrust,
        loop.carrying,
        loop.sent,
        loop.sent_us,
        loop.blend,
        horizontal,
        loop.shaking,
        loop.strained_s,
    )
    return loop, measured, output


def _send(
    settings: ServiceSettings,
    loop: LoopState,
    known: Telemetry,
    order: Order,
    trace: Trace,
    flown: Vector | None,
) -> tuple[LoopState, LoopStep]:
    """Make the setpoint, have it checked, and tell the observer; `trace.applied` is the autopilot's own."""
    assert known.attitude is not None
    output, own, time_us, near = trace.output, trace.applied, trace.time_us, trace.output.estimate
    loop, wanted, target = _wish(settings, loop, known, order, time_us, output.command, own[3], near)
    silent = (time_us - loop.sent_us) * 1e-6
    since = silent if silent > trace.dt else trace.dt
    checked = check_target(settings.limits, target, loop.sent, known.attitude.attitude, since, order.airborne)
    if checked.target is None:
        return loop, LoopStep(None, replace(trace, command=wanted, applied=wanted), checked.fault)
    sent = command_of(settings, known.attitude.attitude, checked.target, near) if checked.changed else wanted
    applied = flown if flown is not None else sent if order.acting else own
    controller, thrust = loop.controller, checked.target.thrust
    shaking, strained_s, fault = NO_TURNS, 0.0, None
    if order.acting and order.airborne:
        climb_rate = output.estimate_rate[3]
        shaking, fault = watch_thrust(loop.shaking, settings.limits, thrust, since)
        if fault is None:
            strained_s, fault = watch_strain(loop.strained_s, settings.limits, thrust, climb_rate, since)
    if fault is not None:
        return loop, LoopStep(None, replace(trace, command=wanted, applied=wanted), fault)
    if applied is not output.command:  # its own it knows
        controller = vehicle.with_applied(settings.controller, controller, applied)
    loop = LoopState(
        controller,
        loop.position_us,
        loop.altitude,
        loop.hold_altitude,
        sent[3] if flown is None else flown[3],
        loop.carrying_until(time_us, thrust, balancing(settings.controller, output.disturbance, thrust)),
        checked.target,
        time_us,
        loop.blend,
        loop.horizontal,
        shaking,
        strained_s,
    )
    if sent is not wanted:
        output = replace(output, saturated=_limited(output, sent, wanted))
    trace = Trace(time_us, trace.dt, trace.place, trace.measured, output, sent, applied)
    return loop, LoopStep(checked.target, trace)


def _limited(output: PlainOutput, sent: Vector, wanted: Vector) -> tuple[bool, ...]:
    """Which channels the law limited, or the guard."""
    pairs = zip(output.saturated, sent, wanted, strict=True)
    return tuple(limited or abs(command - wish) > ROUNDING for limited, command, wish in pairs)


def _wish(
    settings: ServiceSettings,
    loop: LoopState,
    known: Telemetry,
    order: Order,
    time_us: int,
    command: Vector,
    own_vertical: float,
    near: Vector,
) -> tuple[LoopState, Vector, AttitudeTarget]:
    """Command and setpoint before the guard: level with a given thrust, or the controller's, blended."""
    assert known.attitude is not None
    attitude = known.attitude.attitude
    if order.directive.ground_thrust is not None:
        target = level_target(settings, order.directive.reference[2], order.directive.ground_thrust)
        return replace(loop, blend=None), command_of(settings, attitude, target, near), target
    if order.capture:
        loop = replace(loop, blend=Blend(own_vertical - command[3], time_us))
    if loop.blend is not None:
        age = (time_us - loop.blend.since_us) * 1e-6
        fading = loop.blend.offset * exp(-age / settings.sequence.blend_time_s)
        command = (*command[:3], command[3] + fading)
    return loop, command, target_of(settings, attitude, command)


def signals(trace: Trace, state_name: str, latency_s: float) -> Signals:
    """The trace of a step as events have it; what it does not know is the service's state and the latency."""
    output = trace.output
    return Signals(  # by place: names would cost three times as much
        trace.time_us,
        state_name,
        output.reference,
        output.reference_rate,
        trace.measured,
        output.estimate,
        output.estimate_rate,
        output.disturbance,
        output.omega_c,
        trace.command,
        trace.applied,
        output.saturated,
        trace.dt,
        latency_s,
        trace.place,
    )
