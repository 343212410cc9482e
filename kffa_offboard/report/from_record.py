"""Logs written on board (ArduPilot .BIN, PX4 .ulg) as flights, with the estimators run over them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis.read import read_log
from kffa_offboard.loganalysis.record import FlightRecord, Note, Series
from kffa_offboard.report.flight import (
    CHANNELS,
    Channel,
    EventKind,
    Flight,
    FlightEvent,
    Line,
    Origin,
    Quantity,
    line,
)

_ANGLES: tuple[Channel, ...] = ("roll", "pitch", "yaw")
_KINDS: dict[str, EventKind] = {"mode": "mode", "armed": "armed"}

_Lines = dict[tuple[Quantity, Channel], Line]


def read_onboard(path: Path, name: str) -> Flight:
    """Read a log of the autopilot itself.

    Estimate, disturbance and changes of the load are those of `kffa-offboard shadow`, where the log has the
    steady hover that it needs; else `remarks` says why not. Raises UserError as `read_log`.
    """
    record = read_log(path)
    remarks = [*record.damage, "written on board: reference and command are what the autopilot followed"]
    lines = _recorded(record)
    events = [_event(note, record.start_s) for note in record.notes]
    try:
        estimated, loads = _estimated(record)
    except UserError as problem:
        remarks.append(f"no estimates: {str(problem).partition(': ')[2]}")
    else:
        lines |= estimated
        events += loads
    arrivals = {"attitude": record.attitude, "position": record.position}
    return Flight(
        name=name,
        origin=Origin(path.name, command_kind="rates"),
        duration_s=record.duration_s,
        lines=lines,
        arrivals={stream: samples.time_s - record.start_s for stream, samples in arrivals.items() if samples},
        events=tuple(sorted(events, key=lambda event: event.time_s)),
        remarks=tuple(remarks),
    )


def _recorded(record: FlightRecord) -> _Lines:
    lines: _Lines = {}
    columns: tuple[tuple[Quantity, Series], ...] = (
        ("measured", record.attitude),
        ("reference", record.attitude_setpoint),
        ("command", record.rates_setpoint),
    )
    for quantity, samples in columns:
        for column, channel in enumerate(_ANGLES):
            if samples:
                lines[quantity, channel] = _line(samples, column, record.start_s)
    if record.position:
        lines["measured", "altitude"] = _line(record.position, 2, record.start_s)
        lines["measured", "north"] = _line(record.position, 0, record.start_s)
        west = _line(record.position, 1, record.start_s)
        lines["measured", "east"] = Line(west.time_s, -west.values)
    if record.thrust:
        lines["command", "altitude"] = _line(record.thrust, 0, record.start_s)
    return lines


def _estimated(record: FlightRecord) -> tuple[_Lines, list[FlightEvent]]:
    from kffa_offboard.loganalysis.shadow import shadow  # scipy is slow to import

    found = shadow(record, None)
    time_s = found.estimates.time_s - record.start_s
    lines: _Lines = {}
    for column, channel in enumerate(CHANNELS):
        lines["estimate", channel] = line(time_s, found.estimates.estimate[:, column])
        lines["disturbance", channel] = line(time_s, found.estimates.disturbance[:, column])
    changes = () if found.mass is None else found.mass.changes
    loads = [
        FlightEvent(change.time_s - record.start_s, "load", f"{_name(change.share)} % of the empty mass")
        for change in changes
    ]
    return lines, loads


def _name(share: float) -> str:
    return f"{'pick-up' if share > 0.0 else 'drop'} of {100.0 * abs(share):.0f}"


def _event(note: Note, start_s: float) -> FlightEvent:
    return FlightEvent(note.time_s - start_s, _KINDS.get(note.kind, "text"), note.text)


def _line(samples: Series, column: int, start_s: float) -> Line:
    return line(samples.time_s - start_s, np.asarray(samples.values[:, column]))
