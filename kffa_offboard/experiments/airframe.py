"""The `airframe` profile for a batch of flights: the paper's quadrotor with the limits of a real one.

A second, independent writing of what `sim-vehicle` flies (the two packages know each other by MAVLink
only, and a test holds them together): 246 N on four motors with 50 ms of lag, mixing with priorities,
Newton-Euler with a load held rigidly below the centre, drag relative to the air. The autopilot's part is
PX4's body-rate loop (src/lib/rate_control: PID, the derivative on the measurement behind a 30 Hz low-pass)
with the gains that the simulator's PX4 has; behind a softer one without derivative, a load that doubles the
inertia makes the loops above it oscillate.

Rigid state ``(12, N)``: position and velocity of the airframe's centre (world, z up), roll, pitch, yaw, body
rates. Motors ``(4, N)`` N: front, left, rear, right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from kffa_offboard.control import Array
from kffa_offboard.experiments.plant import ARM, GRAVITY, INERTIA, LOAD_OFFSET, MASS

THRUST = 246.0  # N of four motors: 1.5 times the weight of 16.73 kg
MOTOR_LAG = 0.05  # s
YAW_MOMENT = 0.03  # m, a propeller's torque over its thrust
STEP_S = 0.005

Integrator = Literal["runge-kutta", "midpoint"]

Vector = Sequence[Array] | Array
"""Three rows."""

#: Largest torque, N m: motors at 0 and 1; what the rate gains are relative to.
FULL_TORQUE = 0.25 * THRUST * np.array([[ARM], [ARM], [2.0 * YAW_MOMENT]])
RATE_P = np.array([[0.26], [0.26], [0.2]])  # 1/(rad/s), MC_ROLLRATE_P and so on
RATE_I = np.array([[0.2], [0.2], [0.1]])  # 1/rad
RATE_D = np.array([[0.008], [0.008], [0.0]])  # 1/(rad/s^2)
RATE_INTEGRAL_LIMIT = 0.3
DERIVATIVE_CUTOFF_HZ = 30.0


@dataclass(frozen=True)
class RateLoop:
    """Memory of the rate loop, ``(3, N)`` each: integral (of full torque), rates [rad/s], slope [rad/s^2]."""

    integral: Array
    rates: Array
    slope: Array


@dataclass(frozen=True, eq=False)
class Body:
    """Vehicle and load as one body; each ``(N,)`` unless said otherwise.

    The vehicle's own moments are `INERTIA` about every axis (Table 1), the load is a point. So the inertia
    about the common centre of mass is INERTIA + reduced mass times (|offset|^2 - offset offset^T), and its
    inverse has a closed form.

    Attributes
    ----------
    mass : kg
    offset : (3, N) m, of the load from the airframe's centre, in body axes
    share : load over total mass; times `offset` it is the common centre of mass
    reduced : kg, reduced mass of vehicle and load
    drag : N s/m in translation; N m s about yaw, and times the arm about roll and pitch
    thrust : N of four motors at full command
    motor_lag : s
    """

    mass: Array
    offset: Array
    share: Array
    reduced: Array
    drag: float
    thrust: float | Array = THRUST
    motor_lag: float | Array = MOTOR_LAG

    @cached_property
    def inertia(self) -> Array:
        """Moment about an axis through the common centre of mass across `offset` [kg m^2]."""
        ox, oy, oz = self.offset
        return np.asarray(INERTIA + self.reduced * (ox * ox + oy * oy + oz * oz))

    @cached_property
    def center(self) -> Array:
        """The common centre of mass in body axes from the airframe's centre, ``(3, N)`` m."""
        return np.asarray(self.share * self.offset)


def body(
    load_mass: Array,
    drag: float,
    offset: Array | None = None,
    thrust: float | Array = THRUST,
    motor_lag: float | Array = MOTOR_LAG,
) -> Body:
    """The body that a load of `load_mass` ``(N,)`` [kg] makes, by the parallel axis theorem.

    `offset` ``(3, N)`` [m] is where it is held; straight below, `plant.LOAD_OFFSET` high, without it.
    """
    mass = MASS + load_mass
    share = load_mass / mass
    if offset is None:
        offset = np.stack([np.zeros_like(mass), np.zeros_like(mass), np.full_like(mass, LOAD_OFFSET)])
    return Body(mass, offset, share, MASS * share, drag, thrust, motor_lag)


def rate_loop(state: RateLoop, wanted: Array, measured: Array, dt: float = STEP_S) -> tuple[RateLoop, Array]:
    """One step of the autopilot's rate loop: torque ``(3, N)`` [N m] from body rates ``(3, N)`` [rad/s]."""
    share = 1.0 - np.exp(-2.0 * np.pi * DERIVATIVE_CUTOFF_HZ * dt)
    slope = (1.0 - share) * state.slope + share / dt * (measured - state.rates)
    error = wanted - measured
    integral = np.clip(state.integral + RATE_I * dt * error, -RATE_INTEGRAL_LIMIT, RATE_INTEGRAL_LIMIT)
    asked = RATE_P * error + integral - RATE_D * slope
    return RateLoop(integral, measured, slope), FULL_TORQUE * np.clip(asked, -1.0, 1.0)


def mix(thrust: Array, torque: Array) -> Array:
    """Motor commands ``(4, N)`` within 0..1 for a thrust ``(N,)`` of 0..1 and a torque ``(3, N)`` [N m].

    What does not fit gives way as with PX4 and ArduCopter: thrust (down to one half) for roll and pitch, both
    of these by one factor, yaw gets what is left.
    """
    motor = THRUST / 4.0
    roll, pitch = torque[:2] / (2.0 * ARM * motor)
    yaw = torque[2] / (4.0 * YAW_MOMENT * motor)
    spread = np.maximum(np.abs(roll), np.abs(pitch))
    lift = np.minimum(np.clip(thrust, 0.0, 1.0), np.maximum(1.0 - spread, 0.5))
    scale = np.minimum(np.minimum(lift, 1.0 - lift) / np.maximum(spread, 1e-200), 1.0)
    roll, pitch = roll * scale, pitch * scale
    rolling, pitching, above = np.abs(roll), np.abs(pitch), 1.0 - lift
    most = np.maximum(np.minimum(above - pitching, lift - rolling), 0.0)
    least = np.maximum(np.minimum(lift - pitching, above - rolling), 0.0)
    yaw = np.clip(yaw, -least, most)
    return np.array([lift - pitch + yaw, lift + roll - yaw, lift + pitch + yaw, lift - roll - yaw])


def step(
    rigid: Array,
    motors: Array,
    commands: Array,
    whole: Body,
    wind: Array,
    dt: float = STEP_S,
    integrator: Integrator = "runge-kutta",
) -> tuple[Array, Array]:
    """Rigid state and motor thrust `dt` s later: exact motor lag, one step with the mean thrust.

    Parameters
    ----------
    commands : (4, N), 0..1, held over the step
    wind : (3, N) m/s in the world, held over the step
    integrator : of fourth order; "midpoint" is of second order and takes half the time
    """
    target = whole.thrust / 4.0 * commands
    held, decay = _motor_lag(whole, dt)
    transient = motors - target
    front, left, rear, right = target + held * transient
    motors = target + decay * transient
    wrench = np.array(
        [front + left + rear + right, left - right, rear - front, YAW_MOMENT * (front - left + rear - right)]
    )
    first = derivatives(rigid, wrench, whole, wind)
    if integrator == "midpoint":
        first *= 0.5 * dt
        first += rigid
        second = derivatives(first, wrench, whole, wind)
        second *= dt
        second += rigid
        return second, motors
    second = derivatives(rigid + 0.5 * dt * first, wrench, whole, wind)
    third = derivatives(rigid + 0.5 * dt * second, wrench, whole, wind)
    fourth = derivatives(rigid + dt * third, wrench, whole, wind)
    rigid = rigid + dt / 6.0 * (first + 2.0 * (second + third) + fourth)
    return rigid, motors


@lru_cache(maxsize=8)
def _motor_lag(whole: Body, dt: float) -> tuple[Array, Array]:
    """Share of a motor's first transient in its mean over `dt` s, and at the end."""
    lag = np.asarray(whole.motor_lag)
    decay = np.exp(-dt / lag)
    return (1.0 - decay) * lag / dt, decay


def derivatives(rigid: Array, wrench: Array, whole: Body, wind: Array) -> Array:
    """Time derivative ``(12, N)`` per second under U1..U4 ``(4, N)`` of eq 14 [N, N, N, N m]; Newton-Euler.

    The state holds the motion of the airframe's centre, `whole.center` away from the common centre of mass.
    """
    sines, cosines = sines_and_cosines(rigid[6:9])
    body_rates = p, q, r = tuple(rigid[9:12])
    fx, fy, fz = _to_body(whole.drag * (wind - rigid[3:6]), sines, cosines)
    force = fx, fy, fz + wrench[0]
    along = _dot(body_rates, whole.offset)
    angular = _angular_acceleration(body_rates, along, wrench, force, whole)
    # What the centre of mass has on top: alpha x c + omega x (omega x c).
    along, square = whole.share * along, _dot(body_rates, body_rates)
    turned = _cross(angular, whole.center)
    rates = np.empty_like(rigid)
    rates[0:3] = rigid[3:6]
    rates[3], rates[4], rates[5] = _to_world(
        [
            force[k] / whole.mass - turned[k] - along * body_rates[k] + square * whole.center[k]
            for k in range(3)
        ],
        sines,
        cosines,
    )
    rates[5] -= GRAVITY
    turning, rates[7] = _turn(r, q, sines[0], cosines[0])
    yaw_rate = turning / cosines[1]
    rates[6], rates[8] = p + sines[1] * yaw_rate, yaw_rate
    rates[9], rates[10], rates[11] = angular
    return rates


def _angular_acceleration(
    body_rates: Vector, along: Array, wrench: Array, force: Vector, whole: Body
) -> Vector:
    """About body x, y, z [rad/s^2], with `force` [N] at the airframe's centre; both in body axes.

    `along` is the rates' component along the load's offset, times that.
    """
    # -omega x (I omega), of which only the load's part is not zero, has the form of a force at the centre.
    inertial = MASS * along
    tx, ty, tz = _cross([force[k] + inertial * body_rates[k] for k in range(3)], whole.center)
    p, q, r = body_rates
    torque = (
        tx + ARM * (wrench[1] - whole.drag * p),
        ty + ARM * (wrench[2] - whole.drag * q),
        tz + (wrench[3] - whole.drag * r),
    )
    back = whole.reduced / INERTIA * _dot(torque, whole.offset)
    ax, ay, az = [(torque[k] + back * whole.offset[k]) / whole.inertia for k in range(3)]
    return ax, ay, az


def sines_and_cosines(angles: Array) -> tuple[Array, Array]:
    """Of angles [rad], any shape; both from the tangent of half the angle, which takes half the time."""
    half = np.tan(0.5 * angles)
    square = half * half
    over = 1.0 / (1.0 + square)
    return 2.0 * half * over, (1.0 - square) * over


def _turn(a: Array, b: Array, sine: Array, cosine: Array) -> tuple[Array, Array]:
    """Two components in axes that are turned from the first towards the second."""
    return cosine * a + sine * b, cosine * b - sine * a


def _to_body(vector: Vector, sines: Array, cosines: Array) -> Vector:
    """A vector of the world in body axes: turned by yaw, pitch and roll."""
    x, y, z = vector
    x, y = _turn(x, y, sines[2], cosines[2])
    z, x = _turn(z, x, sines[1], cosines[1])
    y, z = _turn(y, z, sines[0], cosines[0])
    return x, y, z


def _to_world(vector: Vector, sines: Array, cosines: Array) -> Vector:
    """A vector of the body in the world's axes."""
    x, y, z = vector
    z, y = _turn(z, y, sines[0], cosines[0])
    x, z = _turn(x, z, sines[1], cosines[1])
    y, x = _turn(y, x, sines[2], cosines[2])
    return x, y, z


def _dot(a: Vector, b: Vector) -> Array:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
