"""MAVLink 2 signing with an unmodified ArduCopter, in real time: who has its key flies it, others do not.

ArduCopter gets its key by SETUP_SIGNING on the link that it takes for USB, where it does not sign; the
daemon is on another one.
"""

from __future__ import annotations

import json
import secrets
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.firmware import arducopter
from kffa_offboard.compare.plan import Trial
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config import bundled
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.mavlink.signing import timestamp_at
from kffa_offboard.mavlink.signing_key import KEY_SIZE
from kffa_offboard.trials.metrics import read_truth
from kffa_offboard.trials.processes import process

pytestmark = pytest.mark.timeout(300)
TRIAL = Trial("flight", "", "kffa-ladrc", "rates")
HEIGHT_M = 2.0
SCENARIO = {
    "segment": [
        {"type": "takeoff", "altitude_m": HEIGHT_M, "climb_rate_m_s": 1.0},
        {"type": "hold", "duration_s": 2.0},
        {"type": "land", "descent_rate_m_s": 1.0},
    ]
}


class Usb:
    """What is plugged into ArduCopter's first port."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(10.0)
        self.port = int(self._socket.getsockname()[1])

    def start(self, binary: Path, directory: Path, link_port: int, *others: Any) -> Any:
        """ArduCopter with this on its first port and the daemon's link on the second."""
        made = arducopter(binary, directory, link_port, *others)
        command = list(made.command)
        command[command.index("--serial0") + 1] = f"udpclient:127.0.0.1:{self.port}"
        command[command.index("--serial1") + 1] = f"udpclient:127.0.0.1:{link_port}"
        return replace(made, command=tuple(command))

    def set_key(self, system: int, key: bytes) -> None:
        _, peer = self._socket.recvfrom(65535)
        now = timestamp_at(time.time_ns() // 1000)
        setup = mavlink.MAVLink_setup_signing_message(system, 1, list(key), now)
        self._socket.sendto(setup.pack(mavlink.MAVLink(None, srcSystem=255, srcComponent=190)), peer)

    def close(self) -> None:
        self._socket.close()


@dataclass
class Vehicle:
    """An ArduCopter on the ground that signs.

    `key` is its own; `link` the daemon's.
    """

    directory: Path
    link: dict[str, Any]
    truth: Path
    key: bytes

    def configured(self, name: str, key: bytes | None) -> list[str]:
        """The daemon's command, with that key or none."""
        changes: dict[str, Any] = {"link": self.link, "scenario": SCENARIO}
        if key is not None:
            key_file = self.directory / f"{name}.key"
            key_file.write_text(key.hex(), encoding="ascii")
            key_file.chmod(0o600)
            changes["signing"] = {"key_file": str(key_file)}
        gains = tomllib.loads(bundled("compare-ardupilot.toml").read_text(encoding="utf-8"))
        config = self.directory / f"{name}.toml"
        config.write_text(toml_text(merged(gains, changes)), encoding="utf-8")
        command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config), "--json"]
        return [*command, "--arm", "--engage", "--fix-params", "--log", str(self.log(name))]

    def log(self, name: str) -> Path:
        return self.directory / f"{name}.tlog"


@pytest.fixture(scope="module")
def vehicle(
    firmware_binary: Callable[[str], Path],
    flying_firmware: Any,
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[Vehicle]:
    directory, key, usb = tmp_path_factory.mktemp("signing"), secrets.token_bytes(KEY_SIZE), Usb()
    binary = firmware_binary("ardupilot")
    with flying_firmware("ardupilot", binary, directory, TRIAL, usb.start) as (url, system, truth):
        usb.set_key(system, key)
        yield Vehicle(directory, {"url": url, "target_system": system}, truth, key)
    usb.close()


def said_until(command: list[str], beginning: str, limit_s: float = 20.0) -> tuple[str, str]:
    """Run a daemon until it says something that has this in it; that line, and its last one."""
    with process(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as daemon:
        assert daemon.stdout is not None
        end = time.monotonic() + limit_s
        lines = []
        for line in daemon.stdout:
            lines.append(line)
            if beginning in line or time.monotonic() > end:
                break
        daemon.send_signal(signal.SIGINT)
        return lines[-1], [line for line in daemon.stdout.read().splitlines() if line][-1]


def test_without_a_key_the_daemon_is_not_listened_to_and_says_what_is_missing(vehicle: Vehicle) -> None:
    line, last = said_until(vehicle.configured("without", None), "signs messages")
    assert "vehicle signs messages: give [signing] key_file" in line
    summary = json.loads(last)
    assert summary["telemetry_received"] > 0 and summary["commands_sent"] == 0


def test_with_another_key_the_vehicle_is_not_listened_to(vehicle: Vehicle) -> None:
    other = secrets.token_bytes(KEY_SIZE)
    line, last = said_until(vehicle.configured("wrong", other), "signing:")
    assert "refus" in line and "key" in line
    summary = json.loads(last)
    assert summary["telemetry_received"] == 0 and summary["commands_sent"] == 0


def test_with_its_key_the_vehicle_is_flown_and_the_log_holds_no_signature(vehicle: Vehicle) -> None:
    command = vehicle.configured("right", vehicle.key)
    done = subprocess.run(command, capture_output=True, text=True, timeout=120.0)
    assert done.returncode == 0, done.stderr[-2000:]
    summary = json.loads(done.stdout.splitlines()[-1])
    assert summary["commands_sent"] > 500 and "signs messages" not in done.stderr
    heights = read_truth(vehicle.truth).z
    assert heights.max() == pytest.approx(HEIGHT_M, abs=0.15) and heights[-1] < 0.1
    frames = [frame for _, frame in read_tlog(vehicle.log("right")).frames()]
    assert not any(frame[2] & mavlink.MAVLINK_IFLAG_SIGNED for frame in frames if frame[0] == 0xFD)
