"""ArduCopter: flight modes, message intervals, and the parameters that change what a setpoint means.

Behaviour from ArduCopter 4.7-dev 90700977c5, ArduCopter/GCS_MAVLink_Copter.cpp and mode_guided.cpp.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.autopilot import Autopilot
from kffa_offboard.mavlink.commands import EncodingError
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.telemetry import TelemetryDecoder
from kffa_offboard.offboard.events import AttitudeTarget, Event, ModeKind, StatusReceived, TargetReported

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

LOOP_RATE_HZ = 400.0
"""SCHED_LOOP_RATE as it comes. A message may be asked for at 0.8 of it, in whole milliseconds."""

SHORTEST_INTERVAL_MS = math.floor(1000.0 / (0.8 * LOOP_RATE_HZ))
REQUESTS_PER_PARAMETER = 5

_THRUST_AS_THRUST = 8


def _guided_options(value: float) -> str | None:
    if int(value) & _THRUST_AS_THRUST:
        return None
    return f"GUID_OPTIONS {value:g} makes thrust a climb rate: add {_THRUST_AS_THRUST} to it"


def _guided_timeout(value: float) -> str | None:
    return f"GUID_TIMEOUT {value:g} s flies stale rates that long: set 0.5" if value > 0.5 else None


def _must_be_zero(name: str) -> Callable[[float], str | None]:
    return lambda value: f"{name} {value:g} alters thrust setpoints: set 0" if value != 0.0 else None


PARAMETER_CHECKS: dict[str, Callable[[float], str | None]] = {
    "GUID_OPTIONS": _guided_options,
    "GUID_TIMEOUT": _guided_timeout,
    "ATC_ANGLE_BOOST": _must_be_zero("ATC_ANGLE_BOOST"),
    "PILOT_THR_FILT": _must_be_zero("PILOT_THR_FILT"),
}
"""Parameters read at connect, and what is wrong with a value (None: nothing)."""


class ArduPilot(Autopilot):
    """ArduCopter's side of the interface.

    It reads `PARAMETER_CHECKS` from the vehicle after the first heartbeats and reports what is wrong
    as `StatusReceived`. Where GUID_OPTIONS is known to turn thrust into a climb rate, setpoints are
    refused: a thrust of 0.7 would be a climb at full speed.
    """

    firmware = "ardupilot"

    def __init__(self, route: Route, telemetry: TelemetryDecoder) -> None:
        super().__init__(route, telemetry)
        self._parameters: dict[str, float] = {}
        self._asked = 0
        self._requests: list[Message] = []

    def mode_of(self, custom_mode: int) -> tuple[ModeKind, str]:
        """See `Autopilot`."""
        name = _NAMES.get(custom_mode, f"mode {custom_mode}")
        return _KINDS.get(name, ModeKind.OTHER), name

    def mode_numbers(self, kind: ModeKind) -> tuple[int, int]:
        """See `Autopilot`. Offboard is GUIDED."""
        if kind not in _NUMBERS:
            raise EncodingError(f"mode {kind.value!r} is no mode that can be asked for; not sent")
        return _NUMBERS[kind], 0

    def interval_us(self, rate_hz: float) -> int:
        """See `Autopilot`. Whole milliseconds, rounded to the faster rate; never one that is DENIED."""
        interval_ms = math.floor(1000.0 / rate_hz + 1e-9)
        if interval_ms < SHORTEST_INTERVAL_MS:
            highest = 1000.0 / SHORTEST_INTERVAL_MS
            LOG.warning("ArduPilot sends at most %.0f Hz; asking for that instead of %g Hz", highest, rate_hz)
        return 1000 * max(interval_ms, SHORTEST_INTERVAL_MS)

    def trusted(self, target: TargetReported) -> TargetReported:
        """See `Autopilot`. It reports what it really commands."""
        return target

    def requests(self) -> list[Message]:
        """See `Autopilot`."""
        waiting, self._requests = self._requests, []
        return waiting

    def decode(self, message: Message) -> list[Event]:
        """See `Autopilot`."""
        match message.get_type():
            case "PARAM_VALUE":
                return self._parameter(message)
            case "HEARTBEAT" if self._asked < REQUESTS_PER_PARAMETER:
                self._asked += 1
                self._requests += [
                    mavlink.MAVLink_param_request_read_message(
                        self._route.target_system, self._route.target_component, name.encode(), -1
                    )
                    for name in PARAMETER_CHECKS
                    if name not in self._parameters
                ]
        return super().decode(message)

    def _parameter(self, message: Message) -> list[Event]:
        """Judge a parameter when its value is new; a full download repeats values, and is not news."""
        name, value = message.param_id, message.param_value
        if name not in PARAMETER_CHECKS or self._parameters.get(name) == value:
            return []
        self._parameters[name] = value
        problem = PARAMETER_CHECKS[name](value)
        return [] if problem is None else [StatusReceived(mavlink.MAV_SEVERITY_WARNING, problem)]

    def _attitude_target(self, target: AttitudeTarget, time_us: int) -> Message:
        options = self._parameters.get("GUID_OPTIONS")
        problem = None if options is None else _guided_options(options)
        if problem is not None:
            raise EncodingError(f"{problem}; not sent")
        return super()._attitude_target(target, time_us)
