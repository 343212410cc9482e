"""Joining a firmware that is already running: all flights on it, one after the other.

Physics is ours, on the port where the firmware looks for it, and lasts for all flights; or it is running, too
(the bundled imitation, or `sim-vehicle run` beside the firmware), and we read the true states that it writes.
Either way the load comes and goes by the firmware's own gripper.
"""

from __future__ import annotations

import contextlib
import csv
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from kffa_offboard.compare import firmware
from kffa_offboard.compare.bridge import Bridge, bridge
from kffa_offboard.compare.firmware_end import FirmwareEnd, Hand, Identity
from kffa_offboard.compare.plan import HEAD_START_S, ComparePlan, Conditions, Join, Trial
from kffa_offboard.compare.relay import Relay, relay
from kffa_offboard.compare.simulation import Physics, Simulation, start_physics
from kffa_offboard.compare.toml_text import merged
from kffa_offboard.config import bundled, load, read_toml
from kffa_offboard.errors import UserError
from kffa_offboard.trials.metrics import FlightFailed
from kffa_offboard.trials.processes import flown_s, last_line

FOUND_LIMIT_S = 60.0
"""Wall time until the firmware has called its physics and sent a HEARTBEAT."""

RESTING_M_S = 0.015
"""At most so much the firmware may believe to climb on the ground, before it takes off again."""

REST_LIMIT_S, REST_WALL_LIMIT_S = 600.0, 240.0
"""Simulated time, and wall time, after which an estimate that is still moving will not come to rest."""

POLL_S = 0.2
PORTS = {"ardupilot": ("UDP", 9002), "px4": ("TCP", 4560)}
"""Where a firmware looks for its physics, if its instance is 0."""

STARTED = {
    "ardupilot": "start it with --model JSON:127.0.0.1",
    "px4": "start it with PX4_SYS_AUTOSTART=10016 PX4_SIM_HOST_ADDR=127.0.0.1; a PX4 that has lost its "
    "simulator never looks for it again: restart it",
}


def check_join(plan: ComparePlan) -> None:
    """Raises UserError for what cannot be had together."""
    join = plan.join
    if plan.config is not None:
        load(plan.config)
    if join is None:
        return
    if plan.firmware is not None:
        raise UserError(
            "--firmware starts a firmware, --join flies on one that is running; leave out one of them"
        )
    if join.truth is None:
        if join.lockstep:
            raise UserError(
                "--lockstep: for physics that is running, with --truth; ours is in lock-step anyway"
            )
        return
    if join.physics_port is not None:
        raise UserError(
            "--physics-port starts physics, --truth reads that of one that is running; leave out one of them"
        )
    if Conditions(rate_hz=plan.conditions.rate_hz) != plan.conditions:
        raise UserError(
            "--load, --offset, --delay and --seed belong to the physics, which is running (--truth): set "
            "them there and leave them out"
        )


@dataclass
class Joined:
    """A firmware that was met, with its physics.

    Attributes
    ----------
    identity : who it is
    truth : the growing CSV of true states
    physics : our process; None if somebody else's is running
    link : between it and the daemon
    """

    identity: Identity
    truth: Path
    end: FirmwareEnd
    link: Bridge | Relay
    physics: Physics | None
    lockstep: bool
    head_start_s: float
    _flights: int = field(default=0, init=False)

    def _come_to_rest(self) -> None:
        """Wait until the vehicle is disarmed and its estimate at rest. Raises FlightFailed if it never is."""
        began_s, give_up = flown_s(self.truth), time.monotonic() + REST_WALL_LIMIT_S
        while self.end.armed or abs(self.end.climb_rate_m_s) > RESTING_M_S:
            if flown_s(self.truth) - began_s > REST_LIMIT_S or time.monotonic() > give_up:
                trouble = f"believes to climb by {self.end.climb_rate_m_s:.2f} m/s on the ground"
                raise FlightFailed(
                    f"the firmware {'is still armed' if self.end.armed else trouble} since its last flight; "
                    "restart it for each row (--only)"
                )
            time.sleep(POLL_S)

    @contextlib.contextmanager
    def flight(self, trial: Trial, truth: Path) -> Iterator[Simulation]:
        """What `trial` needs but its pilot; its part of the true states is in `truth` afterwards."""
        if self._flights:
            self._come_to_rest()
        began_s = flown_s(self.truth) if self._flights else 0.0
        self._flights += 1
        self.end.hand = Hand(trial.course)
        if isinstance(self.link, Bridge):
            self.link.welcome(self.identity.system_id, trial.conditions.delay_s / 2.0)
        else:
            self.link.welcome()
        try:
            yield Simulation(
                f"udpout:127.0.0.1:{self.link.daemon_port}",
                self.identity.system_id,
                self.truth,
                self.head_start_s,
                () if self.physics is None else (self.physics,),
                self.link,
                lockstep=self.lockstep,
            )
        finally:
            self.link.let_go()
            self.end.hand = None
            _cut(self.truth, truth, began_s)


def _cut(whole: Path, part: Path, began_s: float) -> None:
    """Copy the rows from `began_s` on; the last row may be half written."""
    with whole.open(newline="", encoding="utf-8") as source:
        rows = csv.reader(source)
        head = next(rows, [])
        kept = [row for row in rows if len(row) == len(head) and float(row[0]) >= began_s]
    with part.open("w", newline="", encoding="utf-8") as target:
        csv.writer(target).writerows([head, *kept[:-1]])


@contextlib.contextmanager
def joined(plan: ComparePlan, join: Join) -> Iterator[Joined]:
    """Meet the running firmware, and start its physics unless that is running.

    Raises UserError, one line: nobody there, another autopilot than asked for, a port that is taken.
    """
    with contextlib.ExitStack() as stack:
        if join.truth is None:
            yield _with_our_physics(plan, join, stack)
        else:
            yield _with_its_physics(plan, join, join.truth, stack)


def _with_our_physics(plan: ComparePlan, join: Join, stack: contextlib.ExitStack) -> Joined:
    name = firmware.PX4 if plan.autopilot == "px4" else firmware.ARDUCOPTER
    end = FirmwareEnd(join.url)
    link = stack.enter_context(bridge(1, 0.0, end))
    kind, usual = PORTS[plan.autopilot]
    port = join.physics_port or usual
    truth = plan.directory.resolve() / "joined-truth.csv"
    truth.unlink(missing_ok=True)
    backend = firmware.physics_backend(name, port, link.physics_port)
    document = read_toml(bundled(name.physics))
    payload = {
        "gripper_mass_kg": plan.conditions.load_kg,
        "offset_m": [plan.conditions.offset_m, 0.0, document["payload"]["offset_m"][2]],
    }
    changes = {"backend": backend, "payload": payload, "vehicle": {"seed": plan.conditions.seed}}
    document = merged(document, changes)
    physics = start_physics(plan.directory.resolve() / "joined", truth, document, stack)
    nobody = (
        f"--join {join.url}: no firmware asked for its physics on 127.0.0.1:{port} ({kind}) within "
        f"{FOUND_LIMIT_S:g} s; {STARTED[plan.autopilot]}, or name its port with --physics-port"
    )
    _wait(lambda: flown_s(truth) > 0.0, nobody, physics)
    identity = _meet(plan, join, end, physics)
    head_start_s = HEAD_START_S[plan.autopilot]
    return Joined(identity, truth, end, link, physics, lockstep=True, head_start_s=head_start_s)


def _with_its_physics(plan: ComparePlan, join: Join, truth: Path, stack: contextlib.ExitStack) -> Joined:
    if not truth.is_file():
        raise UserError(
            f"--truth {truth}: no such file; the running physics writes it: sim-vehicle run --truth FILE"
        )
    end = FirmwareEnd(join.url)
    link = stack.enter_context(relay(end, join.lockstep))
    identity = _meet(plan, join, end, None)
    return Joined(identity, truth, end, link, None, lockstep=join.lockstep, head_start_s=0.0)


def _meet(plan: ComparePlan, join: Join, end: FirmwareEnd, physics: Physics | None) -> Identity:
    """Wait for the autopilot's HEARTBEAT."""

    def here() -> bool:
        end.greet()
        return end.identity is not None

    nobody = (
        f"--join {join.url}: no HEARTBEAT of a PX4 or ArduPilot within {FOUND_LIMIT_S:g} s; is it running, "
        "and does it send there?"
    )
    _wait(here, nobody, physics)
    identity = end.identity
    assert identity is not None
    if identity.autopilot != plan.autopilot:
        raise UserError(
            f"--join {join.url}: system {identity.system_id} there runs {identity.autopilot}; give "
            f"--autopilot {identity.autopilot}"
        )
    return identity


def _wait(until: Callable[[], bool], nobody: str, physics: Physics | None) -> None:
    give_up = time.monotonic() + FOUND_LIMIT_S
    while not until():
        if physics is not None and physics[1].poll() is not None:
            raise UserError(f"{physics[0]} ended: {last_line(physics[2])}")
        if time.monotonic() > give_up:
            raise UserError(nobody)
        time.sleep(POLL_S)
