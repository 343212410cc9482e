"""The one vehicle we fly: finds out from its heartbeat what it is, then translates both ways."""

from __future__ import annotations

from collections.abc import Collection

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink import commands
from kffa_offboard.mavlink.ardupilot import ArduPilot
from kffa_offboard.mavlink.autopilot import Autopilot, GuidedMode
from kffa_offboard.mavlink.commands import EncodingError
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.px4 import Px4
from kffa_offboard.mavlink.telemetry import TelemetryDecoder
from kffa_offboard.offboard.events import (
    Announce,
    AttitudeTarget,
    Event,
    Firmware,
    Output,
    OwnHeartbeat,
    PayloadReport,
    RequestRefused,
    Signals,
)

_AUTOPILOTS: dict[int, type[Autopilot]] = {
    mavlink.MAV_AUTOPILOT_PX4: Px4,
    mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: ArduPilot,
}
MULTIROTORS = (
    mavlink.MAV_TYPE_QUADROTOR,
    mavlink.MAV_TYPE_COAXIAL,
    mavlink.MAV_TYPE_HEXAROTOR,
    mavlink.MAV_TYPE_OCTOROTOR,
    mavlink.MAV_TYPE_TRICOPTER,
    mavlink.MAV_TYPE_DODECAROTOR,
    mavlink.MAV_TYPE_DECAROTOR,
    mavlink.MAV_TYPE_GENERIC_MULTIROTOR,
)


def decoded_kinds() -> frozenset[str]:
    """Types of messages of which `Vehicle.decode` makes events, whatever firmware it is."""
    adapters = (kind(Route(), TelemetryDecoder()) for kind in _AUTOPILOTS.values())
    return frozenset().union(*(adapter.kinds for adapter in adapters))


class Vehicle:
    """Translation between the target's messages and the service's vocabulary.

    Whatever other systems and components say is ignored, their heartbeats above all: a ground
    station or a gimbal must not be taken for the autopilot. Nothing is decoded before the first
    heartbeat has told which firmware it is.

    Attributes
    ----------
    kinds : types of messages of which `decode` makes events
    """

    def __init__(self, route: Route, guided_mode: GuidedMode = "guided") -> None:
        self._route = route
        self._guided_mode: GuidedMode = guided_mode
        self._autopilot: Autopilot | None = None
        self._identity: tuple[int, int] | None = None
        self._text_id = 0
        self.kinds: Collection[str] = ("HEARTBEAT",)

    @property
    def firmware(self) -> Firmware | None:
        """What the vehicle runs; None before its first heartbeat."""
        return None if self._autopilot is None else self._autopilot.firmware

    def decode(self, message: Message) -> list[Event]:
        """Events of one message from anybody.

        Raises UserError if the target is not a multirotor with PX4 or ArduPilot.
        """
        return self.decode_own(message) if self._route.from_target(message) else []

    def decode_own(self, message: Message) -> list[Event]:
        """The same of a message that is the vehicle's own."""
        if message.msgname == "HEARTBEAT" and not self._is_ours(message):
            return []
        return [] if self._autopilot is None else self._autopilot.decode(message)

    def requests(self) -> list[Message]:
        """Messages to send that the last decoded message gave rise to."""
        return [] if self._autopilot is None else self._autopilot.requests()

    def encode(self, output: Output, time_us: int) -> list[Message]:
        """Messages for an output; none for those that are for the log or for the companion.

        Raises EncodingError if it must not be sent, or cannot be yet.
        """
        match output:
            case AttitudeTarget() if self._autopilot is not None:
                return self._autopilot.encode(output, time_us)
            case Signals() | RequestRefused():
                return []
            case OwnHeartbeat():
                return [commands.heartbeat(output)]
            case PayloadReport():
                return commands.payload_report(output)
            case Announce():
                self._text_id = self._text_id % 65535 + 1
                return commands.status_text(output, self._text_id)
        if self._autopilot is None:
            raise EncodingError(f"{type(output).__name__} before the vehicle's first heartbeat; not sent")
        return self._autopilot.encode(output, time_us)

    def _is_ours(self, heartbeat: Message) -> bool:
        """Recognise the vehicle, at its first heartbeat for good; `rivals` notices another one."""
        identity = (heartbeat.autopilot, heartbeat.type)
        if self._identity is None:
            self._check_supported(heartbeat)
            kind = _AUTOPILOTS[heartbeat.autopilot]
            self._autopilot = kind(self._route, TelemetryDecoder(), self._guided_mode)
            self.kinds = self._autopilot.kinds
            self._identity = identity
        return identity == self._identity

    def _check_supported(self, heartbeat: Message) -> None:
        where = f"system {self._route.target_system} component {self._route.target_component}"
        if heartbeat.autopilot not in _AUTOPILOTS:
            name = _enum_name("MAV_AUTOPILOT", heartbeat.autopilot)
            raise UserError(
                f"{where} runs autopilot {name}, which is not supported; "
                "kffa-offboard flies PX4 and ArduPilot (is link.target_system right?)"
            )
        if heartbeat.type not in MULTIROTORS:
            raise UserError(
                f"{where} is a {_enum_name('MAV_TYPE', heartbeat.type)}, which is not supported; "
                "kffa-offboard flies multirotors only"
            )


def _enum_name(enum: str, value: int) -> str:
    entry = mavlink.enums[enum].get(value)
    return f"{enum} {value}" if entry is None else str(entry.name).removeprefix(f"{enum}_")
