"""One flight of the demonstration: simulated vehicle and daemon as two processes on loopback."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from kffa_offboard.config import bundled
from kffa_offboard.trials.metrics import FlightFailed
from kffa_offboard.trials.processes import Listener, flown_s, free_port, last_line, process

REAL_TIME_LIMIT_S = 150.0
"""A flight takes 45 to 70 s; one that takes longer than this has failed."""

SIMULATED_LIMIT_S = 150.0
"""The vehicle ends by itself after so much simulated time, should it ever be left alone."""

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
        process(_daemon_command(plan, port), stdout=subprocess.PIPE, stderr=subprocess.PIPE) as daemon,
        process(_vehicle_command(plan, port), stdout=vehicle_log, stderr=vehicle_log) as vehicle,
    ):
        listener = Listener(daemon.stderr, plan.file("-daemon.log"))
        _wait(plan, daemon, vehicle, listener, progress)
        assert daemon.stdout is not None
        said = daemon.stdout.read()
        listener.join()
    return _summary(plan, said, listener)


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


def _wait(
    plan: FlightPlan,
    daemon: subprocess.Popen[str],
    vehicle: subprocess.Popen[str],
    listener: Listener,
    progress: Progress,
) -> None:
    """Wait until the daemon has ended; FlightFailed if the vehicle ends first or it takes too long."""
    give_up = time.monotonic() + REAL_TIME_LIMIT_S
    while daemon.poll() is None:
        if vehicle.poll() is not None:
            raise FlightFailed(f"the simulated vehicle ended: {last_line(plan.file('-vehicle.log'))}")
        if time.monotonic() > give_up:
            raise FlightFailed(
                f"not on the ground after {REAL_TIME_LIMIT_S:g} s; the daemon's last word: {listener.latest}"
            )
        progress(flown_s(plan.truth), listener.latest)
        with contextlib.suppress(subprocess.TimeoutExpired):
            daemon.wait(POLL_S)


def _summary(plan: FlightPlan, said: str, listener: Listener) -> FlightSummary:
    lines = said.splitlines()
    if not lines:
        raise FlightFailed(f"the daemon ended: {listener.reason}")
    summary = json.loads(lines[-1])
    if not summary["successful"]:
        raise FlightFailed(f"{plan.controller}: {summary['reason']}")
    return FlightSummary(summary["telemetry_received"], summary["commands_sent"])
