"""Height after the pick-up and the drop, every trial; and the responses to steps of roll, pitch and yaw."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kffa_offboard.compare.results import Result
from kffa_offboard.plot_style import BLUE, GREEN, GREY, ORANGE, VIOLET, figure_to
from kffa_offboard.trials.metrics import WINDOW_S

_COLOURS = {
    "native-stock": "#222222",
    "native-tuned": GREY,
    "pid": "#b03060",
    "cascaded-pid": ORANGE,
    "ladrc": GREEN,
    "kffa-ladrc": BLUE,
    "release": VIOLET,
}
_BEFORE_S = 1.0

SMALL_M = 0.15
"""The rows that move less than this are drawn once more, larger."""


def draw_height(path: Path, results: Sequence[Result], title: str) -> None:
    """Deviation of height from 1 s before to 5 s after; all trials above, the small ones again below.

    The rows of other loads, links and sensors are drawn where there are none but these.
    """
    measured = [result for result in results if result.load is not None]
    shown = [result for result in measured if result.trial.name in _COLOURS] or measured
    small = [result for result in shown if result.load is not None and result.load.pickup.peak_m < SMALL_M]
    rows = [chosen for chosen in (shown, small) if chosen]
    with figure_to(path, (10.5, 0.4 + 3.6 * len(rows)), dpi=130) as figure:
        axes = figure.subplots(len(rows), 2, sharex=True, sharey="row", squeeze=False)
        figure.suptitle(title, fontsize=12.5, fontweight="bold")
        for row, chosen in enumerate(rows):
            for column, event in ((0, "pickup"), (1, "drop")):
                for number, result in enumerate(chosen):
                    colour = _COLOURS.get(result.trial.name, f"C{number}")
                    _height(axes[row][column], result, event, row, colour)
                axes[row][column].axvline(0.0, color=GREY, linewidth=1.0, linestyle=(0, (4, 3)))
                axes[row][column].set_xlim(-_BEFORE_S, WINDOW_S)
        _name_panels(axes)


def _height(axis: Any, result: Result, event: str, row: int, colour: str) -> None:
    truth, load = result.truth, result.load
    assert truth is not None and load is not None
    time = truth.time_s - getattr(load, f"{event}_s")
    near = (time >= -_BEFORE_S) & (time <= WINDOW_S)
    scale = 1.0 if row == 0 else 100.0
    axis.plot(
        time[near],
        scale * (truth.z[near] - load.reference_m),
        color=colour,
        label=f"{result.trial.label}, peak {100 * getattr(load, event).peak_m:.1f} cm",
        linewidth=1.6,
    )


def _name_panels(axes: Any) -> None:
    for row, unit, which in zip(axes, ("m", "cm"), ("", ", the small ones"), strict=False):
        row[0].set_title(f"Picked up{which}")
        row[1].set_title(f"Dropped{which}")
        row[0].set_ylabel(f"deviation of height [{unit}]")
    for axis in axes[-1]:
        axis.set_xlabel("time since then [s]")
    for row in axes:
        low, high = row[0].get_ylim()
        row[0].set_ylim(low - 0.55 * (high - low), high + 0.55 * (high - low))  # room for the legends
        for axis, place in ((row[0], "lower right"), (row[1], "upper right")):
            axis.legend(loc=place, fontsize=7.5)


def draw_steps(path: Path, results: Sequence[Result], title: str) -> None:
    """True roll, pitch and yaw of the attitude course against time since lift-off."""
    shown = [result for result in results if result.steps and result.truth is not None]
    with figure_to(path, (10.5, 6.0), dpi=130) as figure:
        axes = figure.subplots(3, 1)
        figure.suptitle(title, fontsize=12.5, fontweight="bold")
        for axis, name, bounds in zip(axes, ("roll", "pitch", "yaw"), _bounds(shown), strict=True):
            for result, colour in zip(shown, (BLUE, ORANGE), strict=False):
                truth = result.truth
                assert truth is not None
                since = truth.time_s - truth.time_s[np.argmax(truth.z > 0.05)]
                angle = np.unwrap(getattr(truth, name))
                label = f"output {result.trial.output}"
                axis.plot(since, np.degrees(angle), color=colour, label=label, linewidth=1.4)
            axis.set_xlim(*bounds)
            limit = 40.0 if name == "yaw" else 14.0
            axis.set_ylim(-limit, limit)
            axis.set_ylabel(f"{name} [deg]")
            for level in (-1.0, 1.0):
                axis.axhline(
                    level * (30.0 if name == "yaw" else 10.0), color=GREY, linewidth=0.8, linestyle=":"
                )
        axes[0].legend(loc="upper right", ncols=2)
        axes[-1].set_xlabel("time since lift-off [s]")


def _bounds(shown: Sequence[Result]) -> list[tuple[float, float]]:
    """When each channel's steps are, s since lift-off: found in the true angles."""
    truth = shown[0].truth
    assert truth is not None
    since = truth.time_s - truth.time_s[np.argmax(truth.z > 0.05)]
    starts = []
    for name in ("roll", "pitch", "yaw"):
        angle = np.abs(np.unwrap(getattr(truth, name)))
        moved = since[(angle > math.radians(5.0)) & (since > 8.0)]
        starts.append(float(moved[0]) if moved.size else 8.0)
    return [
        (starts[0] - 1.0, starts[0] + 8.5),
        (starts[1] - 1.0, starts[1] + 8.5),
        (starts[2] - 2.0, starts[2] + 23),
    ]
