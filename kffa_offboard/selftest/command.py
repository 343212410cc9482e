"""``kffa-offboard selftest``: run the selection, tell, and judge."""

from __future__ import annotations

import json
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from kffa_offboard import __version__
from kffa_offboard.errors import UserError
from kffa_offboard.selftest.faults import cases, run_fault
from kffa_offboard.selftest.flights import run_flight
from kffa_offboard.selftest.guard import run_guard
from kffa_offboard.selftest.law import run_law
from kffa_offboard.selftest.machine import GROUP, run_machine
from kffa_offboard.selftest.result import Row
from kffa_offboard.trials.processes import terminate_as_interrupt

FAILED = 1
INTERRUPTED = 130
PERSONALITIES = ("px4", "ardupilot")
_WORDS = {True: "[green]pass[/]", False: "[bold red]FAIL[/]", None: "told"}


@dataclass(frozen=True)
class SelftestPlan:
    """What the command line asks for."""

    directory: Path
    json: bool = False


def run_selftest(plan: SelftestPlan) -> int:
    """Run everything and return the exit status: 0 all passed, 1 something failed, 130 stopped."""
    try:
        plan.directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"--out {plan.directory}: {error.strerror}; choose another directory") from error
    began = time.perf_counter()
    rows: list[Row] = []
    try:
        with terminate_as_interrupt():
            for what, part in _parts(plan.directory):
                Console(stderr=True).print(f"{what} ...", highlight=False)
                rows += part()
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return INTERRUPTED
    return _tell(plan, rows, time.perf_counter() - began)


_TOO_SLOW = (
    f"{GROUP} was too slow or too busy to fly with: end other programs and test again; "
    "docs/deployment.md, Punctuality, has what helps"
)


def _parts(directory: Path) -> list[tuple[str, Callable[[], list[Row]]]]:
    log = directory / "flight-px4" / "kffa-ladrc.tlog"
    parts: list[tuple[str, Callable[[], list[Row]]]] = [
        ("control law", run_law),
        ("guard", run_guard),
    ]
    for name in PERSONALITIES:
        parts.append((f"flight on {name}", lambda name=name: run_flight(name, directory)))  # type: ignore[misc]
    for case in cases():
        parts.append((f"fault: {case.name}", lambda case=case: [run_fault(case, directory)]))  # type: ignore[misc]
    parts.append(("timing", lambda: run_machine(log if log.is_file() else None, directory)))
    return parts


def _tell(plan: SelftestPlan, rows: list[Row], took_s: float) -> int:
    failed = [row for row in rows if row.passed is False]
    document = {
        "passed": not failed,
        "rows": [asdict(row) for row in rows],
        "took_s": round(took_s, 1),
        "versions": {"kffa-offboard": __version__, "python": platform.python_version()},
        "machine": {"platform": platform.platform(), "cores": os.cpu_count()},
    }
    (plan.directory / "selftest.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    if plan.json:
        print(json.dumps(document))
        return FAILED if failed else 0
    console = Console()
    table = Table(title=f"kffa-offboard {__version__} self-test")
    for heading in ("", "test", "measured", "limit", ""):
        table.add_column(heading)
    last = ""
    for row in rows:
        if row.group != last:
            table.add_section()
        shown = row.group if row.group != last else ""
        table.add_row(shown, row.name, row.measured, row.limit, _WORDS[row.passed])
        last = row.group
    console.print(table)
    verdict = f"{len(failed)} of {len(rows)} failed" if failed else f"all {len(rows)} passed"
    console.print(f"{verdict} in {took_s:.0f} s; files in {plan.directory}", soft_wrap=True, highlight=False)
    if any(row.group == GROUP for row in failed):
        console.print(_TOO_SLOW, soft_wrap=True, highlight=False)
    return FAILED if failed else 0
