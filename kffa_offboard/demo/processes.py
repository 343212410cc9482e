"""One flight of the demonstration: simulated vehicle and daemon as two processes on loopback."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from kffa_offboard.config import bundled
from kffa_offboard.demo.metrics import FlightFailed

REAL_TIME_LIMIT_S = 150.0
"""A flight takes 45 to 70 s; one that takes longer than this has failed."""

SIMULATED_LIMIT_S = 150.0
"""The vehicle ends by itself after so much simulated time, should it ever be left alone."""

END_LIMIT_S = 5.0
"""How long a process may take to end when asked."""

POLL_S = 0.1

Progress = Callable[[float, str], None]
"""Is told the simulated time so far [s] and the latest announcement."""


@dataclass(frozen=True)
class FlightPlan:
    """What is flown, and where its files go.

    Attributes
    ----------
    directory : of true states, flight log and the output of both processes
    personality : "px4" or "ardupilot"
    output : "rates" or "attitude"
    controller : name of the controller
    seed : of the simulator's noise
    lockstep : simulated time waits for the controller
    position : hold the place in gusty wind, too, and fly a square
    """

    directory: Path
    personality: str
    output: str
    controller: str
    seed: int
    lockstep: bool
    position: bool = False

    @property
    def config(self) -> str:
        """Name of the bundled configuration, without ending."""
        return f"demo-{self.personality}{'-position' * self.position}"

    def file(self, ending: str) -> Path:
        """A file of this flight in `directory`."""
        return self.directory / f"{self.controller}{ending}"

    @property
    def truth(self) -> Path:
        """True states (CSV)."""
        return self.file("-truth.csv")

    @property
    def log(self) -> Path:
        """Flight log of the daemon (.tlog)."""
        return self.file(".tlog")


@dataclass(frozen=True)
class FlightSummary:
    """What the daemon said at its end."""

    telemetry_received: int
    commands_sent: int


def fly(plan: FlightPlan, progress: Progress) -> FlightSummary:
    """Fly `plan`; both processes have ended when this returns or raises.

    Raises FlightFailed with the reason, in the daemon's or the simulator's own words.
    """
    plan.directory.mkdir(parents=True, exist_ok=True)
    for old in (plan.truth, plan.log):
        old.unlink(missing_ok=True)
    port = free_port()
    with (
        plan.file("-vehicle.log").open("w", encoding="utf-8") as vehicle_log,
        _process(_daemon_command(plan, port), stdout=subprocess.PIPE, stderr=subprocess.PIPE) as daemon,
        _process(_vehicle_command(plan, port), stdout=vehicle_log, stderr=vehicle_log) as vehicle,
    ):
        listener = _Listener(daemon.stderr, plan.file("-daemon.log"))
        _wait(plan, daemon, vehicle, listener, progress)
        assert daemon.stdout is not None
        said = daemon.stdout.read()
        listener.join()
    return _summary(plan, said, listener)


def free_port() -> int:
    """A UDP port on loopback that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _vehicle_command(plan: FlightPlan, port: int) -> list[str]:
    config = bundled(f"{plan.config}-vehicle.toml")
    command = [sys.executable, "-m", "sim_vehicle", "run", "--config", str(config)]
    command += ["--link", f"udpout:127.0.0.1:{port}", "--seed", str(plan.seed)]
    command += ["--truth", str(plan.truth), "--duration", str(SIMULATED_LIMIT_S)]
    return command + ["--lockstep"] * plan.lockstep


def _daemon_command(plan: FlightPlan, port: int) -> list[str]:
    config = bundled(f"{plan.config}.toml")
    command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config)]
    command += ["--link", f"udpin:127.0.0.1:{port}", "--log", str(plan.log), "--arm", "--engage", "--json"]
    command += ["--controller", plan.controller, "--output", plan.output]
    return command + ["--lockstep"] * plan.lockstep


@contextlib.contextmanager
def _process(command: list[str], **streams: Any) -> Iterator[subprocess.Popen[str]]:
    """A process that has ended when the block is left, whatever happens in it."""
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, text=True, **streams)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(END_LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class _Listener:
    """Reads what the daemon says about the flight, into a file and for the progress display."""

    def __init__(self, stream: IO[str] | None, path: Path) -> None:
        assert stream is not None
        self.lines: list[str] = []
        self._stream = stream
        self._path = path
        self._thread = threading.Thread(target=self._read, name="daemon output", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with self._path.open("w", encoding="utf-8") as file:
            for line in self._stream:
                file.write(line)
                file.flush()
                self.lines.append(line.rstrip())

    def join(self) -> None:
        """Wait until everything was read."""
        self._thread.join(END_LIMIT_S)

    @property
    def latest(self) -> str:
        """The latest announcement, without its time."""
        return self.lines[-1].partition(" s  ")[2] or self.lines[-1] if self.lines else "starting"

    @property
    def reason(self) -> str:
        """What the daemon said last, best its error."""
        errors = [line.removeprefix("error: ") for line in self.lines if line.startswith("error: ")]
        return errors[-1] if errors else self.latest


def _wait(
    plan: FlightPlan,
    daemon: subprocess.Popen[str],
    vehicle: subprocess.Popen[str],
    listener: _Listener,
    progress: Progress,
) -> None:
    """Wait until the daemon has ended; FlightFailed if the vehicle ends first or it takes too long."""
    give_up = time.monotonic() + REAL_TIME_LIMIT_S
    while daemon.poll() is None:
        if vehicle.poll() is not None:
            raise FlightFailed(f"the simulated vehicle ended: {_last_line(plan.file('-vehicle.log'))}")
        if time.monotonic() > give_up:
            raise FlightFailed(
                f"not on the ground after {REAL_TIME_LIMIT_S:g} s; the daemon's last word: {listener.latest}"
            )
        progress(flown_s(plan.truth), listener.latest)
        with contextlib.suppress(subprocess.TimeoutExpired):
            daemon.wait(POLL_S)


def _last_line(path: Path) -> str:
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return lines[-1].removeprefix("error: ") if lines else "without a word"


def flown_s(truth: Path) -> float:
    """Simulated time of the last whole line of a growing file of true states, s."""
    try:
        with truth.open("rb") as file:
            file.seek(max(0, file.seek(0, 2) - 1000))
            lines = file.read().split(b"\n")
    except FileNotFoundError:
        return 0.0
    try:
        return float(lines[-2].partition(b",")[0]) if len(lines) > 2 else 0.0
    except ValueError:  # the head of the file
        return 0.0


def _summary(plan: FlightPlan, said: str, listener: _Listener) -> FlightSummary:
    lines = said.splitlines()
    if not lines:
        raise FlightFailed(f"the daemon ended: {listener.reason}")
    summary = json.loads(lines[-1])
    if not summary["successful"]:
        raise FlightFailed(f"{plan.controller}: {summary['reason']}")
    return FlightSummary(summary["telemetry_received"], summary["commands_sent"])
