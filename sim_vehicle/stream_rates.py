"""Which telemetry goes out at which rate, by default and when asked (SET_MESSAGE_INTERVAL).

PX4 acts on the link that asked and quantises to its own 4 ms and 8 ms cycles; ArduCopter takes whole
milliseconds and refuses more than 0.8 of its loop rate.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20.development import MAVLink_current_mode_message

PX4_CYCLE_US = 4_000
"""Attitude samples of PX4 come at 250 Hz; asked for each of them, it sends a few less."""
PX4_SLOW_CYCLE_US = 8_000
"""Everything that does not fit the fast cycle comes at 125 Hz."""
PX4_FASTEST_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 237.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 239.0,
}
"""Measured for 250 Hz."""

ARDUPILOT_LOOP_SHARE = 0.8
ARDUPILOT_LONGEST_US = 60_000_000

PX4_DEFAULT_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 5.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 100.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 50.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 30.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 10.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 10.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 10.0,
    mavlink.MAVLINK_MSG_ID_ALTITUDE: 10.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.5,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
    MAVLink_current_mode_message.id: 0.5,
}
"""PX4's offboard link. CURRENT_MODE of the real one also waits for something new, 0.5 s at most."""

ARDUPILOT_DEFAULT_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 4.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 3.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 3.0,
    mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW: 2.0,
    mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: 1.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 4.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
}
"""Low rates, as ArduPilot's simulator starts with; a ground station asks for more."""

DATA_STREAMS: Mapping[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_MISSION_CURRENT,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    ),
    mavlink.MAV_DATA_STREAM_RC_CHANNELS: (mavlink.MAVLINK_MSG_ID_SERVO_OUTPUT_RAW,),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    ),
}
"""ArduPilot's groups for REQUEST_DATA_STREAM; MAV_DATA_STREAM_ALL means every group."""


def interval_of(rate_hz: float) -> int:
    """Interval [us] of a rate."""
    return round(1e6 / rate_hz)


def px4_interval(message_id: int, asked_us: int) -> int:
    """Interval [us] that PX4 really keeps when asked for `asked_us` (> 0)."""
    if asked_us >= PX4_SLOW_CYCLE_US:
        return asked_us
    if asked_us <= PX4_CYCLE_US and message_id in PX4_FASTEST_HZ:
        return interval_of(PX4_FASTEST_HZ[message_id])
    return PX4_SLOW_CYCLE_US


def ardupilot_interval(asked_us: int, loop_rate_hz: float) -> int | None:
    """Interval [us] that ArduCopter keeps when asked for `asked_us` (> 0); None if it refuses."""
    shortest_ms = math.floor(1000.0 / (ARDUPILOT_LOOP_SHARE * loop_rate_hz))
    whole_ms = min(asked_us, ARDUPILOT_LONGEST_US) // 1000
    return None if whole_ms < max(1, shortest_ms) else whole_ms * 1000
