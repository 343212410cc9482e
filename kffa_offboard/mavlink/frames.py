"""MAVLink's axes <-> the paper's axes: the only place where signs change.

MAVLink: world north-east-down (NED), body forward-right-down (FRD). The paper: world north-west-up,
body forward-left-up. Both pairs differ by half a turn about x, so a vector keeps x and negates y
and z; roll keeps its sign, pitch and yaw change it; and each map is its own inverse. It has two
names so that a call says which way it goes.

Angles [rad], quaternions scalar first (w, x, y, z), body to world.
"""

from __future__ import annotations

import math
from typing import TypeAlias

from kffa_offboard.offboard.events import Vector3

Quaternion: TypeAlias = tuple[float, float, float, float]

LEVEL: Quaternion = (1.0, 0.0, 0.0, 0.0)
"""The attitude without rotation, the same in both axes."""


def vector_from_ned(x: float, y: float, z: float) -> Vector3:
    """World vector (position, velocity) NED -> north-west-up."""
    return (x, -y, -z)


def vector_to_ned(vector: Vector3) -> Vector3:
    """World vector north-west-up -> NED."""
    return vector_from_ned(*vector)


def body_rates_from_frd(p: float, q: float, r: float) -> Vector3:
    """Body rates [rad/s] about forward, right, down -> about forward, left, up."""
    return (p, -q, -r)


def body_rates_to_frd(body_rates: Vector3) -> Vector3:
    """Body rates [rad/s] about forward, left, up -> about forward, right, down."""
    return body_rates_from_frd(*body_rates)


def euler_from_ned(roll: float, pitch: float, yaw: float) -> Vector3:
    """Euler angles (ZYX) of FRD in NED -> of forward-left-up in north-west-up."""
    return (roll, -pitch, -yaw)


def euler_to_ned(attitude: Vector3) -> Vector3:
    """Euler angles (ZYX) of forward-left-up in north-west-up -> of FRD in NED."""
    return euler_from_ned(*attitude)


def quaternion_from_ned(quaternion: Quaternion) -> Quaternion:
    """Attitude FRD in NED -> forward-left-up in north-west-up."""
    w, x, y, z = quaternion
    return (w, x, -y, -z)


def quaternion_to_ned(quaternion: Quaternion) -> Quaternion:
    """Attitude forward-left-up in north-west-up -> FRD in NED."""
    return quaternion_from_ned(quaternion)


def quaternion_from_euler(attitude: Vector3) -> Quaternion:
    """Unit quaternion of R = Rz(yaw) Ry(pitch) Rx(roll) (paper eq 3), in whichever axes the angles are."""
    roll, pitch, yaw = attitude
    cr, sr = math.cos(roll / 2), math.sin(roll / 2)
    cp, sp = math.cos(pitch / 2), math.sin(pitch / 2)
    cy, sy = math.cos(yaw / 2), math.sin(yaw / 2)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def euler_from_quaternion(quaternion: Quaternion) -> Vector3:
    """Roll, pitch, yaw of a unit quaternion, in whichever axes it is; NaN in gives NaN out."""
    w, x, y, z = quaternion
    sine = 2 * (w * y - z * x)
    # A float32 quaternion can put the sine a rounding error outside -1..1, where asin has no answer.
    pitch = math.copysign(math.pi / 2, sine) if abs(sine) >= 1.0 else math.asin(sine)
    return (
        math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        pitch,
        math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    )
