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

from dataclasses import dataclass

import numpy as np

from kffa_offboard.control import Array
from kffa_offboard.experiments.plant import ARM, GRAVITY, INERTIA, LOAD_OFFSET, MASS

THRUST = 246.0  # N of four motors: 1.5 times the weight of 16.73 kg
MOTOR_LAG = 0.05  # s
YAW_MOMENT = 0.03  # m, a propeller's torque over its thrust
STEP_S = 0.005

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


@dataclass(frozen=True)
class Body:
    """Vehicle and load as one body; each ``(N,)``.

    Attributes
    ----------
    mass : kg
    inertia : kg m^2 about roll and pitch, through the common centre of mass; about yaw it is `INERTIA`
    center : m, height of the common centre of mass above the airframe's centre (not positive)
    drag : N s/m in translation; N m s about yaw, and times the arm about roll and pitch
    """

    mass: Array
    inertia: Array
    center: Array
    drag: float


def body(load_mass: Array, drag: float) -> Body:
    """The body that a load of `load_mass` ``(N,)`` [kg] makes, by the parallel axis theorem."""
    mass = MASS + load_mass
    share = load_mass / mass
    return Body(mass, INERTIA + MASS * share * LOAD_OFFSET**2, share * LOAD_OFFSET, drag)


def rate_loop(state: RateLoop, wanted: Array, measured: Array, dt: float = STEP_S) -> tuple[RateLoop, Array]:
    """One step of the autopilot's rate loop: torque ``(3, N)`` [N m] from body rates ``(3, N)`` [rad/s]."""
    share = 1.0 - np.exp(-2.0 * np.pi * DERIVATIVE_CUTOFF_HZ * dt)
    slope = state.slope + share * ((measured - state.rates) / dt - state.slope)
    error = wanted - measured
    integral = np.clip(state.integral + RATE_I * error * dt, -RATE_INTEGRAL_LIMIT, RATE_INTEGRAL_LIMIT)
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
    most = np.maximum(np.minimum(1.0 - lift - np.abs(pitch), lift - np.abs(roll)), 0.0)
    least = np.maximum(np.minimum(lift - np.abs(pitch), 1.0 - lift - np.abs(roll)), 0.0)
    yaw = np.clip(yaw, -least, most)
    return np.stack([lift - pitch + yaw, lift + roll - yaw, lift + pitch + yaw, lift - roll - yaw])


def step(
    rigid: Array, motors: Array, commands: Array, whole: Body, wind: Array, dt: float = STEP_S
) -> tuple[Array, Array]:
    """Rigid state and motor thrust `dt` s later: exact motor lag, one Runge-Kutta step with the mean thrust.

    Parameters
    ----------
    commands : (4, N), 0..1, held over the step
    wind : (3, N) m/s in the world, held over the step
    """
    target = THRUST / 4.0 * commands
    keep = np.exp(-dt / MOTOR_LAG)
    mean = target + (1.0 - keep) * MOTOR_LAG / dt * (motors - target)
    front, left, rear, right = mean
    wrench = np.stack(
        [front + left + rear + right, left - right, rear - front, YAW_MOMENT * (front - left + rear - right)]
    )
    first = derivatives(rigid, wrench, whole, wind)
    second = derivatives(rigid + 0.5 * dt * first, wrench, whole, wind)
    third = derivatives(rigid + 0.5 * dt * second, wrench, whole, wind)
    fourth = derivatives(rigid + dt * third, wrench, whole, wind)
    rigid = rigid + dt / 6.0 * (first + 2.0 * (second + third) + fourth)
    return rigid, target + keep * (motors - target)


def derivatives(rigid: Array, wrench: Array, whole: Body, wind: Array) -> Array:
    """Time derivative ``(12, N)`` per second under U1..U4 ``(4, N)`` of eq 14 [N, N, N, N m]; Newton-Euler.

    The centre of mass lies `whole.center` along body z from the point whose motion the state holds.
    """
    sines, cosines = np.sin(rigid[6:9]), np.cos(rigid[6:9])
    (sr, sp, sy), (cr, cp, cy) = sines, cosines
    p, q, r = rigid[9:12]
    u1, u2, u3, u4 = wrench
    force = whole.drag * (wind - rigid[3:6])
    # Axes of the body in the world, and the drag along the first two: its lever about the centre of mass.
    forward = np.stack([cp * cy, cp * sy, -sp])
    left = np.stack([cy * sp * sr - sy * cr, sy * sp * sr + cy * cr, cp * sr])
    up = np.stack([cy * sp * cr + sy * sr, sy * sp * cr - cy * sr, cp * cr])
    turning = whole.inertia - INERTIA
    along_forward, along_left = (force * forward).sum(axis=0), (force * left).sum(axis=0)
    roll_torque = ARM * (u2 - whole.drag * p) + whole.center * along_left + turning * q * r
    pitch_torque = ARM * (u3 - whole.drag * q) - whole.center * along_forward - turning * p * r
    ap, aq = roll_torque / whole.inertia, pitch_torque / whole.inertia
    yaw_rate = (sr * q + cr * r) / cp
    rates = np.empty_like(rigid)
    rates[0:3] = rigid[3:6]
    rates[3:6] = (u1 * up + force) / whole.mass
    rates[5] -= GRAVITY
    # What the centre of mass has on top: alpha x c + omega x (omega x c), c = (0, 0, center).
    swing = (aq + p * r) * forward - (ap - q * r) * left - (p * p + q * q) * up
    rates[3:6] -= whole.center * swing
    rates[6], rates[7], rates[8] = p + sp * yaw_rate, cr * q - sr * r, yaw_rate
    rates[9], rates[10], rates[11] = ap, aq, (u4 - whole.drag * r) / INERTIA
    return rates
