"""Which of the project's targets a set of flights is held against."""

from __future__ import annotations

from pathlib import Path

import pytest

from kffa_offboard.compare.measure import LoadFigures
from kffa_offboard.compare.plan import ComparePlan, trials
from kffa_offboard.compare.results import Result, verdicts
from kffa_offboard.trials.metrics import Deviation


def figures(peak_m: float, iae_m_s: float) -> LoadFigures:
    both = Deviation(peak_m, iae_m_s)
    return LoadFigures(5.0, both, both, None, None, 0.003, 0.1, 0.1, 60.0, 70.0)


@pytest.mark.parametrize(("source", "ending"), [("range finder", "-range"), ("barometer", "-baro")])
def test_flights_with_another_height_are_held_against_its_own_mode_with_the_same_one(
    source: str, ending: str
) -> None:
    plan = ComparePlan(directory=Path("out"), autopilot="px4", firmware=Path("px4"), full=True)
    flown = {
        "native-stock": figures(0.6, 1.0),
        f"native-stock{ending}": figures(0.5, 2.0),
        "kffa-ladrc": figures(0.04, 0.1),
        f"kffa-ladrc{ending}": figures(0.02, 0.04),
        f"release{ending}": figures(0.03, 0.04),
    }
    results = [Result(trial, load=flown[trial.name]) for trial in trials(plan) if trial.name in flown]
    found = {verdict.target: (verdict.measured, verdict.holds) for verdict in verdicts(plan, results)}
    assert found["pick-up: IAE 40 times smaller"] == ("10.0 times", False)
    assert found[f"{source}: pick-up: IAE 40 times smaller"] == ("50.0 times", True)
    assert found[f"{source}: drop: peak 12 times smaller"] == ("25.0 times", True)
    assert found[f"{source}: release by the daemon: peak at most 0.025 m"] == ("0.030 m", False)
