"""Setpoints to the daemon: SET_POSITION_TARGET_LOCAL_NED and SET_ATTITUDE_TARGET addressed to it -> events.

Only what the daemon can do is taken; any other type mask or frame is refused with the reason.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink import frames
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.offboard.events import AttitudeSetpoint, PositionSetpoint

_XY = mavlink.POSITION_TARGET_TYPEMASK_X_IGNORE | mavlink.POSITION_TARGET_TYPEMASK_Y_IGNORE
_Z = mavlink.POSITION_TARGET_TYPEMASK_Z_IGNORE
_YAW = mavlink.POSITION_TARGET_TYPEMASK_YAW_IGNORE
_OPTIONAL = _XY | _Z | _YAW
_IGNORED = (
    mavlink.POSITION_TARGET_TYPEMASK_VX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_VZ_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AX_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AY_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_AZ_IGNORE
    | mavlink.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE
)
"""Velocity, acceleration and yaw rate: 2552. These bits must be set, those of `_OPTIONAL` may be."""

ATTITUDE_ONLY = (
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
    | mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
    | mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
    | mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE
)
"""Type mask 71: the attitude alone; the height is held."""

SETPOINTS = ("SET_POSITION_TARGET_LOCAL_NED", "SET_ATTITUDE_TARGET")
"""Types of the messages that may be setpoints for us."""

_UNIT_NORM_TOLERANCE = 0.01


class SetpointRefused(ValueError):
    """Why a setpoint is not taken; one line."""


def read_setpoint(route: Route, message: Message) -> PositionSetpoint | AttitudeSetpoint | None:
    """The setpoint in a message; None if it is none or not for us. Raises SetpointRefused."""
    kind = message.msgname
    if kind not in SETPOINTS:
        return None
    if (message.target_system, message.target_component) != (route.own_system, route.own_component):
        return None
    return _attitude(message) if kind == "SET_ATTITUDE_TARGET" else _position(message)


def _position(message: Message) -> PositionSetpoint:
    mask = message.type_mask
    if message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED:
        raise SetpointRefused(f"position setpoint: frame {message.coordinate_frame}, only LOCAL_NED (1)")
    if mask & ~_OPTIONAL != _IGNORED:
        raise SetpointRefused(f"position setpoint: mask {mask}, only position and yaw (2552)")
    if mask & _XY not in (0, _XY) or mask & _OPTIONAL == _OPTIONAL:
        raise SetpointRefused(f"position setpoint: mask {mask}, give x and y, or z, or yaw")
    x, y, z = frames.vector_from_ned(message.x, message.y, message.z)
    _, _, yaw = frames.euler_from_ned(0.0, 0.0, message.yaw)
    across = (None, None) if mask & _XY else (x, y)
    return PositionSetpoint((*across, None if mask & _Z else z), None if mask & _YAW else yaw)


def _attitude(message: Message) -> AttitudeSetpoint:
    if message.type_mask != ATTITUDE_ONLY:
        raise SetpointRefused(f"attitude setpoint: mask {message.type_mask}, only {ATTITUDE_ONLY}")
    w, x, y, z = message.q
    if not abs(w * w + x * x + y * y + z * z - 1.0) <= _UNIT_NORM_TOLERANCE:  # NaN too
        raise SetpointRefused("attitude setpoint: the quaternion is not of unit norm")
    return AttitudeSetpoint(frames.euler_from_quaternion(frames.quaternion_from_ned((w, x, y, z))))
