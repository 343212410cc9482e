"""Figures of a flight: all signals against time, and a close look at pick-up and drop."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from kffa_offboard.control.controllers import ALTITUDE, PITCH, ROLL, YAW
from kffa_offboard.demo.processes import FlightPlan
from kffa_offboard.plot_style import BLUE, GREEN, GREY, ORANGE, VIOLET, figure_to
from kffa_offboard.trials.metrics import WINDOW_S, FlightMetrics, Truth
from kffa_offboard.trials.recording import Recording

_FLIGHT_COLOURS = (BLUE, ORANGE)


class DrawnFlight(Protocol):
    """What the figures need to know of a flight."""

    @property
    def plan(self) -> FlightPlan:
        """What was flown."""

    @property
    def truth(self) -> Truth:
        """True states."""

    @property
    def metrics(self) -> FlightMetrics:
        """When things happened."""

    @property
    def recording(self) -> Recording:
        """The controller's signals."""


def draw_flight(path: Path, flights: Sequence[DrawnFlight], target_m: float) -> None:
    """Altitude, attitude, thrust, disturbance estimate and omega_c of the first flight against time.

    Where a place is held, also north and east. Altitude, place and thrust of the second flight, if there is
    one, stand beside it. Time counts from lift-off.
    """
    first = flights[0]
    place = first.metrics.place is not None
    with figure_to(path, (10.0, 14.5 if place else 12.0), dpi=130) as figure:
        panels = figure.subplots(5 + place, 1, sharex=True, height_ratios=[3, *[3] * place, 2, 2, 2, 2])
        axes = [panels[0], *panels[1 + place :]]
        figure.suptitle(_title(first), fontsize=12.5, fontweight="bold")
        _draw_altitude(axes[0], flights, target_m)
        _draw_attitude(axes[1], first)
        _draw_thrust(axes[2], flights)
        _draw_disturbance(axes[3], first)
        _draw_bandwidth(axes[4], first)
        if place:
            _draw_place(panels[1], flights)
        for axis in panels:
            _mark_events(axis, first)
        _name_events(axes[0], first)
        axes[-1].set_xlabel("time since lift-off [s]")
        axes[-1].set_xlim(-2.0, float(_since_liftoff(first, first.truth.time_s)[-1]))


def draw_drop(path: Path, flights: Sequence[DrawnFlight], target_m: float) -> None:
    """Height around pick-up and drop, all flights overlaid; time counts from the change of load.

    Where a place is held, its distance stands below.
    """
    place = flights[0].metrics.place is not None
    with figure_to(path, (10.0, 7.0 if place else 4.0), dpi=130) as figure:
        rows = figure.subplots(1 + place, 2, sharex=True, sharey="row", squeeze=False)
        axes = rows[0]
        load = float(flights[0].truth.load_mass_kg.max())
        for axis, name, event in ((axes[0], "picked up", "pickup"), (axes[1], "dropped", "drop")):
            for flight, colour in zip(flights, _FLIGHT_COLOURS, strict=False):
                time = flight.truth.time_s - getattr(flight.metrics, f"{event}_s")
                shown = (time >= -1.0) & (time <= WINDOW_S)
                peak = getattr(flight.metrics, event).peak_m
                label = f"{flight.plan.controller}, peak {peak:.3f} m"
                axis.plot(
                    time[shown], flight.truth.z[shown] - target_m, color=colour, label=label, linewidth=1.8
                )
            axis.axvline(0.0, color=GREY, linewidth=1.0, linestyle=(0, (4, 3)))
            axis.set_title(f"{load:g} kg {name}")
            axis.set_xlim(-1.0, WINDOW_S)
            axis.legend(loc="upper right" if event == "pickup" else "lower right")
        axes[0].set_ylabel("height error [m]")
        if place:
            _draw_distance(rows[1], flights)
        for axis in rows[-1]:
            axis.set_xlabel("time since then [s]")


def _draw_distance(axes: Any, flights: Sequence[DrawnFlight]) -> None:
    """Horizontal distance from where it took off, around pick-up and drop."""
    for axis, event in zip(axes, ("pickup", "drop"), strict=True):
        for flight, colour in zip(flights, _FLIGHT_COLOURS, strict=False):
            time = flight.truth.time_s - getattr(flight.metrics, f"{event}_s")
            shown = (time >= -1.0) & (time <= WINDOW_S)
            away = np.hypot(flight.truth.x[shown], flight.truth.y[shown])
            peak = getattr(flight.metrics.place, f"{event}_peak_m")
            label = f"{flight.plan.controller}, peak {peak:.3f} m"
            axis.plot(time[shown], away, color=colour, label=label, linewidth=1.8)
        axis.axvline(0.0, color=GREY, linewidth=1.0, linestyle=(0, (4, 3)))
        axis.legend(loc="upper right")
    axes[0].set_ylim(0.0, 1.25 * axes[0].get_ylim()[1])  # both axes; room for the legend
    axes[0].set_ylabel("horizontal distance [m]")


def _title(flight: DrawnFlight) -> str:
    pickup, drop = flight.metrics.pickup, flight.metrics.drop
    return (
        f"{flight.plan.controller} on {flight.plan.personality}, output {flight.plan.output}: "
        f"pick-up moves it {100 * pickup.peak_m:.1f} cm, drop {100 * drop.peak_m:.1f} cm"
    )


def _since_liftoff(flight: DrawnFlight, time_s: Any) -> Any:
    return time_s - flight.metrics.liftoff_s


def _flying(flight: DrawnFlight) -> tuple[Any, Any]:
    """Time since lift-off and the rows of the recording in which the daemon was in control."""
    recording = flight.recording
    time = _since_liftoff(flight, recording.time_s)
    rows = np.flatnonzero((time >= 0.0) & (time <= _since_liftoff(flight, flight.truth.time_s[-1])))
    return time[rows], rows


def _mark_events(axis: Any, flight: DrawnFlight) -> None:
    for event_s in (flight.metrics.pickup_s, flight.metrics.drop_s):
        axis.axvline(_since_liftoff(flight, event_s), color=GREY, linewidth=1.0, linestyle=(0, (4, 3)))


def _name_events(axis: Any, flight: DrawnFlight) -> None:
    load = flight.truth.load_mass_kg.max()
    for name, event_s, side in (
        ("pick-up", flight.metrics.pickup_s, "right"),
        ("drop", flight.metrics.drop_s, "left"),
    ):
        axis.annotate(
            f" {name} {load:g} kg ",
            (_since_liftoff(flight, event_s), 0.03),
            xycoords=("data", "axes fraction"),
            color="#444444",
            horizontalalignment=side,
        )


def _legend(axis: Any) -> None:
    """Right of the title, where no curve can be."""
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=4, borderaxespad=0.0, reverse=True)


def _draw_altitude(axis: Any, flights: Sequence[DrawnFlight], target_m: float) -> None:
    axis.axhline(target_m, color=GREY, linewidth=0.8)
    for flight, colour in reversed(list(zip(flights, _FLIGHT_COLOURS, strict=False))):
        time = _since_liftoff(flight, flight.truth.time_s)
        axis.plot(time, flight.truth.z, color=colour, label=flight.plan.controller)
    axis.set_title("Altitude (true)")
    axis.set_ylabel("m")
    _legend(axis)


def _draw_place(axis: Any, flights: Sequence[DrawnFlight]) -> None:
    """North full, east dashed, of all flights."""
    for flight, colour in reversed(list(zip(flights, _FLIGHT_COLOURS, strict=False))):
        time = _since_liftoff(flight, flight.truth.time_s)
        name = flight.plan.controller
        axis.plot(time, -flight.truth.y, color=colour, label=f"{name} east", linestyle=(0, (4, 2)))
        axis.plot(time, flight.truth.x, color=colour, label=f"{name} north")
    axis.set_title("Place (true)")
    axis.set_ylabel("m")
    _legend(axis)


def _draw_attitude(axis: Any, flight: DrawnFlight) -> None:
    time = _since_liftoff(flight, flight.truth.time_s)
    for name, angle, colour in (
        ("yaw", np.unwrap(flight.truth.yaw), GREEN),
        ("pitch", flight.truth.pitch, ORANGE),
        ("roll", flight.truth.roll, BLUE),
    ):
        axis.plot(time, np.degrees(angle), color=colour, label=name, linewidth=1.0)
    axis.set_title("Attitude (true)")
    axis.set_ylabel("deg")
    _legend(axis)


def _draw_thrust(axis: Any, flights: Sequence[DrawnFlight]) -> None:
    for flight, colour in reversed(list(zip(flights, _FLIGHT_COLOURS, strict=False))):
        time, rows = _flying(flight)
        command = flight.recording.signals.command[rows, ALTITUDE]
        axis.plot(time, command, color=colour, linewidth=0.7, alpha=0.8, label=flight.plan.controller)
    axis.set_title("Vertical thrust commanded")
    axis.set_ylabel("of full thrust")
    axis.set_ylim(0.0, 1.0)
    _legend(axis)


def _draw_disturbance(axis: Any, flight: DrawnFlight) -> None:
    time, rows = _flying(flight)
    axis.plot(time, flight.recording.signals.disturbance[rows, ALTITUDE], color=BLUE, linewidth=0.9)
    axis.set_title("Disturbance estimate on the altitude channel (gravity and load)")
    axis.set_ylabel("m/s²")


def _draw_bandwidth(axis: Any, flight: DrawnFlight) -> None:
    time, rows = _flying(flight)
    for name, channel, colour in (
        ("yaw", YAW, GREEN),
        ("pitch", PITCH, ORANGE),
        ("roll", ROLL, VIOLET),
        ("altitude", ALTITUDE, BLUE),
    ):
        omega_c = flight.recording.signals.omega_c[rows, channel]
        axis.plot(time, omega_c, color=colour, label=name, linewidth=0.9)
    axis.set_title("Controller bandwidth omega_c after the fuzzy rules")
    axis.set_ylabel("rad/s")
    axis.set_ylim(bottom=0.0)
    _legend(axis)
