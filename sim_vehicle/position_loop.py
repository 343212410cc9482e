"""Height and position control of the autopilot's own flight modes: cascades of P and PI.

Height: P on height gives a climb rate, PI on climb rate gives an acceleration, and that gives thrust
through the hover thrust (PX4, src/modules/mc_pos_control). ArduCopter (AC_PosControl) has one stage
more: the acceleration is compared with the accelerometer by another PI, which makes it stiffer.

Horizontal: P on position, PI on velocity, acceleration into tilt.

World axes x north, y west, z up; SI units; angles in radians.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

from sim_vehicle import attitude_loop

Vector3: TypeAlias = tuple[float, float, float]


class VerticalGains(NamedTuple):
    """Gains and limits of the height cascade."""

    height: float  # 1/s
    climb: float  # 1/s
    climb_integral: float  # 1/s^2
    acceleration: float  # share of an acceleration error answered at once; 0: no acceleration stage
    acceleration_integral: float  # 1/s; the same, integrated
    acceleration_cutoff_hz: float  # low-pass on the accelerometer
    climb_max: float  # m/s
    descent_max: float  # m/s
    hover_thrust: float  # 0..1; thrust that carries the weight as far as the autopilot knows
    thrust_min: float
    thrust_max: float
    gravity: float  # m/s^2


class HorizontalGains(NamedTuple):
    """Gains and limits of the position cascade."""

    position: float  # 1/s
    velocity: float  # 1/s
    velocity_integral: float  # 1/s^2
    speed_max: float  # m/s
    tilt_max: float  # rad
    gravity: float  # m/s^2


class VerticalState(NamedTuple):
    """Integrators of the height cascade."""

    climb_integral: float = 0.0  # m/s^2
    acceleration_integral: float = 0.0  # m/s^2
    acceleration: float = 0.0  # m/s^2, filtered accelerometer


class HorizontalState(NamedTuple):
    """Integrators of the position cascade [m/s^2]."""

    x: float = 0.0
    y: float = 0.0


def vertical_step(
    gains: VerticalGains,
    state: VerticalState,
    height_error: float,
    climb_feed_forward: float,
    climb_rate: float,
    acceleration: float,
    dt: float,
) -> tuple[VerticalState, float]:
    """One step of the height cascade.

    Parameters
    ----------
    height_error : m, wanted minus measured; 0 to follow `climb_feed_forward` alone
    climb_feed_forward, climb_rate : m/s, up
    acceleration : m/s^2, up, without gravity (0 at rest)
    dt : s

    Returns
    -------
    new state, vertical thrust 0..1 (to be divided by the cosine of the tilt)
    """
    wanted = climb_feed_forward + gains.height * height_error
    wanted = min(gains.climb_max, max(-gains.descent_max, wanted))
    climb_error = wanted - climb_rate
    demand = gains.climb * climb_error + state.climb_integral
    share = 1.0 - math.exp(-2.0 * math.pi * gains.acceleration_cutoff_hz * dt)
    filtered = state.acceleration + share * (acceleration - state.acceleration)
    feedback = demand
    if gains.acceleration_integral > 0.0:
        feedback = gains.acceleration * (demand - filtered) + state.acceleration_integral
    thrust = gains.hover_thrust * (1.0 + feedback / gains.gravity)
    bounded = min(gains.thrust_max, max(gains.thrust_min, thrust))
    climb_integral, acceleration_integral = state.climb_integral, state.acceleration_integral
    if (thrust - bounded) * climb_error <= 0.0:
        climb_integral += gains.climb_integral * climb_error * dt
    if (thrust - bounded) * (demand - filtered) <= 0.0:
        acceleration_integral += gains.acceleration_integral * (demand - filtered) * dt
    bound = gains.gravity * (1.0 / gains.hover_thrust)
    return (
        VerticalState(
            attitude_loop.limit(climb_integral, bound),
            attitude_loop.limit(acceleration_integral, bound),
            filtered,
        ),
        bounded,
    )


def horizontal_step(
    gains: HorizontalGains,
    state: HorizontalState,
    position_error: tuple[float, float],
    velocity: tuple[float, float],
    yaw: float,
    dt: float,
) -> tuple[HorizontalState, float, float]:
    """One step of the position cascade.

    Parameters
    ----------
    position_error : (2,) m, wanted minus measured
    velocity : (2,) m/s
    yaw : rad, heading of the vehicle
    dt : s

    Returns
    -------
    new state, roll, pitch [rad] that give the wanted acceleration
    """
    wanted_x, wanted_y = (gains.position * value for value in position_error)
    size = math.hypot(wanted_x, wanted_y)
    if size > gains.speed_max:
        wanted_x, wanted_y = wanted_x * gains.speed_max / size, wanted_y * gains.speed_max / size
    error_x, error_y = wanted_x - velocity[0], wanted_y - velocity[1]
    demand_x = gains.velocity * error_x + state.x
    demand_y = gains.velocity * error_y + state.y
    bound = gains.gravity * math.tan(gains.tilt_max)
    size = math.hypot(demand_x, demand_y)
    integral_x, integral_y = state.x, state.y
    if size > bound:
        demand_x, demand_y = demand_x * bound / size, demand_y * bound / size
    else:
        integral_x += gains.velocity_integral * error_x * dt
        integral_y += gains.velocity_integral * error_y * dt
    forward = math.cos(yaw) * demand_x + math.sin(yaw) * demand_y
    left = math.cos(yaw) * demand_y - math.sin(yaw) * demand_x
    pitch = math.atan2(forward, gains.gravity)
    roll = math.atan2(-left * math.cos(pitch), gains.gravity)
    return HorizontalState(integral_x, integral_y), roll, pitch
