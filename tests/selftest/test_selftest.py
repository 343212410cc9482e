"""The self-test: what it finds on a healthy installation, and that it finds what is wrong."""

import json
from dataclasses import replace

import numpy as np
import pytest

from kffa_offboard.control import fuzzy
from kffa_offboard.faults.faults import Lose
from kffa_offboard.offboard import guard as offboard_guard
from kffa_offboard.selftest import command, guard, law, machine
from kffa_offboard.selftest.command import SelftestPlan, run_selftest
from kffa_offboard.selftest.faults import AT_S, Case, cases, run_fault
from kffa_offboard.selftest.result import Row, at_most


def test_the_law_gives_the_known_answers():
    rows = law.run_law()
    assert len(rows) == 4 and all(row.passed for row in rows), rows


def test_a_law_that_is_wrong_fails(monkeypatch):
    monkeypatch.setattr(
        law, "_channel", lambda omega_c, omega_o, right=law._channel: right(1.2 * omega_c, omega_o)
    )
    assert law.run_law()[0].passed is False
    monkeypatch.setattr(fuzzy, "bandwidth_correction", lambda parameters, e, ec: np.full_like(e, 3.0))
    assert law.run_law()[3].passed is False


def test_no_bad_command_passes_the_guard_and_a_broken_guard_is_noticed(monkeypatch):
    rows = guard.run_guard(600)
    assert all(row.passed for row in rows), rows
    monkeypatch.setattr(offboard_guard, "_slew", lambda value, previous, change: value)
    rows = guard.run_guard(600)
    assert rows[0].passed is False and rows[0].value > 100


def test_a_fault_is_flown_in_a_process_of_its_own_and_judged(tmp_path):
    lost = next(case for case in cases() if case.name == "telemetry lost")
    row = run_fault(lost, tmp_path)
    assert row.passed, row
    assert 0.2 <= row.value <= 0.27
    assert (tmp_path / "fault-telemetry-lost.csv").stat().st_size > 10_000


def test_a_reaction_that_is_not_the_stated_one_fails(tmp_path):
    wrong = Case("wrong", Lose(AT_S, 0.1), 0.25, "no attitude for 0.25 s")
    row = run_fault(wrong, tmp_path)
    assert row.passed is False and row.measured == "control is kept"


def test_this_machine_is_measured_without_a_flight_too(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "LOG_FRAMES", 2000)
    monkeypatch.setattr(machine, "ROUND_TRIPS", 50)
    monkeypatch.setattr(machine, "TICKS", 20)
    rows = machine.run_machine(None, tmp_path)
    assert rows[-1].name == "log written and read back"
    assert rows[-1].measured.startswith("2000 of 2000 frames")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("passed", "status"), [(True, 0), (False, 1), (None, 0)])
def test_exit_status_table_and_file(passed, status, tmp_path, monkeypatch, capsys):
    rows = [at_most("a", "one", 1.0, 2.0, "m"), replace(Row("b", "two", "x", "y", True), passed=passed)]
    monkeypatch.setattr(command, "_parts", lambda directory: [("parts", lambda: rows)])
    assert run_selftest(SelftestPlan(tmp_path / "out")) == status
    said = capsys.readouterr().out
    assert "self-test" in said and ("1 of 2 failed" in said) is (passed is False)
    assert run_selftest(SelftestPlan(tmp_path / "out", json=True)) == status
    told = json.loads(capsys.readouterr().out)
    assert told["passed"] is (status == 0) and told["rows"][0]["value"] == 1.0
    assert json.loads((tmp_path / "out" / "selftest.json").read_text())["rows"] == told["rows"]


@pytest.mark.parametrize(("group", "told"), [(machine.GROUP, True), ("guard", False)])
def test_a_machine_that_is_too_slow_is_told_what_helps(group, told, tmp_path, monkeypatch, capsys):
    rows = [Row(group, "100 Hz", "17 ms", "5 ms", False)]
    monkeypatch.setattr(command, "_parts", lambda directory: [("timing", lambda: rows)])
    assert run_selftest(SelftestPlan(tmp_path, False)) == 1
    assert ("end other programs and test again" in capsys.readouterr().out) is told


def test_what_is_not_a_number_fails():
    assert at_most("a", "one", float("nan"), 1.0, "m").passed is False
