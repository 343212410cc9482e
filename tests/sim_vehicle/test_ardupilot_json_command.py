"""`sim-vehicle run --backend ardupilot-json` as a process, with a firmware behind a UDP port."""

from __future__ import annotations

import contextlib
import csv
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sim_vehicle.backends.ardupilot_json import ServoPacket, encode_servo_packet
from sim_vehicle.cli import app

TEXT = '[backend]\nkind = "ardupilot-json"\n{more}\n[backend.ardupilot_json]\nport = 0\n'


@contextlib.contextmanager
def physics(tmp_path: Path, *options: str, more: str = "") -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The process and the port where it waits for servo packets."""
    config = tmp_path / "vehicle.toml"
    config.write_text(TEXT.format(more=more))
    process = subprocess.Popen(
        [sys.executable, "-m", "sim_vehicle", "run", "--config", str(config), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first.startswith("physics for ArduPilot (JSON interface), "), first
        yield process, int(first.rsplit(":", 1)[1])
    finally:
        process.kill()
        process.communicate()


@pytest.fixture
def firmware() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as port:
        port.bind(("127.0.0.1", 0))
        port.settimeout(20.0)
        yield port


def exchange(firmware: socket.socket, port: int, count: int, width: int = 1000) -> bytes:
    packet = ServoPacket(800, count, (width,) * 4 + (0,) * 12)
    firmware.sendto(encode_servo_packet(packet), ("127.0.0.1", port))
    return firmware.recv(4096)


def test_one_answer_for_each_packet_until_the_duration_is_over(tmp_path, firmware):
    truth = tmp_path / "truth.csv"
    with physics(tmp_path, "--speedup", "0", "--duration", "0.1", "--truth", str(truth)) as (process, port):
        answers = [exchange(firmware, port, count, 1700) for count in range(80)]
        _, errors = process.communicate(timeout=20.0)
    assert process.returncode == 0
    assert all(b'"timestamp":' in answer for answer in answers)
    assert errors.splitlines()[0].endswith("physics at 800 Hz")
    assert errors.splitlines()[-1] == (
        "ardupilot-json: 80 frames, 0 repeated, 0 bad packets, 0 firmware restarts"
    )
    rows = list(csv.DictReader(truth.open()))
    assert [float(row["time_s"]) for row in rows] == pytest.approx([0.01 * n for n in range(11)])
    assert {row["mode"] for row in rows} == {"external"}
    assert rows[1]["event"] == "motors on"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_a_full_disk_under_the_truth_is_one_line(tmp_path, firmware):
    with physics(tmp_path, "--speedup", "0", "--truth", "/dev/full") as (process, port):
        exchange(firmware, port, 0)
        _, errors = process.communicate(timeout=20.0)
    assert process.returncode == 2
    assert errors.splitlines()[-1] == (
        "error: --truth /dev/full: cannot be written: No space left on device; choose another file"
    )
    assert "Traceback" not in errors


def test_a_silent_firmware_is_announced_and_then_given_up(tmp_path, firmware):
    with physics(tmp_path, more="stall_warning_s = 0.3\nstall_timeout_s = 1.5") as (process, port):
        exchange(firmware, port, 0)
        _, errors = process.communicate(timeout=20.0)
    assert process.returncode == 2
    said = "ardupilot-json: no servo packet for {} s at 0.00 s of simulated time"
    lines = errors.splitlines()
    assert any(line.startswith(f"{said.format('0.3')}, still waiting; ") for line in lines)
    assert lines[-1].startswith(f"error: {said.format('1.5')}; is the firmware running")


def test_terminating_it_while_it_waits_is_not_an_error(tmp_path, firmware):
    with physics(tmp_path) as (process, port):
        exchange(firmware, port, 0)
        process.send_signal(signal.SIGTERM)
        _, errors = process.communicate(timeout=20.0)
    assert process.returncode == 143
    assert errors.splitlines()[-1] == (
        "ardupilot-json: 1 frames, 0 repeated, 0 bad packets, 0 firmware restarts"
    )


def test_a_port_in_use_is_one_line(firmware, tmp_path):
    port = firmware.getsockname()[1]
    config = tmp_path / "vehicle.toml"
    config.write_text(f'[backend]\nkind = "ardupilot-json"\n[backend.ardupilot_json]\nport = {port}\n')
    result = CliRunner().invoke(app, ["run", "--config", os.fspath(config)])
    assert result.exit_code == 2
    assert result.stderr.startswith(f"error: link udpin:127.0.0.1:{port}: port {port} is in use; ")


def test_a_speed_is_not_for_physics_that_follow_the_firmwares(tmp_path):
    config = tmp_path / "vehicle.toml"
    config.write_text('[backend]\nkind = "ardupilot-json"\n[backend.ardupilot_json]\npace = "firmware"\n')
    result = CliRunner().invoke(app, ["run", "--config", os.fspath(config), "--speedup", "2"])
    assert result.exit_code == 2
    assert (
        result.stderr == "error: --speedup: the file lets the firmware pace; give its own --speedup instead\n"
    )


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["--backend", "gazebo"], "backend.kind = 'gazebo': not a choice"),
        (
            ["--backend", "ardupilot-json", "--link", "udpin:127.0.0.1:0"],
            "--link: the ardupilot-json backend is",
        ),
        (
            ["--backend", "ardupilot-json", "--personality", "px4"],
            "--personality: the ardupilot-json backend is",
        ),
        (
            ["--backend", "ardupilot-json", "--lockstep"],
            "lockstep.enabled = true: with backend.kind = 'ardupilot",
        ),
        (["--speedup", "2"], "--speedup: the bundled firmware flies in real time"),
        (["--backend", "ardupilot-json", "--speedup", "-1"], "backend.real_time_factor = -1.0: too small"),
        (
            ["--backend", "px4-hil", "--speedup", "1e-300"],
            "backend.real_time_factor = 1e-300: too small; give 0.01 or more, or 0 for as fast as possible",
        ),
    ],
)
def test_options_that_do_not_go_together_are_refused(options, error):
    result = CliRunner().invoke(app, ["run", *options])
    assert result.exit_code == 2
    assert error in result.stderr
    assert result.stderr.count("\n") == 1
