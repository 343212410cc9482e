"""Figures for papers: one PNG for each section of the page, all flights laid over one another."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from kffa_offboard.plot_style import GREY, figure_to
from kffa_offboard.report.align import Alignment, zero_of
from kffa_offboard.report.flight import Flight
from kffa_offboard.report.panels import Panel, panels
from kffa_offboard.report.traces import flight_colour, signal_colour

_STYLES: dict[str, Any] = {
    "reference": {"linestyle": (0, (4, 3)), "linewidth": 1.0, "zorder": 4},
    "estimate": {"linestyle": (0, (1, 1.5)), "linewidth": 1.0},
}
_TIME_0 = {"start": "start of the log", "engage": "engaging", "event": "first pick-up or drop"}
_PANEL_HEIGHT, _WIDTH, _DPI = 1.9, 7.0, 200


def draw_figures(directory: Path, flights: Sequence[Flight], alignment: Alignment) -> list[Path]:
    """Draw altitude.png, roll.png, ...; 7 inches wide, 200 dots per inch. Returns the files."""
    zeros_s = [zero_of(flight, alignment).time_s for flight in flights]
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    for section, group in groupby(panels(flights, zeros_s), key=lambda panel: panel.section):
        path = directory / f"{section.lower()}.png"
        _draw(path, list(group), flights, zeros_s, f"time since {_TIME_0[alignment]} [s]")
        paths.append(path)
    return paths


def _draw(
    path: Path, shown: Sequence[Panel], flights: Sequence[Flight], zeros_s: Sequence[float], time: str
) -> None:
    size = (_WIDTH, 0.6 + _PANEL_HEIGHT * len(shown))
    with figure_to(path, size, _DPI, metadata={"Software": None}) as figure:
        axes = figure.subplots(len(shown), 1, sharex=True, squeeze=False)[:, 0]
        for axis, panel in zip(axes, shown, strict=True):
            _draw_panel(axis, panel, flights)
            _mark_loads(axis, flights, zeros_s)
        axes[-1].set_xlabel(time)
        _legend(figure, axes)


def _draw_panel(axis: Any, panel: Panel, flights: Sequence[Flight]) -> None:
    alone = len(flights) == 1
    for curve in panel.curves:
        colour = signal_colour(curve.signal, curve.flight, alone)
        name = " ".join(part for part in ("" if alone else flights[curve.flight].name, curve.signal) if part)
        style = _STYLES.get(curve.signal, {})
        axis.plot(curve.line.time_s, curve.line.values, color=colour, label=name or None, **style)
        if curve.spread is not None:
            time_s, mass = curve.line.time_s, curve.line.values
            half = 2.0 * np.interp(time_s, curve.spread.time_s, curve.spread.values)
            axis.fill_between(time_s, mass - half, mass + half, color=colour, alpha=0.25, linewidth=0.0)
    axis.set_title(panel.title)
    axis.set_ylabel(panel.unit)


def _mark_loads(axis: Any, flights: Sequence[Flight], zeros_s: Sequence[float]) -> None:
    for number, (flight, zero_s) in enumerate(zip(flights, zeros_s, strict=True)):
        for event in flight.events:
            if event.kind == "load":
                colour = GREY if len(flights) == 1 else flight_colour(number)
                axis.axvline(event.time_s - zero_s, color=colour, linewidth=0.8, linestyle=(0, (4, 3)))


def _legend(figure: Any, axes: Any) -> None:
    """One for all panels, above them."""
    named: dict[str, Any] = {}
    for axis in axes:
        handles, names = axis.get_legend_handles_labels()
        named |= {name: handle for name, handle in zip(names, handles, strict=True) if name not in named}
    if named:
        figure.legend(named.values(), named.keys(), loc="outside upper center", ncols=min(len(named), 4))
