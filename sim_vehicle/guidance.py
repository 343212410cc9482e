"""Where the autopilot's own flight modes want to go: hold, climb to a height, sink, fly home.

Holds the targets and the state of the height and position cascades (`position_loop`) between two
steps. Which of it a flight mode uses, and when, is decided by the personalities.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from sim_vehicle import position_loop
from sim_vehicle.attitude_loop import Quaternion, from_euler, limit
from sim_vehicle.position_loop import HorizontalGains, VerticalGains

CLIMB_ACCELERATION = 2.5
"""How fast a commanded climb rate builds up [m/s^2] (PILOT_ACCEL_Z of ArduCopter, 250 cm/s^2)."""

STOPPING_TIME = 0.5
"""Where a moving vehicle is told to stop: its position plus velocity times this [s]."""

TARGET_LEAD = 1.0
"""The height target runs at most this far ahead of the vehicle [m], so nothing winds up on the ground."""


class Estimate(NamedTuple):
    """What the autopilot's sensors and estimator say, in the paper's axes, SI units and radians.

    `climb_acceleration` is the accelerometer along world z without gravity (0 at rest). `satellites`: they
    are there, and place and speed over ground are more than reckoning.
    """

    time_us: int
    position: tuple[float, float, float]
    velocity: tuple[float, float, float]
    euler: tuple[float, float, float]
    body_rates: tuple[float, float, float]
    climb_acceleration: float
    satellites: bool = True

    @property
    def attitude(self) -> Quaternion:
        """Attitude as a quaternion."""
        return from_euler(*self.euler)


class Guidance:
    """Targets and cascades of the autopilot's own modes."""

    def __init__(self, vertical: VerticalGains, horizontal: HorizontalGains) -> None:
        self.vertical_gains = vertical
        self.horizontal_gains = horizontal
        self._vertical = position_loop.VerticalState()
        self._horizontal = position_loop.HorizontalState()
        self._target = [0.0, 0.0, 0.0]
        self._goal: tuple[float, float] | None = None
        self._goal_speed = 0.0
        self._climb_goal: float | None = None
        self._climb_speed = 0.0
        self._climb = 0.0
        self.yaw = 0.0

    @property
    def target_height(self) -> float:
        """Height that is being held or passed [m]."""
        return self._target[2]

    @property
    def climb_target(self) -> float:
        """Climb rate that is being commanded [m/s]."""
        return self._climb

    def engage(self, estimate: Estimate, vertical_thrust: float) -> None:
        """Take over at `estimate` without a bump: integrators start at the thrust flown last (0..1)."""
        excess = self.vertical_gains.gravity * (vertical_thrust / self.vertical_gains.hover_thrust - 1.0)
        staged = self.vertical_gains.acceleration_integral > 0.0
        self._vertical = position_loop.VerticalState(
            0.0 if staged else excess, excess if staged else 0.0, 0.0
        )
        self._horizontal = position_loop.HorizontalState()
        self._climb = 0.0
        self.hold_position(estimate)
        self.hold_height(estimate)

    def hold_position(self, estimate: Estimate) -> None:
        """Stop and stay here, with this heading."""
        self._target[0] = estimate.position[0] + STOPPING_TIME * estimate.velocity[0]
        self._target[1] = estimate.position[1] + STOPPING_TIME * estimate.velocity[1]
        self._goal = None
        self.yaw = estimate.euler[2]

    def hold_height(self, estimate: Estimate) -> None:
        """Stay at this height."""
        self._target[2] = estimate.position[2]
        self._climb_goal = estimate.position[2]
        self._climb_speed = self.vertical_gains.climb_max

    def climb_to(self, height: float, speed: float) -> None:
        """Climb or sink to `height` [m] with at most `speed` [m/s] and stay there."""
        self._climb_goal, self._climb_speed = height, speed

    def climb_at(self, speed: float) -> None:
        """Climb (or sink, if negative) at `speed` [m/s] until told otherwise."""
        self._climb_goal, self._climb_speed = None, speed

    def fly_to(self, x: float, y: float, speed: float) -> None:
        """Fly to (x, y) [m] in a straight line at `speed` [m/s] and stay there."""
        self._goal, self._goal_speed = (x, y), speed

    def height_step(self, estimate: Estimate, dt: float) -> float:
        """Vertical thrust 0..1, to be divided by the cosine of the tilt."""
        wanted = self._climb_speed
        if self._climb_goal is not None:
            remaining = self._climb_goal - self._target[2]
            braking = math.sqrt(CLIMB_ACCELERATION * abs(remaining))  # half the limit: no overshoot
            wanted = math.copysign(min(self._climb_speed, braking, abs(remaining) / dt), remaining)
        self._climb += limit(wanted - self._climb, CLIMB_ACCELERATION * dt)
        moved = self._target[2] + self._climb * dt
        if self._climb_goal is None or abs(self._climb_goal - self._target[2]) > TARGET_LEAD:
            height = estimate.position[2]
            moved = min(height + TARGET_LEAD, max(height - TARGET_LEAD, moved))
        self._target[2] = moved
        self._vertical, thrust = position_loop.vertical_step(
            self.vertical_gains,
            self._vertical,
            self._target[2] - estimate.position[2],
            self._climb,
            estimate.velocity[2],
            estimate.climb_acceleration,
            dt,
        )
        return thrust

    def attitude_step(self, estimate: Estimate, dt: float) -> Quaternion:
        """Attitude that holds or reaches the position target."""
        if self._goal is not None:
            self._advance_towards(self._goal, dt)
        error = self._target[0] - estimate.position[0], self._target[1] - estimate.position[1]
        self._horizontal, roll, pitch = position_loop.horizontal_step(
            self.horizontal_gains,
            self._horizontal,
            error,
            (estimate.velocity[0], estimate.velocity[1]),
            estimate.euler[2],
            dt,
        )
        # roll and pitch were computed for the measured heading; a thrust direction needs no other yaw
        return _with_heading(from_euler(roll, pitch, estimate.euler[2]), self.yaw, estimate.euler[2])

    def _advance_towards(self, goal: tuple[float, float], dt: float) -> None:
        gap_x, gap_y = goal[0] - self._target[0], goal[1] - self._target[1]
        distance = math.hypot(gap_x, gap_y)
        move = min(distance, self._goal_speed * dt)
        if distance > 0.0:
            self._target[0] += gap_x / distance * move
            self._target[1] += gap_y / distance * move


def _with_heading(attitude: Quaternion, wanted_yaw: float, yaw: float) -> Quaternion:
    """Attitude with the same thrust direction, turned about it to another heading."""
    half = 0.5 * (wanted_yaw - yaw)
    w, x, y, z = attitude
    c, s = math.cos(half), math.sin(half)
    return w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s
