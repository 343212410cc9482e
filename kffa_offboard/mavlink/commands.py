"""Outputs -> MAVLink messages that are the same for every firmware.

Nothing is packed that an autopilot could take for a setpoint but that is not one: NaN, infinity and
values out of range raise `EncodingError`. The guard in `offboard/` keeps such values from coming
here; this is the last door.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.frame_codec import Outgoing
from kffa_offboard.mavlink import frames
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.offboard.events import (
    Announce,
    AttitudeTarget,
    OwnHeartbeat,
    PayloadReport,
    SetArmed,
    SetGripper,
    Severity,
    Vector3,
)

RATES_AND_THRUST = mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE
"""Type mask 128. Any other mask with rates stops motors or is refused by one firmware (autopilots.md)."""

ATTITUDE_AND_THRUST = (
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
    | mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
    | mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
)
"""Type mask 7."""

BODY_RATE_LIMIT = math.radians(2000.0)
"""No rate gyro measures more; a setpoint beyond it is a mistake, not a manoeuvre."""

_BODY_RATES = ("body rate p [rad/s]", "body rate q [rad/s]", "body rate r [rad/s]")

TEXT_SIZE = 50

_SEVERITIES = {
    Severity.CRITICAL: mavlink.MAV_SEVERITY_CRITICAL,
    Severity.WARNING: mavlink.MAV_SEVERITY_WARNING,
    Severity.NOTICE: mavlink.MAV_SEVERITY_NOTICE,
    Severity.INFO: mavlink.MAV_SEVERITY_INFO,
}
_STATES = {
    "standby": mavlink.MAV_STATE_STANDBY,
    "active": mavlink.MAV_STATE_ACTIVE,
    "critical": mavlink.MAV_STATE_CRITICAL,
}
_GRIPPER_ACTIONS = {"release": mavlink.GRIPPER_ACTION_RELEASE, "grab": mavlink.GRIPPER_ACTION_GRAB}


class EncodingError(ValueError):
    """An output that must not be sent: what it is, its value and the limit."""


def _check(name: str, value: float, lowest: float, highest: float) -> None:
    if not lowest <= value <= highest:  # NaN fails too
        raise EncodingError(f"{name} {value:g} is outside {lowest:g}..{highest:g}; not sent")


def attitude_target(route: Route, target: AttitudeTarget, time_us: int) -> Message:
    """SET_ATTITUDE_TARGET with mask 128 (rates) or 7 (attitude), quaternion always of unit norm."""
    if (target.body_rates is None) == (target.attitude is None):
        raise EncodingError("a setpoint needs either body rates or an attitude, and not both; not sent")
    _check("thrust", target.thrust, 0.0, 1.0)
    mask, quaternion, body_rates = RATES_AND_THRUST, frames.LEVEL, (0.0, 0.0, 0.0)
    if target.body_rates is not None:
        body_rates = _checked_body_rates(target.body_rates)
    if target.attitude is not None:
        mask, quaternion = ATTITUDE_AND_THRUST, _checked_quaternion(target.attitude)
    vehicle = route.target_system, route.target_component
    values = (time_us // 1000 % 2**32, *quaternion, *body_rates, target.thrust, *vehicle, mask)
    return Outgoing(mavlink.MAVLink_set_attitude_target_message, values)


def _checked_body_rates(body_rates: Vector3) -> Vector3:
    (p, q, r), most = body_rates, BODY_RATE_LIMIT
    if not (-most <= p <= most and -most <= q <= most and -most <= r <= most):
        for name, rate in zip(_BODY_RATES, body_rates, strict=True):
            _check(name, rate, -most, most)
    return frames.body_rates_to_frd(body_rates)


def _checked_quaternion(attitude: Vector3) -> frames.Quaternion:
    roll, pitch, yaw = attitude
    _check("roll [rad]", roll, -math.pi, math.pi)
    _check("pitch [rad]", pitch, -math.pi / 2, math.pi / 2)
    _check("yaw [rad]", yaw, -1e6, 1e6)  # any turn count; only NaN and infinity are wrong
    return frames.quaternion_from_euler(frames.euler_to_ned(attitude))


def command_long(route: Route, command: int, *parameters: float) -> Message:
    """COMMAND_LONG to the vehicle; parameters not given are 0."""
    padded = (*parameters, *[0.0] * (7 - len(parameters)))
    return mavlink.MAVLink_command_long_message(
        route.target_system, route.target_component, command, 0, *padded
    )


def message_interval(route: Route, message_id: int, interval_us: int) -> Message:
    """Ask for a message every `interval_us`."""
    return command_long(route, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)


def set_mode(route: Route, main_mode: int, sub_mode: int) -> Message:
    """Ask for a flight mode by the firmware's own numbers."""
    flag = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    return command_long(route, mavlink.MAV_CMD_DO_SET_MODE, flag, main_mode, sub_mode)


def set_armed(route: Route, order: SetArmed) -> Message:
    """Arm or disarm. Parameter 2 stays 0: the autopilot's own checks decide, nothing is forced."""
    return command_long(route, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, float(order.armed), 0.0)


def set_gripper(route: Route, order: SetGripper) -> Message:
    """Work the first gripper."""
    return command_long(route, mavlink.MAV_CMD_DO_GRIPPER, 1.0, _GRIPPER_ACTIONS[order.action])


def set_origin(route: Route, latitude: int, longitude: int, altitude: int) -> Message:
    """Where the vehicle's own coordinates begin: 1e-7 deg, mm above the sea."""
    return mavlink.MAVLink_set_gps_global_origin_message(route.target_system, latitude, longitude, altitude)


def heartbeat(order: OwnHeartbeat) -> Message:
    """Our own HEARTBEAT: an onboard controller, no autopilot."""
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, _STATES[order.state], 3
    )


def status_text(announcement: Announce, text_id: int) -> list[Message]:
    """STATUSTEXT: one message up to 50 characters, numbered chunks beyond (they carry `text_id`, not 0).

    Characters outside ASCII become "?": not every ground station shows others.
    """
    severity = _SEVERITIES[announcement.severity]
    text = announcement.text.encode("ascii", "replace")
    if len(text) <= TEXT_SIZE:
        return [mavlink.MAVLink_statustext_message(severity, text, 0, 0)]
    # The last chunk is the one with room left, so a text of n * 50 ends with an empty one.
    chunks = [text[start : start + TEXT_SIZE] for start in range(0, len(text) + 1, TEXT_SIZE)]
    return [
        mavlink.MAVLink_statustext_message(severity, chunk, text_id, number)
        for number, chunk in enumerate(chunks)
    ]


def payload_report(report: PayloadReport) -> list[Message]:
    """Mass of the load and its standard deviation, kg, as NAMED_VALUE_FLOAT "payload_kg" and "payload_sd"."""
    time_ms = report.time_us // 1000 % 2**32
    return [
        mavlink.MAVLink_named_value_float_message(time_ms, name, value)
        for name, value in ((b"payload_kg", report.mass_kg), (b"payload_sd", report.std_kg))
    ]


def timesync_answer(request: Message, own_time_ns: int) -> Message:
    """Answer to TIMESYNC: our time in tc1, the asker's time back in ts1."""
    return mavlink.MAVLink_timesync_message(own_time_ns, request.ts1)


def is_timesync_request(message: Message) -> bool:
    """True for a TIMESYNC that asks (tc1 = 0) rather than answers."""
    return bool(message.msgname == "TIMESYNC" and message.tc1 == 0)
