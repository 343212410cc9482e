"""Golden results: the numbers of one seed, kept in the tests, and how a run differs from them."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from kffa_offboard.experiments import evaluate, examples
from kffa_offboard.experiments.claims import judge
from kffa_offboard.experiments.position_flights import PositionTraces, fly_position
from kffa_offboard.experiments.position_results import OURS, evaluate_position, judge_position
from kffa_offboard.experiments.settings import PaperSettings

RELATIVE = 1e-6
ABSOLUTE = 1e-9  # below it a number is zero: rounding errors differ from machine to machine


def jsonable(value: Any) -> Any:
    """The same with nine digits, and None for infinity, which JSON does not know."""
    if isinstance(value, dict):
        return {key: jsonable(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(entry) for entry in value]
    if isinstance(value, float):
        return float(f"{value:.9g}") if math.isfinite(value) else None
    return value


def fly_golden(settings: PaperSettings) -> dict[str, Any]:
    """Fly all examples with one seed, the position ring with its own controller, and return what is kept."""
    traces = examples.fly_all(settings, examples.plan(settings, examples.EXAMPLES, seeds=1))
    return kept(settings, traces, fly_position(settings, 1, (OURS,)))


def kept(settings: PaperSettings, traces: examples.Traces, ring: PositionTraces) -> dict[str, Any]:
    """Numbers and, of the claims, verdicts of everything, flown with one seed."""
    results = evaluate.evaluate(settings, traces, examples.EXAMPLES)
    results[examples.POSITION] = evaluate_position(settings, ring)
    claims = [*judge(results, examples.EXAMPLES), *judge_position(results)]
    verdicts = {f"{_name(claim.example)}: {claim.claim}": claim.verdict for claim in claims}
    numbers: dict[str, Any] = jsonable({"seeds": 1, **results, "verdicts": verdicts})
    return numbers


def _name(example: examples.Example) -> str:
    return f"example {example}" if isinstance(example, int) else example


def write(path: Path, results: dict[str, Any]) -> None:
    """Keep `results` as the golden ones."""
    path.write_text(json.dumps(results, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def differences(golden: Any, measured: Any, at: str = "") -> Iterator[str]:
    """One line for each entry that differs: its path, what it was and what it is."""
    if isinstance(golden, dict) and isinstance(measured, dict):
        for key in {**golden, **measured}:
            path = f"{at}.{key}" if at else str(key)
            if key not in measured:
                yield f"{path}: is gone"
            elif key not in golden:
                yield f"{path}: is new"
            else:
                yield from differences(golden[key], measured[key], path)
    elif not _same(golden, measured):
        yield f"{at}: was {golden}, is {measured}"


def _same(golden: Any, measured: Any) -> bool:
    if isinstance(golden, float | int) and isinstance(measured, float | int):
        return math.isclose(golden, measured, rel_tol=RELATIVE, abs_tol=ABSOLUTE)
    return bool(golden == measured)
