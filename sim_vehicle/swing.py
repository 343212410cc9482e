"""A load that swings: a point mass on a massless rope, taut or slack, from a hook below the centre.

Relative to the hook the load has direction n (unit vector, down when at rest), length L and velocity w.
With the hook's acceleration a without rope, a taut rope keeps its length if

    n . (g - T n / m - a - T n / M) = -|w|^2 / L   =>   T = (n . (g - a) + |w|^2 / L) / (1/m + 1/M),

which is never negative: a rope does not push, the load then falls freely. That the hook also gives way
because the rope turns the vehicle is left out of T, and comes with the next step's a. World axes, (3,) or
(3, N); SI.

A load that rests on the ground is carried by it and gives way to nothing, T = M (|w|^2 / L - n . a), as long
as that does not lift it; what friction does not hold slides.

A rope that stretches is a spring k with some loss: T = k (distance - L) + c (n . w - dL/dt), where it is
longer than L. Load and vehicle bounce on it with sqrt(k (1/m + 1/M)).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, ceil, copysign, hypot, sqrt

import numpy as np

from sim_vehicle.airframe import AirframeParameters
from sim_vehicle.dynamics import BODY_RATES, EULER, POSITION, VELOCITY
from sim_vehicle.frames import Array, Row, rotation_matrix

LOSS = 0.05
"""Damping ratio of a rope that stretches, for instance of nylon."""

WINCH_M_S2 = 1.0
"""How quickly a winch comes to its speed, and stops."""

TURN, MOST_PARTS = 0.02, 50
"""A step in which the rope turns by more [rad] is divided, into so many parts at the most."""

LIFTED_M = 0.05
"""A load so high has left the ground."""

_TINY = 1e-9  # of a load at the hook itself, whose rope has no direction


@dataclass(frozen=True, eq=False, slots=True)
class SwingState:
    """Load on a rope.

    Attributes
    ----------
    offset, velocity : (3[, N]); of the load from the hook [m], and in the world [m/s]
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


@dataclass(frozen=True, slots=True)
class RopeParameters:
    """length [m] and how fast it grows (`rate` [m/s], of a winch); stiffness [N/m], 0 without stretch."""

    length: float
    rate: float = 0.0
    stiffness: float = 0.0


def step(
    state: SwingState,
    rope: RopeParameters,
    mass: float,
    vehicle_mass: float,
    vehicle_velocity: Array,
    free_acceleration: Array,
    gravity: float,
    dt: float,
    resting: bool = False,
) -> tuple[SwingState, Array]:
    """State `dt` later and the force (3[, N]) [N] of the rope on the vehicle.

    Parameters
    ----------
    mass, vehicle_mass : kg
    vehicle_velocity : (3[, N]) m/s; of the hook
    free_acceleration : (3[, N]) m/s^2; what the hook does without the rope
    resting : the load is on the ground
    """
    distance = np.maximum(np.sqrt((state.offset**2).sum(axis=0)), _TINY)
    direction = state.offset / distance
    relative = state.velocity - vehicle_velocity
    down = np.zeros_like(state.offset)
    down[2] = -gravity
    if rope.stiffness > 0.0:
        tension = _stretched(rope, mass, vehicle_mass, distance, (direction * relative).sum(axis=0))
    else:
        pull = _keeping_length(rope, distance, direction, relative, free_acceleration, dt)
        lifting = (pull + (direction * down).sum(axis=0)) / (1.0 / mass + 1.0 / vehicle_mass)
        if resting:
            held = pull * vehicle_mass
            lifting = np.where(-held * direction[2] < mass * gravity, held, lifting)
        tension = np.where(distance >= rope.length * (1.0 - 1e-3), np.maximum(lifting, 0.0), 0.0)
    force = tension * direction
    velocity = state.velocity + dt * (down - force / mass)
    moved_vehicle = vehicle_velocity + dt * (free_acceleration + force / vehicle_mass)
    offset = state.offset + dt * (velocity - moved_vehicle)
    return SwingState(offset, velocity, tension), force


def _stretched(rope: RopeParameters, mass: float, vehicle_mass: float, distance: Row, along: Row) -> Row:
    """Tension [N] of a spring with some loss; `along` [m/s], how fast load and hook part."""
    loss = 2.0 * LOSS * sqrt(rope.stiffness / (1.0 / mass + 1.0 / vehicle_mass))
    pull = rope.stiffness * (distance - rope.length) + loss * (along - rope.rate)
    tension = np.where(distance > rope.length, np.maximum(pull, 0.0), 0.0)
    return np.asarray(tension)


def _keeping_length(
    rope: RopeParameters,
    distance: Row,
    direction: Array,
    relative: Array,
    free_acceleration: Array,
    dt: float,
) -> Row:
    """Acceleration [m/s^2] along a taut rope that keeps its length, without what weighs on the load.

    What the finite step left of length and radial speed is taken back within a few steps.
    """
    along = (direction * relative).sum(axis=0)
    across = (relative**2).sum(axis=0) - along**2
    turning = across / rope.length - (direction * free_acceleration).sum(axis=0)
    left = (along - rope.rate) / (4.0 * dt) + (distance - rope.length) / (16.0 * dt * dt)
    return np.asarray(turning + left)


class Rope:
    """The rope of one vehicle and what hangs on it, or lies on the ground.

    `length` [m], from a hook `below` [m] the airframe's centre; `stiffness` [N/m], 0 if it does not stretch.
    """

    def __init__(self, length: float, below: float = 0.0, stiffness: float = 0.0) -> None:
        self.length = length
        self.mass_kg = 0.0
        self.lifted = False
        self._stiffness = stiffness
        self._hook = np.array([0.0, 0.0, -below])
        self._wanted, self._speed, self._rate = length, 0.0, 0.0
        self._state = hanging(length, np.zeros(3))
        self._place = np.zeros(3)
        self._before: Array | None = None
        self._force = np.zeros(3)

    def hang(self, mass_kg: float, rigid: Array, gravity: float = 9.8, ground: bool = True) -> None:
        """Another load [kg] on the rope of the vehicle in the state `rigid` (12,); 0 for none.

        At rest below the vehicle, or on the ground if it is lower than the rope is long. What is left of a
        load, or comes to it, stays where that is.
        """
        if mass_kg > 0.0 and self.mass_kg > 0.0:
            self.mass_kg = mass_kg
            return
        stretch = mass_kg * gravity / self._stiffness if self._stiffness > 0.0 else 0.0
        hook, velocity = self._hook_of(rigid)
        state = hanging(self.length + stretch, velocity)
        self.lifted = not ground or bool(hook[2] > self.length + stretch)
        if not self.lifted:
            state = SwingState(np.array([0.0, 0.0, -hook[2]]), np.zeros(3))
        self.mass_kg, self._state, self._place = mass_kg, state, hook + state.offset
        self._before, self._force = None, np.zeros(3)

    def wind(self, length: float, speed: float) -> None:
        """A winch makes the rope so long [m] from now on, with so many m/s."""
        self._wanted, self._speed = length, speed

    @property
    def offset(self) -> Array:
        """Of the load from the hook (3,) [m], world."""
        return self._state.offset

    @property
    def place(self) -> Array:
        """Of the load (3,) [m], world; on the ground its height is 0."""
        return self._place

    @property
    def angle(self) -> float:
        """From the vertical, rad; 0 if nothing hangs on it."""
        x, y, z = self._state.offset.tolist()
        return atan2(hypot(x, y), -z) if self.mass_kg > 0.0 and self.lifted else 0.0

    def turn(self, dt: float) -> float:
        """The winch goes on for `dt` s; m/s with which the rope grows."""
        left = self._wanted - self.length
        if left == 0.0 and self._rate == 0.0:
            return 0.0
        most = min(self._speed, sqrt(2.0 * WINCH_M_S2 * abs(left)))
        change = min(max(copysign(most, left) - self._rate, -WINCH_M_S2 * dt), WINCH_M_S2 * dt)
        self._rate += change
        self.length += self._rate * dt
        if abs(self._wanted - self.length) < WINCH_M_S2 * dt * dt and abs(self._rate) < 2.0 * WINCH_M_S2 * dt:
            self.length, self._rate = self._wanted, 0.0
        return self._rate

    def step(self, body: AirframeParameters, rigid: Array, dt: float) -> tuple[Array, Array]:
        """What pulls during the step that begins with the state `rigid` (12,).

        Force on the vehicle (3,) [N], world, and its torque about the centre (3,) [N m], in body axes.
        """
        rope = RopeParameters(self.length, self.turn(dt), self._stiffness)
        hook, velocity = self._hook_of(rigid)
        free = np.zeros(3)
        if self._before is not None:
            free = (velocity - self._before) / dt - self._force / body.base_mass
        self._before, self._force = velocity, np.zeros(3)
        parts = self._parts(velocity, dt)
        for _ in range(parts):
            force = self._go_on(body, rope, hook, velocity, free, dt / parts)
            self._force = self._force + force / parts
            velocity = velocity + dt / parts * (free + force / body.base_mass)
            hook = hook + dt / parts * velocity
        rotation = rotation_matrix(rigid[EULER])
        return self._force, np.cross(self._hook, rotation.T @ self._force)

    def _parts(self, hook_velocity: Array, dt: float) -> int:
        """Into how many a step is divided: the rope is to turn by `TURN` in one at the most."""
        turn = hypot(*(self._state.velocity - hook_velocity).tolist()) / self.length * dt
        return min(max(ceil(turn / TURN), 1), MOST_PARTS)

    def _go_on(
        self,
        body: AirframeParameters,
        rope: RopeParameters,
        hook: Array,
        hook_velocity: Array,
        free: Array,
        dt: float,
    ) -> Array:
        """Load and rope `dt` s later; the force (3,) [N] on the vehicle until then."""
        self._state, force = step(
            SwingState(self._place - hook, self._state.velocity),
            rope,
            self.mass_kg,
            body.base_mass,
            hook_velocity,
            free,
            body.gravity,
            dt,
            resting=body.ground is not None and bool(self._place[2] <= 0.0),
        )
        if body.ground is not None:
            self._touch(body.ground.friction, dt)
        self._place = self._place + dt * self._state.velocity
        return force

    def _touch(self, friction: float, dt: float) -> None:
        """The ground stops what would sink into it, and by friction what slides (dry: it stops fully)."""
        velocity, height = self._state.velocity, float(self._place[2])
        x, y, z = velocity.tolist()
        if height > LIFTED_M:
            self.lifted = True
        if height + dt * z > 0.0:
            return
        self.lifted = False
        self._place[2], velocity[2] = 0.0, 0.0
        slide = hypot(x, y)
        velocity[:2] *= max(1.0 + friction * z / slide, 0.0) if slide > 0.0 else 0.0

    def _hook_of(self, rigid: Array) -> tuple[Array, Array]:
        """Place [m] and velocity [m/s] of the hook, world."""
        rotation = rotation_matrix(rigid[EULER])
        turning = rotation @ np.cross(rigid[BODY_RATES], self._hook)
        return rigid[POSITION] + rotation @ self._hook, rigid[VELOCITY] + turning
