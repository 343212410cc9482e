"""Panels as Plotly figures: thinned lines in the flights' colours, and the events across all of them."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import plotly.graph_objects as go
import plotly.io

from kffa_offboard.plot_style import BLUE, FLIGHT_COLOURS, GREY, ORANGE
from kffa_offboard.report.flight import EventKind, Flight, Line
from kffa_offboard.report.panels import Curve, Panel
from kffa_offboard.report.thinning import thinned

POINT_BUDGET = 240_000
"""Points of all lines of a page together: 2.6 MB."""
FEWEST_POINTS, MOST_POINTS = 500, 12_000
"""Of one line, however many there are."""

EVENT_ROWS: tuple[EventKind, ...] = ("text", "armed", "mode", "state", "load")
"""From the lowest row of the strip of events to the highest."""
_SYMBOLS = {
    "text": "circle-open",
    "armed": "square",
    "mode": "diamond",
    "state": "triangle-right",
    "load": "star",
}
_DASHES = {"reference": "dash", "estimate": "dot"}
_SIGNAL_COLOURS = {"reference": GREY, "measured": BLUE, "estimate": ORANGE}
_SPREAD = 2.0


def flight_colour(flight: int) -> str:
    """Colour of a flight; they repeat after ten."""
    return FLIGHT_COLOURS[flight % len(FLIGHT_COLOURS)]


def signal_colour(signal: str, flight: int, alone: bool) -> str:
    """Colour of a curve: by signal if the flight is alone on the page, else by flight."""
    return _SIGNAL_COLOURS.get(signal, BLUE) if alone else flight_colour(flight)


def points_per_line(panels: Sequence[Panel]) -> int:
    """How many points each line may have so that the page stays within `POINT_BUDGET`."""
    long = sum(len(curve.line) > FEWEST_POINTS for panel in panels for curve in panel.curves)
    return int(np.clip(POINT_BUDGET // max(long, 1), FEWEST_POINTS, MOST_POINTS))


def figure_json(panel: Panel, flights: Sequence[Flight], zeros_s: Sequence[float], points: int) -> Any:
    """A panel as Plotly's JSON: {"data": [...], "layout": {...}}."""
    alone = len(flights) == 1
    traces: list[Any] = []
    for curve in panel.curves:
        colour = signal_colour(curve.signal, curve.flight, alone)
        shown = thinned(curve.line, points)
        if curve.spread is not None:
            traces.append(_band(curve, shown, colour))
        traces.append(_stroke(curve, shown, colour, panel.unit, "" if alone else flights[curve.flight].name))
    traces += [
        _markers(number, flight, zero_s, alone)
        for number, (flight, zero_s) in enumerate(zip(flights, zeros_s, strict=True))
        if flight.events
    ]
    return _document(go.Figure(traces), f"[{panel.unit}]")


def events_json(flights: Sequence[Flight], zeros_s: Sequence[float]) -> Any:
    """The strip with every event of every flight, one row for each kind, as Plotly's JSON."""
    traces = [
        go.Scatter(
            x=np.array([event.time_s - zero_s for event in flight.events], dtype=np.float32),
            y=[EVENT_ROWS.index(event.kind) - 0.12 * number for event in flight.events],
            mode="markers",
            marker={
                "symbol": [_SYMBOLS[event.kind] for event in flight.events],
                "size": 10,
                "color": flight_colour(number),
            },
            hovertext=[_hover(event.text) for event in flight.events],
            hovertemplate="%{hovertext}<br>%{x:.2f} s<extra></extra>",
            meta={"flight": number, "signal": ""},
        )
        for number, (flight, zero_s) in enumerate(zip(flights, zeros_s, strict=True))
        if flight.events
    ]
    document = _document(go.Figure(traces), "")
    document["layout"]["yaxis"] = {
        "tickvals": list(range(len(EVENT_ROWS))),
        "ticktext": list(EVENT_ROWS),
        "range": [-0.8, len(EVENT_ROWS) - 0.4],
        "fixedrange": True,
    }
    document["layout"]["hovermode"] = "closest"
    return document


def _stroke(curve: Curve, shown: Line, colour: str, unit: str, flight: str) -> Any:
    label = " ".join(part for part in (_hover(flight), curve.signal) if part) or "value"
    return go.Scatter(
        x=shown.time_s.astype(np.float32),
        y=shown.values.astype(np.float32),
        mode="lines",
        name=label,
        line={"color": colour, "width": 1.3, "dash": _DASHES.get(curve.signal, "solid")},
        hovertemplate=f"%{{y:.4g}} {unit}",
        opacity=0.85,
        meta={"flight": curve.flight, "signal": curve.signal},
    )


def _band(curve: Curve, shown: Line, colour: str) -> Any:
    """A closed outline around each stretch without gaps."""
    assert curve.spread is not None
    half = _SPREAD * np.interp(shown.time_s, curve.spread.time_s, curve.spread.values)
    known = np.isfinite(shown.values) & np.isfinite(half)
    edges = np.flatnonzero(np.diff(known.astype(int), prepend=0, append=0))
    x: list[Any] = []
    y: list[Any] = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        part = slice(int(begin), int(end))
        time, middle, width = shown.time_s[part], shown.values[part], half[part]
        x += [time, time[::-1], [np.nan]]
        y += [middle + width, (middle - width)[::-1], [np.nan]]
    return go.Scatter(
        x=np.concatenate(x).astype(np.float32) if x else [],
        y=np.concatenate(y).astype(np.float32) if y else [],
        mode="lines",
        line={"width": 0},
        fill="toself",
        fillcolor=colour,
        opacity=0.25,
        hoverinfo="skip",
        meta={"flight": curve.flight, "signal": curve.signal},
    )


def _markers(number: int, flight: Flight, zero_s: float, alone: bool) -> Any:
    """Vertical strokes over the whole height (a second axis, 0..1), what happened at their foot."""
    count = len(flight.events)
    x = np.full(3 * count, np.nan, dtype=np.float32)
    x[0::3] = x[1::3] = [event.time_s - zero_s for event in flight.events]
    texts = [text for event in flight.events for text in (_hover(event.text), "", "")]
    return go.Scatter(
        x=x,
        y=np.tile(np.array([0.0, 1.0, np.nan], dtype=np.float32), count),
        yaxis="y2",
        mode="lines+markers",
        line={"color": GREY if alone else flight_colour(number), "width": 1, "dash": "dot"},
        marker={"size": np.tile([7, 0, 0], count), "symbol": "triangle-up", "line": {"width": 0}},
        name="" if alone else _hover(flight.name),
        text=texts,
        hovertemplate="%{text}",
        opacity=0.7,
        meta={"flight": number, "signal": "events"},
    )


def _document(figure: Any, y_title: str) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(plotly.io.to_json(figure, validate=False))
    document["layout"] = {
        "yaxis": {"title": {"text": y_title, "standoff": 6}, "automargin": False},
        "yaxis2": {"overlaying": "y", "range": [0.0, 1.0], "fixedrange": True, "visible": False},
        "hovermode": "x unified",
        "showlegend": False,
    }
    return document


def _hover(text: str) -> str:
    """Plotly reads some HTML in its texts; a vehicle's words are not to be read as such."""
    return html.escape(text, quote=False)
