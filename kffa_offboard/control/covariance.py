"""How uncertain the Kalman filter is of a channel, and what gain that gives (paper eq 45, 46, 48).

None of it depends on measurements, only on when they come, so that it is worked out once for each pattern
of times and looked up from then on. A covariance waits until its channel is measured again and is then
predicted over all the time since, which is the same as step by step.

With a steady telemetry it comes to rest where prediction and correction balance (the algebraic Riccati
equation). It gets there by ever smaller steps; near enough (`KalmanParameters.rest_tolerance`) it is taken
for what it is going to be. Samples at odd times may leave it there (`late_tolerance`).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter

from kffa_offboard.control import Array
from kffa_offboard.control.memory import remember
from kffa_offboard.control.observer import PlantModel, transition

LITERAL_PROCESS_VARIANCE = 0.03  # the paper's Q, per step (section III-C)

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)
_ODDS = 5  # in a row are a new period: two or three also come when a sender makes up for a delay
_STRAYS = 45  # where no time comes so often: with so many of them
_STRIDE = 1.5  # the period becomes longer or shorter by this factor
_LONGEST_STRAY = 6  # periods that a late time counts as at most: one silence alone changes nothing
_SMALLEST_PART = 10  # of the period, a time that gains are worked out for
_SILENCE = 0.15  # s; from then on it is better known what is measured than what was predicted
_AS_MEASURED = np.eye(3, 2)  # the gain that takes over output and rate, and leaves the disturbance as it was
_DOUBLINGS = 40  # of the time until which the Riccati equation is followed
_EXACT = 1e-14  # of the standard deviations, as `KalmanParameters.rest_tolerance`


@dataclass(frozen=True, eq=False)
class KalmanParameters:
    """Noise model of each channel.

    Attributes
    ----------
    measurement_variance : (4,), output units squared
        R: variance of one measurement.
    disturbance_intensity : (4,), (output units/s^2)^2/s
        Growth of the disturbance's variance per second (random walk); `extended` only.
    rate_variance : (4,), (output units/s)^2, or None
        Variance of the measured rate; None does not use it (the paper).
    model : "extended" or "literal"
    process_variance : (4,), output units squared
        Q of the literal filter, added to both states at every step.
    period_tolerance : share of the period
        Measurements that come after nearly the usual time have its gain; 0 gives each its own.
    rest_tolerance : share of the standard deviations
        A covariance that differs by no more from where it comes to rest is taken for that.
    late_tolerance : share of the period
        A measurement at another than the usual time has the gain of the nearest multiple or part of the
        period, if that is not later than by this much, and leaves the covariance that one at the usual time
        would. Over a silence the random walk grows beyond any load, and the noise of the next two samples
        would be taken for one: after 0.15 s output and rate (if that is fused) are taken as measured, and the
        disturbance stays what it was. What was at rest is so at a new period, too; and where there is no
        usual time, the period comes to be about the mean. With 0 each has its own gain and leaves its own
        covariance.
    """

    measurement_variance: Array
    disturbance_intensity: Array
    rate_variance: Array | None = None
    model: Literal["extended", "literal"] = "extended"
    process_variance: Array | None = None
    period_tolerance: float = 0.0
    rest_tolerance: float = 1e-9
    late_tolerance: float = 0.0

    @property
    def states(self) -> int:
        """Number of states of one channel."""
        return 3 if self.model == "extended" else 2


@dataclass(frozen=True, eq=False, slots=True)
class Covariance:
    """Of a channel's states, `matrix` ``(states, states)``; compared by identity."""

    matrix: Array


class Spread(NamedTuple):
    """How uncertain one channel is.

    Attributes
    ----------
    covariance : after the last correction
    elapsed : s since then
    period : s, usually between two corrections; 0 before the first one
    odd : s, between the last two if that was not the usual; else 0
    odds : how often it has been like that in a row
    strays : thirds of a period that odd times were longer (or, below 0, shorter), less one for each sample
    """

    covariance: Covariance
    elapsed: float = 0.0
    period: float = 0.0
    odd: float = 0.0
    odds: int = 0
    strays: int = 0


class Noise(NamedTuple):
    """What `KalmanParameters` say about one channel; channels with the same noise share what is worked out.

    Attributes
    ----------
    measurement_variance : R of the output
    rate_variance : R of its rate; None if that is not fused
    growth : of the disturbance's variance per second (`extended`), or Q of a step (`literal`)
    states : 3 (`extended`) or 2
    rest_tolerance : see `KalmanParameters`
    """

    measurement_variance: float
    rate_variance: float | None
    growth: float
    states: int
    rest_tolerance: float


@remember
def _noise(parameters: KalmanParameters, with_rate: bool) -> tuple[Noise, ...]:
    """Of each channel."""
    rates, process = parameters.rate_variance, parameters.process_variance
    growths = parameters.disturbance_intensity
    if parameters.states == 2:
        growths = np.full_like(growths, LITERAL_PROCESS_VARIANCE) if process is None else process
    return tuple(
        Noise(
            float(variance),
            float(rates[channel]) if with_rate and rates is not None else None,
            float(growths[channel]),
            parameters.states,
            parameters.rest_tolerance,
        )
        for channel, variance in enumerate(parameters.measurement_variance)
    )


@remember
def _model_matrices(noise: Noise, damping: float, dt: float) -> tuple[Array, Array]:
    """Transition F and process noise Q of a channel over `dt`, ``(states, states)``."""
    decay = np.asarray(damping)
    e, p, q = transition(decay, dt)
    f = np.array([[1.0, p, q], [0.0, e, p], [0.0, 0.0, 1.0]])
    if noise.states == 2:
        return f[:2, :2], noise.growth * np.eye(2)
    # The random walk enters through the disturbance: integral of (q, p, 1)(q, p, 1)^T over dt.
    _, p, q = transition(decay, 0.5 * dt * (1.0 + _NODES))
    entered = np.stack([q, p, np.ones_like(p)])
    return f, noise.growth * 0.5 * dt * (entered * _WEIGHTS) @ entered.T


@remember
def _sensors(noise: Noise) -> tuple[Array, Array]:
    """The H that picks the output (then the rate) of a channel, and the R of these."""
    variances = [noise.measurement_variance]
    if noise.rate_variance is not None:
        variances.append(noise.rate_variance)
    return np.eye(len(variances), noise.states), np.diag(variances)


def _damping(model: PlantModel, channel: int) -> float:
    """All of the plant's model that covariances depend on: another b0 leaves them as they are."""
    return float(np.asarray(model.damping, dtype=float)[channel])


def at_rest(
    parameters: KalmanParameters, model: PlantModel, channel: int, with_rate: bool, period: float
) -> tuple[Covariance]:
    """Where a channel's covariance comes to rest if it is measured every `period` s; after the correction."""
    return _resting(_noise(parameters, with_rate)[channel], _damping(model, channel), period)


@remember
def _resting(noise: Noise, damping: float, period: float) -> tuple[Covariance]:
    """See `at_rest`.

    By doubling: each pass goes twice as far in time as the one before (Anderson, "Second-order
    convergent algorithms for the steady-state Riccati equation", 1978).
    """
    f, prior = _model_matrices(noise, damping, period)
    h, r = _sensors(noise)
    information = h.T @ np.linalg.inv(r) @ h
    identity = np.eye(len(f))
    a, g = f.T, information
    for _ in range(_DOUBLINGS):
        step = np.linalg.inv(identity + g @ prior) @ a
        more = a.T @ prior @ step
        g = g + a @ np.linalg.solve(identity + g @ prior, g) @ a.T
        a, prior = a @ step, prior + more
        if _within(more, prior, _EXACT):
            break
    posterior = np.linalg.solve(identity + prior @ information, prior)
    return (Covariance(0.5 * (posterior + posterior.T)),)


def predicted(
    parameters: KalmanParameters, model: PlantModel, channel: int, covariance: Covariance, dt: float
) -> Covariance:
    """The covariance `dt` s later (eq 45)."""
    f, q = _model_matrices(_noise(parameters, False)[channel], _damping(model, channel), dt)
    return Covariance(f @ covariance.matrix @ f.T + q)


def later(parameters: KalmanParameters, model: PlantModel, channel: int, spread: Spread, dt: float) -> Spread:
    """The same `dt` s later, not measured. The literal filter's noise is one of steps, not of time."""
    if parameters.model == "literal":
        return spread._replace(covariance=predicted(parameters, model, channel, spread.covariance, dt))
    return spread._replace(elapsed=spread.elapsed + dt)


@cache
def _blank_filter(states: int) -> KalmanFilter:
    return KalmanFilter(dim_x=states, dim_z=1)


def corrected(
    parameters: KalmanParameters, model: PlantModel, channel: int, with_rate: bool, spread: Spread, dt: float
) -> tuple[Array, Spread]:
    """A channel is measured `dt` s after `spread`: the gain ``(states, 1 or 2)``, and what is left."""
    after = spread.elapsed + dt
    usual, timed = _times(parameters, spread, after)
    period = timed.period
    noise, damping = _noise(parameters, with_rate)[channel], _damping(model, channel)
    if parameters.late_tolerance == 0.0:
        gain, left = _measured(noise, damping, period, spread.covariance, period if usual else after)
    else:
        before = spread.covariance
        if period != spread.period and spread.period and before is _resting(noise, damping, spread.period)[0]:
            (before,) = _resting(noise, damping, period)
        gain, left = _measured(noise, damping, period, before, period)
        if not usual:
            latest = (1.0 + parameters.late_tolerance) * period
            if with_rate and after > max(latest, _SILENCE):
                gain = _AS_MEASURED[: noise.states]
            else:
                gain, _ = _measured(noise, damping, period, before, min(_multiple(period, after), latest))
    return gain, timed._replace(covariance=left)


@remember
def _measured(
    noise: Noise, damping: float, period: float, covariance: Covariance, time: float
) -> tuple[Array, Covariance]:
    """Gain, and the covariance left by a measurement that counts as one `time` s after `covariance`."""
    f, q = _model_matrices(noise, damping, time)
    h, r = _sensors(noise)
    kalman = copy(_blank_filter(noise.states))  # filterpy rebinds matrices and never writes into them
    kalman.P = covariance.matrix
    kalman.predict(F=f, Q=q)
    kalman.update(0.0, R=r, H=h)
    left = Covariance(np.asarray(kalman.P))
    (rest,) = _resting(noise, damping, period)
    near = _within(left.matrix - rest.matrix, rest.matrix, noise.rest_tolerance)
    return np.asarray(kalman.K), rest if near else left


def _within(difference: Array, covariance: Array, tolerance: float) -> bool:
    """Is a difference of two covariances small beside the standard deviations?"""
    deviations = np.sqrt(np.diag(covariance))
    return bool(np.all(np.abs(difference) <= tolerance * np.outer(deviations, deviations)))


def _times(parameters: KalmanParameters, spread: Spread, after: float) -> tuple[bool, Spread]:
    """Is it the usual time; and the spread with its times as they are then."""
    covariance, _, period, odd, odds, strays = spread
    if parameters.late_tolerance > 0.0 and period > 0.0:
        if abs(strays) >= _STRAYS:
            period, strays = period * (_STRIDE if strays > 0 else 1.0 / _STRIDE), 0
        if strays != 0:
            strays -= 1 if strays > 0 else -1
    if _near(parameters, after, period):
        return True, Spread(covariance, 0.0, period, strays=strays)
    odds = odds + 1 if _near(parameters, after, odd) else 1
    if period == 0.0 or odds >= _ODDS:
        return True, Spread(covariance, 0.0, after)
    if parameters.late_tolerance > 0.0:
        periods = min(_multiple(period, after) / period, _LONGEST_STRAY)
        strays += round(3.0 * (periods - 1.0))
    return False, Spread(covariance, 0.0, period, after, odds, strays)


def _multiple(period: float, time: float) -> float:
    """The multiple of the period, or the fraction of it, that is nearest to a time."""
    if time >= period:
        return round(time / period) * period
    return period / round(period / max(time, period / _SMALLEST_PART))


def _near(parameters: KalmanParameters, time: float, usual: float) -> bool:
    return abs(time - usual) <= parameters.period_tolerance * usual
