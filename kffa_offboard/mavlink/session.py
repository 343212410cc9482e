"""One conversation with a vehicle: what arrives goes to the service, what it answers goes out.

Nothing here waits; `shell.py` decides when. Everything is recorded in the order in which the service
saw it, with the time that the service was told, and whatever falls due is done at its own nominal
time, not when somebody got round to it: so the log replays to the same commands, byte for byte.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import TypeAlias

from kffa_offboard.mavlink import parameter_keeper
from kffa_offboard.mavlink.autopilot import GuidedMode
from kffa_offboard.mavlink.commands import EncodingError, is_timesync_request, timesync_answer
from kffa_offboard.mavlink.companion import Companion
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.parameter_file import ChangedParameter
from kffa_offboard.mavlink.parameter_keeper import ParameterKeeper
from kffa_offboard.mavlink.reception import Reception
from kffa_offboard.mavlink.rivals import RivalWatch
from kffa_offboard.mavlink.session_protocols import OffboardService, ProcessRequest, Recorder
from kffa_offboard.mavlink.transmission import Transmission
from kffa_offboard.mavlink.transport import Datagram, Link
from kffa_offboard.mavlink.vehicle import Vehicle, decoded_kinds
from kffa_offboard.offboard.events import (
    Announce,
    AttitudeTarget,
    Event,
    GiveUpRequested,
    HeartbeatReceived,
    Output,
    ProcessReport,
    ReleaseRequested,
    Signals,
)

LOG = logging.getLogger(__name__)

Observer: TypeAlias = Callable[[int, Event | Output | ProcessReport], None]
"""Is told every event before and every output after the service, with its time [us]; for status lines."""

_WATCHED, _ANSWERED = RivalWatch.MESSAGES, Companion.MESSAGES
_OTHER_KINDS = _WATCHED | _ANSWERED | frozenset(parameter_keeper.MESSAGES)
"""Messages that somebody else than the vehicle's adapter looks at."""

KINDS = _OTHER_KINDS | decoded_kinds()
"""Messages that a session looks into, whatever firmware the vehicle has. Of others it only matters that
something has come, once the service has finished."""


class Session:
    """Joins link, translation, service and log.

    Attributes
    ----------
    counters
        What has gone by so far.

    Parameters
    ----------
    service, link
        As the protocols say.
    route
        Who we are and who the vehicle is.
    recorder, observer
        Where frames and signals are recorded; who is told of events and outputs. Optional.
    on_connected
        Events handed to the service right after the vehicle's first heartbeat.
    parameters
        Reads and judges the vehicle's parameters; without it nothing is asked and nothing refused.
    guided_mode
        The mode of ArduPilot in which to fly.
    companion
        Who answers those that talk to us; left out, one without parameters and signals.
    compare_clocks
        Ask the autopilot for its time by TIMESYNC, from its first heartbeat on. Never in lock-step.

    """

    def __init__(
        self,
        service: OffboardService,
        link: Link,
        route: Route,
        *,
        recorder: Recorder | None = None,
        observer: Observer | None = None,
        on_connected: Sequence[Event] = (),
        parameters: ParameterKeeper | None = None,
        guided_mode: GuidedMode = "guided",
        companion: Companion | None = None,
        compare_clocks: bool = False,
    ) -> None:
        self.service = service
        self.link = link
        self.route = route
        self.connected = False
        self.refusal: str | None = None
        self._given_up = False
        self._time_us: int | None = None
        self._vehicle = Vehicle(route, guided_mode)
        self._recorder = recorder
        self._observer = observer
        self._on_connected = tuple(on_connected)
        self._parameters = parameters
        self._companion = companion or Companion(route)
        self._compare_clocks = compare_clocks
        self._rivals = RivalWatch(route)
        self._reception = Reception(link, route, self._rivals)
        self._transmission = Transmission(link, route, self._rivals, recorder)
        self.counters = self._transmission.counters
        self._due_us: int | None = None
        self._due_known = False  # what is done here may change what is due
        self._others_us: int | None = None
        self._others_known = False  # the same, but for the service
        self._may_reply = False  # since the last reply something was done that may need one

    def read(self, datagram: Datagram) -> list[Message]:
        """See `Reception.read`."""
        return self._reception.read(datagram)

    def report_notices(self, time_us: int) -> None:
        """Tell the service what was noticed about the link itself, and record it."""
        for noticed in self._reception.take_notices():
            self.request(time_us, noticed)

    def handle(self, time_us: int, message: Message) -> bool:
        """Do what is due before `time_us`, then record one message and tell the service what it says.

        True if it was a sample of the attitude, which the service has answered.
        """
        self.advance(time_us)
        if self._recorder is not None:
            self._recorder.write(time_us, bytes(message.get_msgbuf()))
        kind, from_target = message.msgname, self.route.from_target(message)
        if kind not in self._vehicle.kinds and kind not in _OTHER_KINDS and self.service.finished is None:
            self.counters.telemetry_received += from_target
            return False  # it says nothing to anybody here
        noticed = self._rivals.watch(time_us, message) if kind in _WATCHED else None
        if noticed is not None:
            self.tell(time_us, noticed)
        if from_target:
            self.counters.telemetry_received += 1
            self._handle_target(time_us, kind, message)
        if kind in _ANSWERED:
            for event in self._companion.receive(time_us, message):
                self.tell(time_us, event)
            if kind != "TIMESYNC":  # to which there is no reply
                self._told_others()
                self._may_reply = True
        if self._may_reply:
            self._reply(time_us)
        return from_target and kind == "ATTITUDE"

    def _handle_target(self, time_us: int, kind: str, message: Message) -> None:
        """What a message of the vehicle says to the service, and to the parameter keeper."""
        for event in self._vehicle.decode_own(message):
            if isinstance(event, HeartbeatReceived):
                self._handle_heartbeat(time_us, event)
            else:
                self.tell(time_us, event)
        if kind == "COMMAND_ACK":
            for request in self._vehicle.requests():
                self._transmission.send(time_us, request)
        if self._parameters is not None and kind in parameter_keeper.MESSAGES:
            self._told_others()
            self._parameters.receive(time_us, message)
            self._follow_parameters(time_us)
        elif self.service.finished is not None:
            self._follow_parameters(time_us)

    def _handle_heartbeat(self, time_us: int, event: HeartbeatReceived) -> None:
        """The first one is what others wait for."""
        self._told_others()
        if self._parameters is not None:
            self._parameters.heartbeat(time_us, event)
            self._follow_parameters(time_us)
        self.tell(time_us, event)
        if not self.connected:
            self.connected = True
            self._told_others()
            if self._compare_clocks:
                self._companion.compare_clocks(time_us)
            for waiting in self._on_connected:
                self.tell(time_us, waiting)

    def tell(self, time_us: int, event: Event) -> None:
        """Do what is due before `time_us`, then hand an event to the service and send what it answers."""
        due_us = self._due_us
        if time_us != self._time_us or not self._due_known or (due_us is not None and due_us <= time_us):
            self.advance(time_us)
        self._due_known = False
        self._dispatch(time_us, self.service.handle(time_us, event), event)

    def advance(self, time_us: int) -> None:
        """Do everything that is due up to `time_us`, each at its own time, and send it."""
        if self._time_us is None:
            if self._recorder is not None:
                self._recorder.write_begin(time_us)
            self._due_known = False
            self._dispatch(time_us, self.service.advance(time_us))
        self._time_us = time_us
        while (due_us := self.next_deadline()) is not None and due_us <= time_us:
            self._due_known = False
            others_due = self._others_us is not None and self._others_us <= due_us
            if self.service.finished is None:
                self._dispatch(due_us, self.service.advance(due_us))
            if others_due:
                self._advance_others(due_us)
            self._follow_parameters(due_us)
            self._reply(due_us)

    def _advance_others(self, time_us: int) -> None:
        """What is due of parameters and companion."""
        self._told_others()
        if self._parameters is not None:
            self._parameters.advance(time_us)
            self._follow_parameters(time_us)
        self._companion.advance(time_us)

    def _told_others(self) -> None:
        """Parameters or companion learn something: what is due of them may be another."""
        self._due_known = self._others_known = False

    def next_deadline(self) -> int | None:
        """When `advance` must be called next, us; None if nothing is due without an event."""
        if not self._due_known:
            self._due_us, self._due_known = self._first_due(), True
        return self._due_us

    def _first_due(self) -> int | None:
        """Of the service, the parameters and the companion."""
        if not self._others_known:
            keeper = None if self._parameters is None else self._parameters.due_us()
            self._others_us = _earlier(keeper, self._companion.next_deadline())
            self._others_known = True
        others_us = self._others_us
        if self.service.finished is not None:
            return others_us
        due_us = self.service.next_deadline()
        return due_us if others_us is None else _earlier(due_us, others_us)

    @property
    def done(self) -> bool:
        """The service has finished, and the vehicle's parameters are what they were."""
        return self.service.finished is not None and (self._parameters is None or self._parameters.done)

    @property
    def changed_parameters(self) -> tuple[ChangedParameter, ...]:
        """What is changed on the vehicle and not (yet) put back."""
        return () if self._parameters is None else self._parameters.changes

    def request(self, time_us: int, request: ProcessRequest) -> None:
        """Tell the service what the daemon's own process asks for or noticed, and record it."""
        self.advance(time_us)
        if self._recorder is not None:
            self._recorder.write_request(time_us, request)
        self.tell(time_us, request)
        if isinstance(request, GiveUpRequested) and self._parameters is not None:
            self._told_others()
            self._parameters.finish(time_us)
            self._follow_parameters(time_us)

    def report(self, time_us: int, report: ProcessReport) -> None:
        """Record and publish what the daemon's own process reports; the service is not told."""
        self.advance(time_us)
        if self._recorder is not None:
            self._recorder.write_report(time_us, report)
        if self._observer is not None:
            self._observer(time_us, report)
        self._told_others()
        self._companion.report(time_us, report)
        self._reply(time_us)

    def give_up(self, time_us: int) -> bool:
        """Wait for the service no longer, whatever it does; True when the parameters are put back."""
        if not (self.done or self._given_up):
            self._given_up = True
            self.request(time_us, GiveUpRequested())
        return self._parameters is None or self._parameters.done

    def fall_silent(self) -> None:
        """The process ends, for whatever reason: a service that still has control says its last words."""
        if self._time_us is not None and self.service.finished is None:
            self._dispatch(self._time_us, self.service.last_words())

    def close(self, reason: str) -> None:
        """Record that the run is over."""
        if self._recorder is not None and self._time_us is not None:
            self._recorder.write_end(self._time_us, reason, self.counters.frames_dropped)

    def _follow_parameters(self, time_us: int) -> None:
        """Do what the parameter keeper wants done."""
        if self._parameters is None:
            return
        if self.service.finished is not None:
            self._told_others()
            self._parameters.finish(time_us)
        todo = self._parameters.take()
        if todo is None:
            return
        for message in todo.messages:
            self._transmission.send(time_us, message)
        self._dispatch(time_us, todo.announcements)
        for event in todo.events:
            self.tell(time_us, event)

    def _reply(self, time_us: int) -> None:
        """Send what the companion has to say, in its order."""
        self._may_reply = False
        replies = self._companion.take()
        if not replies:
            return
        messages: list[Message] = []
        for reply in replies:
            if isinstance(reply, Announce):
                self._transmission.send_together(time_us, messages)
                messages = []
                self._dispatch(time_us, [reply])
            else:
                messages.append(reply)
        self._transmission.send_together(time_us, messages)

    def answer_timesync(self, time_us: int, request: Message, own_time_ns: int) -> None:
        """Answer a TIMESYNC request of the target; others are not ours to answer."""
        if is_timesync_request(request) and self.route.from_target(request):
            self._transmission.send(time_us, timesync_answer(request, own_time_ns))

    @property
    def damaged_bytes(self) -> int:
        """Bytes received that were no part of a valid frame."""
        return self._reception.damaged_bytes

    @property
    def bytes_received(self) -> int:
        """All that came, whatever it was."""
        return self._reception.bytes_received

    @property
    def heard(self) -> set[tuple[int, int]]:
        """System and component of everybody who has said something."""
        return self._reception.heard

    def _dispatch(self, time_us: int, outputs: Sequence[Output], event: Event | None = None) -> None:
        """Send what the service answers to `event`. A setpoint does not wait for those who look on."""
        refusal: str | None = None
        for output in outputs:
            if isinstance(output, Signals):
                if self._recorder is not None:
                    self._recorder.write_signals(output)
            else:
                try:
                    messages = self._vehicle.encode(output, time_us)
                except EncodingError as error:
                    refusal = str(error)
                    continue
                for message in messages:
                    sent = self._transmission.send(time_us, message)
                    self.counters.commands_sent += sent and isinstance(output, AttitudeTarget)
            self._companion.note(output)
            self._may_reply = True
        if self._observer is not None:
            for item in outputs if event is None else (event, *outputs):
                self._observer(time_us, item)
        if refusal is not None and self.refusal is None:
            # A service that asks for something unsendable must not keep control: once, it has to let go.
            self.refusal = refusal
            LOG.error("refused to send: %s", refusal)
            self.tell(time_us, ReleaseRequested(refusal))


def _earlier(one: int | None, other: int | None) -> int | None:
    """Of two deadlines; None is none."""
    return one if other is None or (one is not None and one <= other) else other
