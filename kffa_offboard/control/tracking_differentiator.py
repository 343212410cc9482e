"""Tracking differentiator: a transition process for the reference (paper eq 16-17).

Turns a step in the reference into a position and a rate that a second-order plant with
acceleration limit `acceleration` can follow, without overshoot (J. Han, "From PID to Active
Disturbance Rejection Control", IEEE Trans. Ind. Electron. 56(3), 2009).

Differs from the paper in: eq 16 defines c_0 twice and uses `i` for the velocity factor r; this is
Han's fhan. Eq 17 omits the h that multiplies fhan. A step longer than `filter_time` / 2 is
taken in equal parts, so that the same parameters hold for any telemetry rate.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil

import numpy as np
from msgspec import Struct

from kffa_offboard.control import Array, column


@dataclass(frozen=True, eq=False)
class TrackingDifferentiatorParameters:
    """Parameters of the transition process.

    Attributes
    ----------
    acceleration : (4,) or (4, N), units/s^2
        The paper's velocity factor i (Han's r): largest acceleration of the reference.
    filter_time : float, s
        The paper's h_0: width of the linear zone; larger is smoother.
    """

    acceleration: Array
    filter_time: float = 0.1


class TrackingDifferentiatorState(Struct, frozen=True, gc=False):
    """Tracked reference, its rate and the acceleration that made it, each ``(4[, N])``."""

    position: Array
    rate: Array
    acceleration: Array


def fhan(x1: Array, x2: Array, r: Array, h0: float) -> Array:
    """Time-optimal discrete synthesis function (paper eq 16, corrected to Han's form).

    Parameters
    ----------
    x1, x2 : position error and rate, ``(4[, N])``
    r : largest acceleration, broadcastable to `x1`
    h0 : time step of the synthesis, s

    Returns
    -------
    Acceleration within ``[-r, r]``.
    """
    d = r * h0**2
    a0 = h0 * x2
    y = x1 + a0
    size = np.abs(y)
    a1 = np.sqrt(d * (d + 8.0 * size))
    a = a0 + np.where(size <= d, y, np.copysign(0.5 * (a1 - d), y))
    share: Array = np.minimum(np.maximum(a / -d, -1.0), 1.0)
    return r * share


def step(
    parameters: TrackingDifferentiatorParameters,
    state: TrackingDifferentiatorState,
    reference: Array,
    dt: float,
) -> TrackingDifferentiatorState:
    """Advance the transition process by `dt` towards `reference` (paper eq 17).

    Parameters
    ----------
    reference : (4[, N])
        Wanted output, already unwrapped near ``state.position`` on angular channels.
    dt : float, s
        Time since the last step, more than 0.
    """
    parts = parts_of(parameters, dt)
    return steps(parameters, state, reference, dt / parts, parts)


def parts_of(parameters: TrackingDifferentiatorParameters, dt: float) -> int:
    """Into how many equal parts a step of `dt` s is divided."""
    return max(1, ceil(2.0 * dt / parameters.filter_time - 1e-9))


def steps(
    parameters: TrackingDifferentiatorParameters,
    state: TrackingDifferentiatorState,
    reference: Array,
    h: float | Array,
    parts: int,
) -> TrackingDifferentiatorState:
    """So many steps of `h` s each."""
    acceleration_limit = column(parameters.acceleration, reference)
    position, rate, acceleration = state.position, state.rate, state.acceleration
    for _ in range(parts):
        acceleration = fhan(position - reference, rate, acceleration_limit, parameters.filter_time)
        position = position + h * rate
        rate = rate + h * acceleration
    return TrackingDifferentiatorState(position, rate, acceleration)
