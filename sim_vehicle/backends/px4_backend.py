"""The shell around `Px4Vehicle`: PX4's connection, the wall clock, lines for people.

Before PX4's first motor outputs, sensors go out at real-time pace: PX4 boots by that time. From then on
each sensor frame waits for its motor outputs (lock-step). If they stay away, simulated time goes on slowly
with the last ones until they are back: PX4 whose OFFBOARD mode was chosen before any setpoint came sends
none, and would never leave that state if its time stood still.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from sim_vehicle.backends.barrier import Barrier
from sim_vehicle.backends.base import Progress, Say
from sim_vehicle.backends.pacing import Pacer, StallWatch
from sim_vehicle.backends.px4_hil import SENSOR_PERIOD_US, Px4Vehicle
from sim_vehicle.backends.px4_port import Px4Port
from sim_vehicle.config import SimConfig
from sim_vehicle.plant import Plant

Clock: TypeAlias = Callable[[], float]
"""Wall time [s]."""

NAME = "px4-hil"
PROGRESS_S = 0.2
WAIT_S = 0.2

FALLBACK_FACTOR = 0.02
"""Simulated seconds per second while outputs stay away, five sensor frames.

Enough for PX4 to act on a setpoint or a mode command within seconds; and few enough for a PX4 that was only
stopped (a debugger): it takes the frames that have piled up without flying in between.
"""

CONNECT_REMEDY = "start PX4 with PX4_SYS_AUTOSTART=10016 PX4_SIM_HOST_ADDR=127.0.0.1, -i N for port 4560 + N"
OUTPUT_REMEDY = "is PX4 stopped, or in OFFBOARD without setpoints?"


class Rhythm:
    """When to stop waiting for motor outputs. Without a clock; times are the wall's [s].

    Attributes
    ----------
    phase : "boot" until the first outputs, "lock-step", or "fallback" while they stay away
    """

    def __init__(self, patience_s: float) -> None:
        self.phase: Literal["boot", "lock-step", "fallback"] = "boot"
        self._patience_s = patience_s

    def deadline(self, heard_s: float, due_s: float) -> float:
        """Until when to wait for the outputs to a frame.

        `heard_s` is when outputs last came nearer to the frame's time, or the frame went out; `due_s` when
        the next frame is due.
        """
        return heard_s + self._patience_s if self.phase == "lock-step" else due_s

    def pacer(self, real_time_factor: float) -> Pacer:
        """What paces this phase: only lock-step may go as fast as possible."""
        if self.phase == "fallback":
            return Pacer(FALLBACK_FACTOR)
        return Pacer(real_time_factor if self.phase == "lock-step" else real_time_factor or 1.0)

    def after_frame(self, heard: bool, answered: bool, lock_step: bool | None) -> str | None:
        """What changes now, for people, if something does.

        `heard`: outputs to a later frame than before came; `answered`: those to this very frame.
        """
        if self.phase == "lock-step" and not answered:
            self.phase = "fallback"
            return (
                f"no motor outputs for {self._patience_s:g} s; going on slowly with the last ones "
                "(OFFBOARD before the first setpoint does this)"
            )
        if self.phase != "lock-step" and heard and lock_step:
            again = " again" if self.phase == "fallback" else ""
            self.phase = "lock-step"
            return f"in lock-step with PX4{again}"
        return None


@dataclass
class _Session:
    """One life of PX4, from its connection to its end; `told` are the lines said once in it."""

    rhythm: Rhythm
    watch: StallWatch
    pacer: Pacer
    told: set[str] = field(default_factory=set)


class Px4HilBackend:
    """PX4 in software-in-the-loop flies the plant."""

    def __init__(
        self,
        config: SimConfig,
        port: Px4Port,
        say: Say,
        clock: Clock = time.monotonic,
        barrier: Barrier | None = None,
    ) -> None:
        self._backend = config.backend
        self._barrier = barrier or Barrier(None)
        self._port = port
        self._say = say
        self._clock = clock
        self._vehicle = Px4Vehicle(config)
        self._next_progress = 0.0
        self._session: _Session | None = None
        self._sessions = 0

    @property
    def plant(self) -> Plant:
        """The flying body."""
        return self._vehicle.plant

    @property
    def announcement(self) -> str:
        """Where PX4's simulator interface is expected, and how fast time goes."""
        factor = self._backend.real_time_factor
        pace = f"at {factor:g} times real time" if factor > 0.0 else "as fast as possible"
        return f"physics for PX4 (HIL interface), {pace}: tcpin:{self._port.address}"

    @property
    def autopilot(self) -> str:
        """Arming."""
        return "armed" if self._vehicle.armed else "disarmed"

    def run(self, duration_s: float | None, progress: Progress) -> None:
        """Fly whatever PX4 connects, and the next one when it has gone; see `Backend.run`.

        Called again, it goes on with the PX4 that is there.
        """
        end_us = None if duration_s is None else round(duration_s * 1e6)
        while end_us is None or self._vehicle.time_us < end_us:
            session = self._session or self._open(progress)
            self._session = session
            while self._port.connected and (end_us is None or self._vehicle.time_us < end_us):
                self._frame(session)
                self._show(progress)
            if not self._port.connected:
                self._session = None
                self._tell("PX4 closed its link; waiting for it to come back")

    # ----------------------------------------------------------------------------- one session

    def _open(self, progress: Progress) -> _Session:
        """Wait for PX4 to connect."""
        watch = self._watch("connection", CONNECT_REMEDY)
        while not self._port.accept(WAIT_S):
            self._check(watch)
            self._show(progress)
        if self._sessions:
            self._vehicle.restart()
        self._tell("PX4 is back, the vehicle is where it was" if self._sessions else "PX4 connected")
        self._sessions += 1
        rhythm = Rhythm(self._backend.px4_hil.outputs_timeout_s)
        watch = self._watch("motor output", OUTPUT_REMEDY)
        return _Session(rhythm, watch, rhythm.pacer(self._backend.real_time_factor))

    def _frame(self, session: _Session) -> None:
        """One sensor period."""
        vehicle, rhythm = self._vehicle, session.rhythm
        self._send(vehicle.advance(), session.watch)
        now = self._clock()
        due = now + session.pacer.wait(vehicle.time_us + SENSOR_PERIOD_US, now)
        heard = self._await_outputs(rhythm, due, session.watch)
        if not self._port.connected:
            return
        change = rhythm.after_frame(heard, vehicle.answered, vehicle.lock_step)
        if change is not None:
            self._tell(change)
            session.pacer = rhythm.pacer(self._backend.real_time_factor)
        self._tell_once(session.told)
        self._rest(due)
        self._barrier.wait(vehicle.time_us)

    def _send(self, frames: bytes, watch: StallWatch) -> None:
        """Send, and say so while PX4 does not read."""
        while frames := self._port.send(frames, WAIT_S):
            self._check(watch)

    def _await_outputs(self, rhythm: Rhythm, due: float, watch: StallWatch) -> bool:
        """Take in what PX4 sends until its outputs are there or the time is up; did they come nearer?"""
        vehicle, before, heard_at = self._vehicle, self._vehicle.heard_us, self._clock()
        while self._port.connected and not vehicle.answered:
            nearest, left = vehicle.heard_us, rhythm.deadline(heard_at, due) - self._clock()
            if left <= 0.0:
                break
            vehicle.receive(self._port.receive(min(left, WAIT_S)))
            if vehicle.heard_us > nearest:
                heard_at = self._clock()
            else:
                self._check(watch)
        if vehicle.heard_us == before:
            return False
        news = watch.heard(self._clock())
        if news is not None:
            self._say(news)
        return True

    def _rest(self, due: float) -> None:
        """Let the wall clock catch up, taking in what comes."""
        while self._port.connected and (left := due - self._clock()) > 0.0:
            self._vehicle.receive(self._port.receive(left))

    # ----------------------------------------------------------------------------- for people

    def _watch(self, what: str, remedy: str) -> StallWatch:
        return StallWatch(
            NAME,
            what,
            remedy,
            warning_s=self._backend.stall_warning_s,
            timeout_s=self._backend.stall_timeout_s,
            now_s=self._clock(),
        )

    def _check(self, watch: StallWatch) -> None:
        line = watch.check(self._clock(), self._vehicle.time_us)
        if line is not None:
            self._say(line)

    def _tell_once(self, told: set[str]) -> None:
        """Lines that are said once in a session."""
        stranger = self._port.turned_away
        for true, line in (
            (
                stranger != "",
                f"{stranger} wanted this port, too, and was turned away; "
                "end this PX4 first if another is to fly",
            ),
            (self._vehicle.lock_step is False, "this PX4 was built without lock-step: flying in real time"),
            (self._vehicle.bad_bytes > 0, "PX4 sent bytes that are no MAVLink frame; they are skipped"),
        ):
            if true and line not in told:
                told.add(line)
                self._tell(line)

    def _tell(self, text: str) -> None:
        self._say(f"{NAME}: {self._vehicle.time_us * 1e-6:.2f} s: {text}")

    def _show(self, progress: Progress) -> None:
        now = self._clock()
        if now >= self._next_progress:
            self._next_progress = now + PROGRESS_S
            progress()
