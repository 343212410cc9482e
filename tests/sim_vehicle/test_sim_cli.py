"""The command `sim-vehicle`: what it prints, what it writes, how it ends."""

from __future__ import annotations

import csv
import os
import signal
import socket
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sim_vehicle import cli
from sim_vehicle.cli import app
from sim_vehicle.truth import COLUMNS, TruthRecorder

CONFIG = Path(__file__).parents[2] / "configs" / "sim-px4.toml"
ANY = "udpin:127.0.0.1:0"


def run(*arguments: str):
    return CliRunner().invoke(app, ["run", *arguments])


def test_flies_for_a_duration_and_writes_the_truth(tmp_path):
    truth = tmp_path / "truth.csv"
    result = run("--config", str(CONFIG), "--link", ANY, "--duration", "0.3", "--truth", str(truth))
    assert result.exit_code == 0, result.output
    assert result.stdout.startswith("px4 vehicle, system 1, in real time: udpin:127.0.0.1:")
    rows = list(csv.reader(truth.open()))
    assert tuple(rows[0]) == COLUMNS
    assert [float(row[0]) for row in rows[1:]] == pytest.approx([0.01 * n for n in range(31)])


def test_options_choose_personality_and_links():
    result = run(
        "--personality", "ardupilot", "--link", ANY, "--link", "tcpin:127.0.0.1:0", "--duration", "0.05"
    )
    assert result.exit_code == 0
    assert result.stdout.startswith("ardupilot vehicle")
    assert "tcpin:127.0.0.1:" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["--config", "nowhere.toml"], "nowhere.toml: no such file"),
        (
            ["--config", str(CONFIG.with_name("demo-px4.toml"))],
            "is a configuration of the daemon; give it to",
        ),
        (
            ["--config", str(CONFIG.parent)],
            "configs: cannot be read: Is a directory; give the path of a TOML",
        ),
        (["--personality", "cleanflight"], "vehicle.personality = 'cleanflight': not a choice"),
        (["--link", "udpin:localhost"], "link.endpoints = 'udpin:localhost': not of the form"),
        (["--seed", "-3"], "vehicle.seed = -3: too small"),
        (["--seed", "x"], "--seed x: must be a whole number"),
        (["--speedup", "fast"], "--speedup fast: must be a number"),
        (["--duration", "0"], "--duration 0: not above zero"),
        (["--duration", "inf"], "--duration inf: above 1e+09; give seconds of simulated time"),
        (["--link", ANY, "--truth", str(CONFIG)], f"--truth {CONFIG}: is there and holds no true states"),
        (["--link", ANY, "--truth", "/nowhere/at/all.csv"], "--truth /nowhere/at/all.csv: cannot be written"),
    ],
)
def test_bad_input_is_one_line_and_status_2(arguments, error):
    result = run(*arguments)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert error in result.stderr
    assert result.stderr.count("\n") == 1


def test_a_file_that_may_not_be_read_is_one_line_and_status_2(monkeypatch):
    # What tests run as may read everything.
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.R_OK)
    result = run("--config", str(CONFIG))
    assert result.exit_code == 2
    assert result.stderr.startswith(f"error: --config: path '{CONFIG}' is not readable; chmod u+r it")
    assert result.stderr.count("\n") == 1


def test_a_busy_port_is_one_line_and_status_2():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        result = run("--link", f"udpin:127.0.0.1:{port}")
    assert result.exit_code == 2
    assert f"port {port} is in use" in result.stderr


def test_a_controller_that_never_answers_is_one_line_and_status_2(tmp_path):
    config = tmp_path / "sim.toml"
    config.write_text("[lockstep]\nconnect_timeout_s = 0.2\n")
    result = run("--config", str(config), "--lockstep", "--link", ANY)
    assert result.exit_code == 2
    assert "lock-step: nobody called within 0.2 s" in result.stderr


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_ctrl_c_ends_cleanly_with_the_truth_written(tmp_path, number, status):
    truth = tmp_path / "truth.csv"
    command = [sys.executable, "-m", "sim_vehicle", "run", "--link", ANY, "--truth", str(truth)]
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[2],
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )
    assert "in real time" in process.stdout.readline()
    process.send_signal(number)
    _, errors = process.communicate(timeout=20)
    assert process.returncode == status
    assert errors == ""
    assert truth.read_text().startswith("time_s,x,y,z,")


def test_without_a_file_true_states_are_let_go() -> None:
    recorder = TruthRecorder()
    with cli._truth_file(None, recorder) as let_go:
        recorder.record(0, [0.0] * 12, 0.0, 0.0, False, "external")
        let_go()
        assert recorder.rows == []


def test_a_file_that_is_not_text_is_one_line(tmp_path):
    config = tmp_path / "flight.tlog"
    config.write_bytes(b"\x00\xfd\xa4")
    assert run("--config", str(config)).stderr == (
        f"error: {config}: is not UTF-8 text (byte 1); save it as UTF-8\n"
    )


@pytest.mark.parametrize("flag", ["--help", "-h"])
def test_help_explains_run(flag):
    result = CliRunner().invoke(app, ["run", flag])
    assert result.exit_code == 0
    for word in ("--lockstep", "--truth", "--duration", "Exit status"):
        assert word in result.output


def test_the_version_is_that_of_the_installed_package():
    said = CliRunner().invoke(app, ["--version"])
    assert (said.exit_code, said.output) == (0, f"sim-vehicle {metadata.version('kffa-offboard')}\n")
