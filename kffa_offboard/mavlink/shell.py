"""The loop around the service: in real time, or in lock-step with a simulated vehicle.

Real time
    The clock is monotonic. The loop sleeps until something arrives or the service's next deadline. What it
    does is told to a `Watch`, which counts what is late and may have something to report.

Lock-step
    The clock is the vehicle's: a TIMESYNC request (tc1 = 0) of the target is a barrier, its ts1 the
    simulated time in ns. Messages wait until the barrier after them and are handled then, in order of
    arrival, all at the barrier's time; then the service does what is due, everything is sent, and
    last comes the answer (tc1 = ts1), upon which the vehicle moves on. No wall time enters, so two
    runs with one seed send the same bytes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.commands import heartbeat, is_timesync_request
from kffa_offboard.mavlink.component import Component, Message
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.transmission import Counters
from kffa_offboard.mavlink.transport import Clock, Datagram
from kffa_offboard.offboard.events import HangNoticed, OwnHeartbeat, ProcessReport, ReleaseRequested

LONGEST_SLEEP_S = 0.1
"""How late a stop request may be noticed."""

RELEASE_LIMIT_S = 3.0
"""How long the service may take to let go after a stop request; then it is told to give up."""

HANG_S = 1.0
"""A turn that comes so late finds others flying: PX4 waits no longer for setpoints (COM_OF_LOSS_T)."""

HELLO_PERIOD_S = 1.0


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended.

    `finished` is the service's own reason (None if it was stopped before it had one), `stopped` tells
    whether somebody asked it to stop, `refusal` what it asked to send that must not be sent.
    """

    counters: Counters
    finished: object | None
    stopped: bool
    refusal: str | None


def real_time_clock() -> Clock:
    """Microseconds that never go back, counted so that they start as UNIX time (for the log)."""
    offset_us = time.time_ns() // 1000 - time.monotonic_ns() // 1000
    return lambda: time.monotonic_ns() // 1000 + offset_us


class Watch(Protocol):
    """Is told what the loop in real time does. Times are microseconds of the loop's clock."""

    def step(self, arrived_us: int, done_us: int) -> None:
        """A sample of the attitude was answered."""

    def deadline(self, due_us: int, done_us: int) -> None:
        """The loop came to what was due."""

    def turned(self, now_us: int) -> Sequence[ProcessReport]:
        """Everything that had arrived or was due is done; returns what there is to report."""

    def ended(self) -> Sequence[ProcessReport]:
        """The loop is over; returns what is left to report."""


class Unwatched:
    """A `Watch` that does nothing."""

    def step(self, arrived_us: int, done_us: int) -> None:
        """See `Watch`."""

    def deadline(self, due_us: int, done_us: int) -> None:
        """See `Watch`."""

    def turned(self, now_us: int) -> Sequence[ProcessReport]:
        """See `Watch`."""
        return ()

    def ended(self) -> Sequence[ProcessReport]:
        """See `Watch`."""
        return ()


class RealTimeLoop:
    """One session's turns in real time; nothing in them waits.

    While `goes_on`: wait at most `wait_s` for the link, then `turn` with what came. `clock` must be the
    link's.
    """

    def __init__(
        self, session: Session, clock: Clock, stop: threading.Event, connect_timeout_s: float, watch: Watch
    ) -> None:
        self.session = session
        self._clock = clock
        self._stop = stop
        self._connect_timeout_s = connect_timeout_s
        self._watch = watch
        self._started_us = self._turned_us = clock()
        self._due_us: int | None = None
        self._watched_us: int | None = None
        self._let_go_by_us: int | None = None

    def goes_on(self) -> bool:
        """False when the service has finished, or has had its time to let go after `stop` was set.

        Raises UserError if no vehicle has answered in time.
        """
        session = self.session
        if session.done:
            return False
        if session.connected and self._let_go_by_us is None and not self._stop.is_set():
            return True
        now_us = self._clock()
        if self._stop.is_set() and self._let_go_by_us is None:
            self._let_go_by_us = now_us + round(RELEASE_LIMIT_S * 1e6) if session.connected else now_us
            session.request(now_us, ReleaseRequested("stop requested"))
            return self.goes_on()
        if self._let_go_by_us is not None and now_us >= self._let_go_by_us and session.give_up(now_us):
            return False
        if not session.connected and now_us - self._started_us >= self._connect_timeout_s * 1e6:
            raise no_vehicle(session, self._connect_timeout_s)
        return True

    def wait_s(self) -> float:
        """How long nothing is due."""
        self._due_us = self.session.next_deadline()
        if self._due_us is None:
            return LONGEST_SLEEP_S
        return min(max((self._due_us - self._clock()) / 1e6, 0.0), LONGEST_SLEEP_S)

    def turn(self, datagrams: Sequence[Datagram]) -> None:
        """Handle what arrived, do what is due, report."""
        session = self.session
        begun_us = datagrams[0].time_us if datagrams else self._clock()
        self._watch_deadline(self._due_us, begun_us)
        self._notice_hang(self._turned_us, begun_us)
        for datagram in datagrams:
            for message in session.read(datagram):
                if take_message(session, datagram.time_us, message):
                    self._watch.step(datagram.time_us - datagram.waited_us, self._clock())
            session.report_notices(datagram.time_us)
        if not session.done:
            now_us = self._clock()
            self._notice_hang(datagrams[-1].time_us if datagrams else begun_us, now_us)
            if datagrams:
                self._watch_deadline(session.next_deadline(), now_us)
            session.advance(now_us)
        self._turned_us = self._clock()
        for report in self._watch.turned(self._turned_us):
            session.report(self._turned_us, report)

    def result(self) -> RunResult:
        """How it ended, once `goes_on` is False."""
        session = self.session
        for report in self._watch.ended():
            session.report(self._clock(), report)
        return RunResult(session.counters, session.service.finished, self._stop.is_set(), session.refusal)

    def _notice_hang(self, since_us: int, now_us: int) -> None:
        """What fell due meanwhile must not be sent now: the service is told at the time when it began."""
        if now_us - since_us >= HANG_S * 1e6 and self.session.connected:
            self.session.request(since_us, HangNoticed((now_us - since_us) * 1e-6))

    def _watch_deadline(self, due_us: int | None, now_us: int) -> None:
        """What was due by the last turn was done then, so nothing can be later than since then."""
        if due_us is not None and due_us <= now_us and due_us != self._watched_us:
            self._watched_us = due_us
            self._watch.deadline(max(due_us, self._turned_us), now_us)


def run_real_time(
    session: Session,
    clock: Clock,
    stop: threading.Event,
    *,
    connect_timeout_s: float = 10.0,
    watch: Watch | None = None,
) -> RunResult:
    """Drive the service until it has finished, or has let go after `stop` was set (3 s at most).

    `clock` must be the link's. Raises UserError if no vehicle answers within `connect_timeout_s`, or if
    it is not supported.
    """
    loop = RealTimeLoop(session, clock, stop, connect_timeout_s, watch or Unwatched())
    while loop.goes_on():
        loop.turn(session.link.receive(loop.wait_s()))
    return loop.result()


def take_message(session: Session, time_us: int, message: Message) -> bool:
    """What a message does in real time: it is handled, and a TIMESYNC request answered with our own time.

    True if it was a sample of the attitude.
    """
    sample = session.handle(time_us, message)
    if message.msgname == "TIMESYNC":
        session.answer_timesync(time_us, message, time_us * 1000)
    return sample


def pass_barrier(session: Session, time_us: int, request: Message) -> None:
    """What a TIMESYNC request does in lock-step: everything due is done, then the vehicle may go on."""
    session.handle(time_us, request)
    # Not 0, which would make the answer look like another request.
    session.answer_timesync(time_us, request, max(request.ts1, 1))


def run_lock_step(
    session: Session,
    clock: Clock,
    stop: threading.Event,
    *,
    connect_timeout_s: float = 10.0,
    barrier_timeout_s: float = 5.0,
) -> RunResult:
    """Drive the service barrier by barrier until it has finished, or has let go after `stop` was set.

    `clock` is wall time, for noticing that the vehicle has stopped: it may take `barrier_timeout_s` to its
    next barrier. The service never sees it. Raises UserError as `run_real_time` does, and if barriers stop
    coming or their time goes back.
    """
    loop = _LockStep(session, stop)
    waiting_since_us = clock()
    hello_due_us = waiting_since_us
    while not loop.ended:
        now_us = clock()
        limit_s = barrier_timeout_s if session.connected else connect_timeout_s
        if now_us - waiting_since_us >= limit_s * 1e6:
            if session.connected:
                raise stopped_clock(session, limit_s)
            raise no_lock_step(session, limit_s) if loop.ignored else no_vehicle(session, limit_s)
        if stop.is_set() and loop.time_us is None:
            break
        if loop.time_us is None and now_us >= hello_due_us:
            loop.say_hello()
            hello_due_us = now_us + round(HELLO_PERIOD_S * 1e6)
        for datagram in session.link.receive(LONGEST_SLEEP_S):
            for message in session.read(datagram):
                if loop.take(message) and session.connected:
                    waiting_since_us = clock()
    return RunResult(session.counters, session.service.finished, stop.is_set(), session.refusal)


class _LockStep:
    """The messages since the last barrier, and the barrier itself."""

    def __init__(self, session: Session, stop: threading.Event) -> None:
        self._session = session
        self._stop = stop
        self._waiting: list[Message] = []
        self._let_go_by_us: int | None = None
        self.time_us: int | None = None
        self.ended = False

    @property
    def ignored(self) -> bool:
        """The vehicle sends heartbeats and has never asked for an answer: its time does not wait for us."""
        return self.time_us is None and any(
            message.msgname == "HEARTBEAT" and self._session.route.from_target(message)
            for message in self._waiting
        )

    def say_hello(self) -> None:
        """Let a vehicle that waits to be addressed know where we are.

        How often depends on wall time, so these frames stand outside the conversation: they take no
        sequence number from it and are not recorded.
        """
        frame = Component(self._session.route).pack(heartbeat(OwnHeartbeat("standby")))
        self._session.link.send(frame)

    def take(self, message: Message) -> bool:
        """Keep a message for the barrier, or pass the barrier (True)."""
        if self.ended:
            return False
        if not (is_timesync_request(message) and self._session.route.from_target(message)):
            self._waiting.append(message)
            return False
        self._pass(message)
        return True

    def _pass(self, request: Message) -> None:
        session, time_us = self._session, request.ts1 // 1000
        if self.time_us is not None and time_us < self.time_us:
            raise UserError(
                f"lock-step: the vehicle's time went back from {self.time_us / 1e6:.3f} s to "
                f"{time_us / 1e6:.3f} s; it was restarted, so restart the daemon too"
            )
        self.time_us = time_us
        session.report_notices(time_us)
        waiting, self._waiting = self._waiting, []
        for message in waiting:
            session.handle(time_us, message)
        if self._stop.is_set() and self._let_go_by_us is None:
            self._let_go_by_us = time_us + round(RELEASE_LIMIT_S * 1e6)
            session.request(time_us, ReleaseRequested("stop requested"))
        pass_barrier(session, time_us, request)
        overdue = self._let_go_by_us is not None and time_us >= self._let_go_by_us
        self.ended = session.done or (overdue and session.give_up(time_us))


def no_vehicle(session: Session, timeout_s: float) -> UserError:
    """Say in one line that nobody answered, and what was heard instead."""
    route = session.route
    hint = "is it running, and does it send there?"
    if (route.target_system, route.target_component) in session.heard:
        hint = f"system {route.target_system} sends, but no HEARTBEAT; does its stream include it?"
    elif session.heard:
        others = ", ".join(f"{system}/{component}" for system, component in sorted(session.heard))
        hint = (
            f"heard only {others} (system/component), not {route.target_system}/{route.target_component}; "
            "is link.target_system right?"
        )
    elif session.bytes_received:
        hint = (
            f"{session.bytes_received} bytes arrived, but they are not MAVLink; "
            "is the port (serial: the baud rate) right?"
        )
    elif session.link.trouble:
        hint = f"{hint} ({session.link.trouble})"
    return UserError(f"no vehicle answered on {session.link.name} for {timeout_s:g} s; {hint}")


def no_lock_step(session: Session, timeout_s: float) -> UserError:
    """Say in one line that there is a vehicle, and that its time does not wait for us."""
    return UserError(
        f"lock-step: the vehicle on {session.link.name} sends HEARTBEAT and no TIMESYNC request in "
        f"{timeout_s:g} s, so it is not in lock-step; start sim-vehicle with --lockstep, or leave it out here"
    )


def stopped_clock(session: Session, timeout_s: float) -> UserError:
    """Say in one line that the lock-step vehicle no longer asks for our answer."""
    return UserError(
        f"lock-step: no TIMESYNC request on {session.link.name} for {timeout_s:g} s; "
        "is the simulated vehicle still running, and in lock-step? "
        "(telemetry.barrier_timeout_s is how long it may take)"
    )
