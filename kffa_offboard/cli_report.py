"""How a run ended, for people and for scripts."""

from __future__ import annotations

import json

from kffa_offboard.cli_status import StatusConsole, complain
from kffa_offboard.cli_vehicle import RunOptions, VehicleRun
from kffa_offboard.mavlink.shell import RunResult
from kffa_offboard.mavlink.signed_link import SignedLink
from kffa_offboard.offboard.service import Finished

INTERRUPTED = 130
FAILED = 1


def reason(result: RunResult) -> str:
    """Why a run ended, in words."""
    finished = result.finished
    return finished.reason if isinstance(finished, Finished) else "stopped before control was given back"


def report(console: StatusConsole, result: RunResult, vehicle: VehicleRun, options: RunOptions) -> int:
    """Say how the run ended and return the exit status."""
    finished = result.finished
    assert finished is None or isinstance(finished, Finished)
    successful = finished is not None and finished.successful and result.refusal is None
    counters, name = result.counters, f"{vehicle.name}: " if vehicle.name else ""
    console.tell(
        f"{name}{counters.telemetry_received} telemetry messages received, "
        f"{counters.commands_sent} commands sent"
        + (f"; log: {vehicle.log}" if vehicle.log is not None else "")
    )
    link = vehicle.session.link
    if isinstance(link, SignedLink) and link.refused:
        console.tell(f"{name}{link.refusals()}")
    if options.json:
        summary = {
            **({"vehicle": vehicle.name} if vehicle.name else {}),
            "reason": result.refusal or reason(result),
            "successful": successful and not result.stopped,
            "stopped": result.stopped,
            "telemetry_received": counters.telemetry_received,
            "commands_sent": counters.commands_sent,
            "frames_dropped": counters.frames_dropped,
            **vehicle.watch.summary(),
        }
        print(json.dumps(summary), flush=True)
    if not successful:
        complain(f"{name}{result.refusal or reason(result)}")
    if result.stopped:
        return INTERRUPTED
    return 0 if successful else FAILED
