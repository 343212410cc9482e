"""The setpoint of a daemon that does not see, or falls silent: level, with the thrust that carried.

When setpoints stop, both autopilots fly the last one on until their own timeout (ArduCopter GUID_TIMEOUT,
PX4 COM_OF_LOSS_T); stale body rates would roll the vehicle all that time (3 s of them rolled it up to
50 degrees). A level attitude is safe for so long: the autopilot holds it with its own estimate, whatever
was wrong with ours. The same goes for rates that are repeated while no telemetry comes.

PX4 is the exception while it is to be controlled on. Whether rates or attitudes count it looks up twice a
second (Commander.cpp, vehicle_control_mode): a level attitude among body rates has no effect for up to 0.5 s,
in which the last rates and thrust stay, and after it, for as long, rates have none, because mc_att_control
writes over them. So it gets body rates all through a silence, which level it by reckoning.
"""

from __future__ import annotations

from msgspec.structs import replace

from kffa_offboard.control import vehicle
from kffa_offboard.control.rotation import body_rates_of
from kffa_offboard.offboard.channels import command_of, level_target
from kffa_offboard.offboard.events import AttitudeReceived, AttitudeTarget
from kffa_offboard.offboard.flight import FlightState, Phase, stands
from kffa_offboard.offboard.guard import check_target
from kffa_offboard.offboard.loop import LoopState
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.telemetry import Telemetry

LEVEL_S = 0.5
"""Time constant of levelling by body rates, s: so long PX4 may hold them when a level attitude follows."""


def farewell(
    settings: ServiceSettings, loop: LoopState | None, flight: FlightState | None, known: Telemetry
) -> tuple[AttitudeTarget, ...]:
    """The last setpoint, level; none if nothing was sent yet or the vehicle stands on the ground.

    PX4 under body rates is told first to turn no more, which it follows until it notices the attitude.

    Thrust is what balances the vehicle with its load (`carrying`); while thrust is ramped up or down near the
    ground, or where touch-down shows already, no more than was sent last.
    """
    if loop is None or known.attitude is None:
        return ()
    level = AttitudeTarget(0.0, attitude=(0.0, 0.0, _heading(loop, known.attitude)))
    words = [level]
    if _keeps_to_rates(settings, known):
        words = [AttitudeTarget(0.0, body_rates=(0.0, 0.0, 0.0)), level]
    checked = [_with_thrust(settings, loop, flight, known, word) for word in words]
    return tuple(word for word in checked if word is not None)


def _heading(loop: LoopState, measured: AttitudeReceived) -> float:
    """As measured, or that of the level setpoint before: what was told in a silence is not told anew."""
    sent = None if loop.sent is None else loop.sent.attitude
    return measured.attitude[2] if sent is None or sent[:2] != (0.0, 0.0) else sent[2]


def _keeps_to_rates(settings: ServiceSettings, known: Telemetry) -> bool:
    """An attitude counts only half a second later."""
    px4 = known.heartbeat is not None and known.heartbeat.firmware == "px4"
    return px4 and settings.output == "rates"


def _with_thrust(
    settings: ServiceSettings,
    loop: LoopState,
    flight: FlightState | None,
    known: Telemetry,
    target: AttitudeTarget,
    since_s: float | None = None,
) -> AttitudeTarget | None:
    """The target with the thrust of `farewell`, checked; or none, as there.

    It may differ at once from the setpoint before, or as much as in `since_s`.
    """
    assert known.attitude is not None
    if loop.sent is None or loop.carrying is None or flight is None or flight.phase is Phase.GROUND:
        return None
    thrust, airborne = loop.carrying.thrust, not stands(flight, known.on_ground)
    if not airborne:
        thrust = min(thrust, loop.sent.thrust)
    target = replace(target, thrust=thrust)
    previous = None if since_s is None else loop.sent
    attitude = known.attitude.attitude
    return check_target(settings.limits, target, previous, attitude, since_s or 0.0, airborne).target


def fly_blind(
    settings: ServiceSettings,
    loop: LoopState,
    flight: FlightState | None,
    known: Telemetry,
    time_us: int,
    *,
    acting: bool,
) -> tuple[LoopState, AttitudeTarget]:
    """The setpoint while no attitude comes: that of `farewell`, or on the ground the last one once more.

    PX4 that is flown by body rates gets such that level it. The observer is told of the setpoint if it is
    `acting`; an autopilot that levels does without rates soon.
    """
    assert loop.sent is not None
    target = _level(settings, loop, flight, known, time_us)
    if target is None:
        return loop.resent(loop.sent, time_us), loop.sent
    if acting:
        assert known.attitude is not None and known.attitude_stream.arrival_us is not None
        attitude, (near, _, _) = known.attitude.attitude, vehicle.estimates(loop.controller)
        acts = target
        if settings.output == "rates" and target.body_rates is None:
            acts = level_target(settings, attitude[2], target.thrust)
        calm = command_of(settings, attitude, acts, near)
        after = (time_us - known.attitude_stream.arrival_us) * 1e-6
        told = vehicle.with_applied(settings.controller, loop.controller, calm, after)
        loop = replace(loop.with_controller(told), vertical_thrust=calm[3])
    return loop.resent(target, time_us), target


def _level(
    settings: ServiceSettings, loop: LoopState, flight: FlightState | None, known: Telemetry, time_us: int
) -> AttitudeTarget | None:
    """What levels this autopilot while it is to be controlled on; None where `farewell` has nothing."""
    if known.attitude is None or not _keeps_to_rates(settings, known):
        return next(iter(farewell(settings, loop, flight, known)), None)
    assert known.attitude_stream.arrival_us is not None
    attitude, actuator = known.attitude.attitude, settings.controller.actuator
    elapsed = (time_us - known.attitude_stream.arrival_us) * 1e-6
    # Where the commands under way lead to, the last one as far as it cannot be taken back any more.
    ahead = elapsed + actuator.longest_delay + actuator.longest_lag
    roll_rate, pitch_rate, *_ = vehicle.forecast(settings.controller, loop.controller, ahead)
    roll, pitch = attitude[0] + ahead * roll_rate, attitude[1] + ahead * pitch_rate
    rates = body_rates_of(attitude, (-roll / LEVEL_S, -pitch / LEVEL_S, 0.0))
    since_s = (time_us - loop.sent_us) * 1e-6
    return _with_thrust(settings, loop, flight, known, AttitudeTarget(0.0, body_rates=rates), since_s)
