"""The setpoint of a daemon that does not see, or falls silent: level, with the thrust that carried.

When setpoints stop, both autopilots fly the last one on until their own timeout (ArduCopter GUID_TIMEOUT,
PX4 COM_OF_LOSS_T); stale body rates would roll the vehicle all that time (3 s of them rolled it up to
50 degrees). A level attitude is safe for so long: the autopilot holds it with its own estimate, whatever
was wrong with ours. The same goes for rates that are repeated while no telemetry comes.
"""

from __future__ import annotations

from msgspec.structs import replace

from kffa_offboard.control import vehicle
from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.offboard.flight import FlightState, Phase, stands
from kffa_offboard.offboard.guard import check_target
from kffa_offboard.offboard.loop import LoopState, command_of, level_target
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.telemetry import Telemetry


def farewell(
    settings: ServiceSettings, loop: LoopState | None, flight: FlightState | None, known: Telemetry
) -> tuple[AttitudeTarget, ...]:
    """One setpoint, or none if nothing was sent yet or the vehicle stands on the ground.

    Thrust is what balances the vehicle with its load (`carrying`); while thrust is ramped up or down near the
    ground, or where touch-down shows already, no more than was sent last.
    """
    if loop is None or loop.sent is None or loop.carrying is None or flight is None or known.attitude is None:
        return ()
    if flight.phase is Phase.GROUND:
        return ()
    thrust, airborne = loop.carrying.thrust, not stands(flight, known.on_ground)
    if not airborne:
        thrust = min(thrust, loop.sent.thrust)
    level = AttitudeTarget(thrust, attitude=(0.0, 0.0, known.attitude.attitude[2]))
    checked = check_target(settings.limits, level, None, known.attitude.attitude, 0.0, airborne)
    return () if checked.target is None else (checked.target,)


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

    The observer is told of it if it is `acting`; an autopilot that levels does without rates soon.
    """
    assert loop.sent is not None
    level = farewell(settings, loop, flight, known)
    if not level:
        return loop.resent(loop.sent, time_us), loop.sent
    (target,) = level
    if acting:
        assert known.attitude is not None and known.attitude_stream.arrival_us is not None
        attitude, (near, _, _) = known.attitude.attitude, vehicle.estimates(loop.controller)
        calm = command_of(settings, attitude, level_target(settings, attitude[2], target.thrust), near)
        after = (time_us - known.attitude_stream.arrival_us) * 1e-6
        told = vehicle.with_applied(settings.controller, loop.controller, calm, after)
        loop = replace(loop.with_controller(told), vertical_thrust=calm[3])
    return loop.resent(target, time_us), target
