"""A pilot for the autopilot's own modes: arm, take off, let it hold its height, land. Sans-I/O.

PX4: NAV_TAKEOFF (its AUTO.TAKEOFF), then AUTO.LOITER, which people know as Hold. ArduCopter: GUIDED and
NAV_TAKEOFF in it. Whatever is not there yet is asked for again each second, because both refuse until
their estimator has a position; what they say meanwhile is kept for the error message. Time is the vehicle's.

PX4 wants a height above the sea for its Hold. Where its estimate counts from the ground (range finder as
reference, EKF2_HGT_REF 2) it has none until a ground station tells it the origin's: SET_GPS_GLOBAL_ORIGIN.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.limits import FlightCut
from kffa_offboard.compare.plan import AutopilotName
from kffa_offboard.mavlink import commands
from kffa_offboard.mavlink.autopilot import result_name
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.px4 import custom_mode
from kffa_offboard.offboard.events import OwnHeartbeat, SetArmed

GUIDED, COPTER_LAND = 4, 9
PX4_LOITER, PX4_LAND = (4, 3), (4, 6)

RETRY_S = 1.0
READY_LIMIT_S = 120.0
"""Simulated time that the firmware may need until it can be armed."""

CLIMB_LIMIT_S = 30.0
LANDING_LIMIT_S = 60.0
AIRBORNE_M = 0.1
GLOBAL_HEIGHT_M = 20.0
"""A height that is further from the satellite fix's is not above the sea; fixes are off by less."""

ARRIVED_M = 0.3
"""The hold mode is asked for this near to the height that was asked for."""

TELEMETRY_HZ = 20.0
HEARTBEAT_S = 1.0


class Phase(Enum):
    """What the pilot is at."""

    WAITING = "no heartbeat came"
    READYING = "it could not be armed"
    CLIMBING = "it did not reach its height"
    HOLDING = "holding"
    LANDING = "it did not land and disarm"
    DONE = "done"


@dataclass(frozen=True)
class Version:
    """What AUTOPILOT_VERSION says: "1.16.0", and the first 8 letters of the commit."""

    number: str
    commit: str


class Pilot:
    """Flies `autopilot` to `height_m`, and lands `end_s` after lift-off.

    Parameters
    ----------
    counts_from_ground : its estimate needs to be told how high above the sea it begins

    Attributes
    ----------
    phase : where it is
    version : of the firmware, when it has told
    texts : what the vehicle said (STATUSTEXT), in order
    """

    def __init__(
        self,
        autopilot: AutopilotName,
        target_system: int,
        height_m: float,
        end_s: float,
        counts_from_ground: bool = False,
    ) -> None:
        self._autopilot = autopilot
        self.route = Route(target_system=target_system)
        self._height_m, self._end_s = height_m, end_s
        self._counts_from_ground = counts_from_ground
        self.phase = Phase.WAITING
        self.version: Version | None = None
        self.texts: list[str] = []
        self._now_s = 0.0
        self._phase_since_s = 0.0
        self._asked_s = -math.inf
        self._heartbeat_s = -math.inf
        self._custom_mode = 0
        self._armed = False
        self._above_m = 0.0
        self._sea_level_m = math.nan
        self._fix: Message | None = None
        self._ground_m: float | None = None
        self._lifted_s: float | None = None
        self._refusal = ""

    # ----------------------------------------------------------------------------- from the vehicle

    def handle(self, message: Message) -> list[Message]:
        """Take one message of the vehicle; what to send."""
        if not self.route.from_target(message):
            return []
        match message.get_type():
            case "HEARTBEAT":
                self._custom_mode = message.custom_mode
                self._armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
                if self.phase is Phase.WAITING:
                    self._go(Phase.READYING)
                    return self._hello()
            case "LOCAL_POSITION_NED":
                self._see_position(message)
            case "GLOBAL_POSITION_INT" if not self._armed:
                self._sea_level_m = message.alt / 1000.0
            case "GPS_RAW_INT" if message.fix_type >= mavlink.GPS_FIX_TYPE_3D_FIX:
                self._fix = message
            case "STATUSTEXT":
                self.texts.append(str(message.text))
            case "COMMAND_ACK" if message.result not in (
                mavlink.MAV_RESULT_ACCEPTED,
                mavlink.MAV_RESULT_IN_PROGRESS,
            ):
                self._refusal = result_name(message.result)
            case "AUTOPILOT_VERSION":
                self.version = _version(message)
            case "ATTITUDE":
                self._now_s = message.time_boot_ms / 1000.0
                return self._act()
            case "TIMESYNC" if commands.is_timesync_request(message):
                return [commands.timesync_answer(message, max(message.ts1, 1))]
        return []

    def hello(self) -> Message:
        """Our heartbeat, for a vehicle that waits to be addressed."""
        return commands.heartbeat(OwnHeartbeat("active"))

    def _hello(self) -> list[Message]:
        rates = {
            mavlink.MAVLINK_MSG_ID_ATTITUDE: TELEMETRY_HZ,
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: TELEMETRY_HZ,
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: TELEMETRY_HZ,
        }
        if self._counts_from_ground:
            rates[mavlink.MAVLINK_MSG_ID_GPS_RAW_INT] = 1.0
        asked = [
            commands.message_interval(self.route, kind, round(1e6 / rate)) for kind, rate in rates.items()
        ]
        version = commands.command_long(
            self.route, mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
        )
        return [self.hello(), *asked, version]

    def _see_position(self, message: Message) -> None:
        if self._ground_m is None or not self._armed:
            self._ground_m = -message.z
        self._above_m = -message.z - self._ground_m
        if self._lifted_s is None and self._armed and self._above_m > AIRBORNE_M:
            self._lifted_s = self._now_s

    # ----------------------------------------------------------------------------- to the vehicle

    def _go(self, phase: Phase) -> None:
        self.phase, self._phase_since_s, self._asked_s = phase, self._now_s, -math.inf

    def _act(self) -> list[Message]:
        """What this moment needs; raises FlightCut if a phase takes too long."""
        messages = []
        if self._now_s - self._heartbeat_s >= HEARTBEAT_S:
            self._heartbeat_s = self._now_s
            messages.append(self.hello())
        asks = {
            Phase.READYING: self._get_ready,
            Phase.CLIMBING: self._climb,
            Phase.HOLDING: self._hold,
            Phase.LANDING: self._land,
        }.get(self.phase)
        return messages + asks() if asks is not None else messages

    def _due(self) -> bool:
        if self._now_s - self._asked_s < RETRY_S:
            return False
        self._asked_s = self._now_s
        return True

    def _within(self, limit_s: float) -> None:
        if self._now_s - self._phase_since_s > limit_s:
            raise FlightCut(self.complaint(f"within {limit_s:g} s"))

    def complaint(self, limit: str) -> str:
        """What went wrong, with the limit that ended it and the vehicle's own words."""
        said = next((text for text in reversed(self.texts) if _is_reason(text)), "")
        said = said or (self.texts[-1] if self.texts else "")
        reasons = [reason for reason in (said, self._refusal) if reason]
        return f"{self._autopilot}: {self.phase.value} {limit}" + (
            f": {'; '.join(reasons)}" if reasons else ""
        )

    def _get_ready(self) -> list[Message]:
        if self._armed:
            self._go(Phase.CLIMBING)
            return []
        self._within(READY_LIMIT_S)
        if self._ground_m is None or math.isnan(self._sea_level_m) or not self._due():
            return []
        if self._counts_from_ground and not self._knows_the_sea():
            return self._tell_origin()
        mode = self._ask_mode(self._take_off_mode)
        return mode if mode else [*mode, commands.set_armed(self.route, SetArmed(True))]

    def _knows_the_sea(self) -> bool:
        return self._fix is not None and abs(self._sea_level_m - self._fix.alt * 1e-3) < GLOBAL_HEIGHT_M

    def _tell_origin(self) -> list[Message]:
        """The estimate's zero is where the fix is, and below it by what the vehicle counts from there."""
        if self._fix is None:
            return []
        assert self._ground_m is not None
        altitude = self._fix.alt - round(1e3 * self._ground_m)
        return [commands.set_origin(self.route, self._fix.lat, self._fix.lon, altitude)]

    def _climb(self) -> list[Message]:
        if self._lifted_s is not None and self._above_m > self._height_m - ARRIVED_M:
            self._go(Phase.HOLDING)
            return []
        self._within(CLIMB_LIMIT_S)
        if self._lifted_s is not None or not self._due():
            return []
        if self._autopilot == "ardupilot":
            parameters = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, self._height_m)
        else:  # PX4 counts from sea level, and takes NaN for "here"
            height = self._sea_level_m + self._height_m
            parameters = (0.0, 0.0, 0.0, math.nan, math.nan, math.nan, height)
        return [commands.command_long(self.route, mavlink.MAV_CMD_NAV_TAKEOFF, *parameters)]

    def _hold(self) -> list[Message]:
        assert self._lifted_s is not None
        if self._now_s - self._lifted_s >= self._end_s:
            self._go(Phase.LANDING)
            return []
        return self._ask_mode(self._hold_mode) if self._due() else []

    def _land(self) -> list[Message]:
        if not self._armed:
            self._go(Phase.DONE)
            return []
        self._within(LANDING_LIMIT_S)
        return (
            self._ask_mode(PX4_LAND if self._autopilot == "px4" else (COPTER_LAND, 0)) if self._due() else []
        )

    @property
    def _hold_mode(self) -> tuple[int, int]:
        return PX4_LOITER if self._autopilot == "px4" else (GUIDED, 0)

    _take_off_mode = _hold_mode

    def _ask_mode(self, mode: tuple[int, int]) -> list[Message]:
        """Ask for a mode unless it is there."""
        wanted = custom_mode(*mode) if self._autopilot == "px4" else mode[0]
        return [] if self._custom_mode == wanted else [commands.set_mode(self.route, *mode)]


def _is_reason(text: str) -> bool:
    """Does it tell why arming was refused? PX4 and ArduCopter begin such lines so."""
    return text.lower().startswith(("prearm", "pre-arm", "arm:", "preflight fail", "arming denied"))


def _version(message: Message) -> Version:
    packed = message.flight_sw_version
    number = ".".join(str(packed >> shift & 0xFF) for shift in (24, 16, 8))
    raw = bytes(message.flight_custom_version)
    text = raw.decode("ascii", "ignore") if all(32 <= byte < 127 for byte in raw) else raw[::-1].hex()
    return Version(number, text[:8])
