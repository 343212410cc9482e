"""Euler angles and body rates: the kinematics behind eq 3, R = Rz(yaw) Ry(pitch) Rx(roll).

Differs from the paper in: the paper takes Euler rates for body rates (its "small angle" reading
of eq 15); a rate setpoint for a real autopilot has to be a true body rate. Batch first: vectors
are ``(3,)`` or ``(3, N)``, in the paper's axes (body x forward, y left, z up).
"""

from __future__ import annotations

import numpy as np

from kffa_offboard.control import Array

# cos(pitch) is held this far from zero, so that a vehicle carried by hand nose-down gives large
# rates instead of infinite ones. Nothing flies there: the tilt limit is far below.
_COSINE_FLOOR = 1e-3


def euler_rates_to_body_rates(euler: Array, euler_rates: Array) -> Array:
    """Body rates [rad/s] that turn the Euler angles `euler` [rad] at `euler_rates` [rad/s].

    Parameters
    ----------
    euler, euler_rates : (3[, N])
        Roll, pitch, yaw and their derivatives.
    """
    roll, pitch = euler[0], euler[1]
    roll_rate, pitch_rate, yaw_rate = euler_rates[0], euler_rates[1], euler_rates[2]
    return np.stack(
        [
            roll_rate - np.sin(pitch) * yaw_rate,
            np.cos(roll) * pitch_rate + np.sin(roll) * np.cos(pitch) * yaw_rate,
            -np.sin(roll) * pitch_rate + np.cos(roll) * np.cos(pitch) * yaw_rate,
        ]
    )


def body_rates_to_euler_rates(euler: Array, body_rates: Array) -> Array:
    """Derivatives [rad/s] of the Euler angles `euler` [rad] under `body_rates` [rad/s]; both ``(3[, N])``.

    Singular at pitch = +-90 degrees; there cos(pitch) is held at 1e-3, so the answer stays finite.
    """
    roll, pitch = euler[0], euler[1]
    p, q, r = body_rates[0], body_rates[1], body_rates[2]
    cosine = np.cos(pitch)
    cosine = np.where(np.abs(cosine) < _COSINE_FLOOR, np.copysign(_COSINE_FLOOR, cosine), cosine)
    turning = np.sin(roll) * q + np.cos(roll) * r
    return np.stack(
        [
            p + np.sin(pitch) / cosine * turning,
            np.cos(roll) * q - np.sin(roll) * r,
            turning / cosine,
        ]
    )


def wrap_angle(angle: Array) -> Array:
    """The same angle [rad] in [-pi, pi); any shape."""
    return (np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi
