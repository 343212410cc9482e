"""Kalman filter in front of the observer (paper eq 43-48), on `filterpy.kalman.KalmanFilter`.

One filter carries the stacked channels (block-diagonal model) and gives covariance and gains, which
depend on times alone; the flights of a batch share them. Only channels with a fresh measurement are
corrected, the others are predicted.

Differs from the paper in: read literally (two states per channel, Q = 0.03 I, R = 0.001) the gain is
0.97 and nothing is filtered; that is `model = "literal"`. The default, `model = "extended"`, has
the states of eq 19: output, rate and the disturbance as a random walk. With it the paper's
claims about noise come out. Where the autopilot's telemetry carries the rate of the output (climb
rate, body rates), it is fused beside the output when `rate_variance` is given: a released load shows
in the climb rate long before it shows in the height.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from kffa_offboard.control import Array, BoolArray
from kffa_offboard.control.memory import remember
from kffa_offboard.control.observer import Discrete, PlantModel, discretised, moved, transition

LITERAL_PROCESS_VARIANCE = 0.03  # the paper's Q, per step (section III-C)
MEASUREMENT_VARIANCE = 0.001  # the paper's R (section III-C)
_AT_REST = 1e-9  # relative change of the covariance in a step below which it stays as it is


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
        Steps that differ from the last period by no more than this have its gain; 0 gives each step its own.
    """

    measurement_variance: Array
    disturbance_intensity: Array
    rate_variance: Array | None = None
    model: Literal["extended", "literal"] = "extended"
    process_variance: Array | None = None
    period_tolerance: float = 0.0

    @property
    def states(self) -> int:
        """Number of states of one channel."""
        return 3 if self.model == "extended" else 2


class KalmanState(NamedTuple):
    """Mean and covariance of the filter.

    Attributes
    ----------
    estimate, rate, disturbance : (4[, N])
        The mean; the literal filter has no disturbance, and zeros here.
    covariance : (4 * states, 4 * states)
        Channel by channel.
    period : s
        Step that covariance and gain are worked out for; 0 before the first one.
    """

    estimate: Array
    rate: Array
    disturbance: Array
    covariance: Array
    period: float = 0.0


class KalmanGains(NamedTuple):
    """What an innovation of the output, and one of its rate, change.

    Attributes
    ----------
    output, rate : (3, 4[, 1])
        Of estimate, rate and disturbance; zero where the channel has no fresh measurement.
    """

    output: Array
    rate: Array


@cache
def _blank_filter(states: int, channels: int) -> KalmanFilter:
    return KalmanFilter(dim_x=states, dim_z=channels)


def _filter(parameters: KalmanParameters, covariance: Array) -> KalmanFilter:
    """A filterpy filter with this covariance; filterpy rebinds its matrices and never writes into them."""
    channels = len(parameters.measurement_variance)
    kalman = copy(_blank_filter(parameters.states * channels, channels))
    kalman.P = covariance
    return kalman


def initial_state(
    parameters: KalmanParameters, measurement: Array, disturbance: Array, rate_std: float = 1.0
) -> KalmanState:
    """Start at `measurement` ``(4[, N])`` at rest, with the disturbance that balances the command.

    Parameters
    ----------
    rate_std : float
        Standard deviation of the unknown first rate, output units/s.
    """
    zero = np.zeros_like(measurement)
    variances = np.zeros((len(measurement), parameters.states))
    variances[:, 0] = parameters.measurement_variance
    variances[:, 1] = rate_std**2
    if parameters.states == 3:
        variances[:, 2] = parameters.disturbance_intensity
    balance = disturbance if parameters.states == 3 else zero
    return KalmanState(measurement, zero, balance, np.diag(variances.reshape(-1)))


def with_disturbance_step(parameters: KalmanParameters, state: KalmanState, step: Array) -> KalmanState:
    """The disturbance is known to have changed by `step` ``(4[, N])``; the literal filter has none."""
    if parameters.states != 3:
        return state
    return state._replace(disturbance=state.disturbance + step)


@remember
def _model_matrices(parameters: KalmanParameters, model: PlantModel, dt: float) -> tuple[Array, Array]:
    """Transition F and process noise Q over `dt`, block diagonal."""
    channels, n = len(parameters.measurement_variance), parameters.states
    e, p, q = transition(np.asarray(model.damping, dtype=float), dt)
    base = n * np.arange(channels)
    f = np.eye(n * channels)
    f[base, base + 1] = p
    f[base + 1, base + 1] = e
    noise = np.zeros_like(f)
    if n == 2:
        variance = (
            np.full(channels, LITERAL_PROCESS_VARIANCE)
            if parameters.process_variance is None
            else parameters.process_variance
        )
        noise[base, base] = noise[base + 1, base + 1] = variance
        return f, noise
    f[base, base + 2] = q
    f[base + 1, base + 2] = p
    # Integral of (t^2/2, t, 1)(t^2/2, t, 1)^T over dt: the random walk enters through the disturbance.
    powers = np.array(
        [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
    )
    for i in range(3):
        for j in range(3):
            noise[base + i, base + j] = parameters.disturbance_intensity * powers[i, j]
    return f, noise


@remember
def _selection(
    parameters: KalmanParameters, fresh: BoolArray, with_rate: bool
) -> tuple[NDArray[np.intp], Array, Array]:
    """Channels with a fresh measurement, the H that picks their outputs (then rates) and the R of these."""
    index = np.flatnonzero(fresh)
    rows, variances = parameters.states * index, parameters.measurement_variance[index]
    if with_rate and parameters.rate_variance is not None:
        rows = np.concatenate([rows, rows + 1])
        variances = np.concatenate([variances, parameters.rate_variance[index]])
    h = np.zeros((rows.size, parameters.states * fresh.size))
    h[np.arange(rows.size), rows] = 1.0
    return index, h, np.diag(variances)


@remember
def _gain(
    parameters: KalmanParameters,
    model: PlantModel,
    covariance: Array,
    fresh: BoolArray,
    with_rate: bool,
    dt: float,
) -> tuple[Array, Array, Array]:
    """Covariance after prediction and correction (eq 45, 46, 48), and the gains of `KalmanGains` ``(3, 4)``.

    Measurements do not enter: with a steady telemetry all of it soon repeats itself.
    """
    channels, n = fresh.size, parameters.states
    f, q = _model_matrices(parameters, model, dt)
    index, h, r = _selection(parameters, fresh, with_rate)
    kalman = _filter(parameters, covariance)
    kalman.predict(F=f, Q=q)
    output, rate = np.zeros((3, channels)), np.zeros((3, channels))
    if index.size:
        kalman.update(0.0, R=r, H=h)
        gain = np.asarray(kalman.K).reshape(channels, n, -1)
        # The model is block diagonal: a channel's measurement corrects that channel alone.
        output[:n, index] = gain[index, :, np.arange(index.size)].T
        if with_rate:
            rate[:n, index] = gain[index, :, index.size + np.arange(index.size)].T
    deviations = np.sqrt(np.diag(covariance))
    at_rest = np.abs(kalman.P - covariance) <= _AT_REST * np.outer(deviations, deviations)
    return covariance if at_rest.all() else np.asarray(kalman.P), output, rate


def _period(parameters: KalmanParameters, state: KalmanState, dt: float) -> float:
    """The period still, if `dt` is near it; else `dt` is the new one."""
    return state.period if abs(dt - state.period) <= parameters.period_tolerance * state.period else dt


def gains(
    parameters: KalmanParameters,
    model: PlantModel,
    state: KalmanState,
    fresh: BoolArray,
    dt: float,
    *,
    with_rate: bool,
) -> tuple[KalmanGains, Array, float]:
    """Look up what depends on times alone: gains (to go with ``state.estimate``), new covariance, and period.

    `fresh` and `with_rate` as in `step`.
    """
    pattern = fresh.reshape(len(fresh), -1)[:, 0]
    fused = with_rate and parameters.rate_variance is not None
    period = _period(parameters, state, dt)
    covariance, output, rate = _gain(parameters, model, state.covariance, pattern, fused, period)
    trailing = (1,) * (state.estimate.ndim - 1)
    shaped = KalmanGains(output.reshape(*output.shape, *trailing), rate.reshape(*rate.shape, *trailing))
    return shaped, covariance, period


def advance(
    gains: KalmanGains,
    discrete: Discrete,
    state: KalmanState,
    command: Array,
    measurement: Array,
    fresh: BoolArray,
    measured_rate: Array | None,
) -> KalmanState:
    """Mean after prediction and correction (eq 44, 47); the covariance is left as it is."""
    estimate, rate = moved(discrete, state.estimate, state.rate, state.disturbance, command)
    innovation = np.where(fresh, measurement - estimate, 0.0)
    change = gains.output * innovation
    if measured_rate is not None:
        change = change + gains.rate * np.where(fresh, measured_rate - rate, 0.0)
    to_estimate, to_rate, to_disturbance = change
    return KalmanState(
        estimate + to_estimate,
        rate + to_rate,
        state.disturbance + to_disturbance,
        state.covariance,
        state.period,
    )


def step(
    parameters: KalmanParameters,
    model: PlantModel,
    state: KalmanState,
    command: Array,
    measurement: Array,
    fresh: BoolArray,
    dt: float,
    measured_rate: Array | None = None,
) -> tuple[KalmanState, Array]:
    """Predict over `dt` with the command that acted, then correct with the fresh measurements (eq 44-48).

    Parameters
    ----------
    model : PlantModel
        ``damping`` must be per channel, ``(4,)``: the flights of a batch share one covariance.
    command : (4[, N])
    measurement : (4[, N])
        Unwrapped near the filter's own output on angular channels.
    fresh : (4[, N]) of bool
        A channel counts as fresh when it is so in the first flight: flights of a batch are sampled together.
    measured_rate : (4[, N]) or None
        Read where fresh, and only with `rate_variance`.

    Returns
    -------
    state, filtered
        The new state and the filtered output ``(4[, N])``.
    """
    rates = None if parameters.rate_variance is None else measured_rate
    shaped, covariance, period = gains(parameters, model, state, fresh, dt, with_rate=rates is not None)
    discrete = discretised(model, dt, state.estimate.ndim)
    state = advance(shaped, discrete, state, command, measurement, fresh, rates)
    return state._replace(covariance=covariance, period=period), state.estimate
