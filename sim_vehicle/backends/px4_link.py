"""The shell around `px4_hil`: the TCP port PX4 connects to, the clock, and what is said to people.

Before PX4's first motor outputs, sensors go out at real-time pace: PX4 boots by that time. From then on each
sensor frame waits for its motor outputs (lock-step). If they stay away, time goes on at real-time pace with
the last ones until they are back: PX4 whose OFFBOARD mode was chosen before any setpoint came sends none, and
would never leave that state if its time stood still.
"""

from __future__ import annotations

import errno
import select
import socket
import time
from collections.abc import Callable
from typing import TypeAlias

from sim_vehicle.backends.px4_hil import SENSOR_PERIOD_US, Px4Hil
from sim_vehicle.errors import SimulatorError

Say: TypeAlias = Callable[[str], None]
Clock: TypeAlias = Callable[[], float]

PATIENCE_S = 1.0
"""Wall time without motor outputs after which simulated time goes on without them."""

REMINDER_S = 10.0
"""A state that PX4 has to end is reported this often."""

SEND_BUFFER = 4096
"""Bytes of sensor frames on their way at most on our side: a stopped PX4 is noticed soon."""

LARGEST_LAG_S = 0.1
"""If the machine is this far behind, simulated time is let go rather than caught up in a burst."""


class Rhythm:
    """When to stop waiting for motor outputs; all times are the wall's [s].

    Attributes
    ----------
    locked : each sensor frame waits for its motor outputs
    """

    def __init__(self, patience_s: float = PATIENCE_S) -> None:
        self.locked = False
        self._patience_s = patience_s
        self._silent_since: float | None = None
        self._reminded = 0.0

    def deadline(self, sent: float, heard: float, paced: float) -> float:
        """Until when to wait for the outputs to a frame sent at `sent`, the latest heard at `heard`.

        `paced` is when the next frame is due in real time.
        """
        return max(sent, heard) + self._patience_s if self.locked else paced

    def note(self, heard: bool, answered: bool, lock_step: bool, now: float) -> str | None:
        """What to tell people after a frame: whether any outputs, and those to this very frame, have come."""
        if self.locked and not answered:
            self.locked, self._silent_since, self._reminded = False, now - self._patience_s, now
            return (
                f"no motor outputs for {self._patience_s:g} s; going on in real time with the last ones "
                "(OFFBOARD before the first setpoint does this: send setpoints or choose another mode)"
            )
        if not self.locked and heard and lock_step:
            self.locked = True
            if self._silent_since is None:
                return "motor outputs arrive: lock-step"
            silence, self._silent_since = now - self._silent_since, None
            return f"motor outputs are back after {silence:.1f} s: lock-step"
        if self._silent_since is not None and now - self._reminded >= REMINDER_S:
            self._reminded = now
            return f"still no motor outputs, for {now - self._silent_since:.0f} s"
        return None


class Px4Port:
    """The port where PX4 connects, and its connection. A newer connection replaces the present one."""

    def __init__(self, host: str, port: int) -> None:
        self._stream: socket.socket | None = None
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            self._listener.bind((host, port))
            self._listener.listen()
            self._listener.setblocking(False)
        except OSError as problem:
            self._listener.close()
            used = problem.errno == errno.EADDRINUSE
            reason = (
                "is in use; stop the program that has it or choose another port" if used else str(problem)
            )
            raise SimulatorError(f"backend px4-hil: port {port} of {host} {reason}") from problem

    def __enter__(self) -> Px4Port:
        return self

    def __exit__(self, *_: object) -> None:
        self.drop()
        self._listener.close()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port, as they really are (matters for port 0)."""
        host, port = self._listener.getsockname()
        return str(host), int(port)

    @property
    def connected(self) -> bool:
        """PX4 is there."""
        return self._stream is not None

    def accept(self, timeout_s: float) -> bool:
        """Wait for a connection; is there a new one?"""
        ready, _, _ = select.select([self._listener], [], [], timeout_s)
        if not ready:
            return False
        self.drop()
        self._stream, _ = self._listener.accept()
        self._stream.setblocking(False)
        self._stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return True

    def drop(self) -> None:
        """Close the connection."""
        if self._stream is not None:
            self._stream.close()
            self._stream = None

    def receive(self, timeout_s: float) -> bytes:
        """What PX4 sent within the time; drops the connection if PX4 has closed it."""
        if self._stream is None:
            return b""
        ready, _, _ = select.select([self._stream, self._listener], [], [], max(0.0, timeout_s))
        if self._listener in ready:
            self.drop()  # PX4 connects once in its life: this is its successor
            return b""
        if not ready:
            return b""
        try:
            data = self._stream.recv(65536)
        except OSError:
            data = b""
        if not data:
            self.drop()
        return data

    def send(self, data: bytes, timeout_s: float) -> bytes:
        """Send; what could not be sent within the time. Drops the connection if PX4 has closed it."""
        while data and self._stream is not None:
            _, ready, _ = select.select([], [self._stream], [], timeout_s)
            if not ready:
                return data
            try:
                data = data[self._stream.send(data) :]
            except BlockingIOError:
                continue
            except OSError:
                self.drop()
        return b""


class _Pace:
    """When simulated time is due on the wall clock; a `speed` of 0 is as fast as possible."""

    def __init__(self, speed: float, clock: Clock) -> None:
        self._speed = speed
        self._clock = clock
        self._due = clock()

    def next(self, locked: bool) -> float:
        """Wall time at which the next sensor frame is due; free-running never goes faster than real time."""
        speed = self._speed
        if speed == 0.0:
            if locked:
                self._due = self._clock()
                return self._due
            speed = 1.0
        now = self._clock()
        self._due += SENSOR_PERIOD_US * 1e-6 / speed
        if now - self._due > LARGEST_LAG_S:
            self._due = now
        return self._due


def run(
    hil: Px4Hil,
    port: Px4Port,
    speed: float,
    duration_s: float | None,
    say: Say,
    progress: Callable[[], None],
    clock: Clock = time.monotonic,
) -> None:
    """Fly until `duration_s` of simulated time have passed, or for ever if None; waits for PX4 if it is away.

    `speed` is simulated over real time, 0 for as fast as PX4 answers. `say` gets lines for people.
    """
    end_us = None if duration_s is None else round(duration_s * 1e6)
    sessions = 0
    while end_us is None or hil.time_us < end_us:
        host, number = port.address
        say(f"waiting for PX4 to connect to {host} port {number}")
        while not port.accept(1.0):
            progress()
        if sessions:
            hil.restart()
        sessions += 1
        say("PX4 connected" if sessions == 1 else "PX4 is back: the vehicle stands at its start again")
        _Session(hil, port, speed, say, progress, clock).fly(end_us)
        if not port.connected:
            say(f"PX4 closed its link at {hil.time_us * 1e-6:.2f} s")


class _Session:
    """One life of PX4, from its connection to its end."""

    def __init__(
        self, hil: Px4Hil, port: Px4Port, speed: float, say: Say, progress: Callable[[], None], clock: Clock
    ) -> None:
        self._hil = hil
        self._port = port
        self._say = say
        self._progress = progress
        self._clock = clock
        self._rhythm = Rhythm()
        self._pace = _Pace(speed, clock)
        self._bad_bytes = 0
        self._told_free = False

    def fly(self, end_us: int | None) -> None:
        hil, port, rhythm = self._hil, self._port, self._rhythm
        while port.connected and (end_us is None or hil.time_us < end_us):
            self._send(hil.advance())
            due = self._pace.next(rhythm.locked)
            heard = self._await_outputs(due)
            if not port.connected:
                return
            told = rhythm.note(heard, hil.answered, bool(hil.lock_step), self._clock())
            self._report(told)
            self._rest(due)
            self._progress()

    def _send(self, frames: bytes) -> None:
        """Send, and wait, not silently, while PX4 does not read."""
        began = self._clock()
        limit = PATIENCE_S
        while frames := self._port.send(frames, limit):
            self._tell(
                f"PX4 has not read its sensors for {self._clock() - began:.0f} s; is it stopped? Waiting"
            )
            limit = REMINDER_S

    def _await_outputs(self, due: float) -> bool:
        """Take in what PX4 sends until its outputs are there or the time is up; did any come?"""
        hil, sent = self._hil, self._clock()
        before, last = hil.heard, sent
        while self._port.connected and not hil.answered:
            left = self._rhythm.deadline(sent, last, due) - self._clock()
            if left <= 0.0:
                break
            count = hil.heard
            hil.receive(self._port.receive(left))
            last = self._clock() if hil.heard > count else last
        return hil.heard > before

    def _rest(self, due: float) -> None:
        """Let the wall clock catch up, taking in what comes."""
        while self._port.connected and (left := due - self._clock()) > 0.0:
            self._hil.receive(self._port.receive(left))

    def _report(self, told: str | None) -> None:
        if told is not None:
            self._tell(told)
        if self._hil.lock_step is False and not self._told_free:
            self._told_free = True
            self._tell("this PX4 was built without lock-step: flying in real time")
        if self._hil.bad_bytes > self._bad_bytes:
            first = self._bad_bytes == 0
            self._bad_bytes = self._hil.bad_bytes
            if first:
                self._tell(
                    f"{self._bad_bytes} bytes from PX4 were no MAVLink frame; skipped, as any more will be"
                )

    def _tell(self, text: str) -> None:
        self._say(f"{self._hil.time_us * 1e-6:.2f} s: {text}")
