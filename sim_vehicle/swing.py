"""A load that swings: a point mass on a massless rope, taut or slack, from a hook below the centre.

Relative to the hook the load has direction n (unit vector, down when at rest), length L and velocity w.
With the hook's acceleration a without rope, a taut rope keeps its length if

    n . (g - T n / m - a - T n / M) = -|w|^2 / L   =>   T = (n . (g - a) + |w|^2 / L) / (1/m + 1/M),

which is never negative: a rope does not push, the load then falls freely. That the hook also gives way
because the rope turns the vehicle is left out of T, and comes with the next step's a. World axes, (3,) or
(3, N); SI.

A rope that stretches is a spring k with some loss: T = k (distance - L) + c n . w, where it is longer than
L. Load and vehicle bounce on it with sqrt(k (1/m + 1/M)).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, hypot, sqrt

import numpy as np

from sim_vehicle.airframe import AirframeParameters
from sim_vehicle.dynamics import BODY_RATES, EULER, POSITION, VELOCITY
from sim_vehicle.frames import Array, Row, rotation_matrix

LOSS = 0.05
"""Damping ratio of a rope that stretches, for instance of nylon."""


@dataclass(frozen=True, eq=False, slots=True)
class SwingState:
    """Load on a rope.

    Attributes
    ----------
    offset, velocity : (3[, N]); of the load from the vehicle's centre [m], and in the world [m/s]
    tension : float or (N,) N; in the last step
    """

    offset: Array
    velocity: Array
    tension: Row = 0.0


def hanging(length: float, vehicle_velocity: Array) -> SwingState:
    """At rest straight below a vehicle with that velocity (3[, N])."""
    offset = np.zeros_like(vehicle_velocity)
    offset[2] = -length
    return SwingState(offset, vehicle_velocity.copy())


def step(
    state: SwingState,
    length: float,
    mass: float,
    vehicle_mass: float,
    vehicle_velocity: Array,
    free_acceleration: Array,
    gravity: float,
    dt: float,
    stiffness: float = 0.0,
) -> tuple[SwingState, Array]:
    """State `dt` later and the force (3[, N]) [N] of the rope on the vehicle.

    Parameters
    ----------
    mass, vehicle_mass : kg
    vehicle_velocity : (3[, N]) m/s
    free_acceleration : (3[, N]) m/s^2; what the vehicle does without the rope
    stiffness : N/m of the whole rope; 0 for one that does not stretch
    """
    distance = np.sqrt((state.offset**2).sum(axis=0))
    direction = state.offset / distance
    relative = state.velocity - vehicle_velocity
    along = (direction * relative).sum(axis=0)
    across = (relative**2).sum(axis=0) - along**2
    down = np.zeros_like(state.offset)
    down[2] = -gravity
    pull = (direction * (down - free_acceleration)).sum(axis=0) + across / length
    # What the finite step left of length and radial speed is taken back within a few steps.
    pull = pull + np.maximum(along, 0.0) / (4.0 * dt) + np.maximum(distance - length, 0.0) / (16.0 * dt * dt)
    taut = distance >= length * (1.0 - 1e-3)
    reduced = 1.0 / (1.0 / mass + 1.0 / vehicle_mass)
    tension = np.where(taut, np.maximum(pull, 0.0), 0.0) * reduced
    if stiffness > 0.0:
        loss = 2.0 * LOSS * sqrt(stiffness * reduced)
        stretched = stiffness * (distance - length) + loss * along
        tension = np.where(distance > length, np.maximum(stretched, 0.0), 0.0)
    force = tension * direction
    velocity = state.velocity + dt * (down - force / mass)
    moved_vehicle = vehicle_velocity + dt * (free_acceleration + force / vehicle_mass)
    offset = state.offset + dt * (velocity - moved_vehicle)
    return SwingState(offset, velocity, tension), force


class Rope:
    """The rope of one vehicle and what hangs on it; lower than its length the load lies on the ground.

    `length` [m], from a hook `below` [m] the airframe's centre; `stiffness` [N/m], 0 if it does not stretch.
    """

    def __init__(self, length: float, below: float = 0.0, stiffness: float = 0.0) -> None:
        self.length = length
        self._stiffness = stiffness
        self._hook = np.array([0.0, 0.0, -below])
        self.mass_kg = 0.0
        self._state = hanging(length, np.zeros(3))
        self._before: Array | None = None
        self._force = np.zeros(3)

    def hang(self, mass_kg: float, velocity: Array, gravity: float = 9.8) -> None:
        """Another load [kg], at rest below a vehicle with that velocity, on the rope; 0 for none."""
        stretch = mass_kg * gravity / self._stiffness if self._stiffness > 0.0 else 0.0
        self.mass_kg, self._state = mass_kg, hanging(self.length + stretch, velocity)
        self._before, self._force = None, np.zeros(3)

    @property
    def offset(self) -> Array:
        """Of the load from the hook (3,) [m], world."""
        return self._state.offset

    @property
    def angle(self) -> float:
        """From the vertical, rad; 0 if nothing hangs on it."""
        x, y, z = self._state.offset.tolist()
        return atan2(hypot(x, y), -z) if self.mass_kg > 0.0 else 0.0

    def step(self, body: AirframeParameters, rigid: Array, dt: float) -> tuple[Array, Array]:
        """What pulls during the step that begins with the state `rigid` (12,).

        Force on the vehicle (3,) [N], world, and its torque about the centre (3,) [N m], in body axes.
        """
        rotation = rotation_matrix(rigid[EULER])
        velocity = rigid[VELOCITY] + rotation @ np.cross(rigid[BODY_RATES], self._hook)
        before, self._before = self._before, velocity
        if rigid[POSITION][2] < self.length:
            self._state, self._force = hanging(self.length, velocity), np.zeros(3)
            return self._force, np.zeros(3)
        free = np.zeros(3)
        if before is not None:
            free = (velocity - before) / dt - self._force / body.base_mass
        self._state, self._force = step(
            self._state,
            self.length,
            self.mass_kg,
            body.base_mass,
            velocity,
            free,
            body.gravity,
            dt,
            self._stiffness,
        )
        return self._force, np.cross(self._hook, rotation.T @ self._force)
