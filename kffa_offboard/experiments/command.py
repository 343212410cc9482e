"""``kffa-offboard paper``: fly the paper's examples, measure, judge, draw, tell."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from kffa_offboard import __version__
from kffa_offboard.errors import UserError
from kffa_offboard.experiments import evaluate, examples
from kffa_offboard.experiments.claims import FAILS, HOLDS, OTHER, Claim, judge
from kffa_offboard.experiments.examples import Traces
from kffa_offboard.experiments.golden import jsonable
from kffa_offboard.experiments.series import write_series
from kffa_offboard.experiments.settings import PaperSettings, load

INTERRUPTED = 130
_STYLES = {HOLDS: "green", OTHER: "yellow", FAILS: "red"}


@dataclass(frozen=True)
class PaperPlan:
    """What the command line asks for; see `kffa-offboard paper --help`."""

    directory: Path
    examples: tuple[int, ...] = examples.EXAMPLES
    seeds: int | None = None
    json: bool = False


def run_paper(plan: PaperPlan) -> int:
    """Reproduce the simulation section and return the exit status: 0, 130 stopped."""
    settings = load()
    seeds = settings.examples.seeds if plan.seeds is None else plan.seeds
    console = Console(stderr=True)
    try:
        plan.directory.mkdir(parents=True, exist_ok=True)
        traces = _fly(settings, plan.examples, seeds, console)
        measured = evaluate.evaluate(settings, traces, plan.examples)
        claims = judge(measured, plan.examples)
        results = {"version": __version__, "seeds": seeds, **measured}
        _write(plan, settings, traces, results, claims, console)
    except OSError as error:
        raise UserError(f"--out {plan.directory}: {error.strerror}; choose another directory") from error
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return INTERRUPTED
    if plan.json:
        print(json.dumps(_as_json(results, claims)), flush=True)
    else:
        _tell(plan, claims)
    return 0


def _fly(settings: PaperSettings, wanted: Sequence[int], seeds: int, console: Console) -> Traces:
    planned = examples.plan(settings, wanted, seeds)
    bar = Progress(
        TextColumn("{task.description:24}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        console=console,
        disable=not console.is_terminal,
    )
    with bar:
        if bar.disable:
            flights = sum(len(flown) for _, flown in planned)
            bar.console.print(f"flying {flights} flights, {len(planned)} controllers ...")
        task = bar.add_task("", total=examples.steps_of(planned))
        return examples.fly_all(
            settings, planned, lambda label, steps: bar.update(task, advance=steps, description=label)
        )


def _write(
    plan: PaperPlan,
    settings: PaperSettings,
    traces: Traces,
    results: dict[str, Any],
    claims: Sequence[Claim],
    console: Console,
) -> None:
    from kffa_offboard.experiments.figures import draw_all  # matplotlib is slow to import
    from kffa_offboard.experiments.report import report

    with console.status("writing series, figures and report"):
        write_series(plan.directory / "csv", settings, traces, plan.examples)
        drawn = draw_all(plan.directory / "figures", settings, traces, plan.examples)
        text = json.dumps(_as_json(results, claims), indent=1, ensure_ascii=False)
        (plan.directory / "results.json").write_text(text + "\n", encoding="utf-8")
        page = report(results, claims, drawn, plan.examples)
        (plan.directory / "report.html").write_text(page, encoding="utf-8")


def _as_json(results: dict[str, Any], claims: Sequence[Claim]) -> dict[str, Any]:
    complete: dict[str, Any] = jsonable({**results, "claims": [asdict(claim) for claim in claims]})
    return complete


def _tell(plan: PaperPlan, claims: Sequence[Claim]) -> None:
    """Claims and verdicts as a table, and where everything is."""
    console = Console()
    table = Table(title="The paper's claims", show_lines=True)
    table.add_column("Ex.", justify="right")
    table.add_column("Claim", ratio=4)
    table.add_column("Measured", ratio=5)
    table.add_column("Verdict", ratio=2)
    for claim in claims:
        verdict = f"[{_STYLES[claim.verdict]}]{claim.verdict}"
        table.add_row(str(claim.example), claim.claim, claim.measured, verdict)
    console.print(table)
    console.print(f"Report: {plan.directory / 'report.html'}", soft_wrap=True, highlight=False)
    console.print(
        f"Numbers: {plan.directory / 'results.json'}, series in csv/, figures in figures/",
        soft_wrap=True,
        highlight=False,
    )
