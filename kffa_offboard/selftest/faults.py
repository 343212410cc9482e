"""Chosen faults of the link in flight, and whether the daemon does what docs/safety.md says.

The vehicle is a process of its own, in lock-step over UDP; the daemon's session runs here, with the faults on
its link.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import dataclass, field, replace
from math import nan
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.errors import UserError
from kffa_offboard.faults.barrier import BarrierFaults
from kffa_offboard.faults.check import ENDINGS, violations
from kffa_offboard.faults.faults import Fault, Flood, Freeze, Lose, Offset, Overwrite, ShiftClock, Thin
from kffa_offboard.faults.line import FaultLine
from kffa_offboard.faults.link import FaultyLink
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import real_time_clock, run_lock_step
from kffa_offboard.offboard.events import Announce, Event, Output, ProcessReport, Signals
from kffa_offboard.offboard.segments import Hold, Takeoff
from kffa_offboard.offboard.service import Service
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.selftest.result import Row
from kffa_offboard.trials.metrics import FlightFailed, read_truth
from kffa_offboard.trials.processes import process

GROUP = "fault"
HEIGHT_M = 2.0
AT_S = 10.5
"""Simulated time at which the fault begins: the vehicle hovers."""

KEPT_S = 1.5
SLOT_S = 0.01
STOPPED = "stop requested"
_SAMPLES = ("ATTITUDE", "LOCAL_POSITION_NED")


@dataclass(frozen=True)
class Case:
    """A fault and what is to come of it.

    `ends_s` and `reason`: control ends within that time with that reason; else it is kept, and the vehicle
    stays within `stays_m` of its height.
    """

    name: str
    fault: Fault
    ends_s: float = 0.0
    reason: str = ""
    stays_m: float = 0.1


def cases() -> list[Case]:
    """The selection."""
    packer = mavlink.MAVLink(None, 77, 1)
    foreign = bytes(mavlink.MAVLink_attitude_message(1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0).pack(packer))
    return [
        Case("telemetry lost", Lose(AT_S), 0.25, "no attitude for 0.25 s"),
        Case("values stand still", Freeze(AT_S, messages=_SAMPLES), 0.5, "stands still"),
        Case("time goes back", ShiftClock(AT_S, offset_s=-1.0), 0.25, "standing clock"),
        Case(
            "not a number",
            Overwrite(AT_S, messages=("ATTITUDE",), values={"roll": nan}),
            0.02,
            "attitude is not finite",
        ),
        Case(
            "height jumps 3 m",
            Offset(AT_S, messages=("LOCAL_POSITION_NED",), values={"z": -3.0}),
            0.02,
            "jumped",
        ),
        Case("a tenth of the rate", Thin(AT_S, messages=_SAMPLES), 1.0, "Hz; omega_o"),
        Case("heartbeat lost", Lose(AT_S, messages=("HEARTBEAT",)), 3.0, "no heartbeat for 3 s"),
        Case("a third of telemetry lost", Lose(AT_S, messages=_SAMPLES, share=0.3)),
        Case("20,000 foreign messages/s", Flood(AT_S, 0.3, frames=(foreign,))),
    ]


@dataclass
class _Flight:
    """What is seen of a flight in faults."""

    settings: ServiceSettings
    heard: list[tuple[int, Event | Output]] = field(default_factory=list)
    sent: list[tuple[int, bytes]] = field(default_factory=list)

    def write(self, time_us: int, frame: bytes) -> None:
        """As a recorder."""
        if frame[5] == Route().own_system:
            self.sent.append((time_us, frame))

    def write_signals(self, signals: Signals) -> None:
        """As a recorder."""

    def write_begin(self, time_us: int) -> None:
        """As a recorder."""

    def write_request(self, time_us: int, request: object) -> None:
        """As a recorder."""

    def write_report(self, time_us: int, report: object) -> None:
        """As a recorder."""

    def write_end(self, time_us: int, reason: str, frames_dropped: int) -> None:
        """As a recorder."""

    @property
    def ending(self) -> tuple[float, str] | None:
        """When control was given up, simulated s, and why; None if only this test put an end to it."""
        for time_us, item in self.heard:
            if isinstance(item, Announce) and item.text.startswith(ENDINGS) and STOPPED not in item.text:
                return time_us * 1e-6, item.text
        return None


def run_fault(case: Case, directory: Path) -> Row:
    """Fly one case and judge it."""
    truth = directory / f"fault-{case.name.replace(' ', '-').replace(',', '').replace('/', '-per-')}.csv"
    try:
        flight = _fly(case, truth)
        if case.reason:
            return _judge_end(case, flight)
        return _judge_kept(case, flight, truth)
    except (FlightFailed, UserError) as problem:
        return Row(GROUP, case.name, str(problem), "flown", False)


def _fly(case: Case, truth: Path) -> _Flight:
    config = load(bundled("demo-px4.toml"), Overrides(arm=True, engage=True))
    settings = replace(config.service, scenario=(Takeoff(HEIGHT_M), Hold(1000.0)))
    flight, clock, stop = _Flight(settings), real_time_clock(), threading.Event()
    udp = open_link("udpin:127.0.0.1:0", clock)
    faults = BarrierFaults(FaultLine((case.fault,)), FaultLine(()))
    end_s = AT_S + (case.ends_s or KEPT_S) + 0.5

    def observe(time_us: int, item: Event | Output | ProcessReport) -> None:
        if not isinstance(item, ProcessReport):
            flight.heard.append((time_us, item))
        if time_us >= end_s * 1e6:
            stop.set()

    session = Session(Service(settings), FaultyLink(udp, faults), Route(), recorder=flight, observer=observe)
    command = [sys.executable, "-m", "sim_vehicle", "run", "--lockstep", "--truth", str(truth)]
    command += ["--config", str(bundled("demo-px4-vehicle.toml"))]
    command += ["--link", f"udpout:{udp.name.partition(':')[2]}", "--duration", "60"]
    with (
        truth.with_suffix(".log").open("w", encoding="utf-8") as said,
        process(command, stdout=said, stderr=said),
    ):
        try:
            run_lock_step(session, clock, stop, connect_timeout_s=30.0)
        finally:
            udp.close()
    return flight


def _judge_end(case: Case, flight: _Flight) -> Row:
    limit = f"{case.ends_s:g} s, {case.reason}"
    if flight.ending is None:
        return Row(GROUP, case.name, "control is kept", limit, False)
    ended_s, text = flight.ending
    after_s = ended_s - AT_S
    wrong = violations(flight.settings, flight.heard, flight.sent, airborne=False)
    passed = case.reason in text and -SLOT_S < after_s <= case.ends_s + 2.0 * SLOT_S and not wrong
    measured = f"{max(after_s, 0.0):.2f} s, {text.partition(': ')[2]}"
    return Row(GROUP, case.name, "; ".join([measured, *wrong[:1]]), limit, passed, after_s)


def _judge_kept(case: Case, flight: _Flight, truth: Path) -> Row:
    limit = f"control is kept, {case.stays_m:g} m"
    states = read_truth(truth)
    after = (states.time_s >= AT_S) & (states.time_s < AT_S + KEPT_S)
    if not after.any():
        return Row(GROUP, case.name, "the vehicle did not fly so long", limit, False)
    away = float(abs(states.z[after] - HEIGHT_M).max())
    ending = flight.ending
    kept = ending is None or ending[0] >= AT_S + KEPT_S
    wrong = violations(flight.settings, flight.heard, flight.sent, airborne=False)
    measured = f"{away:.3f} m" if kept or ending is None else ending[1]
    passed = kept and away <= case.stays_m and not wrong
    return Row(GROUP, case.name, "; ".join([measured, *wrong[:1]]), limit, passed, away)
