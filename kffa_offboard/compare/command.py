"""``kffa-offboard compare``: fly every trial, measure, draw, tell."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from kffa_offboard.compare.course import flown_steps
from kffa_offboard.compare.estimate import EstimateFigures, measure_estimate, read_heights
from kffa_offboard.compare.firmware import find_firmware
from kffa_offboard.compare.flight import Progress as ShowProgress
from kffa_offboard.compare.flight import fly
from kffa_offboard.compare.joining import check_join, joined
from kffa_offboard.compare.limits import FlightCut
from kffa_offboard.compare.measure import LoadFigures, measure_load, measure_place, measure_steps
from kffa_offboard.compare.plan import ComparePlan, Join, Trial, trials
from kffa_offboard.compare.report import Drawing, report
from kffa_offboard.compare.results import Result, as_json, verdicts
from kffa_offboard.compare.simulation import Setup
from kffa_offboard.compare.table import firmware_name, tables
from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.tlog import read_signals
from kffa_offboard.trials.metrics import FlightFailed, Truth, read_truth
from kffa_offboard.trials.processes import terminate_as_interrupt

FAILED, INTERRUPTED = 1, 130


def run_compare(plan: ComparePlan) -> int:
    """Fly the comparison and return the exit status: 0, 1 a trial failed, 130 stopped.

    Raises UserError for a firmware that is none, an unknown trial or a directory that cannot be had.
    """
    setup, chosen = _prepare(plan)
    console = Console(stderr=True)
    try:
        with terminate_as_interrupt():
            if plan.join is None:
                results = _fly_all(setup, chosen, console)
            else:
                results = _fly_joined(plan, plan.join, setup, chosen, console)
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return INTERRUPTED
    page = _write(plan, results)
    judged = verdicts(plan, results)
    if plan.json:
        print(json.dumps(as_json(plan, results)), flush=True)
    else:
        out = Console()
        for table in tables(plan, results, judged):
            out.print(table)
        out.print(f"Report: {page}", soft_wrap=True, highlight=False)
    failures = [result for result in results if result.failure is not None]
    for result in failures:
        print(f"error: {result.trial.name}: {result.failure}; see {plan.directory}", file=sys.stderr)
    return FAILED if failures else 0


def _prepare(plan: ComparePlan) -> tuple[Setup, list[Trial]]:
    check_join(plan)
    binary = None if plan.firmware is None else find_firmware(plan.autopilot, plan.firmware)
    chosen = trials(plan)
    known = {trial.name for trial in trials(replace(plan, only=(), full=True))}
    unknown = [name for name in plan.only if name not in known]
    if unknown or not chosen:
        raise UserError(
            f"--only {', '.join(unknown or plan.only)}: no such trial; choose from "
            f"{', '.join(sorted(known))} (those of --full need --full)"
        )
    try:
        plan.directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"--out {plan.directory}: {error.strerror}; choose another directory") from error
    return Setup(plan.autopilot, binary, plan.directory.resolve(), config=plan.config), chosen


def _fly_all(setup: Setup, chosen: list[Trial], console: Console) -> list[Result]:
    bar = Progress(
        TextColumn("{task.fields[trial]:24}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[latest]}"),
        console=console,
        disable=not console.is_terminal,
    )
    results = []
    with bar:
        task = bar.add_task("", total=len(chosen), trial="", latest="")
        for trial in chosen:
            if bar.disable:
                console.print(f"flying {trial.name} ...")

            def show(time_s: float, latest: str, name: str = trial.name) -> None:
                bar.update(task, trial=name, latest=f"{time_s:.0f} s flown: {latest}")

            results.append(_fly_one(setup, trial, show))
            bar.advance(task)
    return results


def _fly_joined(
    plan: ComparePlan, join: Join, setup: Setup, chosen: list[Trial], console: Console
) -> list[Result]:
    """One after the other on the running firmware, its own rows last.

    PX4's estimate of climb rate is off for minutes after a landing of its own.
    """
    with joined(plan, join) as running:
        flown = sorted(chosen, key=lambda trial: trial.native)
        results = _fly_all(replace(setup, joined=running), flown, console)
    return sorted(results, key=lambda result: chosen.index(result.trial))


def _fly_one(setup: Setup, trial: Trial, show: ShowProgress) -> Result:
    """Fly and measure; what goes wrong is part of the result, so that the other trials go on."""
    try:
        flown = fly(setup, trial, show)
        truth = read_truth(setup.file(trial, "-truth.csv"))
        if trial.course == "attitude":
            steps = measure_steps(truth, read_signals(setup.file(trial, ".tlog")), flown_steps())
            return Result(trial, flown, truth, steps=tuple(steps))
        load = measure_load(truth)
        place = measure_place(truth, load) if trial.conditions.wind else None
        estimate = _estimate(setup, trial, truth, load)
        return Result(trial, flown, truth, load=load, place=place, estimate=estimate)
    except FlightFailed as failure:
        return Result(trial, failure=str(failure), cut=isinstance(failure, FlightCut))


def _estimate(setup: Setup, trial: Trial, truth: Truth, load: LoadFigures) -> EstimateFigures | None:
    """Of real firmware, where the daemon kept a log."""
    if trial.native or setup.binary is None:
        return None
    log = read_heights(setup.file(trial, ".tlog"), trial.conditions.delay_s / 2.0)
    return measure_estimate(truth, log, load)


def _write(plan: ComparePlan, results: list[Result]) -> Path:
    """Figures, report.html and results.json; the path of the page."""
    from kffa_offboard.compare.figure import draw_height, draw_steps  # matplotlib is slow to import

    name, drawings = firmware_name(plan, results), []
    if any(result.load is not None for result in results):
        path = plan.directory / "height.png"
        draw_height(path, results, f"{name}: height when {plan.conditions.load_kg:g} kg come and go")
        drawings.append(Drawing(path, "True height around pick-up and drop, each row of the table."))
    if any(result.steps for result in results):
        path = plan.directory / "steps.png"
        draw_steps(path, results, f"{name}: steps of roll, pitch and yaw under KFFA-LADRC")
        drawings.append(
            Drawing(path, "True angles during the steps, with both kinds of output; dotted: the steps.")
        )
    page = plan.directory / "report.html"
    page.write_text(report(plan, results, verdicts(plan, results), drawings), encoding="utf-8")
    (plan.directory / "results.json").write_text(
        json.dumps(as_json(plan, results), indent=1), encoding="utf-8"
    )
    return page
