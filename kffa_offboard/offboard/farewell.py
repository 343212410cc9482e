"""The last setpoint before the daemon falls silent: level, with the thrust that carried the vehicle.

When setpoints stop, both autopilots fly the last one on until their own timeout (ArduCopter GUID_TIMEOUT,
PX4 COM_OF_LOSS_T); stale body rates would roll the vehicle all that time (3 s of them rolled it up to
50 degrees). A level attitude is safe for so long: the autopilot holds it with its own estimate, whatever
was wrong with ours.
"""

from __future__ import annotations

from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.offboard.flight import FlightState, Phase, stands
from kffa_offboard.offboard.guard import check_target
from kffa_offboard.offboard.loop import LoopState
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.telemetry import Telemetry


def farewell(
    settings: ServiceSettings, loop: LoopState | None, flight: FlightState | None, known: Telemetry
) -> tuple[AttitudeTarget, ...]:
    """One setpoint, or none if nothing was sent yet or the vehicle stands on the ground.

    Thrust is a mean of the last setpoints (`carrying`), which carries a load, too; while thrust is ramped up
    or down near the ground, or where touch-down shows already, no more than was sent last.
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
