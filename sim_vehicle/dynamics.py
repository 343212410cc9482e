"""Rigid-body dynamics of a quadrotor with a load: eq 4-15 of the paper, batched.

State rows, `(12,)` or `(12, N)`: position 0:3 [m] and velocity 3:6 [m/s] in the world (x north,
y west, z up), euler 6:9 (roll, pitch, yaw) [rad], body_rates 9:12 [rad/s].

Wrench rows, `(4,)` or `(4, N)`, eq 14: U1 total thrust along body z [N], U2 = F2 - F4 and
U3 = F3 - F1 [N] (the arm enters in eq 15), U4 yaw moment [N m].

Two readings of the same equations:

``paper``
    Eq 15 as published, corrected as follows. The gyroscopic terms have the signs of eq 12,
    -(I_z - I_y) q r and so on (eq 15 prints the opposite on every axis; eq 12 is Euler's
    equation). Yaw drag is K_f, not l K_f (eq 11 and 15 against eq 12). Euler rates equal body
    rates. The position is that of the common centre of mass. Angles are not wrapped.

``rigid-body``
    Newton-Euler without those simplifications. Euler rates come from body rates, thrust and
    drag act at the airframe's centre and so turn the vehicle when the common centre of mass is
    elsewhere, and the inertia tensor may have products. The position and velocity are those of
    the *airframe's centre*, where the autopilot sits: at a drop the airframe goes on with its own
    velocity, whatever the centre of mass does. Integration goes through a quaternion, so pitching
    through 90 degrees is nothing special; yaw comes back in [-pi, pi].

Differs from the paper also in that drag is taken relative to the air (`wind_velocity`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from sim_vehicle.frames import (
    Array,
    Row,
    array_of,
    euler_rows_from_quaternion,
    quaternion_rows_from_euler,
    rotation_rows_from_euler,
    rotation_rows_from_quaternion,
    rows_of,
    sine_cosine,
)

Kinematics: TypeAlias = Literal["paper", "rigid-body"]

POSITION = slice(0, 3)
VELOCITY = slice(3, 6)
EULER = slice(6, 9)
BODY_RATES = slice(9, 12)


def _no_vector() -> Array:
    return np.zeros(3)


@dataclass(frozen=True, eq=False, slots=True)
class MassProperties:
    """Vehicle and load as one body (eq 13; `payload.mass_properties` makes it).

    Attributes
    ----------
    mass : float or (N,) [kg]
    inertia : (3[, N]) [kg m^2]; moments about body x, y, z through the common centre of mass
    arm_length : float or (N,) [m]; lever of U2 and U3
    center_of_mass : (3[, N]) [m]; in body axes from the airframe's centre
    products_of_inertia : (3[, N]) [kg m^2]; the tensor's entries xy, xz, yz (rigid-body only)
    """

    mass: Row
    inertia: Array
    arm_length: Row
    center_of_mass: Array
    products_of_inertia: Array = field(default_factory=_no_vector)


class _Terms(NamedTuple):
    """Everything that stays constant during one integration step, split into rows."""

    wrench: list[Row]
    mass: Row
    inertia: list[Row]
    products: list[Row]
    inverse: tuple[Row, ...]  # of the tensor: xx, yy, zz, xy, xz, yz
    arm: Row
    center: list[Row]
    drag: float
    gravity: float
    force: list[Row]
    torque: list[Row]
    wind: list[Row]


def _inverse_inertia(inertia: Sequence[Row], products: Sequence[Row]) -> tuple[Row, ...]:
    """Entries xx, yy, zz, xy, xz, yz of the inverse of a symmetric 3 x 3 tensor (adjugate)."""
    (xx, yy, zz), (xy, xz, yz) = inertia, products
    cofactor_xx = yy * zz - yz * yz
    cofactor_xy = xz * yz - xy * zz
    cofactor_xz = xy * yz - xz * yy
    scale = 1.0 / (xx * cofactor_xx + xy * cofactor_xy + xz * cofactor_xz)
    return (
        cofactor_xx * scale,
        (xx * zz - xz * xz) * scale,
        (xx * yy - xy * xy) * scale,
        cofactor_xy * scale,
        cofactor_xz * scale,
        (xy * xz - xx * yz) * scale,
    )


def _terms(
    wrench: Array,
    properties: MassProperties,
    drag: float,
    gravity: float,
    force: Array | None,
    torque: Array | None,
    wind: Array | None,
) -> _Terms:
    one = isinstance(properties.mass, float)
    inertia, products, inverse, center = (_kept_body_rows if one else _body_rows)(properties)
    return _Terms(
        rows_of(wrench),
        properties.mass,
        inertia,
        products,
        inverse,
        properties.arm_length,
        center,
        drag,
        gravity,
        _rows_or_zero(force),
        _rows_or_zero(torque),
        _rows_or_zero(wind),
    )


def _body_rows(properties: MassProperties) -> tuple[list[Row], list[Row], tuple[Row, ...], list[Row]]:
    """Moments and products of inertia, the inverse of their tensor, and the centre of mass."""
    inertia, products = rows_of(properties.inertia), rows_of(properties.products_of_inertia)
    return inertia, products, _inverse_inertia(inertia, products), rows_of(properties.center_of_mass)


_kept_body_rows = lru_cache(maxsize=64)(_body_rows)
"""Of one vehicle, whose load changes a few times in a flight, not in every step."""


def _rows_or_zero(vector: Array | None) -> list[Row]:
    return [0.0, 0.0, 0.0] if vector is None else rows_of(vector)


def _paper_rates(rows: Sequence[Row], t: _Terms) -> list[Row]:
    """Eq 15 with the signs of eq 12: time derivatives of the 12 state rows."""
    vx, vy, vz, roll, pitch, yaw, p, q, r = rows[3:]
    rotation = rotation_rows_from_euler((roll, pitch, yaw))
    u1, u2, u3, u4 = t.wrench
    ix, iy, iz = t.inertia
    (fx, fy, fz), (mx, my, mz), (wx, wy, wz) = t.force, t.torque, t.wind
    return [
        vx,
        vy,
        vz,
        (u1 * rotation[2] - t.drag * (vx - wx) + fx) / t.mass,
        (u1 * rotation[5] - t.drag * (vy - wy) + fy) / t.mass,
        (u1 * rotation[8] - t.drag * (vz - wz) + fz) / t.mass - t.gravity,
        p,
        q,
        r,
        (t.arm * u2 - (iz - iy) * q * r - t.arm * t.drag * p + mx) / ix,
        (t.arm * u3 - (ix - iz) * p * r - t.arm * t.drag * q + my) / iy,
        (u4 - (iy - ix) * p * q - t.drag * r + mz) / iz,
    ]


def _rigid_accelerations(
    rotation: Sequence[Row], velocity: Sequence[Row], rates: Sequence[Row], t: _Terms
) -> tuple[Row, ...]:
    """Acceleration of the airframe's centre (world) and angular acceleration (body), six rows."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation
    (vx, vy, vz), (p, q, r) = velocity, rates
    u1, u2, u3, u4 = t.wrench
    (ix, iy, iz), (ixy, ixz, iyz), (cx, cy, cz) = t.inertia, t.products, t.center
    (fx, fy, fz), (mx, my, mz), (wx, wy, wz) = t.force, t.torque, t.wind
    dx, dy, dz = t.drag * (wx - vx), t.drag * (wy - vy), t.drag * (wz - vz)
    # Force at the airframe's centre in body axes, and its moment -c x F about the centre of mass.
    bx = r00 * dx + r10 * dy + r20 * dz
    by = r01 * dx + r11 * dy + r21 * dz
    bz = r02 * dx + r12 * dy + r22 * dz + u1
    hx, hy, hz = ix * p + ixy * q + ixz * r, ixy * p + iy * q + iyz * r, ixz * p + iyz * q + iz * r
    tx = t.arm * (u2 - t.drag * p) + cz * by - cy * bz - (q * hz - r * hy) + mx
    ty = t.arm * (u3 - t.drag * q) + cx * bz - cz * bx - (r * hx - p * hz) + my
    tz = u4 - t.drag * r + cy * bx - cx * by - (p * hy - q * hx) + mz
    jxx, jyy, jzz, jxy, jxz, jyz = t.inverse
    ap = jxx * tx + jxy * ty + jxz * tz
    aq = jxy * tx + jyy * ty + jyz * tz
    ar = jxz * tx + jyz * ty + jzz * tz
    # What the centre of mass has on top of the airframe's centre: alpha x c + omega x (omega x c).
    along = p * cx + q * cy + r * cz
    square = p * p + q * q + r * r
    sx = aq * cz - ar * cy + p * along - cx * square
    sy = ar * cx - ap * cz + q * along - cy * square
    sz = ap * cy - aq * cx + r * along - cz * square
    return (
        (u1 * r02 + dx + fx) / t.mass - (r00 * sx + r01 * sy + r02 * sz),
        (u1 * r12 + dy + fy) / t.mass - (r10 * sx + r11 * sy + r12 * sz),
        (u1 * r22 + dz + fz) / t.mass - t.gravity - (r20 * sx + r21 * sy + r22 * sz),
        ap,
        aq,
        ar,
    )


def _rigid_rates(rows: Sequence[Row], t: _Terms) -> list[Row]:
    """Time derivatives of the 12 state rows; singular at a pitch of 90 degrees."""
    velocity, euler, rates = rows[3:6], rows[6:9], rows[9:12]
    accelerations = _rigid_accelerations(rotation_rows_from_euler(euler), velocity, rates, t)
    (sine_roll, cosine_roll), (sine_pitch, cosine_pitch) = sine_cosine(euler[0]), sine_cosine(euler[1])
    p, q, r = rates
    yaw_rate = (sine_roll * q + cosine_roll * r) / cosine_pitch
    euler_rates = (p + sine_pitch * yaw_rate, cosine_roll * q - sine_roll * r, yaw_rate)
    return [*velocity, *accelerations[:3], *euler_rates, *accelerations[3:]]


def _rigid_quaternion_rates(rows: Sequence[Row], t: _Terms) -> list[Row]:
    """Time derivatives of 13 rows: position, velocity, quaternion (w first), body rates."""
    velocity, (w, x, y, z), rates = rows[3:6], rows[6:10], rows[10:13]
    accelerations = _rigid_accelerations(rotation_rows_from_quaternion((w, x, y, z)), velocity, rates, t)
    p, q, r = 0.5 * rates[0], 0.5 * rates[1], 0.5 * rates[2]
    return [
        *velocity,
        *accelerations[:3],
        -x * p - y * q - z * r,
        w * p + y * r - z * q,
        w * q + z * p - x * r,
        w * r + x * q - y * p,
        *accelerations[3:],
    ]


def _runge_kutta(
    rates: Callable[[Sequence[Row], _Terms], list[Row]], rows: list[Row], terms: _Terms, dt: float
) -> list[Row]:
    """One step of the classical fourth-order Runge-Kutta method."""
    half, sixth = 0.5 * dt, dt / 6.0
    first = rates(rows, terms)
    second = rates([x + half * k for x, k in zip(rows, first, strict=True)], terms)
    third = rates([x + half * k for x, k in zip(rows, second, strict=True)], terms)
    fourth = rates([x + dt * k for x, k in zip(rows, third, strict=True)], terms)
    return [
        x + sixth * (a + 2.0 * (b + c) + d)
        for x, a, b, c, d in zip(rows, first, second, third, fourth, strict=True)
    ]


def _integrate_rigid(rows: list[Row], terms: _Terms, dt: float) -> list[Row]:
    """Rigid-body step of the 12 state rows by way of a quaternion."""
    quaternion = quaternion_rows_from_euler(rows[6:9])
    rows = _runge_kutta(_rigid_quaternion_rates, [*rows[:6], *quaternion, *rows[9:12]], terms, dt)
    w, x, y, z = rows[6:10]
    scale = (w * w + x * x + y * y + z * z) ** -0.5
    euler = euler_rows_from_quaternion((w * scale, x * scale, y * scale, z * scale))
    return [*rows[:6], *euler, *rows[10:13]]


def derivatives(
    state: Array,
    wrench: Array,
    mass_properties: MassProperties,
    drag: float,
    gravity: float,
    disturbance_force: Array | None = None,
    disturbance_torque: Array | None = None,
    kinematics: Kinematics = "rigid-body",
    wind_velocity: Array | None = None,
) -> Array:
    """Time derivative of the state, eq 15 or Newton-Euler (see the head of this file).

    Parameters
    ----------
    state : (12[, N]); see the head of this file
    wrench : (4[, N]); U1..U4 of eq 14
    mass_properties : of vehicle and load
    drag : K_f; N s/m in translation, and l K_f, l K_f, K_f in N m s about roll, pitch, yaw
    gravity : m/s^2
    disturbance_force : (3[, N]) N in the world, through the common centre of mass
    disturbance_torque : (3[, N]) N m in body axes
    kinematics : "paper" or "rigid-body"
    wind_velocity : (3[, N]) m/s in the world

    Returns
    -------
    (12[, N]) derivative of `state` per second. In "rigid-body" the Euler rates are singular at a
    pitch of 90 degrees (`integrate` is not).
    """
    terms = _terms(
        wrench, mass_properties, drag, gravity, disturbance_force, disturbance_torque, wind_velocity
    )
    rates = _paper_rates if kinematics == "paper" else _rigid_rates
    return array_of(rates(rows_of(state), terms))


def integrate(
    state: Array,
    wrench: Array,
    mass_properties: MassProperties,
    drag: float,
    gravity: float,
    disturbance_force: Array | None = None,
    disturbance_torque: Array | None = None,
    kinematics: Kinematics = "rigid-body",
    dt: float = 0.0025,
    wind_velocity: Array | None = None,
) -> Array:
    """State (12[, N]) after `dt` seconds: one Runge-Kutta step with every input held.

    The parameters are those of `derivatives`.
    """
    terms = _terms(
        wrench, mass_properties, drag, gravity, disturbance_force, disturbance_torque, wind_velocity
    )
    rows = rows_of(state)
    if kinematics == "paper":
        return array_of(_runge_kutta(_paper_rates, rows, terms, dt))
    return array_of(_integrate_rigid(rows, terms, dt))
