"""Flying: link, service, log and status line joined, until the scenario is done or somebody stops it."""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

from rich.console import Console

from kffa_offboard.cli_status import StatusDisplay
from kffa_offboard.config import DaemonConfig
from kffa_offboard.config_log import flight_header, make_companion, parameter_keeper
from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.parameter_file import ParameterFile
from kffa_offboard.mavlink.parameter_keeper import ParameterKeeper
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import RunResult, real_time_clock, run_lock_step, run_real_time
from kffa_offboard.offboard.service import Finished, Service

INTERRUPTED = 130
FAILED = 1


@dataclass(frozen=True)
class RunOptions:
    """What the command line says about one run, beside the configuration."""

    lockstep: bool = False
    log: Path | None = None
    json: bool = False


def run(config: DaemonConfig, options: RunOptions) -> int:
    """Fly `config` and return the exit status: 0 done, 1 failed, 130 stopped.

    Raises UserError for a busy port, a missing device, no vehicle, a log that cannot be written.
    """
    console = Console(stderr=True)
    clock = real_time_clock()
    ids = config.link
    link = open_link(ids.url, clock, allow_remote=ids.allow_remote, signing=ids.signing)
    log = _log_path(config, options)
    parameters, changed = None, _changed_parameters(config, log)
    try:
        route = Route(ids.system_id, ids.component_id, ids.target_system, ids.target_component)
        if config.autopilot.check_parameters:
            parameters = parameter_keeper(config, route, changed)
        writer = _log_writer(config, options, log, route, changed) if log else None
        with writer or nullcontext(), StatusDisplay(console) as status, _stop_on_signals() as stop:
            console.print(f"waiting for a vehicle on {link.name}", soft_wrap=True, highlight=False)
            _say_changes(console, config)
            session = Session(
                Service(config.service),
                link,
                route,
                recorder=writer,
                observer=status,
                parameters=parameters,
                guided_mode=config.autopilot.ardupilot_mode,
                companion=make_companion(config, route),
                compare_clocks=not options.lockstep,
            )
            drive = run_lock_step if options.lockstep else run_real_time
            result = drive(session, clock, stop, connect_timeout_s=config.link.connect_timeout_s)
            session.close(_reason(result))
    except KeyboardInterrupt:  # a second Ctrl-C: at once, but the log is closed
        _say_what_is_left(parameters, changed)
        return INTERRUPTED
    except UserError:
        _say_what_is_left(parameters, changed)
        raise
    finally:
        link.close()
    left = _say_what_is_left(parameters, changed)
    status_code = _report(console, result, log, options)
    return status_code or (FAILED if left else 0)


def _changed_parameters(config: DaemonConfig, log: Path | None) -> ParameterFile:
    """Old parameters of the vehicle: beside the logs, or here if there are none."""
    directory = config.log.directory or (log.parent if log is not None else Path())
    return ParameterFile(directory / f"changed-parameters-{config.link.target_system}.json")


def _say_what_is_left(parameters: ParameterKeeper | None, file: ParameterFile) -> bool:
    """Name the parameters that could not be put back, one line; True if there are any."""
    changes = () if parameters is None else parameters.changes
    if changes:
        values = ", ".join(f"{change.name} {change.old:g} (is {change.new:g})" for change in changes)
        print(
            f"error: parameters not put back: {values}; the next run does it from {file.path}",
            file=sys.stderr,
        )
    return bool(changes)


def _log_writer(
    config: DaemonConfig, options: RunOptions, path: Path, route: Route, changed: ParameterFile
) -> TlogWriter:
    return TlogWriter(
        path,
        header=flight_header(config, options.lockstep, changed),
        system_id=route.own_system,
        component_id=route.own_component,
        part_size=config.log.part_size,
    )


def _say_changes(console: Console, config: DaemonConfig) -> None:
    """Which parameters are not the configuration's own."""
    changed = ", ".join(f"{name} = {value:g}" for name, value in config.tuning.changes.items())
    if changed and config.tuning.store is not None:
        console.print(f"parameters of {config.tuning.store.path}: {changed}", soft_wrap=True, highlight=False)


def _log_path(config: DaemonConfig, options: RunOptions) -> Path | None:
    if options.log is not None or config.log.directory is None:
        return options.log
    return config.log.directory / time.strftime("%Y-%m-%d_%H-%M-%S.tlog")


@contextmanager
def _stop_on_signals() -> Iterator[threading.Event]:
    """An event that Ctrl-C and SIGTERM set; a second one of them ends the process as usual."""
    stop = threading.Event()

    def request_stop(number: int, frame: FrameType | None) -> None:
        stop.set()
        signal.signal(number, before[number])

    before: dict[int, Any] = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, request_stop)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _reason(result: RunResult) -> str:
    finished = result.finished
    return finished.reason if isinstance(finished, Finished) else "stopped before control was given back"


def _report(console: Console, result: RunResult, log: Path | None, options: RunOptions) -> int:
    """Say how the run ended and return the exit status."""
    finished = result.finished
    assert finished is None or isinstance(finished, Finished)
    reason = _reason(result)
    successful = finished is not None and finished.successful and result.refusal is None
    counters = result.counters
    console.print(
        f"{counters.telemetry_received} telemetry messages received, {counters.commands_sent} commands sent"
        + (f"; log: {log}" if log is not None else ""),
        soft_wrap=True,
        highlight=False,
    )
    if options.json:
        summary = {
            "reason": result.refusal or reason,
            "successful": successful and not result.stopped,
            "stopped": result.stopped,
            "telemetry_received": counters.telemetry_received,
            "commands_sent": counters.commands_sent,
            "frames_dropped": counters.frames_dropped,
        }
        print(json.dumps(summary), flush=True)
    if not successful:
        print(f"error: {result.refusal or reason}", file=sys.stderr)
    if result.stopped:
        return INTERRUPTED
    return 0 if successful else FAILED
