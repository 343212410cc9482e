"""``kffa-offboard demo``: fly, measure, draw, tell."""

from __future__ import annotations

import json
import platform
import sys
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from kffa_offboard import __version__
from kffa_offboard.config import bundled, load
from kffa_offboard.demo.processes import FlightPlan, FlightSummary, fly
from kffa_offboard.demo.table import results_table
from kffa_offboard.errors import UserError
from kffa_offboard.offboard.segments import Move, Takeoff
from kffa_offboard.trials.metrics import Array, FlightFailed, FlightMetrics, Truth, measure, read_truth
from kffa_offboard.trials.processes import terminate_as_interrupt
from kffa_offboard.trials.recording import Recording, read_recording

BASELINE = "cascaded-pid"
EXPECTED_FLIGHT_S = 46.0
EXPECTED_POSITION_FLIGHT_S = 66.0
FAILED = 1
INTERRUPTED = 130


@dataclass(frozen=True)
class DemoPlan:
    """What the command line asks for; see `kffa-offboard demo --help`."""

    directory: Path
    personality: str = "px4"
    output: str = "rates"
    controller: str = "kffa-ladrc"
    seed: int = 0
    lockstep: bool = False
    baseline: bool = True
    position: bool = False
    json: bool = False

    def flight(self, controller: str, lockstep: bool) -> FlightPlan:
        """The plan of one of the flights."""
        return FlightPlan(
            self.directory, self.personality, self.output, controller, self.seed, lockstep, self.position
        )


@dataclass(frozen=True)
class DemoFlight:
    """One flight, flown and measured."""

    plan: FlightPlan
    summary: FlightSummary
    truth: Truth
    metrics: FlightMetrics
    recording: Recording


def run_demo(plan: DemoPlan) -> int:
    """Fly the demonstration and return the exit status: 0, 1 flight failed, 130 stopped."""
    console = Console(stderr=True)
    try:
        plan.directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"--out {plan.directory}: {error.strerror}; choose another directory") from error
    try:
        with terminate_as_interrupt():
            flights = _fly_all(plan, console)
            figures = _draw(plan, flights)
    except FlightFailed as error:
        print(f"error: {error}; see {plan.directory}", file=sys.stderr)
        return FAILED
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return INTERRUPTED
    if plan.json:
        print(json.dumps(_as_json(plan, flights)), flush=True)
    else:
        console = Console()
        console.print(results_table(flights))
        console.print(f"Drawn: {', '.join(map(str, figures))}", soft_wrap=True, highlight=False)
    return 0


def target_height(plan: FlightPlan) -> float:
    """The height that the flight's scenario takes off to, m."""
    scenario = load(bundled(f"{plan.config}.toml")).service.scenario
    return next(segment.altitude_m for segment in scenario if isinstance(segment, Takeoff))


def move_corners(plan: FlightPlan) -> Array | None:
    """Ends of the scenario's moves (K, 2), m north and west of the start; None if no place is held."""
    scenario = load(bundled(f"{plan.config}.toml")).service.scenario
    moves = [(move.north_m, -move.east_m) for move in scenario if isinstance(move, Move)]
    return np.cumsum([(0.0, 0.0), *moves], axis=0) if moves else None


def _fly_all(plan: DemoPlan, console: Console) -> list[DemoFlight]:
    """The flight that was asked for and, in lock-step because nobody watches, the baseline."""
    flights = [plan.flight(plan.controller, plan.lockstep)]
    if plan.baseline and plan.controller != BASELINE:
        flights.append(plan.flight(BASELINE, lockstep=True))
    bar = Progress(
        TextColumn("{task.fields[controller]:12}"),
        BarColumn(),
        TextColumn("{task.completed:4.0f} s flown"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[latest]}"),
        console=console,
        disable=not console.is_terminal,
    )
    with bar:
        return [_fly_one(flight, bar) for flight in flights]


def _fly_one(plan: FlightPlan, bar: Progress) -> DemoFlight:
    expected = EXPECTED_POSITION_FLIGHT_S if plan.position else EXPECTED_FLIGHT_S
    if bar.disable:
        how = "in lock-step" if plan.lockstep else f"in real time, about {expected:.0f} s"
        bar.console.print(f"flying {plan.controller} {how} ...")
    task = bar.add_task("", total=expected, controller=plan.controller, latest="starting")

    def show(flown: float, latest: str) -> None:
        bar.update(task, completed=min(flown, expected), latest=latest)

    summary = fly(plan, show)
    bar.update(task, completed=expected, latest="landed")
    truth = read_truth(plan.truth)
    metrics = measure(truth, target_height(plan), move_corners(plan))
    return DemoFlight(plan, summary, truth, metrics, read_recording(plan.log))


def _draw(plan: DemoPlan, flights: list[DemoFlight]) -> list[Path]:
    from kffa_offboard.demo.figure import draw_drop, draw_flight  # matplotlib is slow to import

    target_m = target_height(flights[0].plan)
    figures = [plan.directory / "flight.png", plan.directory / "drop.png"]
    draw_flight(figures[0], flights, target_m)
    draw_drop(figures[1], flights, target_m)
    return figures


def _as_json(plan: DemoPlan, flights: list[DemoFlight]) -> dict[str, Any]:
    first, *others = flights
    return {
        **_flight_json(first),
        "personality": plan.personality,
        "output": plan.output,
        "seed": plan.seed,
        "lockstep": plan.lockstep,
        "position": plan.position,
        "baseline": _flight_json(others[0]) if others else None,
        "versions": {
            "kffa-offboard": __version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "filterpy", "pymavlink")},
        },
    }


def _flight_json(flight: DemoFlight) -> dict[str, Any]:
    metrics = flight.metrics
    return {
        "controller": flight.plan.controller,
        "pickup": asdict(metrics.pickup),
        "drop": asdict(metrics.drop),
        "hover": {"rms_m": metrics.hover_rms_m},
        "attitude": {"rms_rad": metrics.attitude_rms_rad},
        **({} if metrics.place is None else {"place": asdict(metrics.place)}),
        **asdict(flight.summary),
    }
