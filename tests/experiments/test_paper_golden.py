"""The kept results of one seed: a change names the entries that differ."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from kffa_offboard.experiments import bless, golden, settings

GOLDEN = Path(__file__).parents[1] / "golden" / "paper-results.json"


def test_results_are_the_kept_ones() -> None:
    results = golden.fly_golden(settings.load())
    differing = list(golden.differences(json.loads(GOLDEN.read_text(encoding="utf-8")), results))
    shown = "\n".join(differing[:30])
    assert not differing, (
        f"{len(differing)} entries differ:\n{shown}\n"
        "If that is meant: python -m kffa_offboard.experiments.bless"
    )


def test_a_difference_is_named_with_its_path_and_both_values() -> None:
    before = {"a": {"b": 1.0, "c": None, "gone": 2}, "verdict": "holds"}
    after = {"a": {"b": 1.00001, "c": 3.0, "new": 2}, "verdict": "does not hold"}
    assert list(golden.differences(before, after)) == [
        "a.b: was 1.0, is 1.00001",
        "a.c: was None, is 3.0",
        "a.gone: is gone",
        "a.new: is new",
        "verdict: was holds, is does not hold",
    ]


def test_rounding_is_no_difference() -> None:
    before = {"a": 1.0, "tiny": 2e-16, "never": None}
    assert not list(golden.differences(before, {"a": 1.0 + 5e-7, "tiny": 7e-15, "never": None}))


def test_blessing_rewrites_the_kept_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "kept.json"
    golden.write(path, {"a": 1.0})
    monkeypatch.setattr(golden, "fly_golden", lambda settings: {"a": 2.0})
    assert bless.main(path) == 0
    assert capsys.readouterr().out == "a: was 1.0, is 2.0\n"
    assert json.loads(path.read_text(encoding="utf-8")) == {"a": 2.0}
    assert bless.main(tmp_path / "nowhere" / "kept.json") == 2
    assert "run this at the root of the source tree" in capsys.readouterr().err
