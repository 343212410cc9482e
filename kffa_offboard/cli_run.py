"""Flying: one vehicle or several in one process, until the scenarios are done or somebody stops them."""

from __future__ import annotations

import faulthandler
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from types import FrameType
from typing import Any

from kffa_offboard.cli_fleet import Fleet
from kffa_offboard.cli_report import FAILED, INTERRUPTED, reason, report
from kffa_offboard.cli_status import StatusBoard, StatusConsole, complain
from kffa_offboard.cli_vehicle import RunOptions, Shared, VehicleRun, open_vehicle
from kffa_offboard.config import DaemonConfig
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.shell import RunResult, real_time_clock, run_lock_step, run_real_time
from kffa_offboard.process.notify import ServiceManager
from kffa_offboard.process.realtime import Collector, RealtimeSettings, become_real_time

STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def run(configs: Mapping[str, DaemonConfig], options: RunOptions) -> int:
    """Fly one vehicle, or several that have names, and return the exit status. Raises as `run_one`."""
    if len(configs) > 1:
        return run_several(configs, options)
    (config,) = configs.values()
    return run_one(config, options)


def run_several(configs: Mapping[str, DaemonConfig], options: RunOptions) -> int:
    """Fly several vehicles in one loop; what happens to one does not touch the others.

    Returns 130 if they were stopped, else 1 if anything went wrong with one of them, else 0.
    """
    realtime = replace(next(iter(configs.values())).realtime)
    realtime = replace(realtime, enabled=realtime.enabled or options.realtime)
    try:
        with ExitStack() as stack:
            shared = stack.enter_context(shared_parts(realtime))
            stop = stack.enter_context(stop_on_signals())
            fleet = stack.enter_context(Fleet(shared, options, stop))
            for name, config in configs.items():
                fleet.open(name, config)
            prepare(realtime, shared)
            try:
                fleet.fly()
            finally:
                shared.manager.stopping()
    except KeyboardInterrupt:
        return INTERRUPTED
    return INTERRUPTED if stop.is_set() else fleet.status


def run_one(config: DaemonConfig, options: RunOptions) -> int:
    """Fly `config` and return the exit status: 0 done, 1 failed, 130 stopped.

    A log that is not complete at the end is a failure that is told beside how the flight ended.
    Raises UserError for a busy port, a missing device, no vehicle, a log that cannot be begun, or real-time
    scheduling that is required and not permitted.
    """
    realtime = replace(config.realtime, enabled=config.realtime.enabled or options.realtime)
    result, failed = None, False
    try:
        with ExitStack() as stack:
            shared = stack.enter_context(shared_parts(realtime))
            stop = stack.enter_context(stop_on_signals())
            vehicle = stack.enter_context(open_vehicle(config, options, shared))
            prepare(realtime, shared)
            try:
                result = _drive(vehicle, options, shared, stop)
            except BaseException as error:
                vehicle.session.fall_silent()
                if isinstance(error, UserError):
                    vehicle.session.close(str(error))
                raise
            finally:
                shared.manager.stopping()
            vehicle.session.close(reason(result))
    except KeyboardInterrupt:  # a second Ctrl-C: at once, but the log is closed
        return INTERRUPTED
    except UserError as error:
        if result is None:
            raise
        complain(str(error))
        failed = True
    status = report(shared.console, result, vehicle, options)
    return status or (FAILED if failed or vehicle.session.changed_parameters else 0)


def _drive(vehicle: VehicleRun, options: RunOptions, shared: Shared, stop: threading.Event) -> RunResult:
    timeout_s = vehicle.config.link.connect_timeout_s
    if options.lockstep:
        barrier_s = vehicle.config.link.barrier_timeout_s
        return run_lock_step(
            vehicle.session, shared.clock, stop, connect_timeout_s=timeout_s, barrier_timeout_s=barrier_s
        )
    return run_real_time(
        vehicle.session, shared.clock, stop, connect_timeout_s=timeout_s, watch=vehicle.watch
    )


@contextmanager
def shared_parts(realtime: RealtimeSettings) -> Iterator[Shared]:
    """What all vehicles of a process have in common; lines are shown until the end of the block."""
    console, manager = StatusConsole(), ServiceManager()
    collector = Collector(realtime.collect_s if realtime.enabled else None)
    try:
        with StatusBoard(console, manager) as board:
            yield Shared(real_time_clock(), console, board, manager, collector)
    finally:
        collector.restore()
        manager.close()


def prepare(realtime: RealtimeSettings, shared: Shared) -> None:
    """The last thing before flying: scheduling, memory, collector; then the service manager is told.

    Raises UserError, one line for each thing that is required and not permitted.
    """
    if not faulthandler.is_enabled() and sys.__stderr__ is not None:
        faulthandler.enable()  # a watchdog's SIGABRT then shows where we hung
    shared.collector.freeze()
    problems = become_real_time(realtime) if realtime.enabled else []
    if problems and realtime.required:
        raise UserError("\n".join(f"{each}; or set realtime.required = false" for each in problems))
    for problem in problems:
        shared.console.tell(f"warning: {problem}")
    shared.manager.ready()


@contextmanager
def stop_on_signals() -> Iterator[threading.Event]:
    """An event that Ctrl-C, SIGTERM and SIGHUP set; a second one of a kind ends the process as usual.

    A signal that is ignored stays so: nohup does that with SIGHUP.
    """
    stop = threading.Event()

    def request_stop(number: int, frame: FrameType | None) -> None:
        stop.set()
        signal.signal(number, before[number])

    before: dict[int, Any] = {number: signal.getsignal(number) for number in STOP_SIGNALS}
    before = {number: handler for number, handler in before.items() if handler is not signal.SIG_IGN}
    for number in before:
        signal.signal(number, request_stop)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
