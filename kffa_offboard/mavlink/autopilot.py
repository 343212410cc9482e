"""What every autopilot does for the service, and where firmwares differ.

`decode` turns messages of the vehicle into events, `encode` turns outputs into messages. The
subclasses (px4.py, ardupilot.py) say what a flight mode number means, which interval a message rate
becomes, and what of the autopilot's reports is to be believed.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Collection, Sequence
from typing import ClassVar, Literal, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink import commands
from kffa_offboard.mavlink.commands import EncodingError
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.telemetry import Decoder, TelemetryDecoder
from kffa_offboard.offboard.events import (
    AttitudeTarget,
    CommandAnswered,
    Event,
    Firmware,
    HeartbeatReceived,
    ModeKind,
    Output,
    RequestMessageRates,
    SetArmed,
    SetGripper,
    SetMode,
    TargetReported,
)

Action: TypeAlias = Literal["arm", "disarm", "mode", "message-rate", "gripper", "other"]

_ACTIONS: dict[int, Action] = {
    mavlink.MAV_CMD_DO_SET_MODE: "mode",
    mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: "message-rate",
    mavlink.MAV_CMD_DO_GRIPPER: "gripper",
}
GuidedMode: TypeAlias = Literal["guided", "guided_nogps"]
"""Which of ArduPilot's two modes that take SET_ATTITUDE_TARGET is asked for."""

HIGHEST_RATE_HZ = 1000.0
NEEDED_MESSAGES = (mavlink.MAVLINK_MSG_ID_ATTITUDE, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED)
"""Control is impossible without; the other messages are asked for and not insisted on."""


class Autopilot(ABC):
    """Translation for one firmware.

    It remembers what only the wire needs: the last mode and what was asked for last.

    Attributes
    ----------
    mode_message : number of the message by which a change of mode is known soonest
    estimate_message : number of the message that says which parts of the estimate are valid
    """

    firmware: ClassVar[Firmware]
    mode_message: ClassVar[int] = mavlink.MAVLINK_MSG_ID_HEARTBEAT
    estimate_message: ClassVar[int]

    def __init__(self, route: Route, telemetry: TelemetryDecoder, guided_mode: GuidedMode = "guided") -> None:
        self._route = route
        self._guided_mode: GuidedMode = guided_mode
        self._rates: dict[int, float] = {}
        self._unanswered_rates: deque[int] = deque()
        self._refused_rates: set[int] = set()
        self._telemetry = telemetry
        self._decoders: dict[str, Decoder] = {
            **telemetry.decoders,
            "HEARTBEAT": self._heartbeats,
            "COMMAND_ACK": self._command_answer,
            "ATTITUDE_TARGET": self._targets,
        }
        self._arming = True
        self._custom_mode = 0

    @property
    def kinds(self) -> Collection[str]:
        """Types of messages that are decoded."""
        return frozenset(self._decoders)

    # ------------------------------------------------------------- what differs

    @abstractmethod
    def mode_of(self, custom_mode: int) -> tuple[ModeKind, str]:
        """What HEARTBEAT.custom_mode means, and the firmware's own name for it."""

    @abstractmethod
    def mode_numbers(self, kind: ModeKind) -> tuple[int, int]:
        """Parameters 2 and 3 of MAV_CMD_DO_SET_MODE. Raises EncodingError for a kind nobody can ask for."""

    @abstractmethod
    def interval_us(self, rate_hz: float) -> int:
        """Message interval to ask for so that about `rate_hz` arrive."""

    @abstractmethod
    def trusted(self, target: TargetReported) -> TargetReported:
        """The report with None where this firmware, in its present mode, does not tell the truth."""

    def requests(self) -> list[Message]:
        """Messages that the adapter itself wants sent after the answer (COMMAND_ACK) just decoded."""
        return []

    # ----------------------------------------------------------- vehicle -> events

    def decode(self, message: Message) -> list[Event]:
        """Events of one message of the target."""
        decoder = self._decoders.get(message.msgname)
        return [] if decoder is None else decoder(message)

    def _targets(self, message: Message) -> list[Event]:
        reports = self._telemetry.decode(message)
        return [self.trusted(event) if isinstance(event, TargetReported) else event for event in reports]

    def _heartbeats(self, message: Message) -> list[Event]:
        return [self._heartbeat(message)]

    def _heartbeat(self, message: Message) -> HeartbeatReceived:
        self._custom_mode = message.custom_mode
        kind, name = self.mode_of(message.custom_mode)
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        killed = message.system_status == mavlink.MAV_STATE_FLIGHT_TERMINATION
        return HeartbeatReceived(self.firmware, kind, name, message.custom_mode, armed, killed)

    def _command_answer(self, message: Message) -> list[Event]:
        if not self._route.addresses_us(message.target_system, message.target_component):
            return []
        action = _ACTIONS.get(message.command, "other")
        if action == "message-rate" and self._rate_answered(message.result):
            return []
        if message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            action = "arm" if self._arming else "disarm"
        return [
            CommandAnswered(
                action,
                message.command,
                accepted=message.result == mavlink.MAV_RESULT_ACCEPTED,
                in_progress=message.result == mavlink.MAV_RESULT_IN_PROGRESS,
                result_name=result_name(message.result),
            )
        ]

    # ---------------------------------------------------------- outputs -> vehicle

    def encode(self, output: Output, time_us: int) -> list[Message]:
        """Messages for an output that is meant for the vehicle.

        Raises EncodingError if it must not be sent.
        """
        match output:
            case AttitudeTarget():
                return [self._attitude_target(output, time_us)]
            case RequestMessageRates():
                return self._message_rates(output)
            case SetMode(mode):
                return [commands.set_mode(self._route, *self.mode_numbers(mode))]
            case SetArmed(armed):
                self._arming = armed
                return [commands.set_armed(self._route, output)]
            case SetGripper():
                return [commands.set_gripper(self._route, output)]
            case _:
                return []

    def _attitude_target(self, target: AttitudeTarget, time_us: int) -> Message:
        return commands.attitude_target(self._route, target, time_us)

    def _message_rates(self, request: RequestMessageRates) -> list[Message]:
        rates = {
            mavlink.MAVLINK_MSG_ID_ATTITUDE: request.attitude_hz,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: request.position_hz,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: request.target_hz,
            mavlink.MAVLINK_MSG_ID_VFR_HUD: request.status_hz,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: request.status_hz,
            self.estimate_message: request.status_hz,
            self.mode_message: request.heartbeat_hz,
        }
        for rate in rates.values():
            if not (math.isfinite(rate) and 0.0 < rate <= HIGHEST_RATE_HZ):
                raise EncodingError(f"message rate {rate:g} Hz is outside 0..{HIGHEST_RATE_HZ:g}; not sent")
        self._rates = rates
        self._unanswered_rates.clear()
        return self.rate_requests(
            [message_id for message_id in rates if message_id not in self._refused_rates]
        )

    def rate_requests(self, message_ids: Sequence[int]) -> list[Message]:
        """Ask for messages at the rates that the service wants."""
        self._unanswered_rates.extend(message_ids)
        return [
            commands.message_interval(self._route, message_id, self.interval_us(self._rates[message_id]))
            for message_id in message_ids
        ]

    def _rate_answered(self, result: int) -> bool:
        """Take in an answer to SET_MESSAGE_INTERVAL; True if the service need not know.

        COMMAND_ACK does not say which message it is about, but answers come in the order of the requests.
        """
        message_id = self._unanswered_rates.popleft() if self._unanswered_rates else None
        if message_id is None or result == mavlink.MAV_RESULT_ACCEPTED:
            return False
        return self.rate_refused(message_id, result)

    def rate_refused(self, message_id: int, result: int) -> bool:
        """A message is not sent at the rate asked for; True if the service need not know."""
        if message_id in NEEDED_MESSAGES:
            return False
        self._refused_rates.add(message_id)  # an older firmware does not have it, or keeps its own rate
        return True


def result_name(result: int) -> str:
    """MAV_RESULT in words: "accepted", "temporarily rejected", ..."""
    entry = mavlink.enums["MAV_RESULT"].get(result)
    if entry is None or entry.name.endswith("ENUM_END"):
        return f"result {result}"
    return str(entry.name).removeprefix("MAV_RESULT_").replace("_", " ").lower()
