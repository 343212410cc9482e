"""The daemon as a process in a real-time flight: a full disk, kill -9, a restart in flight, a hang-up."""

from __future__ import annotations

import csv
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import pytest

HOVER = """
[link]
url = "udpout:{place}"
[control.altitude]
hover_thrust = 0.398
omega_c = 1.0
omega_o = 10.0
omega_c_range = 0.2
[control.rates.roll]
omega_c = 1.0
omega_c_range = 0.2
omega_o = 10.0
[control.rates.pitch]
omega_c = 1.0
omega_c_range = 0.2
omega_o = 10.0
[telemetry]
settle_time_s = 0.5
attitude_hz = 50
position_hz = 50
timeout_s = 3.0
position_timeout_s = 3.0
heartbeat_timeout_s = 10.0
late_max_s = 20.0
[[scenario.segment]]
type = "takeoff"
altitude_m = 1.0
[[scenario.segment]]
type = "hold"
duration_s = 600
[signals]
rate_hz = 0
[log]
directory = "{directory}"
"""
DISK_BYTES = 30_000
"""A file may not grow beyond this: a second of flight. Python is told as of a full disk."""


class Daemon:
    """A daemon in a process of its own, and what it says."""

    def __init__(self, config: Path, *options: str, disk: int | None = None) -> None:
        def limit() -> None:
            if disk is not None:
                resource.setrlimit(resource.RLIMIT_FSIZE, (disk, disk))

        command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config), "--trust-params"]
        self.process = subprocess.Popen(
            [*command, *options], stderr=subprocess.PIPE, text=True, preexec_fn=limit
        )
        self.said = ""

    def wait_for(self, text: str) -> None:
        assert self.process.stderr is not None
        while text not in self.said:
            line = self.process.stderr.readline()
            assert line, f"ended without {text!r}: {self.said}"
            self.said += line

    def end(self, number: signal.Signals) -> int:
        self.process.send_signal(number)
        _, rest = self.process.communicate(timeout=20)
        self.said += rest
        return self.process.returncode


@pytest.mark.timeout(100)
def test_a_full_disk_a_killed_daemon_and_its_restart_in_one_flight(
    tmp_path: Path, vehicle_process: Callable[[str, str, Path], AbstractContextManager[str]]
) -> None:
    truth, config, logs = tmp_path / "truth.csv", tmp_path / "hover.toml", tmp_path / "logs"
    with vehicle_process("px4", "udp", truth) as place:
        config.write_text(HOVER.format(place=place, directory=logs))
        first = Daemon(config, "--arm", "--engage", disk=DISK_BYTES)
        try:
            first.wait_for("flight log: File too large")
            first.wait_for("Takeoff detected")
            assert "failsafe" not in first.said
            assert first.end(signal.SIGKILL) == -signal.SIGKILL
        finally:
            first.process.kill()
        assert (logs / "in-flight-1.json").exists()
        second = Daemon(config, "--engage")
        try:
            second.wait_for("an earlier run had control")
            second.wait_for("restarted in flight: only observing")
            second.wait_for("ready")
            assert second.end(signal.SIGHUP) == 130
        finally:
            second.process.kill()
    assert "engaging" not in second.said
    assert (logs / "in-flight-1.json").exists(), "the vehicle was not seen disarmed"
    with truth.open() as file:
        rows = list(csv.DictReader(file))
    tilt = max(max(abs(float(row["roll"])), abs(float(row["pitch"]))) for row in rows)
    assert tilt < 0.2
    assert max(float(row["z"]) for row in rows) < 2.0
