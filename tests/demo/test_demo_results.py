"""What people see of the demonstration: table, figures, progress."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from kffa_offboard.demo.command import DemoFlight, target_height
from kffa_offboard.demo.figure import draw_drop, draw_flight
from kffa_offboard.demo.metrics import Deviation, FlightMetrics, Truth
from kffa_offboard.demo.processes import FlightPlan, FlightSummary, flown_s
from kffa_offboard.demo.recording import Recording
from kffa_offboard.demo.table import results_table
from kffa_offboard.flightlog.signals import SignalTable

METRICS = FlightMetrics(
    Deviation(0.0512, 0.0345), Deviation(0.0623, 0.0234), 0.0123, 0.0045, 2.0, 14.0, 22.0, 30.0
)


@pytest.fixture
def flight(tmp_path: Path) -> DemoFlight:
    time = np.arange(0.0, 35.0, 0.01)
    zero, channels = np.zeros_like(time), np.zeros((time.size, 4))
    truth = Truth(time, zero + 5.0, zero, zero, zero, zero + 98.0, np.where(time > 14.0, 5.0, 0.0))
    signals = SignalTable(
        np.asarray(time * 1e6, dtype=np.int64), *(channels,) * 9, np.full(time.size, 3), zero, channels > 0.0
    )
    plan = FlightPlan(tmp_path, "px4", "rates", "kffa-ladrc", 7, lockstep=True)
    return DemoFlight(plan, FlightSummary(12345, 4321), truth, METRICS, Recording(time, signals))


def test_the_table_fits_a_terminal_and_shows_flights_side_by_side(flight: DemoFlight) -> None:
    baseline = replace(flight, plan=replace(flight.plan, controller="cascaded-pid"))
    console = Console(file=io.StringIO(), width=80)
    console.print(results_table("px4", "rates", 7, [flight, baseline]))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for expected in ("kffa-ladrc", "cascaded-pid", "0.051", "0.062", "0.0123", "0.0045", "12345", "seed 7"):
        assert expected in text
    assert "pick-up peak, m " in text
    assert "…" not in text


def test_figures_are_drawn_with_and_without_a_baseline(flight: DemoFlight, tmp_path: Path) -> None:
    for flights in ([flight], [flight, flight]):
        for draw in (draw_flight, draw_drop):
            path = tmp_path / "figure.png"
            path.unlink(missing_ok=True)
            draw(path, flights, 5.0)
            assert path.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_the_demonstration_flies_at_five_metres(personality: str) -> None:
    assert target_height(personality) == 5.0


def test_progress_is_read_from_the_last_whole_line_of_the_true_states(tmp_path: Path) -> None:
    file = tmp_path / "truth.csv"
    assert flown_s(file) == 0.0
    file.write_text("time_s,x\n")
    assert flown_s(file) == 0.0
    file.write_text("time_s,x\n0.01,0\n0.02,0\n0.0")
    assert flown_s(file) == 0.02
