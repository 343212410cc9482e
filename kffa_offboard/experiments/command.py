"""``kffa-offboard paper``: fly the paper's examples, measure, judge, draw, tell."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from kffa_offboard import __version__
from kffa_offboard.errors import UserError
from kffa_offboard.experiments import evaluate, examples
from kffa_offboard.experiments.claims import FAILS, HOLDS, OTHER, Claim, judge
from kffa_offboard.experiments.examples import POSITION, Example, Traces
from kffa_offboard.experiments.golden import jsonable
from kffa_offboard.experiments.position_flights import CONTROLLERS, PositionTraces, fly_position
from kffa_offboard.experiments.position_flights import steps_of as position_steps
from kffa_offboard.experiments.position_results import evaluate_position, judge_position
from kffa_offboard.experiments.series import write_position_series, write_series
from kffa_offboard.experiments.settings import PaperSettings, load

INTERRUPTED = 130
_STYLES = {HOLDS: "green", OTHER: "yellow", FAILS: "red"}


@dataclass(frozen=True)
class PaperPlan:
    """What the command line asks for; see `kffa-offboard paper --help`."""

    directory: Path
    examples: tuple[Example, ...] = examples.EVERYTHING
    seeds: int | None = None
    json: bool = False


@dataclass(frozen=True)
class Flown:
    """Everything that was flown."""

    seeds: int
    traces: Traces
    ring: PositionTraces


def run_paper(plan: PaperPlan) -> int:
    """Reproduce the simulation section and return the exit status: 0, 130 stopped."""
    settings = load()
    console = Console(stderr=True)
    try:
        plan.directory.mkdir(parents=True, exist_ok=True)
        flown = _fly(settings, plan, console)
        results, claims = _judged(settings, plan, flown)
        _write(plan, settings, flown, results, claims, console)
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


def _numbered(plan: PaperPlan) -> tuple[int, ...]:
    """The paper's own examples among those wanted."""
    return tuple(example for example in plan.examples if isinstance(example, int))


def _fly(settings: PaperSettings, plan: PaperPlan, console: Console) -> Flown:
    """Fly what is wanted; the position ring in a second process if there are examples, too."""
    seeds = settings.examples.seeds if plan.seeds is None else plan.seeds
    ring_seeds = settings.position.seeds if plan.seeds is None else plan.seeds
    planned = examples.plan(settings, _numbered(plan), seeds) if _numbered(plan) else []
    ring = POSITION in plan.examples
    bar = Progress(
        TextColumn("{task.description:24}"),
        BarColumn(),
        TextColumn("{task.percentage:3.0f} %"),
        TimeElapsedColumn(),
        console=console,
        disable=not console.is_terminal,
    )
    # Not forked: the progress display has a thread. The pool's end stops what is still being flown.
    with contextlib.ExitStack() as stack:
        beside = None
        if ring and planned:
            with _interrupt_held_back():
                pool = stack.enter_context(get_context("spawn").Pool(1))
            beside = pool.apply_async(fly_position, (settings, ring_seeds, CONTROLLERS))
        stack.enter_context(bar)
        if bar.disable:
            flights = sum(len(flown) for _, flown in planned)
            bar.console.print(f"flying {flights} flights{', and the position ring' * ring} ...")
        alone = position_steps(settings) if ring and not planned else 0
        task = bar.add_task("", total=examples.steps_of(planned) + alone)

        def tick(label: str, steps: int) -> None:
            bar.update(task, advance=steps, description=label)

        traces = examples.fly_all(settings, planned, tick)
        bar.update(task, description="position ring" if beside else "")
        if beside is not None:
            return Flown(seeds, traces, beside.get())
        return Flown(seeds, traces, fly_position(settings, ring_seeds, CONTROLLERS, tick) if ring else {})


@contextlib.contextmanager
def _interrupt_held_back() -> Iterator[None]:
    """Processes started meanwhile leave Ctrl-C to this one from their first moment; here it comes after.

    The mask is for them, and theirs by inheritance. Here another thread, which has none, may get the signal.
    """
    came: list[int] = []
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    handler = signal.signal(signal.SIGINT, lambda number, frame: came.append(number))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if came:
            signal.raise_signal(signal.SIGINT)


def _judged(settings: PaperSettings, plan: PaperPlan, flown: Flown) -> tuple[dict[str, Any], list[Claim]]:
    """results.json without its claims, and the claims."""
    results = evaluate.evaluate(settings, flown.traces, _numbered(plan))
    claims = judge(results, _numbered(plan))
    if flown.ring:
        results[POSITION] = evaluate_position(settings, flown.ring)
        claims += judge_position(results)
    return {"version": __version__, "seeds": flown.seeds, **results}, claims


def _write(
    plan: PaperPlan,
    settings: PaperSettings,
    flown: Flown,
    results: dict[str, Any],
    claims: Sequence[Claim],
    console: Console,
) -> None:
    from kffa_offboard.experiments.figures import draw_all  # matplotlib is slow to import
    from kffa_offboard.experiments.position_figures import draw_position
    from kffa_offboard.experiments.report import report

    with console.status("writing series, figures and report"):
        write_series(plan.directory / "csv", settings, flown.traces, _numbered(plan))
        drawn = draw_all(plan.directory / "figures", settings, flown.traces, _numbered(plan))
        if flown.ring:
            write_position_series(plan.directory / "csv", flown.ring)
            drawn += draw_position(plan.directory / "figures", settings, flown.ring)
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
        table.add_row(str(claim.example).replace(POSITION, "ring"), claim.claim, claim.measured, verdict)
    console.print(table)
    console.print(f"Report: {plan.directory / 'report.html'}", soft_wrap=True, highlight=False)
    console.print(
        f"Numbers: {plan.directory / 'results.json'}, series in csv/, figures in figures/",
        soft_wrap=True,
        highlight=False,
    )
