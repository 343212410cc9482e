"""What surrounds the vehicle: wind (steady, gusty, sinusoidal) and the ground.

World axes x north, y west, z up. Everything takes `(3,)` or `(3, N)` and is pure; random numbers
come from a generator (or as drawn numbers) handed in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sim_vehicle.dynamics import MassProperties
from sim_vehicle.frames import Array, Row, array_of, at_least, at_most, rotation_rows_from_euler, rows_of

SineKind: TypeAlias = Literal["acceleration", "force", "velocity"]
Vector3: TypeAlias = tuple[float, float, float]
Touching: TypeAlias = bool | NDArray[np.bool_]


NOTHING: Array = np.zeros(3)
"""No wind, no force: one read-only array (3,) that everything calm shares."""
NOTHING.flags.writeable = False


def _no_vector() -> Array:
    return NOTHING


@dataclass(frozen=True, slots=True)
class Wind:
    """Steady wind, gusts and a sine.

    Gusts are a first-order Gauss-Markov process on each axis (the longitudinal Dryden form):
    standard deviation `gust_std` [m/s] and correlation time `gust_time_constant` [s]. Steady
    wind `mean` (3) [m/s] and gusts act through drag relative to the air. With the paper's K_f of
    0.15 N s/m that is gentle: 5 m/s of wind push a 10 kg vehicle with 0.075 m/s^2.

    The sine is the paper's Example 4, "vertically oriented sine-wave airflow, d_z = 2 sin(t)":
    `sine_amplitude` along `sine_direction` with period `sine_period` [s]. The paper gives d_z no unit. It
    is read as an *acceleration* [m/s^2] added to the third line of eq 15, the form in which a
    disturbance enters eq 19 and 21; as a "force" [N] or, through drag, a "velocity" [m/s] the same
    number would move a 10 kg vehicle with a tenth and a sixtieth of that.
    """

    mean: Vector3 = (0.0, 0.0, 0.0)
    gust_std: float = 0.0
    gust_time_constant: float = 1.0
    sine_amplitude: float = 0.0
    sine_period: float = 2.0 * math.pi
    sine_direction: Vector3 = (0.0, 0.0, 1.0)
    sine_kind: SineKind = "acceleration"

    @property
    def steady(self) -> bool:
        """It blows the same all the time."""
        return self.gust_std == 0.0 and self.sine_amplitude == 0.0

    def __post_init__(self) -> None:
        if not self.gust_std >= 0.0:
            raise ValueError(f"gust standard deviation of {self.gust_std} m/s is below zero; give 0 or more")
        for name, value in (
            ("gust time constant", self.gust_time_constant),
            ("sine period", self.sine_period),
        ):
            if not value > 0.0:
                raise ValueError(f"{name} of {value} s is not above zero; give a positive time")


@dataclass(frozen=True, eq=False, slots=True)
class EnvironmentInputs:
    """What acts on the vehicle during one step, all (3[, N]).

    wind_velocity [m/s] and force [N] and acceleration [m/s^2] (times the mass: a force) in the world;
    torque [N m] in body axes. Force and acceleration act through the common centre of mass.
    """

    wind_velocity: Array = field(default_factory=_no_vector)
    force: Array = field(default_factory=_no_vector)
    acceleration: Array = field(default_factory=_no_vector)
    torque: Array = field(default_factory=_no_vector)


CALM = EnvironmentInputs()
"""No wind and no disturbance."""


def advance_gust(wind: Wind, gust: Array, normal: Array, dt: float) -> Array:
    """Gust velocity (3[, N]) [m/s] `dt` later, exact for any dt.

    `normal` (3[, N]) are independent draws of the standard normal distribution.
    """
    keep = math.exp(-dt / wind.gust_time_constant)
    return np.asarray(keep * gust + wind.gust_std * math.sqrt(1.0 - keep * keep) * normal)


def inputs_at(wind: Wind, gust: Array, time_s: float) -> EnvironmentInputs:
    """Environment at `time_s` with the gust velocity (3[, N]) [m/s] of that time."""
    velocity = (np.asarray(wind.mean) + gust.T).T
    if wind.sine_amplitude == 0.0:
        return EnvironmentInputs(wind_velocity=velocity)
    strength = wind.sine_amplitude * math.sin(2.0 * math.pi * time_s / wind.sine_period)
    sine = strength * np.asarray(wind.sine_direction)
    if wind.sine_kind == "velocity":
        return EnvironmentInputs(wind_velocity=(sine + velocity.T).T)
    if wind.sine_kind == "force":
        return EnvironmentInputs(wind_velocity=velocity, force=sine)
    return EnvironmentInputs(wind_velocity=velocity, acceleration=sine)


def advance(
    wind: Wind, gust: Array, time_s: float, generator: np.random.Generator, dt: float
) -> tuple[Array, EnvironmentInputs]:
    """Gust `dt` later and the environment for the step that starts at `time_s`.

    Draws from `generator` only if there are gusts.
    """
    inputs = inputs_at(wind, gust, time_s)
    if wind.gust_std == 0.0:
        return gust, inputs
    return advance_gust(wind, gust, generator.standard_normal(gust.shape), dt), inputs


# ------------------------------------------------------------------------------------ ground


@dataclass(frozen=True, slots=True)
class Ground:
    """Flat ground at z = 0 and the landing gear that stands on it.

    friction : coefficient of dry friction, gear on ground
    gear_radius : m; the gear carries anything whose centre of pressure is this near the centre
    levelling_time : s; time constant with which a tilted vehicle comes down onto its gear
    """

    friction: float = 0.6
    gear_radius: float = 0.3
    levelling_time: float = 0.1

    def __post_init__(self) -> None:
        if not self.friction >= 0.0:
            raise ValueError(f"friction of {self.friction} is below zero; give 0 or more")
        for name, value, unit in (
            ("gear radius", self.gear_radius, "m"),
            ("levelling time", self.levelling_time, "s"),
        ):
            if not value > 0.0:
                raise ValueError(f"{name} of {value} {unit} is not above zero; give a positive number")


_TINY = 1e-200  # keeps a division by a length of zero finite


def touch_ground(
    ground: Ground, rigid: Array, mass_properties: MassProperties, dt: float
) -> tuple[Array, Row, Touching]:
    """Hold the vehicle on the ground at the end of a step.

    An inequality, not a spring: nothing sinks, bounces or rings at any dt. The ground gives, as one
    impulse per step, what stops the descent (never pulling), and with it at most

    - `friction` times that impulse against sliding (dry friction: it stops fully),
    - a moment that tilts the vehicle level, as long as the centre of pressure stays within
      `gear_radius` (a stronger torque tips it over),
    - the friction's moment against turning.

    So the vehicle rests exactly still and lifts off exactly when thrust exceeds weight. The gear
    is one contact at the airframe's centre: z is clamped at 0 whatever the tilt.

    Parameters
    ----------
    rigid : (12[, N]); state after the step without ground
    mass_properties : of vehicle and load
    dt : s

    Returns
    -------
    state (12[, N]), mean normal force of the step (float or (N,)) [N], touching (bool or (N,))
    """
    rows = rows_of(rigid)
    touching: Touching = rows[2] <= 0.0
    if not (touching if isinstance(touching, bool) else touching.any()):
        return rigid, 0.0 * rows[2], touching
    fall = at_least(-rows[5], 0.0)
    held = _held(ground, rows, mass_properties, fall, dt)
    force = mass_properties.mass * fall / dt
    if isinstance(touching, bool):
        return array_of(held), force, touching
    return np.where(touching, array_of(held), rigid), np.where(touching, force, 0.0), touching


def _held(ground: Ground, rows: list[Row], properties: MassProperties, fall: Row, dt: float) -> list[Row]:
    """The 12 state rows after the impulse that stops the `fall` [m/s], and all that comes with it."""
    x, y, _, vx, vy, vz, roll, pitch, yaw, p, q, r = rows
    kept = _remaining((vx * vx + vy * vy) ** 0.5, ground.friction * fall)
    half = 0.5 * dt  # impulses spread over the step displace by half of what they change in velocity
    tilt = (roll - half * p, pitch - half * q)  # with rotation stopped
    new_p, new_q, new_r = _held_rates(ground, tilt, rows[9:], properties, properties.mass * fall)
    return [
        x - half * (1.0 - kept) * vx,
        y - half * (1.0 - kept) * vy,
        0.0,
        kept * vx,
        kept * vy,
        at_least(vz, 0.0),
        roll - half * (p - new_p),
        pitch - half * (q - new_q),
        yaw - half * (r - new_r),
        new_p,
        new_q,
        new_r,
    ]


def _remaining(size: Row, reduction: Row) -> Row:
    """Factor that shortens a length `size` by `reduction`, to zero at most."""
    return at_least(1.0 - reduction / at_least(size, _TINY), 0.0)


def _held_rates(
    ground: Ground, tilt: tuple[Row, Row], rates: list[Row], properties: MassProperties, impulse: Row
) -> tuple[Row, Row, Row]:
    """Body rates after the gear's moment and the friction's, for a normal impulse [N s]."""
    (roll, pitch), (p, q, r) = tilt, rates
    (ix, iy, iz), (cx, cy, _) = rows_of(properties.inertia), rows_of(properties.center_of_mass)
    # Past 60 degrees the gear is not below: nothing levels, rotation is only stopped.
    levelling = (rotation_rows_from_euler((roll, pitch, 0.0))[8] > 0.5) / ground.levelling_time
    needed_x, needed_y = ix * (-levelling * roll - p), iy * (-levelling * pitch - q)
    # The impulse P at the centre of pressure (px, py) has the moment ((py - cy) P, -(px - cx) P)
    # about the centre of mass; pressure_x and pressure_y are px P and py P.
    pressure_x, pressure_y = cx * impulse - needed_y, cy * impulse + needed_x
    reach = (pressure_x * pressure_x + pressure_y * pressure_y) ** 0.5
    scale = at_most(ground.gear_radius * impulse / at_least(reach, _TINY), 1.0)
    size = at_least(r, -r)
    turning = ground.friction * ground.gear_radius * impulse / iz
    return (
        p + (scale * pressure_y - cy * impulse) / ix,
        q - (scale * pressure_x - cx * impulse) / iy,
        r * _remaining(size, turning),
    )
