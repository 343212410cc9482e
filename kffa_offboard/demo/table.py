"""The demonstration's result as a table for people."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from rich.table import Table

from kffa_offboard.demo.processes import FlightPlan, FlightSummary
from kffa_offboard.trials.metrics import FlightMetrics, PlaceMetrics


class MeasuredFlight(Protocol):
    """What a row needs to know."""

    @property
    def plan(self) -> FlightPlan:
        """What was flown."""

    @property
    def metrics(self) -> FlightMetrics:
        """How well."""

    @property
    def summary(self) -> FlightSummary:
        """With how many messages."""


def results_table(flights: Sequence[MeasuredFlight]) -> Table:
    """One column for each flight."""
    plan = flights[0].plan
    task = "10 kg pick up and drop 5 kg at 5 m" + ", gusty wind" * plan.position
    table = Table(
        title=f"{task}: {plan.personality}, {plan.output}, seed {plan.seed}",
        caption=_PLACE_CAPTION if plan.position else _CAPTION,
    )
    table.add_column("")
    for flight in flights:
        table.add_column(flight.plan.controller, justify="right")
    for name, show in _ROWS:
        table.add_row(name, *(show(flight.metrics) for flight in flights))
    places = [flight.metrics.place for flight in flights]
    if plan.position:
        table.add_section()
        for name, show_place in _PLACE_ROWS:
            table.add_row(name, *("" if place is None else show_place(place) for place in places))
    table.add_section()
    table.add_row("telemetry received", *(str(flight.summary.telemetry_received) for flight in flights))
    table.add_row("commands sent", *(str(flight.summary.commands_sent) for flight in flights))
    return table


_CAPTION = "True states of the simulator; pick-up and drop: distance from 5 m in the 5 s after it."
_PLACE_CAPTION = (
    "True states of the simulator; pick-up and drop: distance in the 5 s after it from 5 m of height and, "
    "horizontally, from where it took off."
)
_ROWS: tuple[tuple[str, Callable[[FlightMetrics], str]], ...] = (
    ("pick-up peak, m", lambda metrics: f"{metrics.pickup.peak_m:.3f}"),
    ("pick-up IAE, m s", lambda metrics: f"{metrics.pickup.iae_m_s:.3f}"),
    ("drop peak, m", lambda metrics: f"{metrics.drop.peak_m:.3f}"),
    ("drop IAE, m s", lambda metrics: f"{metrics.drop.iae_m_s:.3f}"),
    ("hover rms, m", lambda metrics: f"{metrics.hover_rms_m:.4f}"),
    ("attitude rms, rad", lambda metrics: f"{metrics.attitude_rms_rad:.4f}"),
)
_PLACE_ROWS: tuple[tuple[str, Callable[[PlaceMetrics], str]], ...] = (
    ("hover rms, horizontal, m", lambda place: f"{place.hover_rms_m:.3f}"),
    ("pick-up peak, horizontal, m", lambda place: f"{place.pickup_peak_m:.3f}"),
    ("drop peak, horizontal, m", lambda place: f"{place.drop_peak_m:.3f}"),
    ("off the line of the square, m", lambda place: f"{place.path_peak_m:.3f}"),
)
