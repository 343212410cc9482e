"""COMMAND_LONG, COMMAND_INT and SET_MODE: every one is answered, UNSUPPORTED where it is.

The one exception is deliberate: PX4 with its gripper disabled does not answer DO_GRIPPER at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle import stream_rates, telemetry
from sim_vehicle.firmware import GripperAction, Result, Severity
from sim_vehicle.peer import Peer
from sim_vehicle.telemetry import Message

if TYPE_CHECKING:
    from sim_vehicle.mavlink_server import MavlinkServer

PX4_LATENCY_US = 20_000
"""PX4's commander answers this much later; its MAVLink task answers what concerns streams at once."""

FORCE_ARM = (21196.0, 2989.0)
"""Magic values of param2 that force arming and disarming."""

CHANGE_MODE = mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE

INT32_MAX = 2**31 - 1
"""A coordinate of COMMAND_INT that is not given."""

_RELATIVE_FRAMES = (
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT,
    mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT_INT,
)


class Command(NamedTuple):
    """A command in either form: seven parameters; `relative` if its height is above home for sure."""

    number: int
    parameters: tuple[float, ...]
    relative: bool
    message: Message


Answer: TypeAlias = Result | list[tuple[float, Result]] | None
Handler: TypeAlias = Callable[[Peer, Command], Answer]


class Commands:
    """Dispatch of commands to the firmware and to the streams."""

    def __init__(self, server: MavlinkServer, loop_rate_hz: float) -> None:
        self._server = server
        self._loop_rate_hz = loop_rate_hz
        self._at_once: dict[int, Handler] = {
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_message_interval,
            mavlink.MAV_CMD_GET_MESSAGE_INTERVAL: self._get_message_interval,
            mavlink.MAV_CMD_REQUEST_MESSAGE: self._request_message,
            mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: self._request_version,
            mavlink.MAV_CMD_GET_HOME_POSITION: self._request_home,
        }
        if server.px4:
            self._at_once[mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION] = self._request_protocol
        self._by_commander: dict[int, Handler] = {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: self._land,
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: self._return_home,
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: self._loiter,
            mavlink.MAV_CMD_DO_PAUSE_CONTINUE: self._pause,
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
            mavlink.MAV_CMD_DO_GRIPPER: self._gripper,
            mavlink.MAV_CMD_DO_SET_HOME: self._set_home,
            mavlink.MAV_CMD_MISSION_START: self._start_mission,
            mavlink.MAV_CMD_RUN_PREARM_CHECKS: self._prearm_checks,
        }

    # ------------------------------------------------------------------------------------- in

    def handle_long(self, peer: Peer, message: Message) -> None:
        """COMMAND_LONG."""
        parameters = tuple(float(getattr(message, f"param{index}")) for index in range(1, 8))
        self._handle(peer, Command(int(message.command), parameters, False, message))

    def handle_int(self, peer: Peer, message: Message) -> None:
        """COMMAND_INT; latitude and longitude become degrees, as in COMMAND_LONG."""
        parameters = (
            message.param1,
            message.param2,
            message.param3,
            message.param4,
            math.nan if message.x == INT32_MAX else message.x * 1e-7,
            math.nan if message.y == INT32_MAX else message.y * 1e-7,
            message.z,
        )
        relative = message.frame in _RELATIVE_FRAMES
        self._handle(peer, Command(int(message.command), parameters, relative, message))

    def handle_set_mode(self, peer: Peer, message: Message) -> None:
        """SET_MODE: PX4 answers as to DO_SET_MODE, ArduPilot with the message's own number."""
        px4 = self._server.px4
        number = mavlink.MAV_CMD_DO_SET_MODE if px4 else mavlink.MAVLINK_MSG_ID_SET_MODE
        command = Command(number, (), False, message)

        def change(_: Peer, __: Command) -> Answer:
            if not message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
                return Result.UNSUPPORTED
            return self._server.firmware.set_custom_mode(int(message.custom_mode))

        self._answer_later(peer, command, change)

    def _handle(self, peer: Peer, command: Command) -> None:
        if command.number in self._at_once:
            self._answer(peer, command, self._at_once[command.number](peer, command))
        elif command.number in self._by_commander:
            self._answer_later(peer, command, self._by_commander[command.number])
        else:
            self._answer(peer, command, Result.UNSUPPORTED)

    def _answer_later(self, peer: Peer, command: Command, handler: Handler) -> None:
        def run() -> None:
            self._answer(peer, command, handler(peer, command))

        if self._server.px4:
            self._server.after(PX4_LATENCY_US, run)
        else:
            run()

    def _answer(self, peer: Peer, command: Command, answer: Answer) -> None:
        if answer is None:
            return
        answers = [(0.0, answer)] if isinstance(answer, Result) else answer
        for delay, result in answers:
            message = self._acknowledgement(command, result)
            if delay > 0.0:
                self._server.after(round(delay * 1e6), partial(peer.send, message))
            else:
                peer.send(message)

    def _acknowledgement(self, command: Command, result: Result) -> Message:
        progress = 255 if result != Result.IN_PROGRESS else 0  # 255: progress unknown
        source = command.message
        return mavlink.MAVLink_command_ack_message(
            command.number, int(result), progress, 0, source.get_srcSystem(), source.get_srcComponent()
        )

    # -------------------------------------------------------------------------------- streams

    def _set_message_interval(self, peer: Peer, command: Command) -> Answer:
        message_id, asked = _whole(command.parameters[0]), command.parameters[1]
        keeps_its_rate = self._server.px4 and message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT
        if not self._has(message_id) or keeps_its_rate:
            return Result.FAILED
        if not math.isfinite(asked) or asked < -1.0:
            return Result.DENIED
        now = self._server.time_us
        if asked == 0.0:
            peer.restore_default(message_id, now)
        elif asked < 0.0:
            peer.set_interval(message_id, 0, now)
        elif self._server.px4:
            peer.set_interval(message_id, stream_rates.px4_interval(message_id, round(asked)), now)
        else:
            interval = stream_rates.ardupilot_interval(round(asked), self._loop_rate_hz)
            if interval is None:
                return Result.DENIED
            peer.set_interval(message_id, interval, now)
        return Result.ACCEPTED

    def _get_message_interval(self, peer: Peer, command: Command) -> Answer:
        message_id = _whole(command.parameters[0])
        if not self._has(message_id):
            peer.send(mavlink.MAVLink_message_interval_message(max(0, message_id), 0))
            return Result.FAILED
        stream = peer.streams.get(message_id)
        peer.send(mavlink.MAVLink_message_interval_message(message_id, stream.interval_us if stream else -1))
        return Result.ACCEPTED

    def _request_message(self, peer: Peer, command: Command) -> Answer:
        return self._send_once(peer, _whole(command.parameters[0]))

    def _request_version(self, peer: Peer, command: Command) -> Answer:
        return self._send_once(peer, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)

    def _request_protocol(self, peer: Peer, command: Command) -> Answer:
        return self._send_once(peer, telemetry.ProtocolVersion.id)

    def _request_home(self, peer: Peer, command: Command) -> Answer:
        return self._send_once(peer, mavlink.MAVLINK_MSG_ID_HOME_POSITION)

    def _has(self, message_id: int) -> bool:
        return message_id in telemetry.BUILDERS and (self._server.px4 or message_id not in telemetry.PX4_ONLY)

    def _send_once(self, peer: Peer, message_id: int) -> Answer:
        if not self._has(message_id):
            return Result.DENIED if self._server.px4 else Result.FAILED
        message = self._server.build(message_id)
        if message is None:
            return Result.TEMPORARILY_REJECTED
        peer.send(message)
        return Result.ACCEPTED

    # -------------------------------------------------------------------------------- vehicle

    def _arm_disarm(self, peer: Peer, command: Command) -> Answer:
        wanted, magic = command.parameters[0], command.parameters[1]
        force = magic in FORCE_ARM
        if wanted not in (0.0, 1.0):
            return Result.UNSUPPORTED
        firmware = self._server.firmware
        return firmware.arm(force) if wanted == 1.0 else firmware.disarm(force)

    def _do_set_mode(self, peer: Peer, command: Command) -> Answer:
        base, main, sub = command.parameters[:3]
        if not all(math.isfinite(value) for value in (base, main)):
            return Result.DENIED
        if not int(base) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return Result.UNSUPPORTED
        if not self._server.px4:
            return self._server.firmware.set_custom_mode(int(main))
        return self._server.firmware.set_custom_mode(int(main) << 16 | max(0, _whole(sub)) << 24)

    def _take_off(self, peer: Peer, command: Command) -> Answer:
        return self._server.firmware.take_off(self._above_home(command))

    def _land(self, peer: Peer, command: Command) -> Answer:
        return self._server.firmware.land_here()

    def _return_home(self, peer: Peer, command: Command) -> Answer:
        return self._server.firmware.return_home()

    def _loiter(self, peer: Peer, command: Command) -> Answer:
        return self._server.firmware.loiter()

    def _above_home(self, command: Command) -> float:
        """Param7: height above home for ArduPilot, altitude above sea level for PX4; NaN if not given."""
        height = command.parameters[6]
        if self._server.px4 and not command.relative:
            home = self._server.firmware.home
            height -= telemetry.ORIGIN_ALTITUDE + (home[2] if home else 0.0)
        return height

    def _pause(self, peer: Peer, command: Command) -> Answer:
        return self._server.firmware.loiter() if command.parameters[0] == 0.0 else Result.DENIED

    def _reposition(self, peer: Peer, command: Command) -> Answer:
        """PX4: stay here (nothing given: pause), go there, change the height. ArduPilot: only stay here."""
        latitude, longitude = command.parameters[4:6]
        given = math.isfinite(latitude) and math.isfinite(longitude)
        place = telemetry.local_position(latitude, longitude) if given else None
        firmware = self._server.firmware
        if not _whole(command.parameters[1]) & CHANGE_MODE and firmware.mode != firmware.hold_mode:
            return Result.DENIED
        return firmware.reposition(place, self._above_home(command))

    def _gripper(self, peer: Peer, command: Command) -> Answer:
        actions: dict[float, GripperAction] = {
            float(mavlink.GRIPPER_ACTION_RELEASE): "release",
            float(mavlink.GRIPPER_ACTION_GRAB): "grab",
        }
        action = actions.get(command.parameters[1])
        return Result.DENIED if action is None else self._server.firmware.gripper(action)

    def _set_home(self, peer: Peer, command: Command) -> Answer:
        firmware = self._server.firmware
        if command.parameters[0] != 1.0 or not firmware.position_ready:
            return Result.DENIED
        firmware.home = self._server.estimate.position
        return Result.ACCEPTED

    def _start_mission(self, peer: Peer, command: Command) -> Answer:
        self._server.firmware.texts.append((Severity.WARNING, "Missions are stored, not flown"))
        return Result.DENIED

    def _prearm_checks(self, peer: Peer, command: Command) -> Answer:
        return Result.TEMPORARILY_REJECTED if self._server.firmware.armed else Result.ACCEPTED


def _whole(value: float) -> int:
    """Whole number of a parameter; -1, which no message or mode has, for NaN and infinity."""
    return int(value) if math.isfinite(value) else -1
