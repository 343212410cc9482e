"""Telemetry: the simulated autopilot's state as MAVLink messages.

Every builder takes one `Sample` and returns one message with that sample's own time. Axes change to
MAVLink's here, with `frames`, and nowhere else on the way out.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, NamedTuple, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20.development import MAVLink_current_mode_message

from sim_vehicle import frames
from sim_vehicle.firmware import Firmware
from sim_vehicle.guidance import Estimate

HOME_LATITUDE_DEG = 47.397742
HOME_LONGITUDE_DEG = 8.545594
ORIGIN_ALTITUDE = 488.0
"""Where the local origin is on Earth: m above mean sea level."""

EARTH_RADIUS = 6_378_137.0
CELLS_VOLTAGE = (3850,) * 6
CELL_UNKNOWN = 65535
INT16_MAX = 32767
INT32_MAX = 2**31 - 1
STATUSTEXT_BYTES = 50
CURRENT_MODE: int = MAVLink_current_mode_message.id

Message: TypeAlias = Any  # pymavlink has no types


class ProtocolVersion(mavlink.MAVLink_message):  # type: ignore[misc]
    """PROTOCOL_VERSION (minimal.xml), which pymavlink lacks: MAVLink 2, and 1 is understood."""

    id = 300
    fieldnames: ClassVar = ["version", "min_version", "max_version"]
    crc_extra = 217

    def __init__(self) -> None:
        super().__init__(self.id, "PROTOCOL_VERSION")
        self._fieldnames = self.fieldnames
        self.version, self.min_version, self.max_version = 200, 100, 200

    def pack(self, mav: Any, force_mavlink1: bool = False) -> bytes:
        """The frame; without hashes of the specification, which are zeros."""
        payload = struct.pack("<HHH16x", self.version, self.min_version, self.max_version)
        return bytes(self._pack(mav, self.crc_extra, payload, force_mavlink1=force_mavlink1))


class Sample(NamedTuple):
    """What a message is made of: the firmware and its estimate at one instant."""

    firmware: Firmware
    estimate: Estimate

    @property
    def time_ms(self) -> int:
        """Time since boot of the sample [ms]."""
        return self.estimate.time_us // 1000


def latitude_longitude(position: tuple[float, float, float]) -> tuple[int, int]:
    """Latitude and longitude [1e-7 degrees] of a local position (3,) [m], flat Earth."""
    north, east, _ = frames.flipped(position)
    latitude = HOME_LATITUDE_DEG + math.degrees(north / EARTH_RADIUS)
    scale = EARTH_RADIUS * math.cos(math.radians(HOME_LATITUDE_DEG))
    longitude = HOME_LONGITUDE_DEG + math.degrees(east / scale)
    return _within(latitude * 1e7, INT32_MAX), _within(longitude * 1e7, INT32_MAX)


def local_position(latitude: float, longitude: float) -> tuple[float, float]:
    """Local x and y [m] of a place on Earth [degrees]; undoes `latitude_longitude`."""
    north = EARTH_RADIUS * math.radians(latitude - HOME_LATITUDE_DEG)
    scale = EARTH_RADIUS * math.cos(math.radians(HOME_LATITUDE_DEG))
    x, y, _ = frames.flipped((north, scale * math.radians(longitude - HOME_LONGITUDE_DEG), 0.0))
    return x, y


def _within(value: float, bound: int) -> int:
    """Nearest whole number within plus and minus `bound`: a field that is full stays full."""
    return min(bound, max(-bound, round(value)))


def _heartbeat(s: Sample) -> Message:
    px4 = s.firmware.autopilot == mavlink.MAV_AUTOPILOT_PX4  # ArduCopter does not tell
    if px4 and s.firmware.killed:
        status = mavlink.MAV_STATE_FLIGHT_TERMINATION
    elif s.firmware.in_failsafe:
        status = mavlink.MAV_STATE_CRITICAL
    else:
        status = mavlink.MAV_STATE_ACTIVE if s.firmware.armed else mavlink.MAV_STATE_STANDBY
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR,
        s.firmware.autopilot,
        s.firmware.base_mode,
        s.firmware.custom_mode,
        status,
        3,
    )


def _current_mode(s: Sample) -> Message:
    """PX4 also says here what was asked for last, and the mode's standard number (0: it has none)."""
    firmware = s.firmware
    return MAVLink_current_mode_message(0, firmware.custom_mode, int(getattr(firmware, "intended", 0)))


def _attitude(s: Sample) -> Message:
    roll, pitch, yaw = frames.flipped(s.estimate.euler)
    p, q, r = frames.flipped(s.estimate.body_rates)
    return mavlink.MAVLink_attitude_message(s.time_ms, roll, pitch, yaw, p, q, r)


def _attitude_quaternion(s: Sample) -> Message:
    quaternion = frames.flipped(s.estimate.attitude)
    rates = frames.flipped(s.estimate.body_rates)
    return mavlink.MAVLink_attitude_quaternion_message(s.time_ms, *quaternion, *rates)


def _attitude_target(s: Sample) -> Message:
    mask, attitude, body_rates, thrust = s.firmware.reported_target()
    quaternion, rates = frames.flipped(attitude), frames.flipped(body_rates)
    return mavlink.MAVLink_attitude_target_message(s.time_ms, mask, quaternion, *rates, thrust)


def _local_position(s: Sample) -> Message:
    return mavlink.MAVLink_local_position_ned_message(
        s.time_ms, *frames.flipped(s.estimate.position), *frames.flipped(s.estimate.velocity)
    )


def _centidegrees(angle: float) -> int:
    """Of a compass: 0 to 35999."""
    return round(math.degrees(angle % (2.0 * math.pi)) * 100.0) % 36000


def _heading_cdeg(s: Sample) -> int:
    _, _, yaw = frames.flipped(s.estimate.euler)
    return _centidegrees(yaw)


def _course_cdeg(s: Sample) -> int:
    """Where it moves to, wherever it looks."""
    north, east, _ = frames.flipped(s.estimate.velocity)
    return _centidegrees(math.atan2(east, north))


def _global_position(s: Sample) -> Message:
    latitude, longitude = latitude_longitude(s.estimate.position)
    speed = [_within(value * 100.0, INT16_MAX) for value in frames.flipped(s.estimate.velocity)]
    return mavlink.MAVLink_global_position_int_message(
        s.time_ms,
        latitude,
        longitude,
        _within((ORIGIN_ALTITUDE + s.estimate.position[2]) * 1000.0, INT32_MAX),
        _within(s.firmware.height_above_home * 1000.0, INT32_MAX),
        *speed,
        _heading_cdeg(s),
    )


def _gps_raw(s: Sample) -> Message:
    latitude, longitude = latitude_longitude(s.estimate.position)
    x, y, _ = s.estimate.velocity
    ready = s.firmware.settled and s.estimate.satellites
    return mavlink.MAVLink_gps_raw_int_message(
        s.estimate.time_us,
        mavlink.GPS_FIX_TYPE_3D_FIX if ready else mavlink.GPS_FIX_TYPE_NO_FIX,
        latitude,
        longitude,
        _within((ORIGIN_ALTITUDE + s.estimate.position[2]) * 1000.0, INT32_MAX),
        90,
        140,
        _within(math.hypot(x, y) * 100.0, INT16_MAX),
        _course_cdeg(s),
        14 if ready else 0,
    )


def _home(s: Sample) -> Message | None:
    if s.firmware.home is None:
        return None
    latitude, longitude = latitude_longitude(s.firmware.home)
    altitude = _within((ORIGIN_ALTITUDE + s.firmware.home[2]) * 1000.0, INT32_MAX)
    return mavlink.MAVLink_home_position_message(
        latitude, longitude, altitude, *frames.flipped(s.firmware.home), (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 1.0
    )


def _origin(s: Sample) -> Message:
    return mavlink.MAVLink_gps_global_origin_message(
        round(HOME_LATITUDE_DEG * 1e7), round(HOME_LONGITUDE_DEG * 1e7), round(ORIGIN_ALTITUDE * 1000.0)
    )


def _sensor_bits(s: Sample) -> int:
    bits: int = (
        mavlink.MAV_SYS_STATUS_SENSOR_3D_GYRO
        | mavlink.MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | mavlink.MAV_SYS_STATUS_SENSOR_3D_MAG
        | mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE
        | mavlink.MAV_SYS_STATUS_SENSOR_GPS
        | mavlink.MAV_SYS_STATUS_SENSOR_ANGULAR_RATE_CONTROL
        | mavlink.MAV_SYS_STATUS_SENSOR_ATTITUDE_STABILIZATION
        | mavlink.MAV_SYS_STATUS_SENSOR_YAW_POSITION
        | mavlink.MAV_SYS_STATUS_SENSOR_Z_ALTITUDE_CONTROL
        | mavlink.MAV_SYS_STATUS_SENSOR_XY_POSITION_CONTROL
        | mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
        | mavlink.MAV_SYS_STATUS_AHRS
        | mavlink.MAV_SYS_STATUS_SENSOR_BATTERY
        | mavlink.MAV_SYS_STATUS_PREARM_CHECK
    )
    return bits


def _sys_status(s: Sample) -> Message:
    present = health = _sensor_bits(s)
    if not s.firmware.position_ready:
        health &= ~(mavlink.MAV_SYS_STATUS_SENSOR_GPS | mavlink.MAV_SYS_STATUS_PREARM_CHECK)
    if not s.firmware.attitude_ready:
        health &= ~mavlink.MAV_SYS_STATUS_AHRS
    health |= mavlink.MAV_SYS_STATUS_GEOFENCE  # there is none, so none is breached; ArduPilot says the same
    return mavlink.MAVLink_sys_status_message(
        present, present, health, 250, sum(CELLS_VOLTAGE), -1, 90, 0, 0, 0, 0, 0, 0
    )


def _extended_state(s: Sample) -> Message:
    return mavlink.MAVLink_extended_sys_state_message(
        mavlink.MAV_VTOL_STATE_UNDEFINED, int(s.firmware.landed_state)
    )


def _vfr_hud(s: Sample) -> Message:
    x, y, climb = s.estimate.velocity
    return mavlink.MAVLink_vfr_hud_message(
        0.0,
        math.hypot(x, y),
        _heading_cdeg(s) // 100,
        round(min(1.0, max(0.0, s.firmware.thrust)) * 100.0),
        ORIGIN_ALTITUDE + s.estimate.position[2],
        climb,
    )


def _altitude(s: Sample) -> Message:
    height = s.estimate.position[2]
    return mavlink.MAVLink_altitude_message(
        s.estimate.time_us,
        ORIGIN_ALTITUDE + height,
        ORIGIN_ALTITUDE + height,
        height,
        s.firmware.height_above_home,
        height,
        math.nan,
    )


def _battery(s: Sample) -> Message:
    voltages = [*CELLS_VOLTAGE, *(CELL_UNKNOWN,) * (10 - len(CELLS_VOLTAGE))]
    return mavlink.MAVLink_battery_status_message(
        0,
        mavlink.MAV_BATTERY_FUNCTION_ALL,
        mavlink.MAV_BATTERY_TYPE_LIPO,
        INT16_MAX,  # temperature unknown
        voltages,
        -1,
        -1,
        -1,
        90,
    )


def _system_time(s: Sample) -> Message:
    return mavlink.MAVLink_system_time_message(0, s.time_ms)


def _servo_output(s: Sample) -> Message:
    pulses = [round(1000.0 + 1000.0 * min(1.0, max(0.0, value))) for value in s.firmware.motor_commands]
    return mavlink.MAVLink_servo_output_raw_message(s.estimate.time_us & 0xFFFFFFFF, 0, *pulses, 0, 0, 0, 0)


def _estimator(s: Sample) -> Message:
    flags = mavlink.ESTIMATOR_ATTITUDE if s.firmware.attitude_ready else 0
    if s.firmware.settled:
        flags |= mavlink.ESTIMATOR_VELOCITY_VERT | mavlink.ESTIMATOR_POS_VERT_ABS
    if s.firmware.position_ready:
        flags |= (
            mavlink.ESTIMATOR_VELOCITY_HORIZ
            | mavlink.ESTIMATOR_POS_HORIZ_REL
            | mavlink.ESTIMATOR_POS_HORIZ_ABS
        )
    return mavlink.MAVLink_estimator_status_message(
        s.estimate.time_us, flags, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0, 0.3, 0.3
    )


def _ekf_report(s: Sample) -> Message:
    flags = mavlink.EKF_ATTITUDE if s.firmware.attitude_ready else mavlink.EKF_UNINITIALIZED
    if s.firmware.settled:
        flags |= mavlink.EKF_VELOCITY_VERT | mavlink.EKF_POS_VERT_ABS
    if s.firmware.position_ready:
        flags |= (
            mavlink.EKF_VELOCITY_HORIZ
            | mavlink.EKF_POS_HORIZ_REL
            | mavlink.EKF_POS_HORIZ_ABS
            | mavlink.EKF_PRED_POS_HORIZ_REL
            | mavlink.EKF_PRED_POS_HORIZ_ABS
        )
    return mavlink.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.0)


def _version(s: Sample) -> Message:
    px4 = s.firmware.autopilot == mavlink.MAV_AUTOPILOT_PX4
    encoding = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
        if px4
        else mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    )
    capabilities = (
        mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_FLOAT
        | mavlink.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | mavlink.MAV_PROTOCOL_CAPABILITY_SET_ATTITUDE_TARGET
        | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
        | encoding
    )
    version = (1, 16, 0, 0) if px4 else (4, 6, 0, 0)  # last byte 0: development version
    number = version[0] << 24 | version[1] << 16 | version[2] << 8 | version[3]
    custom = [0] * 8
    return mavlink.MAVLink_autopilot_version_message(
        capabilities, number, 0, 0, 0, custom, custom, custom, 0x1209, 0x5740, 0x53494D
    )


def _protocol_version(s: Sample) -> Message:
    return ProtocolVersion()


def _mission_current(s: Sample) -> Message:
    return mavlink.MAVLink_mission_current_message(0)


def status_texts(severity: int, text: str, number: int) -> list[Message]:
    """STATUSTEXT: one message, or numbered pieces with `number` (1 to 65535) in common if it is long.

    The last piece is shorter than the others, empty if need be: that is how receivers know it.
    """
    data = text.encode()
    if len(data) <= STATUSTEXT_BYTES:
        return [mavlink.MAVLink_statustext_message(severity, data)]
    pieces = [data[at : at + STATUSTEXT_BYTES] for at in range(0, len(data) + 1, STATUSTEXT_BYTES)]
    return [
        mavlink.MAVLink_statustext_message(severity, piece, number, index)
        for index, piece in enumerate(pieces)
    ]


Builder: TypeAlias = Callable[[Sample], Message | None]

BUILDERS: Mapping[int, Builder] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: _system_time,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _gps_raw,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: _attitude_quaternion,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global_position,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: _servo_output,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: _mission_current,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: _origin,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: _vfr_hud,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: _attitude_target,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: _altitude,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: _battery,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _version,
    ProtocolVersion.id: _protocol_version,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _ekf_report,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _estimator,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _home,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_state,
    CURRENT_MODE: _current_mode,
}
"""What can be asked for, by message id. A builder returns None while there is nothing to say."""

PX4_ONLY = frozenset({ProtocolVersion.id, CURRENT_MODE})
"""Messages that ArduPilot does not have."""

SENT_WHEN_SETTLED = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
    }
)
"""Not sent before the estimator has a position; then, whether or not it is still valid."""
