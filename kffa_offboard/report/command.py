"""The command `kffa-offboard report`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.parts import without_parts
from kffa_offboard.loganalysis.output_files import refuse_others
from kffa_offboard.report.align import Alignment
from kffa_offboard.report.flight import Flight
from kffa_offboard.report.read import read_any, short_name


@dataclass(frozen=True)
class ReportPlan:
    """What `kffa-offboard report` was asked for; `png` None draws no figures."""

    logs: tuple[Path, ...]
    out: Path
    png: Path | None = None
    align: Alignment = "engage"


def run_report(plan: ReportPlan) -> int:
    """Write the page, and the figures if asked for. Returns 0.

    Raises UserError for a log that cannot be read or has no flight in it, and for a file that cannot be
    written.
    """
    refuse_others(plan.out, plan.logs, begins="<!DOCTYPE html>")
    logs = without_parts(plan.logs)
    flights = [read_any(log, name) for log, name in zip(logs, distinct_names(logs), strict=True)]
    from kffa_offboard.report.page import render

    page = render(flights, plan.align)
    try:
        plan.out.parent.mkdir(parents=True, exist_ok=True)
        plan.out.write_text(page, encoding="utf-8")
        drawn = _draw(plan.png, flights, plan.align)
    except OSError as error:
        raise UserError(f"cannot write {error.filename}: {error.strerror}; choose another place") from error
    for flight in flights:
        for remark in flight.remarks:
            print(f"{flight.name}: {remark}")
    print(f"{plan.out}: {plan.out.stat().st_size / 1e6:.1f} MB, {_count(len(flights), 'flight')}")
    for path in drawn:
        print(path)
    return 0


def _draw(directory: Path | None, flights: Sequence[Flight], alignment: Alignment) -> list[Path]:
    if directory is None:
        return []
    from kffa_offboard.report.figures import draw_figures

    return draw_figures(directory, flights, alignment)


def distinct_names(logs: Sequence[Path]) -> list[str]:
    """Names of the flights: those of the files; with suffix or directory where files are called alike."""
    namings: Sequence[Callable[[Path], str]] = (
        short_name,
        lambda log: log.name,
        lambda log: str(log.with_name(short_name(log))),
    )
    names = [str(log) for log in logs]
    for naming in reversed(namings):
        shorter = [naming(log) for log in logs]
        counts = Counter(shorter)
        names = [new if counts[new] == 1 else old for new, old in zip(shorter, names, strict=True)]
    return names


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
