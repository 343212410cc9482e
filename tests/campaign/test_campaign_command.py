"""`kffa-offboard campaign`: what it keeps, that it goes on where it was, and what it says."""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kffa_offboard import __version__, cli
from kffa_offboard.campaign import command, extras, store
from kffa_offboard.campaign.engine import run_local
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.campaign.store import Store
from kffa_offboard.campaign.task import Task, run, tasks
from kffa_offboard.errors import UserError

parquet: Any = pytest.importorskip("pyarrow.parquet")
pytest.importorskip("joblib")

SHORT = """
[campaign]
flights = 14
[flight]
settle_s = 0.3
[random]
drop_after_s = [0.2, 0.4]
[failed]
recovery_max_s = 0.3
"""
WIDTH = 6


def short_plan(directory: Path) -> command.CampaignPlan:
    file = directory / "campaign.toml"
    file.write_text(SHORT, encoding="utf-8")
    return command.CampaignPlan(file, directory / "out", jobs=1, width=WIDTH, json=True)


@pytest.fixture
def plan(tmp_path: Path) -> command.CampaignPlan:
    return short_plan(tmp_path)


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> command.CampaignPlan:
    """A campaign that was flown to its end: to be copied, or only read."""
    plan = short_plan(tmp_path_factory.mktemp("flown"))
    assert command.run_campaign(plan) == 0
    return plan


def summary_of(captured: pytest.CaptureFixture[str]) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(captured.readouterr().out.splitlines()[-1])
    return told


def kept_summary(plan: command.CampaignPlan) -> dict[str, Any]:
    kept: dict[str, Any] = json.loads((plan.directory / "summary.json").read_text(encoding="utf-8"))
    return kept


def test_everything_is_kept_and_summed_up(
    plan: command.CampaignPlan, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.run_campaign(replace(plan, compare="kffa-ladrc, pid")) == 0
    told = summary_of(capsys)["controllers"]
    assert list(told) == ["pid", "kffa-ladrc"]
    table = parquet.read_table(plan.directory / "flights").to_pydict()
    assert len(table["flight"]) == 28
    ours = [row for row, name in enumerate(table["controller"]) if name == "kffa-ladrc"]
    assert sorted(table["flight"][row] for row in ours) == list(range(14))
    peaks = np.array([table["drop_peak_m"][row] for row in ours])
    assert told["kffa-ladrc"]["percentiles"]["drop_peak_m"]["p99"] == pytest.approx(np.percentile(peaks, 99))
    failed = sorted(table["flight"][row] for row in ours if table["failure"][row])
    assert told["kffa-ladrc"]["failed_flights"] == failed
    assert told["kffa-ladrc"]["failed"] == len(failed) == sum(told["kffa-ladrc"]["failures"].values())
    loads = {name: [] for name in ("pid", "kffa-ladrc")}  # type: dict[str, list[float]]
    for name, load in zip(table["controller"], table["load_kg"], strict=True):
        loads[name].append(load)
    assert sorted(loads["pid"]) == sorted(loads["kffa-ladrc"])
    page = (plan.directory / "report.html").read_text(encoding="utf-8")
    assert "14 random flights with pid, kffa-ladrc" in page
    assert "http" not in page.replace("data:image", "")


def test_a_stopped_campaign_goes_on_and_ends_the_same(
    plan: command.CampaignPlan,
    flown: command.CampaignPlan,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    keep, kept = Store.keep, []

    def stopped(store: Store, task: Task, table: Any) -> None:
        if kept:
            raise KeyboardInterrupt
        keep(store, task, table)
        kept.append(task)

    with monkeypatch.context() as patched:
        patched.setattr(Store, "keep", stopped)
        assert command.run_campaign(plan) == command.INTERRUPTED
    assert "6 of 14 flights are kept" in capsys.readouterr().err
    first = plan.directory / "flights" / f"{kept[0].name}.parquet"
    before = first.stat().st_mtime_ns
    assert command.run_campaign(plan) == 0
    ours = summary_of(capsys)
    assert first.stat().st_mtime_ns == before
    assert ours == kept_summary(flown)


def test_sigterm_ends_a_campaign_with_all_its_processes(plan: command.CampaignPlan) -> None:
    """The pipe is at its end only when no process holds it any more."""
    arguments = [sys.executable, "-m", "kffa_offboard", "campaign", str(plan.file)]
    options = ["--out", str(plan.directory), "--flights", "100000", "--jobs", "2"]
    with subprocess.Popen(
        [*arguments, *options], stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as process:
        while len(_children(process.pid)) < 2 and process.poll() is None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(0.05)
        process.terminate()
        said, _ = process.communicate(timeout=90)
    assert process.returncode == 130, said
    assert b" of 100,000 flights are kept" in said


def _children(number: int) -> list[str]:
    """Process numbers of the children whose work has begun: those that have imported numpy."""
    listed = Path(f"/proc/{number}/task/{number}/children").read_text(encoding="ascii").split()
    return [child for child in listed if "numpy" in Path(f"/proc/{child}/maps").read_text(encoding="utf-8")]


def test_a_longer_campaign_keeps_its_flights_and_counts_none_twice(
    plan: command.CampaignPlan, capsys: pytest.CaptureFixture[str]
) -> None:
    for flights in (3, 8):
        assert command.run_campaign(replace(plan, flights=flights)) == 0
        assert summary_of(capsys)["controllers"]["kffa-ladrc"]["flights"] == flights


def test_another_campaign_is_not_mixed_in(plan: command.CampaignPlan) -> None:
    short = replace(plan, flights=2)
    assert command.run_campaign(short) == 0
    with pytest.raises(UserError, match="holds another campaign's flights with kffa-ladrc; choose another"):
        command.run_campaign(replace(short, seed=2))
    (plan.directory / "campaign.json").write_text("{", encoding="utf-8")
    with pytest.raises(UserError, match=r"campaign\.json: is damaged"):
        command.run_campaign(short)


def test_flights_of_two_versions_are_not_mixed(
    plan: command.CampaignPlan, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.run_campaign(replace(plan, flights=2)) == 0
    before = (plan.directory / "campaign.json").read_bytes()
    monkeypatch.setattr(store, "__version__", "9.8.7")
    for more in ({"flights": 8}, {"compare": "pid", "flights": 2}):
        with pytest.raises(
            UserError,
            match=rf"kffa-offboard {re.escape(__version__)}, and this is 9\.8\.7; choose another dir",
        ):
            command.run_campaign(replace(plan, **more))
    assert (plan.directory / "campaign.json").read_bytes() == before
    assert command.run_campaign(replace(plan, flights=2, directory=plan.directory.with_name("new"))) == 0


def test_a_directory_of_another_version_without_flights_is_taken(
    plan: command.CampaignPlan, capsys: pytest.CaptureFixture[str]
) -> None:
    plan.directory.mkdir()
    nothing = {"version": "0.0.1", "controllers": {}}
    (plan.directory / "campaign.json").write_text(json.dumps(nothing), encoding="utf-8")
    assert command.run_campaign(replace(plan, flights=2)) == 0


@pytest.mark.parametrize("text", ["[]", "{}", '{"controllers": 3}', "null"])
def test_a_manifest_that_is_none_is_one_line(plan: command.CampaignPlan, text: str) -> None:
    plan.directory.mkdir()
    (plan.directory / "campaign.json").write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=r"campaign\.json: is damaged \(it names no controllers\); choose"):
        command.run_campaign(replace(plan, flights=2))


def test_flights_without_a_manifest_are_nobodys(
    plan: command.CampaignPlan, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.run_campaign(replace(plan, flights=2)) == 0
    (plan.directory / "campaign.json").unlink()
    with pytest.raises(UserError, match=r"holds flights and no campaign\.json that says what was flown; ch"):
        command.run_campaign(replace(plan, flights=2, seed=5))


def _cut(path: Path, other: Path) -> None:
    os.truncate(path, 3000)


def _empty(path: Path, other: Path) -> None:
    os.truncate(path, 0)


def _swap(path: Path, other: Path) -> None:
    path.write_bytes(other.read_bytes())


def _replace_by_a_directory(path: Path, other: Path) -> None:
    path.unlink()
    path.mkdir()


def _foreign(path: Path, other: Path) -> None:
    arrow: Any = pytest.importorskip("pyarrow")
    parquet.write_table(arrow.table({"x": [1, 2]}), path)


@pytest.mark.parametrize(
    ("spoil", "why"),
    [
        (_cut, "Parquet magic bytes not found"),
        (_empty, "Parquet file size is 0 bytes"),
        (_swap, "have other numbers or another controller"),
        (_replace_by_a_directory, "directory"),
        (_foreign, "its columns are x"),
    ],
)
def test_a_file_that_is_damaged_or_foreign_is_named_and_flown_again_once_removed(
    plan: command.CampaignPlan,
    flown: command.CampaignPlan,
    capsys: pytest.CaptureFixture[str],
    spoil: Callable[[Path, Path], None],
    why: str,
) -> None:
    shutil.copytree(flown.directory, plan.directory)
    first, second = sorted((plan.directory / "flights").iterdir())[:2]
    spoil(first, second)
    with pytest.raises(
        UserError, match=r"is damaged or not of this campaign .* remove it, and the same"
    ) as told:
        command.run_campaign(plan)
    assert why in str(told.value) and str(first) in str(told.value)
    first.rmdir() if first.is_dir() else first.unlink()
    assert command.run_campaign(plan) == 0
    assert summary_of(capsys) == kept_summary(flown)


def test_a_full_disk_is_one_line_and_leaves_what_was_there(
    plan: command.CampaignPlan, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.run_campaign(replace(plan, flights=6)) == 0
    before = {path: path.read_bytes() for path in plan.directory.rglob("*") if path.is_file()}

    def full(number: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(UserError, match=r"No space left on device; make room, and the same command goes"):
            command.run_campaign(replace(plan, flights=7))
    assert {path: path.read_bytes() for path in plan.directory.rglob("*") if path.is_file()} == before
    assert command.run_campaign(replace(plan, flights=7)) == 0


def test_two_processes_that_write_one_file_leave_it_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "flights.parquet"

    def write_while_another_does(draft: Path) -> None:
        with draft.open("w", encoding="ascii") as file:
            file.write("one ")
            file.flush()
            with monkeypatch.context() as other:
                other.setattr(os, "getpid", lambda: 1)
                store._replace(path, lambda theirs: theirs.write_text("one and two", encoding="ascii"))
            file.write("and two")

    store._replace(path, write_while_another_does)
    assert path.read_text(encoding="ascii") == "one and two"
    assert list(tmp_path.iterdir()) == [path]


def test_one_flight_alone_is_the_one_of_the_campaign(
    plan: command.CampaignPlan, flown: command.CampaignPlan, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.run_campaign(replace(plan, flight=11)) == 0
    alone = summary_of(capsys)["kffa-ladrc"]
    table = parquet.read_table(flown.directory / "flights").to_pydict()
    row = table["flight"].index(11)
    for name, value in alone.items():
        assert value == (None if name == "failed_at_s" else table[name][row]), name
    directory = plan.directory / "flight-00000011"
    assert (directory / "flight.png").read_bytes().startswith(b"\x89PNG")
    page = (directory / "report.html").read_text(encoding="utf-8")
    assert "flight 11, kffa-ladrc" in page
    assert "picked up" in page


def test_several_processes_fly_the_same(campaign: Campaign) -> None:
    work = list(tasks(campaign, 4, 2))
    ours = dict(run(campaign, task) for task in work)
    theirs = dict(run_local(campaign, work, jobs=2))
    assert list(ours) == sorted(theirs, key=lambda task: task.first)
    for task, table in ours.items():
        for name, values in table.items():
            np.testing.assert_array_equal(values, theirs[task][name])


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["--compare", "pid,adrc"], "--compare adrc: no such controller; choose from pid,"),
        (["--engine", "dask"], "--engine dask and --scheduler ADDRESS go together"),
        (["--scheduler", "tcp://127.0.0.1:1"], "--engine dask and --scheduler ADDRESS go together"),
        (["--jobs", "0", "--flights", "1"], "--jobs 0: no process would fly"),
    ],
)
def test_wrong_usage_is_one_line_and_status_2(
    plan: command.CampaignPlan, capsys: pytest.CaptureFixture[str], arguments: list[str], line: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.main(["campaign", str(plan.file), "--out", str(plan.directory), *arguments])
    assert ended.value.code == 2
    said = [text for text in capsys.readouterr().err.splitlines() if text.startswith("error: ")]
    assert len(said) == 1
    assert line in said[0]


def test_without_the_extra_it_says_what_to_install(
    plan: command.CampaignPlan, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(extras, "import_module", missing)
    with pytest.raises(UserError, match=r'pyarrow, which is not installed; .*"kffa-offboard\[campaign\]"'):
        command.run_campaign(plan)
    assert command.run_campaign(replace(plan, flight=1, flights=2)) == 0  # needs none of it


def test_help_does_not_load_what_flies() -> None:
    script = (
        "import sys; from kffa_offboard import cli\n"
        "try: cli.main(['campaign', '--help'])\n"
        "except SystemExit: pass\n"
        "assert not {'numpy', 'pyarrow', 'joblib', 'distributed', 'matplotlib'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", script], check=True, env=os.environ, stdout=subprocess.DEVNULL)
