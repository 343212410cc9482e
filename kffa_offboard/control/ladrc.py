"""Linear control law and bandwidth tuning (paper eq 24-37).

Differs from the paper in: eq 33's two constants are exchanged (4.74 belongs to 5 %, 5.83 to 2 %);
the known damping and stiffness of the plant model are compensated beside the estimated disturbance;
the reference's acceleration may be fed forward. Without it (eq 25 as printed) the loop answers the
tracked reference with (2 w s + w^2)/(s + w)^2, whose zero overshoots a fast one.
"""

from __future__ import annotations

from dataclasses import dataclass

from kffa_offboard.control import Array, column
from kffa_offboard.control.observer import ObserverState, PlantModel

#: omega_c * settling time of the double pole 1 - (1 + w t) exp(-w t) (eq 32-33, put right).
SETTLING_2_PERCENT = 5.83
SETTLING_5_PERCENT = 4.74


@dataclass(frozen=True, eq=False)
class LawParameters:
    """Gains of the PD part; each ``(4,)`` or ``(4, N)``.

    Attributes
    ----------
    omega_c : rad/s
        Nominal controller bandwidth: kp = omega_c^2, kd = 2 omega_c.
    acceleration_feedforward : 0..1
        Share of the reference's acceleration in u0; 0 is the paper's eq 25.
    kp, kd : 1/s^2, 1/s, or None
        Gains chosen one by one (the WB-LADRC); None takes the bandwidth form.
    rejection : 0..1, or None
        Share of the estimated disturbance that the command meets; None meets all of it (eq 24).
    """

    omega_c: Array
    acceleration_feedforward: float = 0.0
    kp: Array | None = None
    kd: Array | None = None
    rejection: Array | None = None


def gains(parameters: LawParameters, omega_c: Array) -> tuple[Array, Array]:
    """Kp [1/s^2] and kd [1/s] for the momentary bandwidth `omega_c` ``(4[, N])``."""
    if parameters.kp is not None and parameters.kd is not None:
        return column(parameters.kp, omega_c), column(parameters.kd, omega_c)
    return omega_c * omega_c, 2.0 * omega_c


def command(
    model: PlantModel,
    state: ObserverState,
    reference: tuple[Array, Array, Array],
    kp: Array,
    kd: Array,
    rejection: Array | None = None,
) -> Array:
    """Control law: u = (u0 - s3) / b0 with u0 = kp (r - s1) + kd (dr/dt - s2) + d2r/dt2 (eq 24-25).

    Parameters
    ----------
    reference : three of (4[, N])
        Output of the tracking differentiator and its first two derivatives, unwrapped near
        ``state.estimate``; a zero second derivative is eq 25 as printed.
    rejection : see `LawParameters`

    Returns
    -------
    Unlimited command ``(4[, N])``.
    """
    position, rate, acceleration = reference
    u0 = kp * (position - state.estimate) + kd * (rate - state.rate) + acceleration
    known = column(model.damping, position) * state.rate + column(model.stiffness, position) * state.estimate
    met = state.disturbance if rejection is None else column(rejection, position) * state.disturbance
    wanted: Array = (u0 + known - met) / column(model.b0, position)
    return wanted


def bandwidth_for_settling(settling_time: float, percent: float = 2.0) -> float:
    """omega_c [rad/s] that settles to 2 % or 5 % in `settling_time` s without disturbance (eq 33).

    Raises
    ------
    ValueError
        If `percent` is neither 2 nor 5.
    """
    constants = {2.0: SETTLING_2_PERCENT, 5.0: SETTLING_5_PERCENT}
    if percent not in constants:
        raise ValueError(f"settling band of {percent} % is not tabulated; use 2 or 5")
    return constants[percent] / settling_time
