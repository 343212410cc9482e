"""What ends a flight early, and how the results say so."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from kffa_offboard.compare import limits
from kffa_offboard.compare.flight import fly, wait_for_head_start
from kffa_offboard.compare.limits import FlightCut, Watch
from kffa_offboard.compare.plan import ComparePlan, Trial, trials
from kffa_offboard.compare.report import report
from kffa_offboard.compare.results import Result, as_json
from kffa_offboard.compare.simulation import Setup, Simulation
from kffa_offboard.compare.table import load_row
from kffa_offboard.trials.processes import free_port


class WallClock:
    """Wall time that goes on when told."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def say(limit: str) -> str:
    return limit


def test_a_flight_a_thousand_times_slower_than_real_time_is_not_cut_and_a_stalled_one_is() -> None:
    clock = WallClock()
    watch = Watch(0.0, clock=clock)
    for millisecond in range(1, 60_001, 50):  # a minute of it in 16 hours
        clock.now_s += 50.0
        watch.see(1e-3 * millisecond, say)
    clock.now_s += limits.STALL_LIMIT_S
    watch.see(59.951, say)
    clock.now_s += 0.1
    with pytest.raises(FlightCut, match=r"stood still at 60\.0 s for 60 s of wall time"):
        watch.see(59.951, say)


@pytest.mark.parametrize(
    ("began_s", "waited_s", "flown_s", "said"),
    [
        (0.0, limits.BOOT_LIMIT_S, 0.0, r"stood still at 0\.0 s for 120 s"),
        (40.0, 0.0, limits.FLIGHT_LIMIT_S, r"not over after 300 s of simulated time"),
    ],
    ids=["it never boots", "it never lands"],
)
def test_a_flight_is_given_up_beyond_the_limit_and_not_at_it(
    began_s: float, waited_s: float, flown_s: float, said: str
) -> None:
    clock = WallClock()
    watch = Watch(began_s, clock=clock)
    clock.now_s = waited_s
    watch.see(began_s + flown_s, say)
    clock.now_s += 0.1
    with pytest.raises(FlightCut, match=said):
        watch.see(began_s + (flown_s + 0.1 if flown_s else 0.0), say)


class Stalled:
    """A running firmware whose time stands still after 43.2 s; nobody answers on its link."""

    @contextlib.contextmanager
    def flight(self, trial: Trial, truth: Path) -> Iterator[Simulation]:
        truth.write_text("time_s\n43.2,\n43.2,\n", encoding="utf-8")
        yield Simulation(f"udpin:127.0.0.1:{free_port()}", 1, truth, 0.0, ())


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "STALL_LIMIT_S", 0.2)


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("name", ["native-stock", "kffa-ladrc"])
def test_a_stalled_lock_step_ends_the_flight_with_the_time_at_which_it_stalled(
    name: str, tmp_path: Path
) -> None:
    (trial,) = trials(ComparePlan(tmp_path, only=(name,)))
    setup = Setup("px4", None, tmp_path, joined=Stalled())
    with pytest.raises(FlightCut, match=r"stood still at 43\.2 s for 0\.2 s of wall time"):
        fly(setup, trial, lambda time_s, text: None)


@pytest.mark.usefixtures("impatient")
def test_a_firmware_whose_time_stalls_before_the_daemon_starts_is_not_waited_for(tmp_path: Path) -> None:
    (trial,) = trials(ComparePlan(tmp_path, only=("kffa-ladrc",)))
    with Stalled().flight(trial, tmp_path / "truth.csv") as running:
        late = replace(running, head_start_s=50.0)
        with pytest.raises(FlightCut, match=r"the firmware does not boot: .* at 43\.2 s"):
            wait_for_head_start(late, lambda time_s, text: None)


def test_a_flight_that_was_cut_is_marked_in_results_table_and_page(tmp_path: Path) -> None:
    plan = ComparePlan(tmp_path, only=("kffa-ladrc", "release"))
    cut, failed = (
        Result(trial, failure="simulated time stood still", cut=trial.name == "kffa-ladrc")
        for trial in trials(plan)
    )
    told = as_json(plan, [cut, failed])["trials"]
    assert [(trial["cut"], trial["failure"], trial["load"]) for trial in told] == [
        (True, "simulated time stood still", None),
        (False, "simulated time stood still", None),
    ]
    assert load_row(cut)[:2] == ("KFFA-LADRC (cut off)", "—")
    assert load_row(failed)[0] == "KFFA-LADRC, own release (failed)"
    page = report(plan, [cut, failed], [], [])
    assert "No figures of KFFA-LADRC (cut off): simulated time stood still." in page
