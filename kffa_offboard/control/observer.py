"""Linear extended state observer in exact discrete form (paper eq 18-23, 26-27).

The plant of each channel is

    d2y/dt2 = b0 u - damping dy/dt - stiffness y + disturbance

and the observer estimates y, dy/dt and the disturbance s3 from y and u alone.

Differs from the paper in:

* the discretisation. With forward Euler at the published h = 0.005 s, omega_o = 240..260 and
  omega_c = 25..30, the closed loop diverges; here the plant is held exactly (zero-order hold) and the
  gain is that of a current estimator (R. Miklosovic, A. Radke, Z. Gao, "Discrete implementation
  and generalization of the extended state observer", ACC 2006), so that the error has its poles
  at exp(-omega_o h) for any h;
* known `damping` and `stiffness` (model assistance). Zero is the paper's observer. A rate loop
  with time constant tau, commanded in rates, has b0 = damping = 1/tau: without that knowledge
  -rate/tau is most of the "disturbance", and the observer is always late with it;
* eq 26 prints power n where n + 1 is meant, and lacks the binomial coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from kffa_offboard.control import Array, BoolArray, column
from kffa_offboard.control.memory import remember


@dataclass(frozen=True, eq=False)
class PlantModel:
    """What is known of each channel's plant; each entry ``(4,)`` or ``(4, N)``.

    Attributes
    ----------
    b0 : output acceleration per unit of command (paper eq 24, 36-37)
    damping : 1/s
    stiffness : 1/s^2
    """

    b0: Array
    damping: Array
    stiffness: Array


@dataclass(frozen=True, eq=False)
class ObserverParameters:
    """Poles of the estimation error.

    Attributes
    ----------
    poles : (3, 4) or (3, 4, N), 1/s
        Decay rates, positive real part; three equal ones are the bandwidth omega_o.
    """

    poles: NDArray[np.float64] | NDArray[np.complex128]

    @cached_property
    def fastest(self) -> Array:
        """Decay rate of the fastest pole of each channel, (4,) or (4, N), 1/s."""
        return np.asarray(np.abs(self.poles).max(axis=0))

    def hurried(self, damping: Array) -> ObserverParameters:
        """With poles that are in sum no slower than the plant's `damping` ``(4,)``, ``(4, 1)`` or ``(4, N)``.

        Slower ones would hold the decay of the rate back, with gains that grow like
        exp((damping - 3 omega_o) elapsed): with samples lost, estimates diverge.
        """
        poles = self.poles
        if poles.ndim == 2 and damping.ndim == 2:
            poles = poles[..., None]
        return ObserverParameters(poles * np.maximum(1.0, damping / np.real(poles.sum(axis=0))))

    @classmethod
    def from_bandwidth(cls, omega_o: Array) -> ObserverParameters:
        """Bandwidth form: L = [3 omega_o, 3 omega_o^2, omega_o^3] (paper after eq 27)."""
        return cls(np.repeat(np.asarray(omega_o, dtype=float)[None], 3, axis=0))

    @classmethod
    def from_gains(cls, gains: Array) -> ObserverParameters:
        """Continuous gains l1, l2, l3 of eq 23 chosen one by one, shape ``(3, 4)`` (the WB-LADRC).

        Raises
        ------
        ValueError
            If the gains of a channel make an unstable observer.
        """
        gains = np.asarray(gains, dtype=float)
        poles = np.stack([-np.roots([1.0, *column_gains]) for column_gains in gains.T], axis=1)
        if np.any(poles.real <= 0.0):
            raise ValueError(
                f"observer gains {gains.tolist()} put an estimation pole in the right half plane; "
                "s^3 + l1 s^2 + l2 s + l3 must have l1 l2 > l3 > 0"
            )
        return cls(poles)


class ObserverState(Struct, frozen=True, gc=False):
    """Estimates s1 (output), s2 (its rate), s3 (total disturbance) and the age of the last correction.

    Attributes
    ----------
    estimate, rate, disturbance : (4[, N])
    elapsed : (4[, N]), s
        Time since the channel was last corrected by a measurement.
    """

    estimate: Array
    rate: Array
    disturbance: Array
    elapsed: Array


def transition(damping: Array, dt: float | Array) -> tuple[Array, Array, Array]:
    """Exact step of dv/dt = -damping v + a, dy/dt = v over `dt` with a held.

    Returns
    -------
    e, p, q
        v+ = e v + p a and y+ = y + p v + q a. With no damping they are 1, dt, dt^2/2.
    """
    x = damping * dt
    small = np.abs(x) < 1e-3
    safe = np.where(small, 1.0, x)
    e = np.exp(-x)
    phi1 = np.where(small, 1.0 - x / 2.0 + x**2 / 6.0, -np.expm1(-safe) / safe)
    phi2 = np.where(small, 0.5 - x / 6.0 + x**2 / 24.0, (safe + np.expm1(-safe)) / safe**2)
    return e, dt * phi1, dt**2 * phi2


def correction_gains(
    parameters: ObserverParameters, damping: Array, elapsed: Array
) -> tuple[Array, Array, Array]:
    """Current-estimator gains that put the error poles at exp(-poles * elapsed).

    Found by comparing coefficients of det(zI - (I - L C) Phi) for the exact Phi of
    `transition`; with three equal poles and no damping they are Miklosovic's
    [1 - beta^3, 1.5 (1-beta)^2 (1+beta)/h, (1-beta)^3/h^2].
    """
    poles = parameters.poles
    if poles.ndim == 2 and elapsed.ndim == 2:
        poles = poles[..., None]
    b1, b2, b3 = np.exp(-poles * elapsed)
    sum1 = np.real(b1 + b2 + b3)
    sum2 = np.real(b1 * b2 + b2 * b3 + b1 * b3)
    sum3 = np.real(b1 * b2 * b3)
    e, p, q = transition(damping, elapsed)
    remainder = sum3 / e
    l3 = (1.0 - sum1 + sum2 - sum3) / (p**2 + q * (1.0 - e))
    l2 = (remainder + e + 1.0 - sum1 - l3 * q) / p
    return 1.0 - remainder, l2, l3


class Discrete(NamedTuple):
    """The plant over one step: `transition`, b0 and stiffness, shaped to go with arrays of so many axes."""

    e: Array
    p: Array
    q: Array
    b0: Array
    stiffness: Array


@remember
def discretised(model: PlantModel, dt: float | Array, axes: int) -> Discrete:
    """`model` over `dt`, which is one number or one for each channel, for arrays of so many axes."""
    like = np.empty((1,) * axes)
    e, p, q = transition(column(model.damping, like), column(dt, like))
    return Discrete(e, p, q, column(model.b0, like), column(model.stiffness, like))


@remember
def gains(parameters: ObserverParameters, model: PlantModel, elapsed: Array) -> tuple[Array, Array, Array]:
    """`correction_gains` after `elapsed` s ``(4[, N])`` without a correction, with `hurried` poles."""
    damping = column(model.damping, elapsed)
    return correction_gains(parameters.hurried(damping), damping, elapsed)


def moved(
    discrete: Discrete, estimate: Array, rate: Array, disturbance: Array, command: Array
) -> tuple[Array, Array]:
    """Output and rate after the step with the command that was acting (eq 19, exact), all ``(4[, N])``."""
    acceleration = disturbance + discrete.b0 * command - discrete.stiffness * estimate
    return (
        estimate + discrete.p * rate + discrete.q * acceleration,
        discrete.e * rate + discrete.p * acceleration,
    )


def predict(model: PlantModel, state: ObserverState, command: Array, dt: float | Array) -> ObserverState:
    """Advance the estimates by `dt` s with the command that was acting.

    `dt` is one number, or one for each channel ``(4[, N])``.
    """
    discrete = discretised(model, dt, state.estimate.ndim)
    estimate, rate = moved(discrete, state.estimate, state.rate, state.disturbance, command)
    return ObserverState(estimate, rate, state.disturbance, state.elapsed + dt)


def correct(
    parameters: ObserverParameters,
    model: PlantModel,
    state: ObserverState,
    measurement: Array,
    fresh: BoolArray,
) -> ObserverState:
    """Correct the channels that have a fresh measurement (paper eq 23); the others stay predicted.

    Parameters
    ----------
    measurement : (4[, N])
        Output, unwrapped near ``state.estimate`` on angular channels. Entries that are not
        fresh are not read.
    fresh : (4[, N]) of bool
    """
    state = corrected(gains(parameters, model, state.elapsed), state, measurement, fresh)
    return replace(state, elapsed=np.where(fresh, 0.0, state.elapsed))


def corrected(
    gains: tuple[Array, Array, Array], state: ObserverState, measurement: Array, fresh: BoolArray
) -> ObserverState:
    """`correct` with given gains; the age of the last correction is left as it is."""
    l1, l2, l3 = gains
    innovation = np.where(fresh, measurement - state.estimate, 0.0)
    return ObserverState(
        estimate=state.estimate + l1 * innovation,
        rate=state.rate + l2 * innovation,
        disturbance=state.disturbance + l3 * innovation,
        elapsed=state.elapsed,
    )
