"""One trial from start to end: simulation, pilot or daemon, and what is left of it on disk."""

from __future__ import annotations

import contextlib
import json
import math
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

from kffa_offboard.compare.course import course
from kffa_offboard.compare.limits import Watch
from kffa_offboard.compare.pilot import Phase, Pilot, Version
from kffa_offboard.compare.plan import END_S, HEIGHT_M, NORMAL_DELAY_S, Trial
from kffa_offboard.compare.simulation import PATIENCE_S, Setup, Simulation, simulation
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config import bundled, read_toml
from kffa_offboard.mavlink.component import Component, FrameParser
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.shell import real_time_clock
from kffa_offboard.trials.metrics import FlightFailed
from kffa_offboard.trials.processes import Listener, process

STILL_ARMED = "disarming was refused"
"""The daemon's reason for an ending after touch-down."""

POLL_S = 0.1
HELLO_S = 0.5

Progress: TypeAlias = Callable[[float, str], None]
"""Is told the simulated time so far [s] and what is going on."""


@dataclass(frozen=True)
class Flown:
    """What a pilot can tell after the flight.

    Attributes
    ----------
    version : of the firmware, if it was asked for
    texts : what the vehicle said to the native pilot
    remark : what went wrong without touching what is measured
    """

    version: Version | None = None
    texts: tuple[str, ...] = ()
    remark: str | None = None


def fly(setup: Setup, trial: Trial, progress: Progress) -> Flown:
    """Fly `trial`; all processes have ended when this returns or raises.

    Raises FlightFailed with one line.
    """
    with simulation(setup, trial) as running:
        if trial.native:
            return _fly_native(setup, trial, running, progress)
        return Flown(remark=_fly_daemon(setup, trial, running, progress))


def _fly_native(setup: Setup, trial: Trial, running: Simulation, progress: Progress) -> Flown:
    """The autopilot's own modes, with `Pilot` as the ground station."""
    from_ground = trial.conditions.height_source == "range finder"
    pilot = Pilot(setup.autopilot, running.target_system, HEIGHT_M, END_S, from_ground)
    component, parser = Component(pilot.route), FrameParser(keeps_frames_whole=True)
    clock = real_time_clock()
    link = open_link(running.url, clock)
    watch, hello_at, shown_at = Watch(running.time_s), 0.0, 0.0
    try:
        while pilot.phase is not Phase.DONE:
            now = time.monotonic()
            running.check()
            if pilot.phase is Phase.WAITING and now >= hello_at:  # a vehicle in lock-step waits for us
                hello_at = now + HELLO_S
                link.send(component.pack(pilot.hello()))
            if now >= shown_at:
                shown_at = now + POLL_S
                watch.see(running.time_s, pilot.complaint)
                progress(running.time_s, pilot.phase.name.lower())
            for datagram in link.receive(POLL_S):
                for message in [] if datagram.stranger else parser.parse(datagram):
                    if pilot.route.from_target(message):
                        link.lock(datagram.source)
                    for answer in pilot.handle(message):
                        link.send(component.pack(answer))
    finally:
        link.close()
        log = setup.file(trial, "-pilot.log")
        log.write_text("".join(f"{text}\n" for text in pilot.texts), encoding="utf-8")
    return Flown(pilot.version, tuple(pilot.texts))


def _fly_daemon(setup: Setup, trial: Trial, running: Simulation, progress: Progress) -> str | None:
    """The daemon takes off, holds and lands; it starts when the firmware's estimator has settled.

    Returns a remark if the vehicle has landed and would not be disarmed.
    """
    wait_for_head_start(running, progress)
    config = setup.file(trial, ".toml")
    config.write_text(toml_text(daemon_document(setup, trial, running)), encoding="utf-8")
    log = setup.file(trial, ".tlog")
    log.unlink(missing_ok=True)
    command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config), "--log", str(log)]
    command += [
        "--controller",
        trial.controller,
        "--output",
        trial.output,
        "--arm",
        "--engage",
        "--json",
        *(["--lockstep"] if running.lockstep else []),
    ]
    with process(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as daemon:
        listener = Listener(daemon.stderr, setup.file(trial, "-daemon.log"))
        watch = Watch(running.time_s)
        while daemon.poll() is None:
            running.check()
            watch.see(running.time_s, lambda limit: f"{limit}; the daemon's last word: {listener.latest}")
            progress(running.time_s, listener.latest)
            with contextlib.suppress(subprocess.TimeoutExpired):
                daemon.wait(POLL_S)
        if running.bridge is not None:
            running.bridge.let_go()
        assert daemon.stdout is not None
        said = daemon.stdout.read().splitlines()
        listener.join()
    if not said:
        raise FlightFailed(f"the daemon ended: {listener.reason}")
    summary = json.loads(said[-1])
    if summary["successful"]:
        return None
    if summary["reason"] == STILL_ARMED:
        return "landed, but the autopilot refused to disarm"
    raise FlightFailed(f"{trial.controller}: {summary['reason']}")


def wait_for_head_start(running: Simulation, progress: Progress) -> None:
    """Let the firmware boot and its estimator settle. Raises FlightCut if time does not pass."""
    watch = Watch(running.time_s, math.inf)
    while running.time_s < running.head_start_s:
        running.check()
        watch.see(running.time_s, lambda limit: f"the firmware does not boot: {limit}; see its log")
        progress(running.time_s, "the firmware boots")
        time.sleep(POLL_S)


def daemon_document(setup: Setup, trial: Trial, running: Simulation) -> dict[str, Any]:
    """The daemon's configuration of a trial: ours for this firmware, with the trial's link and course."""
    base = read_toml(setup.config or bundled(_gains(setup, trial)))
    rate, delay = trial.conditions.rate_hz, trial.conditions.delay_s
    changes: dict[str, Any] = {
        "link": {"url": running.url, "target_system": running.target_system},
        "scenario": {"segment": course(trial)},
        "telemetry": {"barrier_timeout_s": PATIENCE_S},
    }
    if rate != base.get("telemetry", {}).get("attitude_hz"):
        changes["telemetry"] |= {"attitude_hz": rate, "position_hz": rate}
    if delay != NORMAL_DELAY_S:
        changes |= {
            section: _with_delay(base[section], delay - NORMAL_DELAY_S)
            for section in ("control", "position")
            if section in base
        }
    if trial.conditions.wind:
        changes["position"] = changes.get("position", {}) | {"enabled": True}
    return merged(base, changes)


def _gains(setup: Setup, trial: Trial) -> str:
    """Our configuration of the daemon for this firmware."""
    if setup.binary is not None or setup.joined is not None:
        return f"compare-{setup.autopilot}.toml"
    return f"demo-{setup.autopilot}{'-position' if trial.conditions.wind else ''}.toml"


def _with_delay(control: dict[str, Any], delay_s: float) -> dict[str, Any]:
    """Delays that the observers are told of, and forecasts, longer by `delay_s`, which can be measured."""
    longer: dict[str, Any] = {}
    for key, value in control.items():
        if isinstance(value, dict):
            longer[key] = _with_delay(value, delay_s)
        elif key in ("delay_s", "prediction_s"):
            longer[key] = value + delay_s
    return longer
