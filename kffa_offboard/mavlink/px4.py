"""PX4: flight modes, message intervals, and when its ATTITUDE_TARGET is wrong.

Behaviour from PX4 main 5b6e4416, modules/mavlink/mavlink_receiver.cpp; mode numbers from
modules/commander/px4_custom_mode.h.
"""

from __future__ import annotations

from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.frame_codec import CURRENT_MODE
from kffa_offboard.mavlink.autopilot import Autopilot, GuidedMode
from kffa_offboard.mavlink.commands import EncodingError
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.telemetry import TelemetryDecoder
from kffa_offboard.offboard.events import (
    AttitudeTarget,
    Event,
    HeartbeatReceived,
    ModeKind,
    Output,
    SetMode,
    TargetReported,
)

_AUTO = 4
_ACRO = 5
_MAIN_MODES = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    _AUTO: "AUTO",
    _ACRO: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
    9: "SIMPLE",
    10: "TERMINATION",
}
_AUTO_MODES = {
    1: "READY",
    2: "TAKEOFF",
    3: "LOITER",
    4: "MISSION",
    5: "RTL",
    6: "LAND",
    8: "FOLLOW_TARGET",
    9: "PRECLAND",
    10: "VTOL_TAKEOFF",
}
_POSITION_MODES = {0: "POSCTL", 1: "POSCTL.ORBIT", 2: "POSCTL.SLOW"}
_KINDS = {
    "OFFBOARD": ModeKind.OFFBOARD,
    "AUTO.LOITER": ModeKind.HOLD,
    "AUTO.LAND": ModeKind.LAND,
    "AUTO.PRECLAND": ModeKind.LAND,
}
_NUMBERS = {ModeKind.OFFBOARD: (6, 0), ModeKind.HOLD: (_AUTO, 3), ModeKind.LAND: (_AUTO, 6)}

HEARTBEATS_TO_SEE_A_MODE = 2
"""HEARTBEAT comes once a second, so the first one after a mode command may still tell of before."""


def custom_mode(main_mode: int, sub_mode: int = 0) -> int:
    """HEARTBEAT.custom_mode of a main and a sub mode."""
    return sub_mode << 24 | main_mode << 16


class Px4(Autopilot):
    """PX4's side of the interface."""

    firmware = "px4"
    mode_message = CURRENT_MODE  # SET_MESSAGE_INTERVAL for HEARTBEAT fails in every mode of the link
    estimate_message = mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS

    def __init__(self, route: Route, telemetry: TelemetryDecoder, guided_mode: GuidedMode = "guided") -> None:
        super().__init__(route, telemetry, guided_mode)
        self._sends_attitude = False
        self._heartbeats_until_known = 0
        self._last: HeartbeatReceived | None = None
        self._decoders["CURRENT_MODE"] = self._current_mode

    def mode_of(self, custom_mode: int) -> tuple[ModeKind, str]:
        """See `Autopilot`."""
        main_mode, sub_mode = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
        name = _MAIN_MODES.get(main_mode, f"mode {main_mode}.{sub_mode}")
        if main_mode == _AUTO:
            name = f"AUTO.{_AUTO_MODES.get(sub_mode, sub_mode)}"
        elif name == "POSCTL":
            name = _POSITION_MODES.get(sub_mode, f"POSCTL.{sub_mode}")
        return _KINDS.get(name, ModeKind.OTHER), name

    def mode_numbers(self, kind: ModeKind) -> tuple[int, int]:
        """See `Autopilot`."""
        if kind not in _NUMBERS:
            raise EncodingError(f"mode {kind.value!r} is no mode that can be asked for; not sent")
        return _NUMBERS[kind]

    def interval_us(self, rate_hz: float) -> int:
        """See `Autopilot`. Taken as asked; 50 and 100 Hz are kept exactly, 200 Hz gives 125."""
        return round(1e6 / rate_hz)

    def _current_mode(self, message: Message) -> list[Event]:
        """It tells of a change of mode before the next HEARTBEAT does."""
        if self._last is None or message.custom_mode == self._custom_mode:
            return []
        self._custom_mode = message.custom_mode
        kind, name = self.mode_of(message.custom_mode)
        self._last = replace(self._last, mode=kind, mode_name=name, custom_mode=message.custom_mode)
        return [self._last]

    def _heartbeat(self, message: Message) -> HeartbeatReceived:
        self._heartbeats_until_known = max(self._heartbeats_until_known - 1, 0)
        self._last = super()._heartbeat(message)
        return self._last

    def encode(self, output: Output, time_us: int) -> list[Message]:
        """See `Autopilot`."""
        messages = super().encode(output, time_us)
        if isinstance(output, AttitudeTarget):
            self._sends_attitude = output.attitude is not None
        elif output == SetMode(ModeKind.OFFBOARD):
            self._heartbeats_until_known = HEARTBEATS_TO_SEE_A_MODE
        return messages

    def trusted(self, target: TargetReported) -> TargetReported:
        """Nothing of it under rate control.

        ATTITUDE_TARGET is filled from the attitude setpoint, which nobody updates while rates are
        commanded (ACRO; OFFBOARD unless we send attitudes): it then repeats an old attitude and an
        old thrust, with a type mask that says all is valid.
        """
        kind, name = self.mode_of(self._custom_mode)
        maybe_offboard = kind is ModeKind.OFFBOARD or self._heartbeats_until_known > 0
        if name == _MAIN_MODES[_ACRO] or (maybe_offboard and not self._sends_attitude):
            return replace(target, thrust=None, body_rates=None, attitude=None)
        return target
