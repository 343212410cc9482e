"""Physics and firmware of one trial as child processes on loopback."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeAlias

from kffa_offboard.compare import firmware
from kffa_offboard.compare.bridge import bridge
from kffa_offboard.compare.idle import Threads
from kffa_offboard.compare.plan import DROP_S, NORMAL_DELAY_S, PICKUP_S, AutopilotName, Trial, head_start_s
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config import bundled
from kffa_offboard.trials.metrics import FlightFailed
from kffa_offboard.trials.processes import flown_s, free_port, last_line, process

SIMULATED_LIMIT_S = 1000.0
"""The physics ends by itself after so much simulated time, should it ever be left alone."""

PATIENCE_S = 60.0
"""Wall time that the imitation waits for its pilot, and the daemon for a barrier, on a busy machine."""

WINDY = "demo-px4-position-vehicle.toml"
"""Its wind blows in the rows with wind, and its drag lets the vehicle feel it."""

FIRMWARE_PATIENCE_S = 2.0
"""How long a firmware may take to end when asked: it has nothing to lose."""


Physics: TypeAlias = tuple[str, "subprocess.Popen[str]", Path]
"""What it is called, its process, its log."""


class Between(Protocol):
    """What stands between firmware and daemon."""

    def check(self) -> None:
        """Raises FlightFailed if the link broke in the middle of the flight."""

    def let_go(self) -> None:
        """The daemon has ended."""

    @property
    def time_s(self) -> float:
        """Simulated time so far, s; 0 if it does not know."""


class JoinedFirmware(Protocol):
    """A firmware that is already running; see `joining`."""

    def flight(self, trial: Trial, truth: Path) -> contextlib.AbstractContextManager[Simulation]:
        """What `trial` needs but its pilot."""


@dataclass(frozen=True)
class Setup:
    """Where a trial's files go, and which autopilot flies it.

    Attributes
    ----------
    autopilot : PX4 or ArduCopter
    binary : the firmware's program; None for the bundled imitation, which flies in lock-step with its pilot
    directory : of logs, configurations and true states
    joined : a firmware that somebody else has started; then `binary` is None
    config : the daemon's gains, instead of ours for this firmware
    """

    autopilot: AutopilotName
    binary: Path | None
    directory: Path
    joined: JoinedFirmware | None = None
    config: Path | None = None

    def file(self, trial: Trial, ending: str) -> Path:
        """A file of a trial."""
        return self.directory / f"{trial.name}{ending}"


@dataclass(frozen=True)
class Simulation:
    """Physics and firmware that are running.

    Attributes
    ----------
    url : where the pilot finds the vehicle
    target_system : its system id
    truth : CSV of true states, growing
    head_start_s : simulated time that the estimator needs
    bridge : between firmware and daemon; None if there is none
    lockstep : simulated time waits for the daemon
    """

    url: str
    target_system: int
    truth: Path
    head_start_s: float
    processes: tuple[Physics, ...]
    bridge: Between | None = None
    lockstep: bool = True

    def check(self) -> None:
        """Raises FlightFailed, with its last word, if one of the processes has ended."""
        if self.bridge is not None:
            self.bridge.check()
        for name, child, log in self.processes:
            if child.poll() is not None:
                raise FlightFailed(f"{name} ended (status {child.returncode}): {last_line(log)}")

    @property
    def time_s(self) -> float:
        """Simulated time so far, s."""
        return max(flown_s(self.truth), 0.0 if self.bridge is None else self.bridge.time_s)


@contextlib.contextmanager
def simulation(setup: Setup, trial: Trial) -> Iterator[Simulation]:
    """Start what `trial` needs but its pilot; everything has ended when the block is left.

    The firmware ends before the physics: without physics it could hang.
    """
    truth = setup.file(trial, "-truth.csv")
    truth.unlink(missing_ok=True)
    with contextlib.ExitStack() as stack:
        if setup.joined is not None:
            yield stack.enter_context(setup.joined.flight(trial, truth))
        elif setup.binary is None:
            yield _imitation(setup, trial, truth, stack)
        else:
            yield _real(setup, trial, truth, setup.binary, stack)


def _imitation(setup: Setup, trial: Trial, truth: Path, stack: contextlib.ExitStack) -> Simulation:
    """The bundled firmware with its own physics, in lock-step; its link makes the delay itself."""
    port = free_port()
    base = _read(bundled(f"demo-{setup.autopilot}-vehicle.toml"))
    more = (trial.conditions.delay_s - NORMAL_DELAY_S) / 2.0  # than the demonstration's
    link = {
        "endpoints": [f"udpout:127.0.0.1:{port}"],
        "telemetry_delay_s": max(0.0, base["link"]["telemetry_delay_s"] + more),
        "command_delay_s": max(0.0, base["link"]["command_delay_s"] + more),
    }
    lockstep = {"enabled": True, "connect_timeout_s": PATIENCE_S, "answer_timeout_s": PATIENCE_S}
    changes = {"link": link, "lockstep": lockstep}
    physics = _physics(setup, trial, truth, merged(base, changes), stack)
    return Simulation(f"udpin:127.0.0.1:{port}", 1, truth, 0.0, (physics,))


def _real(setup: Setup, trial: Trial, truth: Path, binary: Path, stack: contextlib.ExitStack) -> Simulation:
    """Real firmware; daemon or native pilot meet it on a bridge."""
    directory = setup.file(trial, "-firmware")
    shutil.rmtree(directory, ignore_errors=True)
    directory.mkdir()
    name = firmware.PX4 if setup.autopilot == "px4" else firmware.ARDUCOPTER
    instance = firmware.free_instance()
    head_start = head_start_s(setup.autopilot, trial.conditions)
    link = stack.enter_context(
        bridge(
            name.system_id(instance),
            trial.conditions.delay_s / 2.0,
            meeting_s=head_start,
            answers=name.answers,
        )
    )
    wanted = name.start(binary, directory, link.firmware_port, instance, trial)
    backend = firmware.physics_backend(
        name, wanted.physics_port, link.physics_port, trial.conditions.height_source
    )
    document = merged(_read(bundled(name.physics)), {"backend": backend})
    physics = _physics(setup, trial, truth, document, stack)
    log = setup.file(trial, "-firmware.log")
    output = stack.enter_context(log.open("w", encoding="utf-8"))
    child = stack.enter_context(
        process(
            wanted.command,
            patience_s=FIRMWARE_PATIENCE_S,
            cwd=directory,
            env={**os.environ, **wanted.environment},
            stdout=output,
            stderr=output,
        )
    )
    if name.answers and Threads.can_be_seen():
        link.watch(child.pid)
    url = f"udpout:127.0.0.1:{link.daemon_port}"
    running = (physics, ("the firmware", child, log))
    return Simulation(url, name.system_id(instance), truth, head_start, running, link)


def _physics(
    setup: Setup, trial: Trial, truth: Path, document: dict[str, Any], stack: contextlib.ExitStack
) -> Physics:
    """The simulator's process with the load and the wind of this trial."""
    return start_physics(
        setup.file(trial, ""),
        truth,
        physics_document(document, trial),
        stack,
        ("--duration", str(SIMULATED_LIMIT_S)),
    )


def physics_document(document: dict[str, Any], trial: Trial) -> dict[str, Any]:
    """The simulator's configuration `document` with the load, the wind and the seed of this trial."""
    conditions = trial.conditions
    schedule = [{"time_s": PICKUP_S, "mass_kg": conditions.load_kg}]
    if trial.course == "load":
        schedule.append({"time_s": DROP_S, "mass_kg": 0.0})
    elif trial.course == "attitude":
        schedule = []
    if conditions.wind:
        windy = _read(bundled(WINDY))
        drag = {"drag_n_s_m": windy["vehicle"]["drag_n_s_m"]}
        document = merged(document, {"wind": windy["wind"], "vehicle": drag})
    down = document["payload"]["offset_m"][2]
    payload = {
        "schedule": schedule,
        "gripper_mass_kg": conditions.load_kg,
        "offset_m": [conditions.offset_m, 0.0, down],
    }
    return merged(document, {"payload": payload, "vehicle": {"seed": conditions.seed}})


def start_physics(
    stem: Path,
    truth: Path,
    document: dict[str, Any],
    stack: contextlib.ExitStack,
    options: tuple[str, ...] = (),
) -> Physics:
    """The simulator's process; its configuration and log are `stem`-vehicle.toml and .log."""
    config, log = (stem.with_name(f"{stem.name}-vehicle{ending}") for ending in (".toml", ".log"))
    config.write_text(toml_text(document), encoding="utf-8")
    output = stack.enter_context(log.open("w", encoding="utf-8"))
    command = [sys.executable, "-m", "sim_vehicle", "run", "--config", str(config), "--truth", str(truth)]
    child = stack.enter_context(process([*command, *options], stdout=output, stderr=output))
    return ("the simulated vehicle", child, log)


def _read(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text(encoding="utf-8"))
