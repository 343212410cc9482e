"""One vehicle's run: link, service, log and whatever watches them, opened and closed together."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from kffa_offboard.cli_status import StatusBoard, StatusConsole, complain
from kffa_offboard.config import DaemonConfig, LinkSettings
from kffa_offboard.config_log import flight_header, make_companion, parameter_keeper
from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.plot import PlotStream
from kffa_offboard.flightlog.writer import LogExists, TlogWriter
from kffa_offboard.mavlink.address import NetworkAddress, parse_url
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.last_words import FramedLastWords
from kffa_offboard.mavlink.line_rate import too_slow
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.parameter_file import ParameterFile
from kffa_offboard.mavlink.session import Observer, Session
from kffa_offboard.mavlink.transport import Clock, Link
from kffa_offboard.mavlink.udp import UdpLink
from kffa_offboard.offboard.events import Event, Output, ProcessReport
from kffa_offboard.offboard.service import Service
from kffa_offboard.process import dead_man
from kffa_offboard.process.dead_man import LastWords
from kffa_offboard.process.flight_mark import FlightMark
from kffa_offboard.process.notify import ServiceManager
from kffa_offboard.process.realtime import Collector
from kffa_offboard.process.timing import StepClock
from kffa_offboard.process.tuning_writer import TuningWriter
from kffa_offboard.process.watch import LoopWatch, TroubleSource


@dataclass(frozen=True)
class RunOptions:
    """What the command line says about one run, beside the configuration."""

    lockstep: bool = False
    log: Path | None = None
    json: bool = False
    realtime: bool = False
    reengage: bool = False
    plot: str | None = None


@dataclass(frozen=True)
class Shared:
    """What all vehicles of a process have in common."""

    clock: Clock
    console: StatusConsole
    board: StatusBoard
    manager: ServiceManager
    collector: Collector


@dataclass(frozen=True)
class VehicleRun:
    """A vehicle that is ready to be flown. `name` is empty if it is the only one."""

    name: str
    config: DaemonConfig
    log: Path | None
    session: Session
    watch: LoopWatch


@contextmanager
def open_vehicle(
    config: DaemonConfig, options: RunOptions, shared: Shared, name: str = ""
) -> Iterator[VehicleRun]:
    """Open link and log, and close them again; parameters that could not be put back are named then.

    Raises UserError for a busy port, a missing device, a log that cannot be written or is not complete.
    """
    with ExitStack() as stack:
        link = stack.enter_context(closing(_link(config.link, shared.clock)))
        log = _log_path(config, options, name)
        directory = config.log.directory or (log.parent if log is not None else Path())
        changed = ParameterFile(directory / f"changed-parameters-{config.link.target_system}.json")
        ids = config.link
        route = Route(ids.system_id, ids.component_id, ids.target_system, ids.target_component)
        parameters = parameter_keeper(config, route, changed) if config.autopilot.check_parameters else None
        observers: list[Observer] = [shared.board.vehicle(name)]
        sources: list[TroubleSource] = [link.take_news]
        if options.plot is not None:
            observers.append(stack.enter_context(_plot_stream(options.plot, shared.clock, name)))
        if not options.lockstep:
            path = directory / f"in-flight-{ids.target_system}.json"
            mark = stack.enter_context(closing(FlightMark(path)))
            config = _after_interruption(config, options, mark, shared.console)
            observers.append(mark)
            sources.append(mark.take_trouble)
        config = _stored_beside_control(config, stack, sources)
        writer = None
        if log is not None:
            writer = stack.enter_context(_log_writer(config, options, name, route, changed))
            log = writer.path
            sources.append(writer.take_trouble)
        _say_begin(shared.console, config, link, name)
        service = Service(config.service)
        if not options.lockstep:
            words = FramedLastWords(service, link, route, shared.clock)
            sources += _dead_man_switch(config, words, shared.console, stack)
        session = Session(
            service,
            link,
            route,
            recorder=writer,
            observer=_tell_all(observers),
            parameters=parameters,
            guided_mode=config.autopilot.ardupilot_mode,
            companion=make_companion(config, route),
            compare_clocks=not options.lockstep,
        )
        late = StepClock(config.process.late_step_s)
        watch = LoopWatch(late, shared.manager, shared.collector, sources)
        try:
            yield VehicleRun(name, config, log, session, watch)
        finally:
            _say_what_is_left(session, changed)


def _link(settings: LinkSettings, clock: Clock) -> Link:
    return open_link(settings.url, clock, allow_remote=settings.allow_remote, signing=settings.signing)


def _dead_man_switch(
    config: DaemonConfig, words: LastWords, console: StatusConsole, stack: ExitStack
) -> list[TroubleSource]:
    """Who says our last words if we cannot. Raises UserError if that process cannot be started."""
    if not config.process.dead_man_switch:
        return []
    if not dead_man.is_available():
        console.tell("warning: no dead man's switch on this system; it needs Linux")
        return []
    try:
        switch = stack.enter_context(closing(dead_man.DeadManSwitch(words)))
    except OSError as error:
        raise UserError(
            f"dead man's switch: a process cannot be started: {error.strerror}; allow it, or set "
            "process.dead_man_switch = false"
        ) from error
    return [switch.take_trouble]


def _stored_beside_control(
    config: DaemonConfig, stack: ExitStack, sources: list[TroubleSource]
) -> DaemonConfig:
    """The same, with a thread between control and the file of changed parameters, if there is one."""
    if config.tuning.store is None:
        return config
    stored = stack.enter_context(_said_at_the_end(TuningWriter(config.tuning.store)))
    sources.append(stored.take_trouble)
    return replace(config, tuning=replace(config.tuning, store=stored))


@contextmanager
def _said_at_the_end(writer: TuningWriter) -> Iterator[TuningWriter]:
    """Closes it; what only then goes wrong is said, too."""
    try:
        yield writer
    finally:
        writer.close()
        trouble = writer.take_trouble()
        if trouble is not None:
            complain(trouble)


def _after_interruption(
    config: DaemonConfig, options: RunOptions, mark: FlightMark, console: StatusConsole
) -> DaemonConfig:
    """The configuration of a run that may have been started again in flight."""
    if not config.service.engage:
        return config
    obstacle = mark.obstacle()
    if obstacle is not None:
        console.tell(f"warning: {obstacle}")
    if not mark.found or options.reengage or config.process.reengage:
        return config
    console.tell(
        f"an earlier run had control when the vehicle was last seen armed ({mark.path}); if it still is, "
        "this one only observes until asked to engage (--reengage engages by itself)"
    )
    return replace(
        config,
        service=replace(config.service, interrupted=True),
        overrides=replace(config.overrides, interrupted=True),
    )


def _tell_all(observers: Sequence[Observer]) -> Observer:
    def tell(time_us: int, item: Event | Output | ProcessReport) -> None:
        for observer in observers:
            observer(time_us, item)

    return tell


def _say_what_is_left(session: Session, file: ParameterFile) -> None:
    """Name the parameters that could not be put back, one line."""
    if session.changed_parameters:
        values = ", ".join(
            f"{change.name} {change.old:g} (is {change.new:g})" for change in session.changed_parameters
        )
        complain(f"parameters not put back: {values}; the next run does it from {file.path}")


def _log_writer(
    config: DaemonConfig, options: RunOptions, name: str, route: Route, changed: ParameterFile
) -> TlogWriter:
    """Begin the log, under the next free name where another process has just taken this one."""
    header = flight_header(config, options.lockstep, changed)
    while True:
        path = _log_path(config, options, name)
        assert path is not None
        try:
            return TlogWriter(
                path,
                header=header,
                system_id=route.own_system,
                component_id=route.own_component,
                part_size=config.log.part_size,
            )
        except LogExists:
            if options.log is not None:
                raise


@contextmanager
def _plot_stream(url: str, clock: Clock, name: str) -> Iterator[PlotStream]:
    """Signals for a plotting program. Nobody need listen there. Raises UserError for a wrong `url`."""
    if not url.startswith("udpout:"):
        raise UserError(f"--plot {url!r}: signals go out over UDP only; write udpout:HOST:PORT")
    address = parse_url(url)
    assert isinstance(address, NetworkAddress)  # as that kind is
    with closing(UdpLink(address, clock)) as link:
        yield PlotStream(link.send, name)


def _say_begin(console: StatusConsole, config: DaemonConfig, link: Link, name: str) -> None:
    """Where the vehicle is expected, and which parameters are not the configuration's own."""
    prefix = f"{name}: " if name else ""
    console.tell(f"{prefix}waiting for a vehicle on {link.name}")
    if (slow := slow_line(config)) is not None:
        console.tell(f"{prefix}warning: {slow}")
    changed = ", ".join(f"{key} = {value:g}" for key, value in config.tuning.changes.items())
    if changed and config.tuning.store is not None:
        console.tell(f"{prefix}parameters of {config.tuning.store.path}: {changed}")


def slow_line(config: DaemonConfig) -> str | None:
    """Why the serial line, if it is one, is too slow for the flight."""
    signed = config.link.signing is not None
    return too_slow(parse_url(config.link.url), config.service.telemetry, config.signals_hz, signed=signed)


def key_problem(config: DaemonConfig) -> str | None:
    """Why the signing key, if there is to be one, cannot be had here."""
    if config.link.signing is None:
        return None
    from kffa_offboard.mavlink.signing_key import read_key

    try:
        read_key(config.link.signing.key_file)
    except UserError as problem:
        return str(problem)
    return None


def _log_path(config: DaemonConfig, options: RunOptions, name: str) -> Path | None:
    """Where to log. Names are wall time: where no clock has kept it, they may be there already."""
    if options.log is not None or config.log.directory is None:
        return options.log
    stem = time.strftime("%Y-%m-%d_%H-%M-%S") + (f"_{name}" if name else "")
    path, number = config.log.directory / f"{stem}.tlog", 1
    while path.exists():
        number += 1
        path = config.log.directory / f"{stem}_{number}.tlog"
    return path
