"""The baselines: a PID in parallel form, and a cascade like the one that PX4 flies.

The parallel PID stands in the paper's comparison. The cascade (P on the output, PI on its rate) has
the structure and the height gains of PX4's mc_pos_control (MPC_Z_P 1, MPC_Z_VEL_P_ACC 4,
MPC_Z_VEL_I_ACC 2) and the attitude gain of mc_att_control (MC_ROLL_P 6.5). Both know the same b0
as the others: what they command is an acceleration divided by b0, plus a constant feed-forward
`trim` (hover thrust).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from msgspec import Struct

from kffa_offboard.control import Array, BoolArray, column


@dataclass(frozen=True, eq=False)
class PidParameters:
    """Gains of each channel, ``(4,)`` or ``(4, N)``.

    Attributes
    ----------
    kp, ki, kd : parallel form: 1/s^2, 1/s^3, 1/s. Cascade: 1/s (output to rate), 1/s^2, 1/s
    b0 : output acceleration per unit of command (cascade to a rate loop: 1, the command is the rate)
    trim : command at rest
    derivative_time : s, of the low-pass on the measured rate when no measured rate is given
    follow : the parallel form meets the reference's rate and acceleration, too: it keeps up with a reference
        that moves, and answers a step of an unfiltered one with a kick
    cascade : bool ``(4,)``
        True: rate = kp * error, command = (kd * (rate - measured rate) + ki * its integral) / b0 + trim.
    rate_command : bool ``(4,)``
        True: the command *is* the wanted rate, kp * error (attitude loop above a rate loop).
    pass_reference : bool ``(4,)``
        True: the command *is* the reference (the autopilot's own attitude loop does the rest).
    """

    kp: Array
    ki: Array
    kd: Array
    b0: Array
    trim: Array
    cascade: BoolArray
    rate_command: BoolArray
    pass_reference: BoolArray
    derivative_time: float = 0.02
    follow: bool = False


class PidState(Struct, frozen=True, gc=False):
    """Integral (as an acceleration), last measurement and filtered rate, each ``(4[, N])``."""

    integral: Array
    measurement: Array
    rate: Array


def initial_state(measurement: Array) -> PidState:
    """At rest at `measurement` ``(4[, N])``."""
    zero = np.zeros_like(measurement)
    return PidState(zero, measurement, zero)


def differentiate(parameters: PidParameters, state: PidState, measurement: Array, dt: float) -> PidState:
    """Low-pass filtered difference of the measurement (exact first order for a held slope)."""
    slope = (measurement - state.measurement) / dt
    blend = -np.expm1(-dt / parameters.derivative_time)
    return PidState(state.integral, measurement, state.rate + blend * (slope - state.rate))


def command(
    parameters: PidParameters, state: PidState, reference: Array, rate: Array, acceleration: Array
) -> Array:
    """Unlimited command ``(4[, N])``; the derivative acts on the measurement, so steps do not kick.

    Rate and acceleration of the reference count with `PidParameters.follow`.
    """
    like = reference
    kp, kd = column(parameters.kp, like), column(parameters.kd, like)
    error = reference - state.measurement
    parallel = kp * error + state.integral - kd * state.rate
    if parameters.follow:
        parallel = parallel + kd * rate + acceleration
    cascaded = kd * (kp * error - state.rate) + state.integral
    acceleration = np.where(column(parameters.cascade, like), cascaded, parallel)
    commanded = acceleration / column(parameters.b0, like) + column(parameters.trim, like)
    commanded = np.where(column(parameters.rate_command, like), kp * error, commanded)
    return np.where(column(parameters.pass_reference, like), reference, commanded)


def integrate(
    parameters: PidParameters, state: PidState, reference: Array, excess: Array, dt: float
) -> PidState:
    """Advance the integral, but not further into a saturated limit (conditional integration).

    Parameters
    ----------
    excess : (4[, N])
        Unlimited minus limited command; its sign is the side of the saturation.
    """
    error = reference - state.measurement
    rate_error = column(parameters.kp, reference) * error - state.rate
    driving = np.where(column(parameters.cascade, reference), rate_error, error)
    increment = column(parameters.ki, reference) * driving * dt
    pushes_out = excess * increment * np.sign(column(parameters.b0, reference)) > 0.0
    return PidState(state.integral + np.where(pushes_out, 0.0, increment), state.measurement, state.rate)
