"""MAVProxy, as people install it, flies the simulated vehicle: over TCP, in real time, with either firmware.

It is driven as a person would: commands in at its standard input, lines out at its standard output. Needs
the extra "clients".
"""

from __future__ import annotations

import contextlib
import csv
import os
import queue
import re
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Iterator
from itertools import takewhile
from pathlib import Path
from typing import Any

import pytest

from sim_vehicle.config import load
from sim_vehicle.parameters import ParameterStore

pytest.importorskip(
    "MAVProxy", reason='extra "clients" is not installed: no MAVProxy; pip install "kffa-offboard[clients]"'
)

CONFIGS = Path(__file__).parents[2] / "configs"
MAVPROXY = Path(sysconfig.get_path("scripts")) / "mavproxy.py"
HEIGHT = 2.0
PATIENCE_S = 30.0


class MavProxy:
    """A running MAVProxy. `said` is everything it printed so far."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        self.said: list[str] = []
        self._lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self.reader = threading.Thread(target=self._read)
        self.reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line.rstrip())
        self._lines.put(None)

    def type(self, command: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()

    def wait_for(self, pattern: str) -> re.Match[str]:
        """The next line with `pattern` in it; the test fails if none comes."""
        deadline = time.monotonic() + PATIENCE_S
        with contextlib.suppress(queue.Empty):
            while (line := self._lines.get(timeout=max(0.0, deadline - time.monotonic()))) is not None:
                self.said.append(line)
                if found := re.search(pattern, line):
                    return found
        pytest.fail(f"MAVProxy never said {pattern!r}:\n" + "\n".join(self.said))

    def ask(self, command: str, pattern: str) -> re.Match[str]:
        """Type a command and wait for what must come of it."""
        self.type(command)
        return self.wait_for(pattern)

    def leave(self) -> None:
        """End of input ends MAVProxy, as Ctrl-D does."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait(PATIENCE_S)
        self.reader.join(PATIENCE_S)
        while (line := self._lines.get(timeout=PATIENCE_S)) is not None:
            self.said.append(line)


@contextlib.contextmanager
def mavproxy(address: str, directory: Path) -> Iterator[MavProxy]:
    """MAVProxy with its core modules only, all its files below `directory`."""
    command = [sys.executable, "-u", str(MAVPROXY), f"--master={address}", "--state-basedir", str(directory)]
    command += ["--default-modules=param,mode,arm,misc,cmdlong,log,fence"]
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=directory,
        env={**os.environ, "HOME": str(directory)},
    )
    with process:
        proxy = MavProxy(process)
        try:
            yield proxy
        finally:
            process.kill()
            proxy.reader.join(PATIENCE_S)


def check_parameters(proxy: MavProxy, store: ParameterStore) -> None:
    """MAVProxy fetches the list by itself, and again when asked; what it saves is complete and right."""
    count = len(store.names)
    proxy.wait_for(rf"Received {count} parameters")
    proxy.wait_for("Saved")
    proxy.ask("param fetch", "Requested parameter list")
    proxy.wait_for(rf"Received {count} parameters")
    file = proxy.wait_for(r"Saved \d+ parameters to (\S+)")[1]
    saved = dict(line.split()[:2] for line in Path(file).read_text().splitlines() if line[:1] not in "#_")
    assert {name: float(value) for name, value in saved.items()} == {
        name: pytest.approx(store[name], abs=1e-6) for name in store.names
    }


def change_parameter(proxy: MavProxy, name: str, value: float) -> None:
    """Set, wait for the vehicle's confirmation, and read back."""
    proxy.type(f"param watch {name}")
    proxy.ask(f"param set {name} {value}", f"> {name}=")
    assert float(proxy.ask(f"param fetch {name}", rf"{name} = (\S+)")[1]) == pytest.approx(value)


def rise(proxy: MavProxy) -> None:
    """Wait until the vehicle is near its height."""
    proxy.wait_for("Takeoff detected")
    proxy.type("watch GLOBAL_POSITION_INT")
    while int(proxy.wait_for(r"relative_alt : (-?\d+)")[1]) < 1000.0 * (HEIGHT - 0.2):
        pass


def fly_px4(proxy: MavProxy) -> None:
    """PX4 takes heights above the sea.

    Modes by name are beyond MAVProxy here: it hands PX4's three numbers of a mode on as one.
    """
    change_parameter(proxy, "COM_OBL_RC_ACT", 4)
    change_parameter(proxy, "MPC_LAND_SPEED", 1.25)
    proxy.ask("arm throttle", "^ARMED")
    proxy.ask(f"takeoff {HEIGHT}", "Already higher than takeoff altitude")
    proxy.ask(f"takeoff {488.0 + HEIGHT}", "NAV_TAKEOFF: ACCEPTED")
    rise(proxy)
    proxy.ask("long NAV_LAND", "NAV_LAND: ACCEPTED")
    proxy.wait_for("Mode LAND")
    proxy.wait_for("Landing detected")
    proxy.ask("disarm", "Disarmed by external command")
    proxy.wait_for("^DISARMED")


def fly_ardupilot(proxy: MavProxy) -> None:
    """ArduCopter takes heights above home, in GUIDED only, and disarms itself after landing."""
    change_parameter(proxy, "GUID_TIMEOUT", 1.5)
    change_parameter(proxy, "LAND_SPEED", 125)
    proxy.ask(f"takeoff {HEIGHT}", "NAV_TAKEOFF: FAILED")
    proxy.ask("mode guided", "Mode GUIDED")
    proxy.ask("arm throttle", "^ARMED")
    proxy.ask(f"takeoff {HEIGHT}", "NAV_TAKEOFF: ACCEPTED")
    rise(proxy)
    proxy.ask("mode land", "Mode LAND")
    proxy.wait_for("Landing detected")
    proxy.wait_for("^DISARMED")


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_mavproxy_reads_everything_and_flies_the_vehicle(
    vehicle_process: Any, personality: str, tmp_path: Path
) -> None:
    truth = tmp_path / "truth.csv"
    store = load(CONFIGS / f"sim-{personality}.toml").make_parameters()
    with vehicle_process(personality, "tcp", truth) as at, mavproxy(f"tcp:{at}", tmp_path) as proxy:
        proxy.wait_for("online system 1")
        check_parameters(proxy, store)
        proxy.ask("log list", "No logs")
        (fly_px4 if personality == "px4" else fly_ardupilot)(proxy)
        proxy.ask("status", "MAV Errors: 0")
        for kind in ("ATTITUDE", "BATTERY_STATUS", "GLOBAL_POSITION_INT", "HEARTBEAT", "SYS_STATUS"):
            proxy.wait_for(rf"\d+: {kind} ")
        proxy.leave()
    # Leaving, it takes its modules apart while a thread of its own still reads, which may break there.
    everything = "\n".join(takewhile(lambda line: "Unloading module" not in line, proxy.said))
    assert not re.search("Traceback|ERROR|fence breach|link .* down", everything), everything
    with truth.open() as file:
        rows = list(csv.DictReader(file))
    assert max(float(row["z"]) for row in rows) == pytest.approx(HEIGHT, abs=0.4)
    assert abs(float(rows[-1]["z"])) < 0.01
    happened = [event for row in rows for event in row["event"].split("; ")]
    order = [happened.index(event) for event in ("armed", "takeoff", "mode LAND", "landed", "disarmed")]
    assert order == sorted(order)
