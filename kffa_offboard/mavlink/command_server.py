"""Commands to the daemon: COMMAND_LONG and COMMAND_INT addressed to it, each answered by a COMMAND_ACK.

Only exactly our system and component are addressed: a command to everybody is not one to take control.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard import __version__
from kffa_offboard.mavlink.commands import heartbeat
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.parameter_server import ParameterServer, Reply
from kffa_offboard.mavlink.signal_streams import SignalStreams
from kffa_offboard.offboard.events import (
    Announce,
    EngageRequested,
    Event,
    GripperRequested,
    Output,
    OwnHeartbeat,
    ReleaseRequested,
    RequestRefused,
    Severity,
)
from kffa_offboard.offboard.tuning import TuningProblem

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED
REJECTED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
FAILED = mavlink.MAV_RESULT_FAILED

READ, WRITE, RESET = 0.0, 1.0, 2.0
"""Parameter 1 of MAV_CMD_PREFLIGHT_STORAGE (PREFLIGHT_STORAGE_PARAMETER_ACTION)."""

REPEAT_WINDOW_US = 5_000_000
"""A repetition (confirmation > 0) is answered again, not done again, so long after the one before it."""

DUPLICATE_WINDOW_US = 1_000_000
"""The same for a frame that comes twice, with one sequence number: routers have more than one way."""

REMEMBERED = 64
"""Commands whose answers are remembered, of all senders."""

QUESTIONS = (mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_CMD_GET_MESSAGE_INTERVAL)
"""Commands that change nothing, which everybody may send."""

_GRIPPER_ACTIONS: dict[float, GripperRequested] = {
    float(mavlink.GRIPPER_ACTION_RELEASE): GripperRequested("release"),
    float(mavlink.GRIPPER_ACTION_GRAB): GripperRequested("grab"),
}
_SWITCH: dict[float, Event] = {
    1.0: EngageRequested(),
    0.0: ReleaseRequested("commanded", stay=True),
}


@dataclass(frozen=True, slots=True)
class Request:
    """A command as either message carries it, and who sent it.

    `confirmation` counts repetitions, `sequence` the frames of the sender.
    """

    command: int
    parameters: tuple[float, ...]
    system: int
    component: int
    confirmation: int = 0
    sequence: int = 0


@dataclass(frozen=True, slots=True)
class Answer:
    """Result, what else goes out, and what the service is asked; it may still refuse."""

    result: int
    replies: list[Reply] = field(default_factory=list)
    events: tuple[Event, ...] = ()


def read_request(message: Message) -> Request:
    """COMMAND_LONG or COMMAND_INT as a `Request`."""
    long = message.get_type() == "COMMAND_LONG"
    last = (message.param5, message.param6, message.param7) if long else (message.x, message.y, message.z)
    parameters = (message.param1, message.param2, message.param3, message.param4, *map(float, last))
    sender = message.get_srcSystem(), message.get_srcComponent()
    confirmation = message.confirmation if long else 0
    return Request(message.command, parameters, *sender, confirmation, message.get_seq())


def acknowledgement(request: Request, result: int) -> Message:
    """COMMAND_ACK to whoever asked."""
    return mavlink.MAVLink_command_ack_message(
        request.command, result, 0, 0, request.system, request.component
    )


def autopilot_version() -> Message:
    """What this component is and can do."""
    major, minor, patch = (int(part) for part in __version__.split(".")[:3])
    capabilities = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    version = major << 24 | minor << 16 | patch << 8 | mavlink.FIRMWARE_VERSION_TYPE_DEV
    nothing = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        capabilities, version, 0, 0, 0, nothing, nothing, nothing, 0, 0, 0
    )


class CommandServer:
    """Carries out commands and remembers its answers, for repetitions."""

    def __init__(self, route: Route, parameters: ParameterServer, streams: SignalStreams) -> None:
        self._route = route
        self._parameters = parameters
        self._streams = streams
        self._state = OwnHeartbeat("standby")
        self._pending: Request | None = None
        self._time_us = 0
        self._answered: dict[str, tuple[int, int, int]] = {}  # when, its sequence number, the result
        self._handlers: dict[int, Callable[[Request], Answer]] = {
            mavlink.MAV_CMD_NAV_GUIDED_ENABLE: self._switch,
            mavlink.MAV_CMD_DO_GRIPPER: self._gripper,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_interval,
            mavlink.MAV_CMD_PREFLIGHT_STORAGE: self._storage,
        }

    def note(self, output: Output) -> Message | None:
        """Take note of what the service says; the acknowledgement, if it refuses what was just asked."""
        if isinstance(output, OwnHeartbeat):
            self._state = output
        if not isinstance(output, RequestRefused) or self._pending is None:
            return None
        return self._conclude(DENIED if output.final else REJECTED)

    def handle(self, time_us: int, message: Message, *, allowed: bool = True) -> Answer | None:
        """Answer a command, without its acknowledgement; None if it is not for us or is a repetition.

        Of somebody who is not `allowed` only questions are answered.

        `accepted` or `note` gives the acknowledgement once the service was told the events.
        """
        if (message.target_system, message.target_component) != (
            self._route.own_system,
            self._route.own_component,
        ):
            return None
        request = read_request(message)
        self._pending, self._time_us = request, time_us
        result = self._result_before(time_us, request)
        if result is not None:
            answer = Answer(result)
        elif not allowed and request.command not in QUESTIONS:
            answer = Answer(DENIED)
        else:
            handler = self._handlers.get(request.command)
            answer = Answer(UNSUPPORTED) if handler is None else handler(request)
        self._remember(time_us, request, answer.result)
        return answer

    def _result_before(self, time_us: int, request: Request) -> int | None:
        """What was answered to the command that this one repeats; None if it is a new one."""
        before_us, sequence, result = self._answered.get(_key(request), (0, -1, 0))
        if sequence < 0:
            return None
        repeats = request.confirmation > 0 and time_us - before_us <= REPEAT_WINDOW_US
        doubled = request.sequence == sequence and time_us - before_us <= DUPLICATE_WINDOW_US
        return result if repeats or doubled else None

    def _remember(self, time_us: int, request: Request, result: int) -> None:
        """As the latest; beyond `REMEMBERED` the oldest is forgotten."""
        key = _key(request)
        self._answered.pop(key, None)
        self._answered[key] = time_us, request.sequence, result
        if len(self._answered) > REMEMBERED:
            del self._answered[next(iter(self._answered))]

    def conclude(self, result: int) -> Message | None:
        """The acknowledgement, unless `note` has given it."""
        return None if self._pending is None else self._conclude(result)

    def _conclude(self, result: int) -> Message:
        assert self._pending is not None
        request, self._pending = self._pending, None
        when_us, sequence, _ = self._answered[_key(request)]
        self._answered[_key(request)] = when_us, sequence, result
        return acknowledgement(request, result)

    # ------------------------------------------------------------------------- commands

    def _switch(self, request: Request) -> Answer:
        event = _SWITCH.get(request.parameters[0])
        if event is None:
            return _denied(f"NAV_GUIDED_ENABLE {request.parameters[0]:g}: 1 engages, 0 releases")
        return Answer(ACCEPTED, events=(event,))

    def _gripper(self, request: Request) -> Answer:
        number, action = request.parameters[:2]
        event = _GRIPPER_ACTIONS.get(action)
        if number not in (0.0, 1.0) or event is None:
            return _denied(f"DO_GRIPPER {number:g} {action:g}: gripper 1, 0 release or 1 grab")
        return Answer(ACCEPTED, events=(event,))

    def _request_message(self, request: Request) -> Answer:
        wanted = request.parameters[0]
        if wanted == mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            return Answer(ACCEPTED, [autopilot_version()])
        if wanted == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return Answer(ACCEPTED, [heartbeat(self._state)])
        if wanted == mavlink.MAVLINK_MSG_ID_MESSAGE_INTERVAL:
            return self._interval(request.parameters[1])
        if wanted in self._streams.message_ids:
            messages: list[Reply] = [*self._streams.latest(int(wanted))]
            return Answer(ACCEPTED if messages else REJECTED, messages)
        return Answer(UNSUPPORTED)

    def _set_interval(self, request: Request) -> Answer:
        message_id, interval_us = request.parameters[:2]
        if message_id not in self._streams.message_ids:
            return Answer(UNSUPPORTED)
        if not math.isfinite(interval_us) or not (interval_us == -1.0 or 0 <= interval_us < 2**31):
            return _denied(f"message interval {interval_us:g}: microseconds, 0 default or -1 off")
        self._streams.set_interval(int(message_id), int(interval_us))
        return Answer(ACCEPTED)

    def _get_interval(self, request: Request) -> Answer:
        return self._interval(request.parameters[0])

    def _interval(self, message_id: float) -> Answer:
        if message_id not in self._streams.message_ids:
            return Answer(UNSUPPORTED)
        interval_us = self._streams.interval_us(int(message_id))
        return Answer(ACCEPTED, [mavlink.MAVLink_message_interval_message(int(message_id), interval_us)])

    def _storage(self, request: Request) -> Answer:
        action = request.parameters[0]
        try:
            if action == WRITE:
                return Answer(ACCEPTED, [Announce(Severity.INFO, self._parameters.store())])
            if action in (READ, RESET):
                if not self._parameters.takes_change(self._time_us):
                    return Answer(REJECTED)
                stored = action == READ
                events = tuple(self._parameters.reset(stored=stored))
                return Answer(ACCEPTED, events=events)
        except TuningProblem as error:
            return Answer(FAILED, [Announce(Severity.WARNING, str(error))])
        return _denied(f"PREFLIGHT_STORAGE {action:g}: 0 reads, 1 writes, 2 resets")


def _key(request: Request) -> str:
    """The same for a repetition. Parameters that are not used are NaN with many senders: equal to nothing."""
    return repr(replace(request, confirmation=0, sequence=0))


def _denied(reason: str) -> Answer:
    return Answer(DENIED, [Announce(Severity.WARNING, reason)])
