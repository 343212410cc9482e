"""The report as one HTML file that needs no network: tables, plots, Plotly itself."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from importlib.resources import files
from itertools import groupby
from typing import Any

import numpy as np
from plotly.offline import get_plotlyjs

from kffa_offboard import __version__
from kffa_offboard.report import tables
from kffa_offboard.report.align import Alignment, Zero, zero_of
from kffa_offboard.report.flight import Flight
from kffa_offboard.report.metrics import judge
from kffa_offboard.report.panels import SIGNALS, Panel, panels
from kffa_offboard.report.traces import (
    events_json,
    figure_json,
    flight_colour,
    points_per_line,
    signal_colour,
)

_TIME_0 = {"start": "start of the log", "engage": "engaging", "event": "the first pick-up or drop"}

# Nothing may be fetched, whatever a log has put into the page.
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"


def render(flights: Sequence[Flight], alignment: Alignment) -> str:
    """The whole page. Flights must have different names."""
    zeros = [zero_of(flight, alignment) for flight in flights]
    zeros_s = [zero.time_s for zero in zeros]
    shown = panels(flights, zeros_s)
    points = points_per_line(shown)
    document: dict[str, Any] = {
        "timeTitle": f"time since {_TIME_0[alignment]} [s]",
        "range": _range(flights, zeros_s),
        "panels": [{"key": panel.key, **figure_json(panel, flights, zeros_s, points)} for panel in shown],
    }
    if any(flight.events for flight in flights):
        document["panels"].insert(0, {"key": "events", **events_json(flights, zeros_s)})
    body = "".join(
        (
            _head(flights),
            _controls(flights, shown),
            "<main>",
            "<h2>Figures of the flight</h2>",
            tables.metrics_table(flights, zeros, metrics := [judge(flight) for flight in flights]),
            tables.loads_table(flights, metrics),
            _events(flights, zeros),
            *_sections(shown),
            tables.configurations(flights),
            _foot(shown, points),
            "</main>",
        )
    )
    return _assemble(_title(flights), body, document)


def _assemble(title: str, body: str, document: Any) -> str:
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{html.escape(title)}</title><style>{_asset('page.css')}</style></head>\n"
        f"<body>{body}\n"
        f'<script type="application/json" id="report-data">{_for_script(document)}</script>\n'
        f"<script>{get_plotlyjs()}</script>\n<script>{_asset('page.js')}</script>\n</body></html>\n"
    )


def _asset(name: str) -> str:
    return files("kffa_offboard.report").joinpath(name).read_text(encoding="utf-8")


def _for_script(document: Any) -> str:
    """JSON in which no text can end the script element."""
    return json.dumps(document, separators=(",", ":")).replace("<", "\\u003c")


def _range(flights: Sequence[Flight], zeros_s: Sequence[float]) -> list[float]:
    begin = min(-zero_s for zero_s in zeros_s)
    end = max(flight.duration_s - zero_s for flight, zero_s in zip(flights, zeros_s, strict=True))
    margin = 0.02 * max(end - begin, 1.0)  # what happened at the very ends is to be seen
    return [begin - margin, end + margin]


def _title(flights: Sequence[Flight]) -> str:
    return "Flight " + ", ".join(flight.name for flight in flights)


def _head(flights: Sequence[Flight]) -> str:
    remarks = "".join(
        f'<p class="remark">{html.escape(flight.name)}: {html.escape(remark)}.</p>'
        for flight in flights
        for remark in flight.remarks
    )
    return f"<header><h1>{html.escape(_title(flights))}</h1>{remarks}</header>"


def _controls(flights: Sequence[Flight], shown: Sequence[Panel]) -> str:
    """The legend that toggles, and the buttons for the time axis."""
    alone = len(flights) == 1
    present = {curve.signal for panel in shown for curve in panel.curves}
    if any(flight.events for flight in flights):
        present.add("events")
    legend = "" if alone else "".join(
        _toggle("flight", str(number), flight.name, flight_colour(number), "solid")
        for number, flight in enumerate(flights)
    )  # fmt: skip
    styles = {"reference": "dashed", "estimate": "dotted", "events": "dotted"}
    legend += "".join(
        _toggle(
            "signal",
            signal,
            signal,
            signal_colour(signal, 0, alone) if alone and signal != "events" else "currentColor",
            styles.get(signal, "solid"),
        )
        for signal in SIGNALS
        if signal in present
    )
    buttons = "".join(
        f'<button type="button" data-time="{action}" aria-label="{label}" title="{label}">{sign}</button>'
        for action, sign, label in (
            ("back", "◀", "earlier"),
            ("on", "▶", "later"),
            ("in", "+", "zoom in"),
            ("out", "−", "zoom out"),
            ("all", "all", "the whole flight"),
        )
    )
    return (
        f'<nav aria-label="What is shown"><div class="legend">{legend}</div>'
        f'<div class="time">{buttons}<output id="span"></output></div></nav>'
    )


def _toggle(kind: str, value: str, label: str, colour: str, style: str) -> str:
    return (
        f'<label><input type="checkbox" checked data-{kind}="{value}">'
        f'<i style="border-top:3px {style} {colour}"></i>{html.escape(label)}</label>'
    )


def _events(flights: Sequence[Flight], zeros: Sequence[Zero]) -> str:
    if not any(flight.events for flight in flights):
        return ""
    plot = _plot("events", "What happened", "")
    return f"<section><h2>Events</h2>{plot}{tables.events_table(flights, zeros)}</section>"


def _sections(shown: Sequence[Panel]) -> list[str]:
    return [
        f'<section><h2>{html.escape(name)}</h2><div class="grid">'
        + "".join(_plot(panel.key, panel.title, panel.unit) for panel in group)
        + "</div></section>"
        for name, group in groupby(shown, key=lambda panel: panel.section)
    ]


def _plot(key: str, title: str, unit: str) -> str:
    heading = html.escape(f"{title} [{unit}]" if unit else title)
    return (
        f'<figure class="{"strip" if key == "events" else "panel"}"><figcaption>{heading}</figcaption>'
        f'<div class="plot" id="plot-{key}" role="group" aria-label="{heading}"></div></figure>'
    )


def _foot(shown: Sequence[Panel], points: int) -> str:
    thinned = [curve.line for panel in shown for curve in panel.curves if len(curve.line) > points]
    notes = [
        "Axes: x forward (north), y left (west), z up; roll right, pitch nose down, yaw left positive. "
        "Angles in degrees."
    ]
    if thinned:
        longest = max(thinned, key=lambda line: line.time_s[-1] - line.time_s[0])
        stretch = -(-2 * len(longest) // points) * float(np.median(np.diff(longest.time_s)))
        notes.append(
            f"Lines of more than {points} samples are drawn with the least and the greatest value of each "
            f"stretch of {stretch:.2g} s; the tables are computed from all samples."
        )
    notes.append(f"Written by kffa-offboard {__version__}.")
    return f"<footer><p>{' '.join(html.escape(note) for note in notes)}</p></footer>"
