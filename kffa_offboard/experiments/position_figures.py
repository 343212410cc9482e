"""Figures of the position ring: hover through pick-up and drop, a step, a square from above."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from kffa_offboard.experiments.examples import POSITION
from kffa_offboard.experiments.figures import About, Drawn, draw, legend_above, plot
from kffa_offboard.experiments.position_flights import CORNERS, PositionTrace, PositionTraces
from kffa_offboard.experiments.settings import PaperSettings, PositionRing
from kffa_offboard.plot_style import GREY
from kffa_offboard.trials.metrics import distance_from_path

SHOWN_SEED = 0
_DASHED: Any = (0, (4, 3))


def draw_position(directory: Path, settings: PaperSettings, traces: PositionTraces) -> list[Drawn]:
    """Draw the position ring's figures, of the first seed."""
    told = settings.position
    return [
        draw(directory, POSITION, about, lambda figure, paint=paint: paint(figure, told, traces))  # type: ignore[misc]
        for about, paint in _FIGURES
    ]


def _shown(traces: PositionTraces, flight: str) -> dict[str, PositionTrace]:
    return {
        label: trace for (label, name, seed), trace in traces.items() if (name, seed) == (flight, SHOWN_SEED)
    }


def _draw_hover(figure: Any, told: PositionRing, traces: PositionTraces) -> None:
    axes = figure.subplots(2, 2, sharex=True)
    panels = (
        (axes[0, 0], "(a) North", 0, 0.0, "x [m]"),
        (axes[0, 1], "(b) West", 1, 0.0, "y [m]"),
        (axes[1, 0], "(c) Height", 2, told.altitude_m, "off set-point [m]"),
        (axes[1, 1], "(d) Height, magnified", 2, told.altitude_m, "off set-point [m]"),
    )
    for axis, title, row, around, unit in panels:
        for label, trace in _shown(traces, "hover").items():
            plot(axis, trace.time, trace.place[:, row] - around, label, linewidth=1.1)
        for event, name in ((told.pick_up_s, "pick-up"), (told.drop_s, "drop")):
            axis.axvline(event, color=GREY, linewidth=1.0, linestyle=_DASHED)
            axis.annotate(f" {name}", (event, 0.02), xycoords=("data", "axes fraction"), color="#444444")
        axis.set_title(title)
        axis.set_ylabel(unit)
        axis.set_xlim(told.lead_s, told.drop_s + told.hover_s)
    for axis in axes[0]:
        axis.set_ylim(-0.25, 0.25)
    axes[1, 1].set_ylim(-0.2, 0.2)
    for axis in axes[1]:
        axis.set_xlabel("time [s]")
    legend_above(figure, axes[0, 0])


def _draw_step(figure: Any, told: PositionRing, traces: PositionTraces) -> None:
    axes = figure.subplots(2, 2, sharex=True, sharey="row", height_ratios=[3, 2])
    for column, (flight, title) in enumerate(
        (("step", "empty"), ("loaded-step", f"with {told.load_kg:g} kg"))
    ):
        upper, lower = axes[:, column]
        flown = _shown(traces, flight)
        first = next(iter(flown.values()))
        upper.plot(
            first.time - told.lead_s, first.target[:, 0], color="#222222", linestyle=_DASHED, linewidth=1.1,
            label="reference",
        )  # fmt: skip
        for label, trace in flown.items():
            time = trace.time - told.lead_s
            plot(upper, time, trace.place[:, 0], label)
            plot(lower, time, np.degrees(trace.attitude[:, 1]), label, linewidth=1.0)
        upper.set_title(f"({'ab'[column]}) North, {title}")
        lower.set_title(f"({'cd'[column]}) Pitch, {title}")
        lower.set_xlabel("time since the step [s]")
        lower.set_xlim(-0.5, told.step_s)
    axes[0, 0].set_ylabel("x [m]")
    axes[1, 0].set_ylabel("δ [deg]")
    legend_above(figure, axes[0, 0])


def _draw_square(figure: Any, told: PositionRing, traces: PositionTraces) -> None:
    above, beside = figure.subplots(1, 2, width_ratios=[1, 1.15])
    corners = told.step_m * np.array(CORNERS)
    above.plot(-corners[:, 1], corners[:, 0], color="#222222", linestyle=_DASHED, linewidth=1.1, label="line")
    for label, trace in _shown(traces, "square").items():
        shown = trace.time >= told.lead_s
        place = trace.place[shown]
        plot(above, -place[:, 1], place[:, 0], label, linewidth=1.1)
        away = distance_from_path(place[:, :2], corners)
        plot(beside, trace.time[shown] - told.lead_s, away, label, linewidth=1.1)
    above.set_aspect("equal")
    above.set_title("(a) From above")
    above.set_xlabel("east [m]")
    above.set_ylabel("north [m]")
    dropped = told.square_drop_s - told.lead_s
    beside.axvline(dropped, color=GREY, linewidth=1.0, linestyle=_DASHED)
    beside.annotate(" drop", (dropped, 0.94), xycoords=("data", "axes fraction"), color="#444444")
    beside.set_title("(b) Distance from the line")
    beside.set_xlabel("time since the start [s]")
    beside.set_ylabel("m")
    beside.set_ylim(bottom=0.0)
    beside.set_xlim(0.0, 4.0 * told.side_s)
    legend_above(figure, above)


_FIGURES: tuple[tuple[About, Callable[[Any, PositionRing, PositionTraces], None]], ...] = (
    (
        (
            "position-hover", "Position ring: a hover in gusty wind, 5 kg picked up and dropped",
            "Airframe profile, 5 m/s of wind to the north-east, first seed, true states. The paper has no "
            "figure of this.", (9.5, 6.0),
        ),
        _draw_hover,
    ),
    (
        (
            "position-step", "Position ring: a step of 5 m to the north",
            "In the same wind, the nose 0.6 rad to the west of north.", (9.5, 6.0),
        ),
        _draw_step,
    ),
    (
        (
            "position-square", "Position ring: a square with a drop",
            "Four moves of 5 m with at most 2 m/s, begun with 5 kg, which are dropped on the second side.",
            (9.5, 4.6),
        ),
        _draw_square,
    ),
)  # fmt: skip
