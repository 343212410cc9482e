"""Figures that correspond to Figs 6-13 of the paper (same channels, same axes), and three of our own."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kffa_offboard.control import Array
from kffa_offboard.control.controllers import ALTITUDE, PITCH, ROLL, YAW
from kffa_offboard.experiments.examples import Example, Traces
from kffa_offboard.experiments.flights import STEP_S
from kffa_offboard.experiments.settings import PaperSettings
from kffa_offboard.plot_style import BLUE, GREEN, GREY, ORANGE, RED, VIOLET, figure_to

COLOURS = {
    "pid": VIOLET,
    "cascaded-pid": VIOLET,
    "wb-ladrc": GREEN,
    "ladrc": ORANGE,
    "fa-ladrc": BLUE,
    "kffa-ladrc": RED,
}
#: Panels of the paper's figures: a height, b roll, c pitch, d yaw.
PANELS = (
    (ALTITUDE, "(a) Height", "z [m]"),
    (ROLL, "(b) Roll", "ξ [rad]"),
    (PITCH, "(c) Pitch", "δ [rad]"),
    (YAW, "(d) Yaw", "η [rad]"),
)
_CHANGES: Any = {"axes.axisbelow": True, "legend.fontsize": 9.5, "lines.linewidth": 1.5}


@dataclass(frozen=True)
class Drawn:
    """A figure on disk, and what it shows."""

    example: Example
    path: Path
    title: str
    caption: str


#: File name, title, caption, size in inches.
About = tuple[str, str, str, tuple[float, float]]


def draw_all(
    directory: Path, settings: PaperSettings, traces: Traces, examples: Iterable[int]
) -> list[Drawn]:
    """Draw the figures of the paper's examples that were flown."""
    return [
        draw(directory, example, about, lambda figure, paint=paint: paint(figure, settings, traces))  # type: ignore[misc]
        for example in examples
        for about, paint in _FIGURES[example]
    ]


def draw(directory: Path, example: Example, about: About, paint: Callable[[Any], None]) -> Drawn:
    """Draw one figure: `paint` is given the empty matplotlib figure."""
    name, title, caption, size = about
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / f"{name}.png"
    with figure_to(path, size, 110, _CHANGES, {"Software": None}) as figure:
        paint(figure)
    return Drawn(example, path, title, caption)


def plot(axis: Any, time: Array, values: Array, controller: str, **style: Any) -> None:
    """One curve in the controller's colour, `time` and `values` (T,)."""
    colour = COLOURS[controller.split("/")[0]]
    axis.plot(time, values, **{"color": colour, "label": controller, **style})


def legend_above(figure: Any, axis: Any) -> None:
    """One legend for all panels, above them."""
    handles, names = axis.get_legend_handles_labels()
    figure.legend(
        handles,
        names,
        loc="outside upper center",
        ncols=min(len(names), 6),
        columnspacing=1.4,
    )


def _four_panels(
    figure: Any, traces: Traces, flight: str, labels: Sequence[str], until_s: float, error: bool = False
) -> None:
    """Height, roll, pitch and yaw of several controllers, output or error."""
    axes = figure.subplots(2, 2, sharex=True)
    for axis, (channel, title, unit) in zip(axes.flat, PANELS, strict=True):
        first = traces[labels[0], flight]
        shown = first.time <= until_s + STEP_S / 2
        if not error:
            axis.plot(
                first.time[shown], first.reference[shown, channel], color="#222222", linestyle=(0, (4, 3)),
                linewidth=1.1, label="reference",
            )  # fmt: skip
        for label in labels:
            trace = traces[label, flight]
            plot(axis, trace.time[shown], (trace.error if error else trace.output)[shown, channel], label)
        axis.set_title(title)
        axis.set_ylabel("error of " + unit if error else unit)
        axis.set_xlim(0.0, until_s)
    for axis in axes[1]:
        axis.set_xlabel("time [s]")
    legend_above(figure, axes[0, 0])


def _draw_step(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    _four_panels(figure, traces, "1/up", ("pid", "wb-ladrc", "ladrc", "fa-ladrc"), 1.2)


def _draw_step_error(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    _four_panels(figure, traces, "1/up", ("pid", "wb-ladrc", "ladrc", "fa-ladrc"), 1.2, error=True)


def _draw_differentiator(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    left, right = figure.subplots(1, 2)
    for axis, (channel, title, unit) in zip((left, right), PANELS[:2], strict=True):
        for label, style in (
            ("ladrc", "-"),
            ("fa-ladrc", "-"),
            ("ladrc/td", "--"),
            ("fa-ladrc/td", (0, (1, 1.2))),
        ):
            trace = traces[label, "1/up"]
            name = label.removesuffix("/td") + (" with TD" if label.endswith("td") else "")
            plot(axis, trace.time, trace.output[:, channel], label, linestyle=style, label=name)
        axis.axvspan(0.29, 0.30, color="#f2c14e", alpha=0.8, linewidth=0, label="Table 4: FA-LADRC")
        axis.set_title(title)
        axis.set_ylabel(unit)
        axis.set_xlabel("time [s]")
        axis.set_xlim(0.0, 1.2)
    legend_above(figure, left)


def _draw_down(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    axes = figure.subplots(1, 2, sharey=True)
    for axis, label, title in (
        (axes[0], "fa-ladrc", "published rules"),
        (axes[1], "fa-ladrc/even", "even rules"),
    ):
        for direction, colour in (("up", "#1f5fa8"), ("down", "#c0233b")):
            trace = traces[label, f"1/{direction}"]
            axis.plot(trace.time, trace.omega_c[:, ROLL], color=colour, label=f"step {direction}")
        axis.axhline(settings.channels.omega_c_rad_s[ROLL], color=GREY, linewidth=0.9, linestyle=(0, (4, 3)))
        axis.set_title(f"FA-LADRC, {title}")
        axis.set_xlabel("time [s]")
        axis.set_xlim(0.0, 0.6)
    axes[0].set_ylabel("ω_c on roll [rad/s]")
    axes[0].legend(loc="lower right")


def _draw_triangle(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    told = settings.examples
    labels = ("pid", "wb-ladrc", "ladrc", "fa-ladrc")
    _four_panels(figure, traces, "2/triangle", labels, told.triangle_period_s * told.triangle_cycles)


def _draw_triangle_error(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    told = settings.examples
    labels = ("pid", "wb-ladrc", "ladrc", "fa-ladrc")
    _four_panels(
        figure, traces, "2/triangle", labels, told.triangle_period_s * told.triangle_cycles, error=True
    )


def _draw_schedule(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    axis, told = figure.subplots(), settings.examples
    for mass, name, colour in (
        (told.load_kg, f"{told.load_kg:g} kg", "#1f5fa8"),
        (told.load_limit_kg, f"m_max = {told.load_limit_kg:g} kg", "#d9731a"),
    ):
        times = [0.0, told.load_on_s, told.load_on_s, told.load_off_s, told.load_off_s, told.duration_s]
        axis.plot(times, [0.0, 0.0, mass, mass, 0.0, 0.0], color=colour, label=name)
    axis.set_xlabel("time [s]")
    axis.set_ylabel("load [kg]")
    axis.set_xlim(0.0, told.duration_s)
    axis.legend(loc="upper left")


def _draw_load(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    told, labels = settings.examples, ("pid", "kffa-ladrc", "fa-ladrc")
    axes = figure.subplots(3, 2)
    for axis, (channel, title, unit) in zip(axes.flat, PANELS, strict=False):
        for label in labels:
            trace = traces[label, "3/load"]
            plot(axis, trace.time, trace.output[:, channel], label)
        axis.set_title(title)
        axis.set_ylabel(unit)
        axis.set_xlim(0.0, told.duration_s)
    for axis, start, title in (
        (axes[2, 0], told.load_on_s, f"(e) Height, {told.load_kg:g} kg picked up"),
        (axes[2, 1], told.load_off_s, f"(f) Height, {told.load_kg:g} kg dropped"),
    ):
        for label in labels:
            trace = traces[label, "3/load"]
            shown = (trace.time >= start - 0.1) & (trace.time <= start + 0.8)
            plot(axis, trace.time[shown], -1000.0 * trace.error[shown, ALTITUDE], label)
        axis.set_title(title)
        axis.set_ylabel("off set-point [mm]")
        axis.set_xlim(start - 0.1, start + 0.8)
        axis.set_xlabel("time [s]")
    legend_above(figure, axes[0, 0])


def _draw_gains(channel: int) -> Callable[[Any, PaperSettings, Traces], None]:
    def draw(figure: Any, settings: PaperSettings, traces: Traces) -> None:
        axes = figure.subplots(2, 2, sharex="col")
        columns = (("3/load", "without noise, from 1 s on"), ("4/load/0", "with noise σ = 0.03"))
        for column, (flight, title) in enumerate(columns):
            for label in ("fa-ladrc", "kffa-ladrc"):
                if (label, flight) not in traces:
                    continue
                trace = traces[label, flight]
                shown = trace.time >= 1.0 - STEP_S / 2
                omega_c = trace.omega_c[shown, channel]
                for axis, values in ((axes[0, column], omega_c**2), (axes[1, column], 2.0 * omega_c)):
                    plot(axis, trace.time[shown], values, label, linewidth=0.9 if column else 1.4)
                    axis.set_xlim(1.0, settings.examples.duration_s)
            axes[0, column].set_title(title)
            axes[1, column].set_xlabel("time [s]")
        axes[0, 0].set_ylabel("kp [1/s²]")
        axes[1, 0].set_ylabel("kd [1/s]")
        for axis in axes[:, 0]:
            _readable_range(axis)
        if not axes[0, 1].lines:
            for axis in axes[:, 1]:
                axis.text(0.5, 0.5, "Example 4 was not flown", transform=axis.transAxes, ha="center")
        legend_above(figure, axes[0, 0])

    return draw


def _readable_range(axis: Any) -> None:
    """No offset notation, and no zoom into rounding errors."""
    axis.ticklabel_format(useOffset=False)
    low, high = axis.get_ylim()
    middle, least = (low + high) / 2.0, 5e-4 * abs(low + high)
    if high - low < least:
        axis.set_ylim(middle - least / 2.0, middle + least / 2.0)


def _draw_noise(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    axes = figure.subplots(2, 2, sharex=True, sharey="row")
    cases = (("4/load/0", "5 kg from 3 s to 7 s"), ("4/wind/0", "d_z = 2 sin t"))
    for column, (flight, title) in enumerate(cases):
        for label in ("fa-ladrc", "kffa-ladrc"):
            trace = traces[label, flight]
            plot(axes[0, column], trace.time, trace.omega_c[:, ROLL], label, linewidth=0.7)
            plot(axes[1, column], trace.time, trace.output[:, ROLL], label, linewidth=0.9)
        axes[1, column].plot(
            trace.time, trace.reference[:, ROLL], color="#222222", linestyle=(0, (4, 3)), linewidth=1.1,
            label="reference",
        )  # fmt: skip
        axes[0, column].set_title(f"({'ab'[column]}) ω_c on roll, {title}")
        axes[1, column].set_title(f"({'cd'[column]}) Roll, {title}")
        axes[1, column].set_xlabel("time [s]")
        axes[1, column].set_xlim(0.0, settings.examples.duration_s)
    axes[0, 0].set_ylabel("ω_c [rad/s]")
    axes[1, 0].set_ylabel("ξ [rad]")
    axes[1, 0].set_ylim(0.3, 0.75)
    legend_above(figure, axes[1, 0])


def _draw_filters(figure: Any, settings: PaperSettings, traces: Traces) -> None:
    """Roll error of all readings, split into what is constant and what fluctuates."""
    axis = figure.subplots()
    names = {
        "pid": "PID",
        "wb-ladrc": "WB-LADRC",
        "ladrc": "LADRC",
        "fa-ladrc": "FA-LADRC,\npublished rules",
        "kffa-ladrc/literal": "KFFA-LADRC,\nliteral filter",
        "kffa-ladrc": "KFFA-LADRC,\nextended filter",
        "fa-ladrc/even": "FA-LADRC,\neven rules",
        "kffa-ladrc/even": "KFFA-LADRC, ext.\nfilter, even rules",
    }
    settled = settings.examples.settled_after_s - 1e-9
    constant, fluctuating = [], []
    for label in names:
        errors = [
            trace.error[trace.time >= settled, ROLL]
            for (flown, name), trace in traces.items()
            if flown == label and name.startswith("4/load/")
        ]
        constant.append(1000.0 * float(np.mean([abs(error.mean()) for error in errors])))
        fluctuating.append(1000.0 * float(np.mean([error.std() for error in errors])))
    places = np.arange(len(names))
    axis.bar(places - 0.2, constant, 0.38, color=RED, label="constant part")
    axis.bar(places + 0.2, fluctuating, 0.38, color=BLUE, label="fluctuating part (standard deviation)")
    axis.set_xticks(places, list(names.values()), fontsize=8.5)
    axis.grid(visible=False, axis="x")
    axis.set_ylabel("true roll error [mrad]")
    axis.legend(loc="upper right")


_Draw = Callable[[Any, PaperSettings, Traces], None]
_WIDE, _TALL, _LOW = (9.5, 6.0), (9.5, 8.0), (9.5, 3.4)
_FIGURES: dict[int, tuple[tuple[About, _Draw], ...]] = {
    1: (
        (("fig06-step", "Fig 6: tracking a step", "0.5 rad and 5 m at once, without TD.", _WIDE), _draw_step),
        (("fig07-step-error", "Fig 7: error of the step", "The same flights.", _WIDE), _draw_step_error),
        (
            ("differentiator", "With and without the TD",
            "Behind the published TD, LADRC and FA-LADRC are equally slow.", _LOW), _draw_differentiator,
        ),
        (
            ("step-down", "A step down",
            "omega_c during a step up and a step down. The published table is odd: what it adds upward it "
            "takes downward.",
            _LOW), _draw_down,
        ),
    ),
    2: (
        (("fig08-triangle", "Fig 8: tracking a triangle wave", "Without TD.", _WIDE), _draw_triangle),
        (("triangle-error", "Error of the triangle", "The lag as an error.", _WIDE), _draw_triangle_error),
    ),
    3: (
        (("fig09-load", "Fig 9: the load", "As published, and Table 1's largest.", _LOW), _draw_schedule),
        (
            ("fig10-load-response", "Fig 10: response to the load",
            "Set-points of Example 1 from 0 s on. The load is invisible at the scale of Fig 10, hence (e) "
            "and (f).",
            _TALL), _draw_load,
        ),
        (
            ("fig11-gains-height", "Fig 11: kp and kd of the height",
            "A load of 5 kg moves the height by millimetres, so the rules hardly notice; noise moves the "
            "gains far more.",
            _WIDE), _draw_gains(ALTITUDE),
        ),
        (
            ("fig12-gains-roll", "Fig 12: kp and kd of roll",
            "Left: constant, because eq 15 has no torque of a load on the vertical "
            "axis.", _WIDE), _draw_gains(ROLL),
        ),
    ),
    4: (
        (
            ("fig13-noise", "Fig 13: noise, with load and with d_z",
            "Measurement noise sigma = 0.03 on all channels, first seed; the roll is the true "
            "one.", _WIDE), _draw_noise,
        ),
        (
            ("filters", "Where the error under noise comes from",
            "All seeds, load case. The published rules turn noise into a constant error; the literal "
            "filter leaves it there.",
            (9.5, 4.2)), _draw_filters,
        ),
    ),
}  # fmt: skip
