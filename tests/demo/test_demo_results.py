"""What people see of the demonstration: table, figures, progress."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from kffa_offboard.demo.command import DemoFlight, move_corners, target_height
from kffa_offboard.demo.figure import draw_drop, draw_flight
from kffa_offboard.demo.processes import FlightPlan, FlightSummary
from kffa_offboard.demo.table import results_table
from kffa_offboard.flightlog.signals import SignalTable
from kffa_offboard.trials.metrics import Deviation, FlightMetrics, PlaceMetrics, Truth
from kffa_offboard.trials.processes import flown_s
from kffa_offboard.trials.recording import Recording

METRICS = FlightMetrics(
    Deviation(0.0512, 0.0345), Deviation(0.0623, 0.0234), 0.0123, 0.0045, 2.0, 14.0, 22.0, 30.0
)


@pytest.fixture
def flight(tmp_path: Path) -> DemoFlight:
    time = np.arange(0.0, 35.0, 0.01)
    zero, channels = np.zeros_like(time), np.zeros((time.size, 4))
    truth = Truth(
        time,
        zero + 0.1,
        zero - 0.2,
        zero + 5.0,
        zero,
        zero,
        zero,
        zero + 98.0,
        np.where(time > 14.0, 5.0, 0.0),
    )
    signals = SignalTable(
        np.asarray(time * 1e6, dtype=np.int64),
        *(channels,) * 9,
        np.full(time.size, 3),
        zero,
        channels > 0.0,
        zero,
        channels[:, :2],
    )
    plan = FlightPlan(tmp_path, "px4", "rates", "kffa-ladrc", 7, lockstep=True)
    return DemoFlight(plan, FlightSummary(12345, 4321), truth, METRICS, Recording(time, signals))


def test_the_table_fits_a_terminal_and_shows_flights_side_by_side(flight: DemoFlight) -> None:
    baseline = replace(flight, plan=replace(flight.plan, controller="cascaded-pid"))
    console = Console(file=io.StringIO(), width=80)
    console.print(results_table([flight, baseline]))
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


PLACE = PlaceMetrics(0.0412, 0.0513, 0.0614, 0.0715)


def test_where_a_place_is_held_table_and_figures_show_it(flight: DemoFlight, tmp_path: Path) -> None:
    held = replace(
        flight, plan=replace(flight.plan, position=True), metrics=replace(flight.metrics, place=PLACE)
    )
    console = Console(file=io.StringIO(), width=80)
    console.print(results_table([held]))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for expected in ("gusty", "horizontal", "0.041", "0.051", "0.061", "0.071"):
        assert expected in text
    for draw, plain in ((draw_flight, 12.0), (draw_drop, 4.0)):
        draw(tmp_path / "figure.png", [held, held], 5.0)
        assert height_of(tmp_path / "figure.png") > plain * 130


def height_of(picture: Path) -> int:
    """Pixels, from the head of a PNG."""
    return int.from_bytes(picture.read_bytes()[20:24], "big")


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
@pytest.mark.parametrize("position", [False, True])
def test_the_demonstration_flies_at_five_metres(flight: DemoFlight, personality: str, position: bool) -> None:
    plan = replace(flight.plan, personality=personality, position=position)
    assert target_height(plan) == 5.0


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_the_moves_are_a_square_of_five_metres(flight: DemoFlight, personality: str) -> None:
    corners = move_corners(replace(flight.plan, personality=personality, position=True))
    assert corners is not None
    assert corners.tolist() == [[0, 0], [5, 0], [5, -5], [0, -5], [0, 0]]
    assert move_corners(flight.plan) is None


def test_progress_is_read_from_the_last_whole_line_of_the_true_states(tmp_path: Path) -> None:
    file = tmp_path / "truth.csv"
    assert flown_s(file) == 0.0
    file.write_text("time_s,x\n")
    assert flown_s(file) == 0.0
    file.write_text("time_s,x\n0.01,0\n0.02,0\n0.0")
    assert flown_s(file) == 0.02
