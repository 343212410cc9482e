"""Body-rate control of the simulated autopilot: a PID on each axis, gyro in, torque out.

The law is that of PX4 (src/lib/rate_control, a derivative on the measurement) or of ArduCopter
(AC_PID in AC_AttitudeControl, a derivative on the error and a filtered target), depending on the
gains. Output is normalised, -1..1 of the torque that the airframe can give about an axis; whoever
calls it knows what that is in N m.

Plain floats on purpose: at 400 Hz a numpy array of three costs more than the arithmetic in it.
"""

from __future__ import annotations

import math
from typing import NamedTuple, TypeAlias

Vector3: TypeAlias = tuple[float, float, float]
ZERO: Vector3 = (0.0, 0.0, 0.0)


class RateGains(NamedTuple):
    """Gains about roll, pitch and yaw; outputs are normalised torque."""

    proportional: Vector3  # 1/(rad/s)
    integral: Vector3  # 1/rad
    derivative: Vector3  # 1/(rad/s^2)
    integral_limit: Vector3  # largest share of the integrator, normalised
    derivative_on_error: bool  # ArduCopter: yes; PX4: on the measurement only
    derivative_cutoff_hz: float  # first-order low-pass on the derivative
    target_cutoff_hz: Vector3  # first-order low-pass on the setpoint, 0 = none


class RateState(NamedTuple):
    """Memory between two steps: normalised integrators, filtered setpoint [rad/s], slopes [rad/s^2]."""

    integrator: Vector3 = ZERO
    target: Vector3 = ZERO
    previous: Vector3 = ZERO
    slope: Vector3 = ZERO


def low_pass_share(cutoff_hz: float, dt: float) -> float:
    """Share of a new value that an exact first-order low-pass takes in `dt` seconds; 1 for no filter."""
    return 1.0 if cutoff_hz <= 0.0 else 1.0 - math.exp(-2.0 * math.pi * cutoff_hz * dt)


def step(
    gains: RateGains,
    state: RateState,
    setpoint: Vector3,
    measured: Vector3,
    saturation: Vector3,
    integrate: bool,
    dt: float,
) -> tuple[RateState, Vector3]:
    """One step of the rate loop.

    Parameters
    ----------
    gains, state : see their classes
    setpoint, measured : (3,) body rates [rad/s]
    saturation : (3,) how much of the last torque the motors could not give; its sign stops the
        integrator from winding further that way
    integrate : False on the ground, where the integrators are cleared
    dt : s

    Returns
    -------
    new state, torque demand (3,) normalised to -1..1
    """
    share = low_pass_share(gains.derivative_cutoff_hz, dt)
    integrator, target, previous, slope, torque = [0.0] * 3, [0.0] * 3, [0.0] * 3, [0.0] * 3, [0.0] * 3
    for axis in range(3):
        wanted = state.target[axis]
        wanted += low_pass_share(gains.target_cutoff_hz[axis], dt) * (setpoint[axis] - wanted)
        error = wanted - measured[axis]
        signal = error if gains.derivative_on_error else -measured[axis]
        raw = (signal - state.previous[axis]) / dt
        slope[axis] = state.slope[axis] + share * (raw - state.slope[axis])
        held = state.integrator[axis]
        if integrate and saturation[axis] * error <= 0.0:
            limit = gains.integral_limit[axis]
            held = min(limit, max(-limit, held + gains.integral[axis] * error * dt))
        demand = gains.proportional[axis] * error + held + gains.derivative[axis] * slope[axis]
        torque[axis] = min(1.0, max(-1.0, demand))
        integrator[axis] = held if integrate else 0.0
        target[axis], previous[axis] = wanted, signal
    return (
        RateState(_vector(integrator), _vector(target), _vector(previous), _vector(slope)),
        _vector(torque),
    )


def _vector(values: list[float]) -> Vector3:
    return values[0], values[1], values[2]
