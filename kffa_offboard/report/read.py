"""Telemetry logs as flights to show: the daemon's with its inner signals, others with what they have."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog import signals
from kffa_offboard.flightlog.notes import End, Header, Lost, NoteReader, is_note
from kffa_offboard.flightlog.parts import following_parts
from kffa_offboard.flightlog.tlog import clock_remarks, message_id, read_tlog
from kffa_offboard.frame_codec import decode
from kffa_offboard.loganalysis import dataflash
from kffa_offboard.loganalysis.read import ULOG_MAGIC, first_bytes
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.vehicle import MULTIROTORS, Vehicle
from kffa_offboard.offboard.events import (
    AttitudeReceived,
    HeartbeatReceived,
    PositionReceived,
    StatusReceived,
)
from kffa_offboard.report.flight import Flight, FlightEvent, Line, Origin, line
from kffa_offboard.report.from_signals import signal_lines, state_events

_WANTED = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_STATUSTEXT,
        mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT,
        mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY,
        mavlink.MAVLINK_MSG_ID_TUNNEL,
    }
)
_AUTOPILOTS = (mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
_ONBOARD = (ULOG_MAGIC, dataflash.HEADER)
_OWN_COMPONENT = Route().own_component
_LOAD_TEXT = re.compile(r"(picked up|dropped) (\d+(?:\.\d+)?) kg")


@dataclass
class _Column:
    """Times [us] and rows as they come, `values` one row after the other."""

    time_us: array[int] = field(default_factory=lambda: array("q"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, time_us: int, row: tuple[float, ...]) -> None:
        self.time_us.append(time_us)
        self.values.extend(row)

    def columns(self, width: int) -> Any:
        """Of all rows ``(width, rows)``."""
        return np.array(self.values).reshape(-1, width).T


@dataclass
class _Collector:
    """Sorts the messages of a log."""

    header: Header | None = None
    end: End | None = None
    first_us: int | None = None
    last_us: int = 0
    full: signals.SignalRows = field(default_factory=signals.SignalRows)
    live: signals.SignalRows = field(default_factory=signals.SignalRows)
    attitude: _Column = field(default_factory=_Column)
    position: _Column = field(default_factory=_Column)
    load: _Column = field(default_factory=_Column)
    load_std: _Column = field(default_factory=_Column)
    events: list[tuple[int, FlightEvent]] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)
    systems: set[int] = field(default_factory=set)
    shown: int | None = None
    _notes: NoteReader = field(default_factory=NoteReader)
    _vehicle: Vehicle | None = None
    _own: tuple[int, int] | None = None
    _mode: str = ""
    _armed: bool | None = None

    def pass_by(self, time_us: int) -> None:
        """A record at this time."""
        self.first_us = time_us if self.first_us is None else self.first_us
        self.last_us = max(self.last_us, time_us)

    def take(self, time_us: int, message: Any) -> None:
        """Sort in one message."""
        if is_note(message) and (self._own is None or self._is_own(message)):
            self._take_note(time_us, message)
        elif self._is_own(message):
            if signals.is_signals(message):
                self.full.add(message)
            elif signals.is_signals(message, signals.LIVE_ARRAY_ID):
                self.live.add(message)
            self._take_own(time_us, message)
        else:
            self._take_telemetry(time_us, message)

    def _is_own(self, message: Any) -> bool:
        """Sent by the daemon: whoever wrote the header, else a component with the daemon's usual number."""
        if self._own is None:
            return bool(message.get_srcComponent() == _OWN_COMPONENT)
        return (message.get_srcSystem(), message.get_srcComponent()) == self._own

    def _take_note(self, time_us: int, message: Any) -> None:
        self._own = (message.get_srcSystem(), message.get_srcComponent())
        try:
            note = self._notes.take(message)
        except ValueError as problem:
            self.remarks.append(f"a note could not be read: {problem}")
            self._notes = NoteReader()
            return
        if isinstance(note, Header) and self.header is None:
            self.header = note
        elif isinstance(note, Lost):
            since_s = (time_us - (self.first_us or 0)) / 1e6
            self.remarks.append(f"{note.records} records are missing before {since_s:.1f} s (full disk)")
        elif isinstance(note, End):
            self.end = note

    def _take_own(self, time_us: int, message: Any) -> None:
        """What the daemon says: texts and the mass of the load."""
        if message.get_type() == "STATUSTEXT":
            self._note(time_us, own_text(message.text))
        elif message.get_type() == "NAMED_VALUE_FLOAT" and message.name == "payload_kg":
            self.load.add(time_us, (message.value,))
        elif message.get_type() == "NAMED_VALUE_FLOAT" and message.name == "payload_sd":
            self.load_std.add(time_us, (message.value,))

    def _take_telemetry(self, time_us: int, message: Any) -> None:
        if message.get_type() == "HEARTBEAT" and self._is_vehicle(message):
            self.systems.add(message.get_srcSystem())
        if self._vehicle is None and not self._found(message):
            return
        assert self._vehicle is not None
        for event in self._vehicle.decode(message):
            match event:
                case AttitudeReceived():
                    self.attitude.add(time_us, event.attitude)
                case PositionReceived():
                    self.position.add(time_us, event.position)
                case StatusReceived():
                    self._note(time_us, FlightEvent(0.0, "text", event.text))
                case HeartbeatReceived():
                    self._take_heartbeat(time_us, event)
                case _:
                    pass

    def _found(self, message: Any) -> bool:
        """Recognise the vehicle by its first heartbeat; ground stations and gimbals are passed over."""
        if message.get_type() != "HEARTBEAT" or not self._is_vehicle(message):
            return False
        self.shown = message.get_srcSystem()
        self._vehicle = Vehicle(
            Route(target_system=message.get_srcSystem(), target_component=message.get_srcComponent())
        )
        return True

    def _is_vehicle(self, heartbeat: Any) -> bool:
        return heartbeat.autopilot in _AUTOPILOTS and heartbeat.type in MULTIROTORS

    def _take_heartbeat(self, time_us: int, event: HeartbeatReceived) -> None:
        if event.mode_name != self._mode:
            self._mode = event.mode_name
            self._note(time_us, FlightEvent(0.0, "mode", f"mode {event.mode_name}"))
        if event.armed != self._armed:
            if event.armed or self._armed is not None:
                self._note(time_us, FlightEvent(0.0, "armed", "armed" if event.armed else "disarmed"))
            self._armed = event.armed

    def _note(self, time_us: int, event: FlightEvent) -> None:
        self.events.append((time_us, event))


def own_text(text: str) -> FlightEvent:
    """A text of the daemon's as an event (at 0 s); what it says of the load is an event of its own kind."""
    found = _LOAD_TEXT.fullmatch(text)
    if found is None:
        return FlightEvent(0.0, "text", text)
    mass = float(found[2]) * (1.0 if found[1] == "picked up" else -1.0)
    return FlightEvent(0.0, "load", text, mass)


def read_any(path: Path, name: str) -> Flight:
    """Read a telemetry log, or a log written on board (.BIN, .ulg): its first bytes tell.

    Raises UserError as `read_flight` and `from_record.read_onboard`.
    """
    onboard = first_bytes(path).startswith(_ONBOARD)
    if not onboard and path.suffix.lower() not in (".bin", ".ulg"):
        return read_flight(path, name)
    from kffa_offboard.report.from_record import read_onboard

    return read_onboard(path, name)


def read_flight(path: Path, name: str | None = None) -> Flight:
    """Read a telemetry log (.tlog, .tlog.gz) and its further parts (FLIGHT-2.tlog, ...).

    A log that is damaged or breaks off gives what could be read, and says so in `remarks`.
    Raises UserError if the file cannot be read, is no telemetry log or has no flight in it.
    """
    collector = _Collector()
    _read_part(path, collector)
    if collector.header is not None:
        for part in following_parts(path):
            _read_part(part, collector)
    if not collector.full and not collector.live and not collector.attitude.values:
        why = "holds no attitude of a PX4 or ArduPilot multirotor"
        if collector.first_us is None:
            why = "is empty"
        raise UserError(f"flight log {path}: {why}; there is nothing to show")
    return _flight(collector, path, name or short_name(path))


def short_name(path: Path) -> str:
    """File name without .tlog, .tlog.gz, .BIN or .ulg."""
    return re.sub(r"(\.tlog(\.gz)?|\.bin|\.ulg)$", "", path.name, flags=re.IGNORECASE)


def _read_part(path: Path, collector: _Collector) -> None:
    log = read_tlog(path, even=True)
    damaged = 0
    try:
        for time_us, frame in log.frames():
            collector.pass_by(time_us)
            if message_id(frame) not in _WANTED:
                continue
            try:
                collector.take(time_us, decode(frame))
            except mavlink.MAVError:
                damaged += 1
    except UserError as error:
        if collector.first_us is None:
            raise
        collector.remarks.append(str(error).partition(": ")[2])
    if damaged:
        collector.remarks.append(f"{damaged} frames of {path.name} with a wrong checksum are left out")
    collector.remarks += clock_remarks(log)
    if log.truncated:
        collector.remarks.append(f"the last record of {path.name} is incomplete")


def _flight(collector: _Collector, path: Path, name: str) -> Flight:
    begin_us, header = collector.first_us or 0, collector.header
    table = (collector.full or collector.live).table()
    lines = signal_lines(table, begin_us)
    measured = dict(_measured(collector, begin_us))
    # What was sent live is thinned; telemetry is whole.
    lines = lines | measured if not collector.full else measured | lines
    states, engaged = state_events(table, begin_us)
    others = [_at(event, time_us, begin_us) for time_us, event in collector.events]
    latency = _clean(line(_since(table.time_us, begin_us), table.latency_s))
    return Flight(
        name=name,
        origin=_origin(header, path, begin_us),
        duration_s=(collector.last_us - begin_us) / 1e6,
        lines=lines,
        saturated=table.saturated if len(table.time_us) else None,
        engaged=engaged,
        load=_column(collector.load, begin_us),
        load_std=_column(collector.load_std, begin_us),
        latency=latency,
        arrivals={
            "attitude": _since(np.array(collector.attitude.time_us), begin_us),
            "position": _since(np.array(collector.position.time_us), begin_us),
        },
        events=tuple(sorted((*states, *others), key=lambda event: event.time_s)),
        frames_dropped=None if collector.end is None else collector.end.frames_dropped,
        remarks=(*_remarks(collector), *collector.remarks),
    )


def _remarks(collector: _Collector) -> Iterator[str]:
    if not collector.full:
        if collector.live:
            yield "the controller's signals are those that were sent live, thinned"
        else:
            yield "the log has no inner signals of the controller: only what was measured is shown"
    if collector.header is not None and collector.header.part > 1:
        yield f"is part {collector.header.part} of a flight alone; name its first file to see all of it"
    elif collector.header is not None and collector.end is None:
        yield "the log breaks off: the daemon was killed, or still writes it"
    if others := collector.systems - {collector.shown}:
        names = ", ".join(map(str, sorted(others)))
        yield f"system {collector.shown} is shown; left out: system {names}"


def _origin(header: Header | None, path: Path, begin_us: int) -> Origin:
    if header is None:
        return Origin(path.name, begin_us)
    control = header.configuration.get("control", {})
    attitude = isinstance(control, dict) and control.get("output") == "attitude"
    return Origin(
        path.name,
        begin_us,
        header.version,
        header.libraries,
        header.configuration,
        "attitude" if attitude else "rates",
    )


def _measured(collector: _Collector, begin_us: int) -> Iterator[tuple[Any, Line]]:
    attitude, position = collector.attitude, collector.position
    columns = attitude.columns(3)
    for channel, values in zip(("roll", "pitch", "yaw"), columns, strict=True):
        if len(values):
            yield ("measured", channel), line(_since(np.array(attitude.time_us), begin_us), values)
    if not position.values:
        return
    time_s = _since(np.array(position.time_us), begin_us)
    x, y, z = position.columns(3)
    for channel, values in (("altitude", z), ("north", x), ("east", -y)):
        yield ("measured", channel), line(time_s, values)


def _at(event: FlightEvent, time_us: int, begin_us: int) -> FlightEvent:
    return FlightEvent((time_us - begin_us) / 1e6, event.kind, event.text, event.mass_kg)


def _since(time_us: Any, begin_us: int) -> Any:
    return (np.asarray(time_us, dtype=np.int64) - begin_us) / 1e6


def _column(column: _Column, begin_us: int) -> Line | None:
    if not column.values:
        return None
    return line(_since(np.array(column.time_us), begin_us), np.array(column.values))


def _clean(found: Line) -> Line | None:
    """The line if it has any value at all."""
    return found if np.any(np.isfinite(found.values)) else None
