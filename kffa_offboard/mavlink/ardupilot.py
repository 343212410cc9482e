"""ArduCopter: flight modes, message intervals, and the parameters that change what a setpoint means.

Behaviour from ArduCopter 4.7-dev 90700977c5, ArduCopter/GCS_MAVLink_Copter.cpp and mode_guided.cpp.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.autopilot import NEEDED_MESSAGES, Autopilot, GuidedMode
from kffa_offboard.mavlink.commands import EncodingError
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.parameter_check_ardupilot import thrust_is_climb_rate
from kffa_offboard.mavlink.parameters import name_of
from kffa_offboard.mavlink.telemetry import TelemetryDecoder
from kffa_offboard.offboard.events import AttitudeTarget, Event, ModeKind, TargetReported

LOG = logging.getLogger(__name__)

_PREFIX = "COPTER_MODE_"
_NAMES: dict[int, str] = {
    number: entry.name.removeprefix(_PREFIX)
    for number, entry in mavlink.enums["COPTER_MODE"].items()
    if not entry.name.endswith("ENUM_END")
}
_KINDS = {
    "GUIDED": ModeKind.OFFBOARD,
    "GUIDED_NOGPS": ModeKind.OFFBOARD,
    "BRAKE": ModeKind.HOLD,
    "LAND": ModeKind.LAND,
}
_NUMBERS = {ModeKind.OFFBOARD: 4, ModeKind.HOLD: 17, ModeKind.LAND: 9}

GUIDED_NOGPS = 20
LOOP_RATE_HZ = 400.0
"""SCHED_LOOP_RATE as it comes. A message may be asked for at 0.8 of it, in whole milliseconds."""

LONGEST_TRIED_MS = 20
"""A needed message that is DENIED is asked for again, 1 ms slower each time, up to this interval."""

_DATA_STREAMS = (
    (mavlink.MAV_DATA_STREAM_EXTRA1, mavlink.MAVLINK_MSG_ID_ATTITUDE),
    (mavlink.MAV_DATA_STREAM_POSITION, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    (mavlink.MAV_DATA_STREAM_EXTRA2, mavlink.MAVLINK_MSG_ID_VFR_HUD),
    (mavlink.MAV_DATA_STREAM_EXTRA3, mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT),
)
"""REQUEST_DATA_STREAM of firmware without SET_MESSAGE_INTERVAL: a group, and its message that we want."""


def shortest_interval_ms(loop_rate_hz: float) -> int:
    """Shortest message interval of a loop rate: 0.8 of it, in whole milliseconds (cap_message_interval)."""
    return max(1, math.floor(1000.0 / (0.8 * loop_rate_hz)))


def mode_name(number: int) -> str:
    """Name of a flight mode by ArduCopter's own number."""
    return _NAMES.get(number, f"mode {number}")


class ArduPilot(Autopilot):
    """ArduCopter's side of the interface.

    Where GUID_OPTIONS is known to turn thrust into a climb rate, setpoints are refused, whatever was
    found at connect: a thrust of 0.7 would be a climb at full speed.
    """

    firmware = "ardupilot"
    estimate_message = mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT

    def __init__(self, route: Route, telemetry: TelemetryDecoder, guided_mode: GuidedMode = "guided") -> None:
        super().__init__(route, telemetry, guided_mode)
        self._guided_options: float | None = None
        self._shortest_ms = shortest_interval_ms(LOOP_RATE_HZ)
        self._has_intervals = True
        self._requests: list[Message] = []
        self._decoders["PARAM_VALUE"] = self._parameter

    def mode_of(self, custom_mode: int) -> tuple[ModeKind, str]:
        """See `Autopilot`."""
        name = mode_name(custom_mode)
        return _KINDS.get(name, ModeKind.OTHER), name

    def mode_numbers(self, kind: ModeKind) -> tuple[int, int]:
        """See `Autopilot`. Offboard is GUIDED, or GUIDED_NOGPS if so configured."""
        if kind not in _NUMBERS:
            raise EncodingError(f"mode {kind.value!r} is no mode that can be asked for; not sent")
        if kind is ModeKind.OFFBOARD and self._guided_mode == "guided_nogps":
            return GUIDED_NOGPS, 0
        return _NUMBERS[kind], 0

    def interval_us(self, rate_hz: float) -> int:
        """See `Autopilot`. Whole milliseconds, rounded to the faster rate; never one that is DENIED."""
        interval_ms = math.floor(1000.0 / rate_hz + 1e-9)
        if interval_ms < self._shortest_ms:
            highest = 1000.0 / self._shortest_ms
            LOG.warning("ArduPilot sends at most %.0f Hz; asking for that instead of %g Hz", highest, rate_hz)
        return 1000 * max(interval_ms, self._shortest_ms)

    def trusted(self, target: TargetReported) -> TargetReported:
        """See `Autopilot`. It reports what it really commands."""
        return target

    def requests(self) -> list[Message]:
        """See `Autopilot`."""
        waiting, self._requests = self._requests, []
        return waiting

    def _parameter(self, message: Message) -> list[Event]:
        """Two parameters that say what may be asked for."""
        match name_of(message):
            case "GUID_OPTIONS":
                self._guided_options = message.param_value
            case "SCHED_LOOP_RATE" if message.param_value > 0.0:
                self._shortest_ms = shortest_interval_ms(message.param_value)
        return []

    def rate_requests(self, message_ids: Sequence[int]) -> list[Message]:
        """See `Autopilot`. Old firmware has only groups of messages (REQUEST_DATA_STREAM), in whole Hz."""
        if self._has_intervals:
            return super().rate_requests(message_ids)
        route = self._route
        return [
            mavlink.MAVLink_request_data_stream_message(
                route.target_system, route.target_component, group, math.ceil(self._rates[message_id]), 1
            )
            for group, message_id in _DATA_STREAMS
            if message_id in message_ids
        ]

    def rate_refused(self, message_id: int, result: int) -> bool:
        """See `Autopilot`. Ask again for what can be had."""
        if result == mavlink.MAV_RESULT_UNSUPPORTED:
            if self._has_intervals:
                self._has_intervals = False
                self._unanswered_rates.clear()
                self._requests += self.rate_requests(list(self._rates))
            return True
        if result == mavlink.MAV_RESULT_DENIED and message_id in NEEDED_MESSAGES:
            longer_ms = self.interval_us(self._rates[message_id]) // 1000 + 1
            if longer_ms <= LONGEST_TRIED_MS:
                self._shortest_ms = max(self._shortest_ms, longer_ms)
                self._requests += self.rate_requests([message_id])
                return True
        return super().rate_refused(message_id, result)

    def _attitude_target(self, target: AttitudeTarget, time_us: int) -> Message:
        options = self._guided_options
        if options is not None and thrust_is_climb_rate(options):
            raise EncodingError(f"GUID_OPTIONS {options:g} makes thrust a climb rate: add 8 to it; not sent")
        return super()._attitude_target(target, time_us)
