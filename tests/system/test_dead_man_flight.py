"""A daemon that dies or hangs while the vehicle rolls: it is level before its autopilot misses anybody."""

from __future__ import annotations

import csv
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

SWING = """
[link]
url = "udpout:{place}"
[control]
output = "rates"
[control.altitude]
hover_thrust = 0.398
[telemetry]
settle_time_s = 0.5
[signals]
rate_hz = 0
[[scenario.segment]]
type = "takeoff"
altitude_m = 2.0
climb_rate_m_s = 1.5
[[scenario.segment]]
type = "sine"
channel = "roll"
amplitude_deg = 15.0
period_s = 2.0
cycles = 30
"""
FAST_RAD_S = 0.5


def end_in_the_swing(config: Path, truth: Path, number: signal.Signals) -> float:
    """Fly, and send a signal while a fast roll is asked for; returns when, s of simulated time."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(30.0)
        command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config), "--trust-params"]
        command += ["--arm", "--engage", "--plot", f"udpout:127.0.0.1:{ear.getsockname()[1]}"]
        daemon = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        try:
            while True:
                signals = json.loads(ear.recv(65535))
                if abs(signals.get("roll/command", 0.0)) > FAST_RAD_S and signals["altitude/estimate"] > 1.9:
                    break
            daemon.send_signal(number)
            sent_s = last_row_s(truth)
            time.sleep(1.5)
            return sent_s
        finally:
            daemon.kill()
            daemon.wait()


def last_row_s(truth: Path) -> float:
    return float(truth.read_text().splitlines()[-2].split(",")[0])


@pytest.mark.timeout(100)
@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
@pytest.mark.parametrize(("number", "roll"), [(signal.SIGKILL, 0.25), (signal.SIGSTOP, 0.35)])
def test_a_daemon_that_dies_or_stops_in_a_swing_leaves_a_level_vehicle(
    tmp_path: Path,
    vehicle_process: Callable[[str, str, Path], AbstractContextManager[str]],
    number: signal.Signals,
    roll: float,
) -> None:
    """Without the switch its last body rate goes on for a second: 0.5 rad."""
    truth, config = tmp_path / "truth.csv", tmp_path / "swing.toml"
    with vehicle_process("px4", "udp", truth) as place:
        config.write_text(SWING.format(place=place))
        since_s = end_in_the_swing(config, truth, number)
    with truth.open() as file:
        rolls = [float(row["roll"]) for row in csv.DictReader(file) if float(row["time_s"]) > since_s]
    assert len(rolls) > 100
    assert max(map(abs, rolls)) < roll
