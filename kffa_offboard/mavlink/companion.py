"""The daemon as a MAVLink component: parameters, commands, signals, clocks and pings, for whoever asks.

Sans-I/O like the service: messages in, replies out. `Session` tells the service the events and sends the
replies.
"""

from __future__ import annotations

from typing import ClassVar

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.clock import REQUEST_PERIOD_US, ClockEstimate, take_answer, timesync_request
from kffa_offboard.mavlink.command_server import CommandServer
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.parameter_server import ParameterServer, Reply
from kffa_offboard.mavlink.senders import Sender, is_allowed
from kffa_offboard.mavlink.setpoints import SETPOINTS, SetpointRefused, read_setpoint
from kffa_offboard.mavlink.signal_streams import SignalStreams, ToArray
from kffa_offboard.mavlink.timing_reports import TimingReports
from kffa_offboard.offboard.events import (
    Announce,
    Event,
    Output,
    OwnHeartbeat,
    ProcessReport,
    RequestRefused,
    Severity,
    Signals,
    Trouble,
)
from kffa_offboard.offboard.tuning import Tuning

_PARAMETER_REQUESTS = ("PARAM_REQUEST_LIST", "PARAM_REQUEST_READ", "PARAM_SET")

MOST_REASONS = 20
"""So many different reasons for refusing setpoints are said in one run."""


class Companion:
    """What component 191 says and does beside flying.

    Parameters
    ----------
    route
        Who we are.
    tuning
        The parameters; None for none.
    allowed
        Who may command, set parameters and send setpoints; None for everybody. Reading is free.
    signals_hz, to_array, vector
        See `SignalStreams`.

    """

    MESSAGES: ClassVar = frozenset(
        ("COMMAND_LONG", "COMMAND_INT", "TIMESYNC", "PING", *SETPOINTS, *_PARAMETER_REQUESTS)
    )
    """What `receive` looks at."""

    def __init__(
        self,
        route: Route,
        *,
        tuning: Tuning | None = None,
        allowed: tuple[Sender, ...] | None = None,
        signals_hz: float = 0.0,
        to_array: ToArray | None = None,
        vector: int | None = None,
    ) -> None:
        self._route = route
        self._allowed = allowed
        self._parameters = ParameterServer(tuning)
        self._streams = SignalStreams(signals_hz, to_array, vector)
        self._commands = CommandServer(route, self._parameters, self._streams)
        self._clock = ClockEstimate()
        self._timing = TimingReports()
        self._request_us: int | None = None
        self._result: int | None = None
        self._replies: list[Reply] = []
        self._said: set[str] = set()

    def compare_clocks(self, time_us: int) -> None:
        """Ask the autopilot for its time, from now on. Not in lock-step, where TIMESYNC is the barrier."""
        self._request_us = time_us

    def next_deadline(self) -> int | None:
        """When `advance` must be called next; None if nothing is due by itself."""
        asking, listing = self._request_us, self._parameters.next_deadline()
        return listing if asking is None or (listing is not None and listing < asking) else asking

    def advance(self, time_us: int) -> None:
        """Do what is due at `time_us`."""
        if self._request_us is not None and time_us >= self._request_us:
            self._replies.append(timesync_request(time_us))
            self._request_us = time_us + REQUEST_PERIOD_US
        self._replies += self._parameters.advance(time_us)

    def receive(self, time_us: int, message: Message) -> list[Event]:
        """Take one of `MESSAGES` from anybody; return what the service is to be told."""
        kind = message.msgname
        if kind in ("COMMAND_LONG", "COMMAND_INT"):
            return self._command(time_us, message)
        if kind == "TIMESYNC":
            return self._timesync(time_us, message)
        if kind in SETPOINTS:
            return self._setpoint(message)
        if kind == "PING":
            self._ping(message)
        elif kind in _PARAMETER_REQUESTS:
            return self._parameter(time_us, kind, message)
        return []

    def note(self, output: Output) -> None:
        """Take note of what the service says."""
        if isinstance(output, Signals):
            self._replies += self._streams.take(output)
        elif isinstance(output, (OwnHeartbeat, RequestRefused)):
            if isinstance(output, RequestRefused):
                self._parameters.refuse(output.reason)
            refused = self._commands.note(output)
            if refused is not None:
                self._replies.append(refused)

    def report(self, time_us: int, report: ProcessReport) -> None:
        """Publish what the daemon's own process reports."""
        if isinstance(report, Trouble):
            self._replies.append(Announce(Severity.WARNING, report.text))
        else:
            self._replies += self._timing.take(time_us, report)

    def take(self) -> list[Reply]:
        """Replies to be sent now. Call it when the service was told everything that `receive` returned."""
        self._replies += self._parameters.conclude()
        if self._result is None and not self._replies:
            return []
        if self._result is not None:
            done = self._commands.conclude(self._result)
            self._replies += [done] if done is not None else []
            self._result = None
        replies, self._replies = self._replies, []
        return replies

    def _command(self, time_us: int, message: Message) -> list[Event]:
        allowed = is_allowed(self._allowed, message)
        answer = self._commands.handle(time_us, message, allowed=allowed)
        if answer is None:
            return []
        if not allowed and answer.result == mavlink.MAV_RESULT_DENIED:
            self._say_once(f"commands of {_sender(message)} not allowed")
        self._result = answer.result
        self._replies += answer.replies
        return list(answer.events)

    def _timesync(self, time_us: int, message: Message) -> list[Event]:
        if self._request_us is None or not self._route.from_target(message):
            return []
        before, self._clock = self._clock, take_answer(self._clock, time_us, message)
        measured = self._clock.measured
        return [measured] if measured is not None and self._clock is not before else []

    def _setpoint(self, message: Message) -> list[Event]:
        """Setpoints come many times a second: each reason for refusing one is said once."""
        try:
            setpoint = read_setpoint(self._route, message)
        except SetpointRefused as refused:
            self._say_once(str(refused))
            return []
        if setpoint is not None and not is_allowed(self._allowed, message):
            self._say_once(f"setpoints of {_sender(message)} not allowed")
            return []
        return [] if setpoint is None else [setpoint]

    def _say_once(self, reason: str) -> None:
        if reason not in self._said and len(self._said) < MOST_REASONS:
            self._said.add(reason)
            self._replies.append(Announce(Severity.WARNING, reason))

    def _ping(self, message: Message) -> None:
        """Answer a request, which has no target; answers have one."""
        if (message.target_system, message.target_component) == (0, 0):
            sender = message.get_srcSystem(), message.get_srcComponent()
            self._replies.append(mavlink.MAVLink_ping_message(message.time_usec, message.seq, *sender))

    def _parameter(self, time_us: int, kind: str, message: Message) -> list[Event]:
        """Requests to us; those for a list may be to all components of our system."""
        everybody = message.target_component == 0 and kind == "PARAM_REQUEST_LIST"
        for_us = everybody or message.target_component == self._route.own_component
        if message.target_system != self._route.own_system or not for_us:
            return []
        if kind == "PARAM_REQUEST_LIST":
            self._parameters.request_list(time_us)
            self.advance(time_us)
        elif kind == "PARAM_REQUEST_READ":
            self._replies += self._parameters.read(message)
        elif not is_allowed(self._allowed, message):
            self._say_once(f"parameters of {_sender(message)} not allowed")
            self._replies += self._parameters.unchanged(message)
        else:
            replies, events = self._parameters.set(time_us, message)
            if not (replies or events):
                self._say_once("PARAM_SET: more than 20 a second are not answered; send them again")
            self._replies += replies
            return list(events)
        return []


def _sender(message: Message) -> str:
    return f"{message.get_srcSystem()}/{message.get_srcComponent()}"
