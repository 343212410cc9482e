"""Euler angles and body rates: the kinematics behind eq 3, R = Rz(yaw) Ry(pitch) Rx(roll).

Differs from the paper in: the paper takes Euler rates for body rates (its "small angle" reading
of eq 15); a rate setpoint for a real autopilot has to be a true body rate. Batch first: vectors
are three numbers, ``(3,)`` or ``(3, N)``, in the paper's axes (body x forward, y left, z up).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from kffa_offboard.control import Array
from kffa_offboard.control.tracing import Tape, compiled

Vector3: TypeAlias = tuple[float, float, float]
Vector: TypeAlias = Array | Vector3

# cos(pitch) is held this far from zero, so that a vehicle carried by hand nose-down gives large
# rates instead of infinite ones. Nothing flies there: the tilt limit is far below.
_COSINE_FLOOR = 1e-3


class Tilt(NamedTuple):
    """Sines and cosines of roll and pitch, ``(N,)`` or one number each."""

    sin_roll: Array
    cos_roll: Array
    sin_pitch: Array
    cos_pitch: Array


def tilt(euler: Vector) -> Tilt:
    """Of Euler angles ``(3[, N])``."""
    roll, pitch, _ = euler
    return Tilt(np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch))


def euler_rates_to_body_rates(euler: Vector, euler_rates: Vector) -> Array:
    """Body rates [rad/s] that turn the Euler angles `euler` [rad] at `euler_rates` [rad/s].

    Parameters
    ----------
    euler, euler_rates : (3[, N])
        Roll, pitch, yaw and their derivatives.
    """
    return to_body_rates(tilt(euler), euler_rates)


def to_body_rates(tilted: Tilt, euler_rates: Vector) -> Array:
    """`euler_rates_to_body_rates` with a known `tilt`."""
    sin_roll, cos_roll, sin_pitch, cos_pitch = tilted
    roll_rate, pitch_rate, yaw_rate = euler_rates
    return np.stack(
        [
            roll_rate - sin_pitch * yaw_rate,
            cos_roll * pitch_rate + sin_roll * cos_pitch * yaw_rate,
            -sin_roll * pitch_rate + cos_roll * cos_pitch * yaw_rate,
        ]
    )


def body_rates_to_euler_rates(euler: Vector, body_rates: Vector) -> Array:
    """Derivatives [rad/s] of the Euler angles `euler` [rad] under `body_rates` [rad/s]; both ``(3[, N])``.

    Singular at pitch = +-90 degrees; there cos(pitch) is held at 1e-3, so the answer stays finite.
    """
    return to_euler_rates(tilt(euler), body_rates)


def to_euler_rates(tilted: Tilt, body_rates: Vector) -> Array:
    """`body_rates_to_euler_rates` with a known `tilt`."""
    sin_roll, cos_roll, sin_pitch, cos_pitch = tilted
    p, q, r = body_rates
    cos_pitch = np.copysign(np.maximum(np.abs(cos_pitch), _COSINE_FLOOR), cos_pitch)
    turning = sin_roll * q + cos_roll * r
    return np.stack(
        [
            p + sin_pitch / cos_pitch * turning,
            cos_roll * q - sin_roll * r,
            turning / cos_pitch,
        ]
    )


@cache
def _straight(function: Callable[[Any, Any], Array]) -> Callable[[Vector3, Vector3], Any]:
    """`function` of two vectors, written out for one vehicle (`tracing`)."""
    tape = Tape()
    arguments = {name: tape.inputs(name, (3,)) for name in ("a", "b")}
    first, second = arguments.values()
    return compiled(tape, arguments, [function(first, second)])


def body_rates_of(euler: Vector3, euler_rates: Vector3) -> Vector3:
    """`euler_rates_to_body_rates` for three floats each."""
    p, q, r = _straight(euler_rates_to_body_rates)(euler, euler_rates)
    return p, q, r


def euler_rates_of(euler: Vector3, body_rates: Vector3) -> Vector3:
    """`body_rates_to_euler_rates` for three floats each."""
    roll_rate, pitch_rate, yaw_rate = _straight(body_rates_to_euler_rates)(euler, body_rates)
    return roll_rate, pitch_rate, yaw_rate


def wrap_angle(angle: Array) -> Array:
    """The same angle [rad] in [-pi, pi); any shape."""
    return (np.asarray(angle, dtype=float) + np.pi) % (2.0 * np.pi) - np.pi
