"""The tables of the page: figures, loads, events, configuration, as HTML."""

from __future__ import annotations

import html
import json
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from math import degrees, isfinite
from typing import Any

from kffa_offboard.report.align import Zero
from kffa_offboard.report.flight import Channel, Flight
from kffa_offboard.report.metrics import AFTER_EVENT_S, BEFORE_EVENT_S, Metrics

_YEAR_2000_US = 946_684_800_000_000
NOTHING = "–"
_ROWS: tuple[Channel, ...] = ("altitude", "roll", "pitch", "yaw")


def metrics_table(flights: Sequence[Flight], zeros: Sequence[Zero], metrics: Sequence[Metrics]) -> str:
    """One column for each flight."""
    columns = [
        list(_column(flight, zero, found))
        for flight, zero, found in zip(flights, zeros, metrics, strict=True)
    ]
    rows = [[name, *(column[row][1] for column in columns)] for row, (name, _) in enumerate(columns[0])]
    return _table(["", *(flight.name for flight in flights)], rows)


def loads_table(flights: Sequence[Flight], metrics: Sequence[Metrics]) -> str:
    """Every announced pick-up and drop with the height's answer; "" if there was none."""
    rows = [
        [
            flight.name,
            load.event.text,
            number(load.event.time_s, "s", 2),
            number(load.peak_m, "m", 3),
            number(load.peak_estimate_m, "m", 3),
            number(load.iae_m_s, "m s", 3),
        ]
        for flight, found in zip(flights, metrics, strict=True)
        for load in found.loads
    ]
    if not rows:
        return ""
    note = (
        "<p>|reference − measured| of the altitude, noise included, and |reference − estimate|, from "
        f"{BEFORE_EVENT_S:g} s before to {AFTER_EVENT_S:g} s after the announcement, which comes a little "
        "after the event itself.</p>"
    )
    headings = [
        "flight",
        "announced",
        "at, since start of log",
        "peak, measured",
        "peak, estimate",
        "IAE, measured",
    ]
    return f"<h2>Pick-ups and drops</h2>{_table(headings, rows)}{note}"


def events_table(flights: Sequence[Flight], zeros: Sequence[Zero]) -> str:
    """All events, expandable, in the time of the plots."""
    rows = sorted(
        (event.time_s - zero.time_s, flight.name, event.kind, event.text)
        for flight, zero in zip(flights, zeros, strict=True)
        for event in flight.events
    )
    texts = [[number(time_s, "s", 2), *rest] for time_s, *rest in rows]
    table = _table(["time", "flight", "kind", "what"], texts)
    return f"<details><summary>All {len(rows)} events</summary>{table}</details>"


def configurations(flights: Sequence[Flight]) -> str:
    """Summary and, expandable, the whole configuration of each flight whose log has it."""
    parts = []
    for flight in flights:
        if not flight.origin.configuration:
            continue
        whole = json.dumps(flight.origin.configuration, indent=2, ensure_ascii=False)
        parts.append(
            f"<h3>{html.escape(flight.name)}</h3><p>{html.escape(_summary(flight))}</p>"
            f"<details><summary>Full configuration</summary><pre>{html.escape(whole)}</pre></details>"
        )
    return f"<h2>Configuration</h2>{''.join(parts)}" if parts else ""


def number(value: float | None, unit: str, digits: int) -> str:
    """A figure with its unit; a dash where it is not known."""
    if value is None or not isfinite(value):
        return NOTHING
    return f"{value:.{digits}f} {unit}".rstrip()


def _column(flight: Flight, zero: Zero, found: Metrics) -> Iterator[tuple[str, str]]:
    yield "log", flight.origin.file
    yield "begun", _begun(flight.origin.start_us)
    yield "time 0 of the plots", f"{zero.what}, {zero.time_s:.2f} s into the log"
    yield "duration", number(found.duration_s, "s", 1)
    yield "engaged", number(found.engaged_s, "s", 1)
    for channel in _ROWS:
        yield f"tracking rms, {channel}", _tracking(channel, found.tracking_rms[channel])
    for channel in _ROWS:
        yield f"saturated, {channel}", number(100.0 * found.saturated_share[channel], "% of engaged steps", 2)
    for name in ("attitude", "position"):
        stream = found.streams.get(name)
        yield f"{name} rate", NOTHING if stream is None else number(stream.rate_hz, "Hz", 1)
        yield f"{name} jitter", NOTHING if stream is None else number(1e3 * stream.jitter_s, "ms", 2)
        yield (
            f"{name} gaps",
            NOTHING if stream is None else f"{stream.gaps}, longest pause {1e3 * stream.longest_s:.0f} ms",
        )
    yield "latency, median", number(1e3 * found.latency_p50_s, "ms", 1)
    yield "latency, 99th percentile", number(1e3 * found.latency_p99_s, "ms", 1)
    yield "frames dropped by the link", NOTHING if found.frames_dropped is None else str(found.frames_dropped)
    yield "kffa-offboard", flight.origin.version or NOTHING
    libraries = ", ".join(f"{name} {version}" for name, version in flight.origin.libraries.items())
    yield "libraries", libraries or NOTHING
    yield "remarks", "; ".join(flight.remarks) or NOTHING


def _tracking(channel: Channel, rms: float) -> str:
    return number(rms, "m", 4) if channel == "altitude" else number(degrees(rms), "deg", 3)


def _begun(start_us: int) -> str:
    if not start_us:
        return NOTHING
    if start_us < _YEAR_2000_US:
        return f"{start_us / 1e6:.1f} s of simulated time"
    return datetime.fromtimestamp(start_us / 1e6, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def _summary(flight: Flight) -> str:
    """The settings that a person asks for first."""
    tables = flight.origin.configuration
    wanted: tuple[tuple[str, ...], ...] = (
        ("control", "controller"),
        ("control", "output"),
        ("control", "altitude", "hover_thrust"),
        ("control", "altitude", "omega_c"),
        ("control", "altitude", "omega_o"),
        ("control", "altitude", "delay_s"),
        ("telemetry", "attitude_hz"),
        ("telemetry", "position_hz"),
        ("payload", "vehicle_mass_kg"),
        ("link", "url"),
    )
    found = [(".".join(path), _entry(tables, path)) for path in wanted]
    return ", ".join(f"{name} = {value}" for name, value in found if value is not None)


def _entry(tables: Any, path: Sequence[str]) -> Any:
    for name in path:
        tables = tables.get(name) if isinstance(tables, dict) else None
    return tables


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    head = "".join(f'<th scope="col">{html.escape(heading)}</th>' for heading in headings)
    body = "".join(
        f'<tr><th scope="row">{html.escape(row[0])}</th>'
        + "".join(f"<td>{html.escape(cell)}</td>" for cell in row[1:])
        + "</tr>"
        for row in rows
    )
    return (
        '<div class="scroll" tabindex="0"><table>'
        f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )
