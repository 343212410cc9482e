"""Figures of a campaign: how the peaks are spread, what makes flights fail; and of one of its flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.campaign.single import SingleFlight
from kffa_offboard.plot_style import BLUE, FLIGHT_COLOURS, GREY, figure_to

_CONDITIONS = {
    "load_kg": ("load [kg]", 1.0),
    "link_delay_s": ("link delay each way [ms]", 1e3),
    "hover_thrust_error": ("hover thrust error [%]", 100.0),
    "motor_lag_s": ("motor lag [ms]", 1e3),
}
_BINS = 10
_TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0)
_DASHED: Any = (0, (4, 3))


def draw_campaign(path: Path, flown: dict[str, dict[str, Any]]) -> None:
    """Distribution of the peaks after pick-up and drop, and failures against four of the conditions."""
    with figure_to(path, (10.0, 10.0), dpi=130) as figure:
        axes = figure.subplots(3, 2)
        for axis, column, title in (
            (axes[0, 0], "pickup_peak_m", "(a) Largest height error after the pick-up"),
            (axes[0, 1], "drop_peak_m", "(b) after the drop"),
        ):
            for (name, columns), colour in zip(flown.items(), FLIGHT_COLOURS, strict=False):
                values = np.sort(columns[column])
                above = 100.0 * (1.0 - np.arange(len(values)) / len(values))
                axis.loglog(np.maximum(values, 1e-3), above, color=colour, label=name)
            axis.set_title(title)
            axis.set_xlabel("peak [m]")
            axis.set_ylabel("flights with at least this peak [%]")
            axis.set_xlim(left=0.01)
            axis.set_xticks([tick for tick in _TICKS if tick < axis.get_xlim()[1]])
            axis.xaxis.set_major_formatter("{x:g}")
            axis.xaxis.set_minor_formatter("")
            axis.yaxis.set_major_formatter("{x:g}")
        axes[0, 0].legend(loc="lower left")
        for axis, letter, (column, (label, factor)) in zip(
            axes[1:].flat, "cdef", _CONDITIONS.items(), strict=True
        ):
            for (name, columns), colour in zip(flown.items(), FLIGHT_COLOURS, strict=False):
                _draw_failures(axis, columns, column, factor, colour, name)
            axis.set_title(f"({letter}) Failed flights")
            axis.set_xlabel(label)
            axis.set_ylabel("failed [%]")
            axis.set_ylim(bottom=0.0)


def _draw_failures(
    axis: Any, columns: dict[str, Any], name: str, factor: float, colour: str, label: str
) -> None:
    values, failed = factor * columns[name], columns["failure"] != ""
    edges = np.linspace(values.min(), values.max() + 1e-9, _BINS + 1)
    inside = np.clip(np.digitize(values, edges) - 1, 0, _BINS - 1)
    count = np.bincount(inside, minlength=_BINS)
    share = 100.0 * np.bincount(inside, weights=failed, minlength=_BINS) / np.maximum(count, 1)
    axis.stairs(share, edges, color=colour, label=label, linewidth=1.6, zorder=2.0)  # above the grid


def draw_single(path: Path, campaign: Campaign, flights: Sequence[SingleFlight]) -> None:
    """True height, tilt and thrust of one flight, one curve for each controller."""
    with figure_to(path, (10.0, 8.0), dpi=130) as figure:
        axes = figure.subplots(3, 1, sharex=True, height_ratios=[3, 2, 2])
        first = flights[0]
        figure.suptitle(f"Flight {first.number}: {_conditions(first)}", fontsize=11)
        for flown, colour in zip(flights, FLIGHT_COLOURS if len(flights) > 1 else (BLUE,), strict=False):
            outcome = f"failed: {flown.failure}" if flown.failure else "not failed"
            label = f"{flown.controller}, {outcome}"
            axes[0].plot(flown.time_s, flown.rigid[:, 2], color=colour, label=label)
            cosine = np.cos(flown.rigid[:, 6]) * np.cos(flown.rigid[:, 7])
            axes[1].plot(flown.time_s, np.degrees(np.arccos(np.minimum(cosine, 1.0))), color=colour)
            axes[2].plot(flown.time_s, flown.blocks["command"][:, 3], color=colour, linewidth=1.0)
        target, band = campaign.file.flight.altitude_m, campaign.file.failed.recovered_m
        axes[0].axhspan(target - band, target + band, color=GREY, alpha=0.15, linewidth=0)
        for axis, label in zip(axes, ("height [m]", "tilt [deg]", "thrust commanded"), strict=True):
            axis.set_ylabel(label)
            for event in (first.pickup_s, first.drop_s):
                axis.axvline(event, color=GREY, linewidth=1.0, linestyle=_DASHED)
        axes[0].legend(loc="best")
        axes[2].set_xlabel("time [s]")


def _conditions(flown: SingleFlight) -> str:
    row = flown.row()
    return (
        f"{row['load_kg']:.2f} kg, link {1e3 * row['link_delay_s']:.0f} ms each way, hover thrust "
        f"{100 * row['hover_thrust_error']:+.0f} %, motor lag {1e3 * row['motor_lag_s']:.0f} ms, "
        f"wind {np.hypot(row['wind_x_m_s'], row['wind_y_m_s']):.1f} m/s, gusts {row['gust_std_m_s']:.1f} m/s"
    )
