"""The figure of heights: which rows are in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from kffa_offboard.compare.figure import draw_height
from kffa_offboard.compare.measure import measure_load
from kffa_offboard.compare.plan import ComparePlan, trials
from kffa_offboard.compare.results import Result
from kffa_offboard.trials.metrics import Truth


def flight(peak_m: float) -> Truth:
    """Hover at 5 m; the load comes at 18 s and goes at 28 s, each moves it by `peak_m` for 2 s."""
    time = np.arange(0.0, 40.0, 0.01)
    level = np.zeros_like(time)
    load = np.where((time > 18.0) & (time < 28.0), 5.0, 0.0)
    moved = ((time > 18.0) & (time < 20.0)) | ((time > 28.0) & (time < 30.0))
    height = np.where(time > 38.0, 0.0, 5.0 - peak_m * moved)
    return Truth(time, level, level, height, level, level, level, level + 100.0, load)


def panels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, peaks_m: dict[str, float]) -> list[list[str]]:
    """Rows' labels without their peaks, in each panel of the figure of these rows."""
    drawn: list[Figure] = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path, **settings: drawn.append(figure))
    plan = ComparePlan(tmp_path, firmware=tmp_path, full=True, only=tuple(peaks_m))
    results = []
    for trial in trials(plan):
        truth = flight(peaks_m[trial.name])
        results.append(Result(trial, None, truth, load=measure_load(truth)))
    draw_height(tmp_path / "height.png", results, "heights")
    (figure,) = drawn
    return [
        [text.get_text().split(", peak")[0] for text in axis.get_legend().get_texts()] for axis in figure.axes
    ]


def test_small_deviations_are_drawn_again_below(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = panels(tmp_path, monkeypatch, {"native-stock": 0.5, "kffa-ladrc": 0.04})
    assert found == [["Hold, stock gains", "KFFA-LADRC"]] * 2 + [["KFFA-LADRC"]] * 2


def test_rows_of_other_loads_are_left_out_beside_the_main_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = panels(tmp_path, monkeypatch, {"native-stock": 0.5, "native-stock-2kg": 0.3})
    assert found == [["Hold, stock gains"]] * 2


def test_rows_of_other_loads_are_drawn_where_there_are_no_main_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = panels(tmp_path, monkeypatch, {"native-stock-2kg": 0.3, "kffa-ladrc-2kg": 0.04})
    labels = {"KFFA-LADRC, 2 kg", "Hold, stock gains, 2 kg"}
    assert [set(panel) for panel in found] == [labels] * 2 + [{"KFFA-LADRC, 2 kg"}] * 2
