"""``kffa-offboard campaign``: fly thousands of random flights, keep, sum up; or one of them alone."""

from __future__ import annotations

import errno
import json
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table as RichTable

from kffa_offboard.campaign.engine import EngineName, run_dask, run_local
from kffa_offboard.campaign.flight import WIDTH
from kffa_offboard.campaign.settings import Campaign, load_campaign
from kffa_offboard.campaign.single import SingleFlight, as_report_flight, fly_alone
from kffa_offboard.campaign.store import Store
from kffa_offboard.campaign.summary import MEASURES, PERCENTILES, percent_failed, summarise
from kffa_offboard.campaign.task import Table, Task, tasks
from kffa_offboard.config import bundled
from kffa_offboard.control.controllers import NAMES, ControllerName
from kffa_offboard.errors import UserError
from kffa_offboard.trials.processes import terminate_as_interrupt

INTERRUPTED = 130


@dataclass(frozen=True)
class CampaignPlan:
    """What the command line asks for; see `kffa-offboard campaign --help`."""

    file: Path | None
    directory: Path
    flights: int | None = None
    seed: int | None = None
    compare: str | None = None
    flight: int | None = None
    engine: EngineName = "local"
    scheduler: str | None = None
    jobs: int = -1
    json: bool = False
    width: int = WIDTH


def run_campaign(plan: CampaignPlan) -> int:
    """Fly what is asked for and return the exit status: 0 flown, 130 stopped."""
    if (plan.engine == "dask") != (plan.scheduler is not None):
        raise UserError("--engine dask and --scheduler ADDRESS go together; give both or neither")
    campaign = _campaign(plan)
    try:
        with terminate_as_interrupt():
            return _alone(plan, campaign) if plan.flight is not None else _all(plan, campaign)
    except OSError as error:
        remedy = "choose another directory"
        if error.errno == errno.ENOSPC:
            remedy = "make room, and the same command goes on with the rest"
        raise UserError(f"--out {plan.directory}: {error.strerror or error}; {remedy}") from error


def _campaign(plan: CampaignPlan) -> Campaign:
    path = bundled("campaign.toml") if plan.file is None else plan.file
    campaign = load_campaign(path, _controllers(plan.compare))
    changes = {"flights": plan.flights, "seed": plan.seed}
    told = campaign.file.campaign.model_copy(update={k: v for k, v in changes.items() if v is not None})
    return replace(campaign, file=campaign.file.model_copy(update={"campaign": told}))


def _controllers(compare: str | None) -> tuple[ControllerName, ...]:
    if compare is None:
        return ()
    wanted = [name.strip() for name in compare.split(",")]
    for name in wanted:
        if name not in NAMES:
            raise UserError(f"--compare {name}: no such controller; choose from {', '.join(NAMES)}")
    return tuple(name for name in NAMES if name in wanted)


def _all(plan: CampaignPlan, campaign: Campaign) -> int:
    flights = campaign.file.campaign.flights
    store = Store(plan.directory, campaign)
    work = list(tasks(campaign, flights, plan.width))
    todo = store.missing(work)
    console = Console(stderr=True)
    done = sum(task.count for task in work) - sum(task.count for task in todo)
    total = flights * len(campaign.services)
    if done:
        console.print(f"{done:,} of {total:,} flights are in {store.directory} already", highlight=False)
    try:
        for task, table in _shown(_results(plan, campaign, todo), console, done, total):
            store.keep(task, table)
            done += task.count
    except KeyboardInterrupt:
        kept = f"{done:,} of {total:,} flights are kept in {store.directory}"
        print(f"stopped: {kept}; the same command goes on with the rest", file=sys.stderr)
        return INTERRUPTED
    _finish(plan, campaign, store)
    return 0


def _results(plan: CampaignPlan, campaign: Campaign, todo: list[Task]) -> Iterator[tuple[Task, Table]]:
    if not todo:
        return iter(())
    if plan.scheduler is not None:
        return run_dask(campaign, todo, plan.scheduler)
    return run_local(campaign, todo, plan.jobs)


def _shown(
    results: Iterator[tuple[Task, Table]], console: Console, done: int, total: int
) -> Iterator[tuple[Task, Table]]:
    """Pass the results on, and show how far they are."""
    columns = (TextColumn("flights"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal) as bar:
        shown = bar.add_task("", total=total, completed=done)
        for task, table in results:
            yield task, table
            bar.update(shown, advance=task.count)


def _finish(plan: CampaignPlan, campaign: Campaign, store: Store) -> None:
    from kffa_offboard.campaign.figures import draw_campaign  # matplotlib is slow to import
    from kffa_offboard.campaign.page import page

    flights = campaign.file.campaign.flights
    flown: dict[str, dict[str, Any]] = {name: store.read(name, flights) for name in campaign.services}
    summaries = {name: summarise(columns) for name, columns in flown.items()}
    store.write_summary({"seed": campaign.file.campaign.seed, "controllers": summaries})
    draw_campaign(plan.directory / "campaign.png", flown)
    text = page(campaign, summaries, plan.directory / "campaign.png")
    (plan.directory / "report.html").write_text(text, encoding="utf-8")
    if plan.json:
        print(json.dumps({"seed": campaign.file.campaign.seed, "controllers": summaries}), flush=True)
        return
    console = Console()
    for name, summary in summaries.items():
        console.print(_table(name, summary))
    console.print(f"Report: {plan.directory / 'report.html'}", soft_wrap=True, highlight=False)
    console.print(f"Every flight: {plan.directory / 'flights'} (Parquet)", soft_wrap=True, highlight=False)


def _table(name: str, summary: dict[str, Any]) -> RichTable:
    reasons = ", ".join(f"{count:,} {reason}" for reason, count in summary["failures"].items() if count)
    title = f"{name}: {summary['flights']:,} flights, failed {percent_failed(summary)}"
    table = RichTable(title=title + (f": {reasons}" if reasons else ""), title_justify="left")
    table.add_column("")
    for share in PERCENTILES:
        table.add_column(
            "median" if share == 50 else "worst" if share == 100 else f"{share} %", justify="right"
        )
    for measure, label in MEASURES.items():
        values = summary["percentiles"][measure]
        table.add_row(escape(label), *(f"{values[f'p{share}']:.3f}" for share in PERCENTILES))
    return table


def _alone(plan: CampaignPlan, campaign: Campaign) -> int:
    from kffa_offboard.campaign.figures import draw_single
    from kffa_offboard.report.page import render

    assert plan.flight is not None
    directory = plan.directory / f"flight-{plan.flight:08d}"
    directory.mkdir(parents=True, exist_ok=True)
    flown = [fly_alone(campaign, name, plan.flight, plan.width) for name in campaign.services]
    rows = {flight.controller: _plain(flight) for flight in flown}
    text = json.dumps(rows, indent=1, allow_nan=False)
    (directory / "flight.json").write_text(text + "\n", encoding="utf-8")
    draw_single(directory / "flight.png", campaign, flown)
    shown = render([as_report_flight(campaign, flight) for flight in flown], "start")
    (directory / "report.html").write_text(shown, encoding="utf-8")
    if plan.json:
        print(json.dumps(rows), flush=True)
    else:
        _tell(flown, directory)
    return 0


def _plain(flight: SingleFlight) -> dict[str, float | str | None]:
    """Its row as JSON knows it, which has no NaN: `failed_at_s` of a flight that did not fail is None."""
    row = {name: None if math.isnan(value) else value for name, value in flight.row().items()}
    return {**row, "failure": flight.failure}


def _tell(flown: list[SingleFlight], directory: Path) -> None:
    console = Console()
    table = RichTable(title=f"Flight {flown[0].number}", title_justify="left")
    table.add_column("")
    for flight in flown:
        table.add_column(flight.controller, justify="right")
    rows = [flight.row() for flight in flown]
    for name in rows[0]:
        if name not in ("failure", "failed_at_s"):
            table.add_row(name, *(f"{row[name]:.4g}" for row in rows))
    table.add_row(
        "failed", *(f"{f.failure}, {f.outcomes.failed_at_s[0]:.2f} s" if f.failure else "no" for f in flown)
    )
    console.print(table)
    console.print(f"Report: {directory / 'report.html'}", soft_wrap=True, highlight=False)
