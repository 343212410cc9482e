"""Axes and attitude: the paper's axes to MAVLink's and back, Euler angles, quaternions.

Inside the simulator everything is in the paper's axes: world x north, y west, z up; body
x forward, y left, z up; R = Rz(yaw) Ry(pitch) Rx(roll) takes body to world (eq 3). MAVLink is
NED (north, east, down) and FRD (forward, right, down): x is the same, y and z change sign;
roll is the same, pitch and yaw change sign. This is the only file of `sim_vehicle` where
signs change. Every conversion is its own inverse; both names exist so that code reads right.

Arrays have the component first and an optional batch last: `(3,)` or `(3, N)`.

The second half splits arrays into *rows*: one row is a Python float for one vehicle and an
`(N,)` array for a batch. Formulas written on rows are the same code for both, and for one
vehicle they run several times faster than numpy on tiny arrays.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Row: TypeAlias = float | Array
AnyRow = TypeVar("AnyRow", float, Array)

# ------------------------------------------------------------------ the paper's axes <-> MAVLink


def _negate_from(values: Array, first: int) -> Array:
    """Copy with every row from `first` on negated."""
    result = np.array(values, dtype=np.float64)
    np.negative(result[first:], out=result[first:])
    return result


def vector_to_ned(vector: Array) -> Array:
    """World vector (3[, N]), north-west-up to north-east-down. Any unit."""
    return _negate_from(vector, 1)


def vector_from_ned(vector: Array) -> Array:
    """World vector (3[, N]), north-east-down to north-west-up. Any unit."""
    return _negate_from(vector, 1)


def body_to_frd(vector: Array) -> Array:
    """Body vector (3[, N]), for instance body rates [rad/s], forward-left-up to forward-right-down."""
    return _negate_from(vector, 1)


def body_from_frd(vector: Array) -> Array:
    """Body vector (3[, N]), for instance body rates [rad/s], forward-right-down to forward-left-up."""
    return _negate_from(vector, 1)


def euler_to_ned(euler: Array) -> Array:
    """Roll, pitch, yaw (3[, N]) [rad] in the paper's axes to those of MAVLink ATTITUDE."""
    return _negate_from(euler, 1)


def euler_from_ned(euler: Array) -> Array:
    """Roll, pitch, yaw (3[, N]) [rad] of MAVLink ATTITUDE to the paper's axes."""
    return _negate_from(euler, 1)


def quaternion_to_ned(quaternion: Array) -> Array:
    """Attitude quaternion (4[, N]), w first: body to world in the paper's axes, to FRD to NED."""
    return _negate_from(quaternion, 2)


def quaternion_from_ned(quaternion: Array) -> Array:
    """Attitude quaternion (4[, N]), w first: FRD to NED, to body to world in the paper's axes."""
    return _negate_from(quaternion, 2)


def flipped(rows: Sequence[float]) -> list[float]:
    """The same of one vehicle's vector (3), Euler angles (3) or quaternion (4), either way, in floats."""
    first = len(rows) - 2
    return [*rows[:first], *[-row for row in rows[first:]]]


# --------------------------------------------------------------------------------- attitude


def wrap_angle(angle: Array) -> Array:
    """Angles of any shape [rad] into [-pi, pi)."""
    return np.asarray(wrapped(angle), dtype=np.float64)


def wrapped(angle: AnyRow) -> AnyRow:
    """One row of angles [rad] into [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


def rotation_matrix(euler: Array) -> Array:
    """Body to world matrix (3, 3[, N]) of roll, pitch, yaw (3[, N]) [rad]; its third column is eq 5."""
    entries = array_of(rotation_rows_from_euler(rows_of(euler)))
    return entries.reshape((3, 3, *entries.shape[1:]))


def quaternion_from_euler(euler: Array) -> Array:
    """Unit quaternion (4[, N]), w first, w >= 0 near level, of roll, pitch, yaw (3[, N]) [rad]."""
    return array_of(quaternion_rows_from_euler(rows_of(euler)))


def euler_from_quaternion(quaternion: Array) -> Array:
    """Roll, pitch, yaw (3[, N]) [rad] of a unit quaternion (4[, N]), w first; pitch in [-pi/2, pi/2]."""
    return array_of(euler_rows_from_quaternion(rows_of(quaternion)))


# ------------------------------------------------------------------------------------- rows


def rows_of(array: Array) -> list[Row]:
    """Split an array along its first axis: floats for one vehicle, `(N,)` arrays for a batch."""
    rows: list[Row] = array.tolist() if array.ndim == 1 else list(array)
    return rows


def array_of(rows: Sequence[Row]) -> Array:
    """Inverse of `rows_of`; floats among arrays are spread over the batch."""
    for row in rows:
        if not isinstance(row, float):
            return np.stack(np.broadcast_arrays(*rows))
    return np.array(rows, dtype=np.float64)


def sine_cosine(angle: Row) -> tuple[Row, Row]:
    """Sine and cosine of one row [rad]."""
    if isinstance(angle, float):
        return math.sin(angle), math.cos(angle)
    return np.sin(angle), np.cos(angle)


def at_most(value: Row, bound: Row) -> Row:
    """Smaller of the two; a `value` that is not a number stays so."""
    if isinstance(value, float) and isinstance(bound, float):
        return min(value, bound)
    return np.minimum(value, bound)


def at_least(value: Row, bound: Row) -> Row:
    """Larger of the two; a `value` that is not a number stays so."""
    if isinstance(value, float) and isinstance(bound, float):
        return max(value, bound)
    return np.maximum(value, bound)


Limit: TypeAlias = Callable[[Row, Row], Row]


def limits(*rows: Row) -> tuple[Limit, Limit]:
    """`at_most` and `at_least` for many uses on `rows` and numbers made of them."""
    for row in rows:
        if not isinstance(row, float):
            return np.minimum, np.maximum
    return min, max


def rotation_rows_from_euler(euler: Sequence[Row]) -> tuple[Row, ...]:
    """Nine entries, row by row, of R = Rz(yaw) Ry(pitch) Rx(roll) (eq 3)."""
    (sr, cr), (sp, cp), (sy, cy) = (sine_cosine(angle) for angle in euler)
    return (
        cp * cy,
        sr * sp * cy - cr * sy,
        cr * sp * cy + sr * sy,
        cp * sy,
        sr * sp * sy + cr * cy,
        cr * sp * sy - sr * cy,
        -sp,
        sr * cp,
        cr * cp,
    )


def rotation_rows_from_quaternion(quaternion: Sequence[Row]) -> tuple[Row, ...]:
    """Nine entries, row by row, of the rotation matrix of a unit quaternion, w first."""
    w, x, y, z = quaternion
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


def quaternion_rows_from_euler(euler: Sequence[Row]) -> tuple[Row, Row, Row, Row]:
    """Four rows, w first, of the quaternion of roll, pitch, yaw [rad]."""
    (sr, cr), (sp, cp), (sy, cy) = (sine_cosine(0.5 * angle) for angle in euler)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def euler_rows_from_quaternion(quaternion: Sequence[Row]) -> tuple[Row, Row, Row]:
    """Roll, pitch, yaw [rad] of a unit quaternion, w first."""
    w, x, y, z = quaternion
    roll = 2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)
    yaw = 2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)
    sine = 2.0 * (w * y - z * x)
    if isinstance(sine, float):
        pitch = math.asin(min(1.0, max(-1.0, sine)))  # rounding may leave [-1, 1] at vertical
        return math.atan2(*roll), pitch, math.atan2(*yaw)
    return np.arctan2(*roll), np.arcsin(np.clip(sine, -1.0, 1.0)), np.arctan2(*yaw)
