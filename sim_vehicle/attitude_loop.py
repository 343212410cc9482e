"""Attitude control of the simulated autopilot: quaternions in, body-rate setpoints out.

Quaternions are (w, x, y, z), body to world, in the paper's axes; errors are rotation vectors in
body axes [rad]. The error is split into a tilt (which moves the thrust) and a twist about the thrust
axis (heading), as PX4 (src/modules/mc_att_control/AttitudeControl) and ArduCopter (AC_AttitudeControl,
thrust vector first) both do, so that a large heading error never tilts the vehicle.

ArduCopter does not steer to the setpoint itself but to a *target attitude* that moves towards it with
limited acceleration; `shape_rate` and `square_root_rate` are that shaping.
"""

from __future__ import annotations

import math
from typing import TypeAlias

Vector3: TypeAlias = tuple[float, float, float]
Quaternion: TypeAlias = tuple[float, float, float, float]

LEVEL: Quaternion = (1.0, 0.0, 0.0, 0.0)


def from_euler(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Quaternion of R = Rz(yaw) Ry(pitch) Rx(roll) (eq 3) [rad]."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def yaw_of(q: Quaternion) -> float:
    """Heading angle [rad] of a quaternion."""
    w, x, y, z = q
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Hamilton product a b: first b, then a."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(q: Quaternion) -> Quaternion:
    """Inverse of a unit quaternion."""
    return q[0], -q[1], -q[2], -q[3]


def normalised(q: Quaternion) -> Quaternion:
    """Unit quaternion of the same direction; `q` must not be zero."""
    size = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return q[0] / size, q[1] / size, q[2] / size, q[3] / size


def rotation_vector(q: Quaternion) -> Vector3:
    """Rotation vector [rad], at most pi long, of a unit quaternion."""
    w, x, y, z = q if q[0] >= 0.0 else (-q[0], -q[1], -q[2], -q[3])
    sine = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if sine < 1e-9 else 2.0 * math.atan2(sine, w) / sine
    return scale * x, scale * y, scale * z


def advanced(q: Quaternion, body_rates: Vector3, dt: float) -> Quaternion:
    """Quaternion after turning with constant `body_rates` [rad/s] for `dt` seconds."""
    x, y, z = body_rates
    rate = math.sqrt(x * x + y * y + z * z)
    half = 0.5 * rate * dt
    scale = 0.5 * dt if rate < 1e-9 else math.sin(half) / rate
    return normalised(multiply(q, (math.cos(half), scale * x, scale * y, scale * z)))


def error(attitude: Quaternion, target: Quaternion) -> Vector3:
    """What is missing from `attitude` to `target`: tilt about x and y, twist about z [rad], body axes."""
    w, x, y, z = multiply(conjugate(attitude), target)
    if w < 0.0:
        w, x, y, z = -w, -x, -y, -z
    size = math.hypot(w, z)
    if size < 1e-9:  # upside down: the heading means nothing, any tilt axis will do
        return math.pi * x, math.pi * y, 0.0
    twist = (w / size, 0.0, 0.0, z / size)
    tilt = rotation_vector(multiply((w, x, y, z), conjugate(twist)))
    return tilt[0], tilt[1], 2.0 * math.atan2(z, w)


def towards(attitude: Quaternion, target: Quaternion, angle: float) -> Quaternion:
    """`attitude` turned by `angle` [rad] in the direction of `target`."""
    x, y, z = rotation_vector(multiply(conjugate(attitude), target))
    return advanced(attitude, (x, y, z), angle / max(1e-9, math.sqrt(x * x + y * y + z * z)))


def limit(value: float, bound: float) -> float:
    """`value` within plus and minus `bound`."""
    return min(bound, max(-bound, value))


def square_root_rate(error_angle: float, gain: float, acceleration_limit: float) -> float:
    """Rate [rad/s] that closes an angle [rad] with at most `acceleration_limit` [rad/s^2]; 0 = no limit.

    Proportional close to the target, the square root of the distance (constant deceleration) far from it.
    """
    if acceleration_limit <= 0.0:
        return gain * error_angle
    linear = acceleration_limit / (gain * gain)
    if abs(error_angle) <= linear:
        return gain * error_angle
    speed = math.sqrt(2.0 * acceleration_limit * (abs(error_angle) - 0.5 * linear))
    return math.copysign(speed, error_angle)


def shape_rate(rate: float, wanted: float, acceleration_limit: float, dt: float) -> float:
    """`rate` moved towards `wanted` [rad/s] with at most `acceleration_limit` [rad/s^2]; 0 = at once."""
    if acceleration_limit <= 0.0:
        return wanted
    return rate + limit(wanted - rate, acceleration_limit * dt)
