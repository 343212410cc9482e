"""``kffa-offboard paper``: files, JSON, one self-contained page; mistakes are one line."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from kffa_offboard import cli
from kffa_offboard.errors import UserError
from kffa_offboard.experiments import settings


def status_of(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main(list(arguments))
    return int(ended.value.code or 0)


def test_one_example_writes_its_series_figures_numbers_and_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of("paper", "--example", "1", "--out", str(tmp_path), "--json") == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed == json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))
    assert {claim["example"] for claim in printed["claims"]} == {1}
    assert printed["example1"]["controllers"]["pid/no-integral"]["up"]["settling_01_percent_s"]["roll"] < 0.5
    with (tmp_path / "csv" / "example1-up.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 400
    assert float(rows[-1]["fa-ladrc:altitude"]) == pytest.approx(5.0, abs=1e-3)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == len(list((tmp_path / "figures").glob("*.png"))) == 4
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert "does not hold" in page


def test_an_unknown_example_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("paper", "--example", "5") == 2
    assert "5" in capsys.readouterr().err


def test_an_output_that_is_a_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert status_of("paper", "--example", "1", "--out", str(tmp_path / "file")) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith(f"error: --out {tmp_path / 'file'}: ")


def test_a_mistake_in_the_settings_is_named(tmp_path: Path) -> None:
    text = settings.bundled("paper.toml").read_text(encoding="utf-8")
    path = tmp_path / "paper.toml"
    path.write_text(text.replace("load_kg = 5.0", "load_kg = 7.0"), encoding="utf-8")
    with pytest.raises(UserError, match=r"paper\.toml: examples\.load_kg = 7\.0: "):
        settings.load(path)


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="children are looked up in /proc")
def test_ctrl_c_while_the_second_process_starts_is_one_word(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "kffa_offboard", "paper", "--seeds", "1", "--out", str(tmp_path)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as paper:
        deadline = time.monotonic() + 60.0
        while not any("spawn_main" in line for line in children_of(paper.pid)):
            assert time.monotonic() < deadline and paper.poll() is None
        os.killpg(paper.pid, signal.SIGINT)
        assert paper.stderr is not None
        said = paper.stderr.read()
    assert said.splitlines()[-1] == "stopped"
    assert "Traceback" not in said
    assert paper.returncode == 130


def children_of(process: int) -> list[str]:
    """Their command lines."""
    lines = []
    for child in Path(f"/proc/{process}/task/{process}/children").read_text().split():
        try:
            lines.append(Path(f"/proc/{child}/cmdline").read_text())
        except FileNotFoundError:  # ended meanwhile
            continue
    return lines
