"""Kalman filter in front of the observer (paper eq 43-48), on `filterpy.kalman.KalmanFilter`.

One filter carries the stacked channels (block-diagonal model); the columns of its state are the
batch of flights, which share one covariance. Only channels with a fresh measurement are
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

from kffa_offboard.control import Array, BoolArray, column
from kffa_offboard.control.memory import remember
from kffa_offboard.control.observer import PlantModel, transition

LITERAL_PROCESS_VARIANCE = 0.03  # the paper's Q, per step (section III-C)
MEASUREMENT_VARIANCE = 0.001  # the paper's R (section III-C)


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
    """Mean ``(4 * states, N)`` (channel by channel; N = 1 for one vehicle) and covariance of the filter.

    Attributes
    ----------
    period : s
        Step that covariance and gain are worked out for; 0 before the first one.
    """

    mean: Array
    covariance: Array
    period: float = 0.0


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
    channels, n = len(measurement), parameters.states
    mean = np.zeros((channels, n, measurement.size // channels))
    mean[:, 0] = measurement.reshape(channels, -1)
    variances = np.zeros((channels, n))
    variances[:, 0] = parameters.measurement_variance
    variances[:, 1] = rate_std**2
    if n == 3:
        mean[:, 2] = disturbance.reshape(channels, -1)
        variances[:, 2] = parameters.disturbance_intensity
    return KalmanState(mean.reshape(channels * n, -1), np.diag(variances.reshape(-1)))


def with_disturbance_step(parameters: KalmanParameters, state: KalmanState, step: Array) -> KalmanState:
    """The disturbance is known to have changed by `step` ``(4[, N])``; the literal filter has none."""
    if parameters.states != 3:
        return state
    mean = state.mean.copy()
    mean[2::3] += step.reshape(len(step), -1)
    return state._replace(mean=mean)


@remember
def _model_matrices(
    parameters: KalmanParameters, model: PlantModel, dt: float
) -> tuple[Array, Array, Array, Array, Array]:
    """Transition F, input matrix B (for accelerations) and process noise Q over `dt`, block diagonal.

    And the model's b0 and stiffness as columns ``(4, 1)`` or ``(4, N)``.
    """
    channels, n = len(parameters.measurement_variance), parameters.states
    e, p, q = transition(np.asarray(model.damping, dtype=float), dt)
    b0, stiffness = (column(value, np.empty((1, 1))) for value in (model.b0, model.stiffness))
    base = n * np.arange(channels)
    f = np.eye(n * channels)
    f[base, base + 1] = p
    f[base + 1, base + 1] = e
    b = np.zeros((n * channels, channels))
    b[base, np.arange(channels)] = q
    b[base + 1, np.arange(channels)] = p
    noise = np.zeros_like(f)
    if n == 2:
        variance = (
            np.full(channels, LITERAL_PROCESS_VARIANCE)
            if parameters.process_variance is None
            else parameters.process_variance
        )
        noise[base, base] = noise[base + 1, base + 1] = variance
        return f, b, noise, b0, stiffness
    f[base, base + 2] = q
    f[base + 1, base + 2] = p
    # Integral of (t^2/2, t, 1)(t^2/2, t, 1)^T over dt: the random walk enters through the disturbance.
    powers = np.array(
        [[dt**5 / 20, dt**4 / 8, dt**3 / 6], [dt**4 / 8, dt**3 / 3, dt**2 / 2], [dt**3 / 6, dt**2 / 2, dt]]
    )
    for i in range(3):
        for j in range(3):
            noise[base + i, base + j] = parameters.disturbance_intensity * powers[i, j]
    return f, b, noise, b0, stiffness


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
) -> tuple[Array, Array, NDArray[np.intp], Array]:
    """Covariance after prediction and correction (eq 45, 46, 48), the gain, channels and H of `_selection`.

    Measurements do not enter: with a steady telemetry all of it soon repeats itself, to the last bit.
    """
    f, _, q, _, _ = _model_matrices(parameters, model, dt)
    index, h, r = _selection(parameters, fresh, with_rate)
    kalman = _filter(parameters, covariance)
    kalman.predict(F=f, Q=q)
    if index.size:
        kalman.update(0.0, R=r, H=h)
    return np.asarray(kalman.P), np.asarray(kalman.K), index, h


def prepare(
    parameters: KalmanParameters,
    model: PlantModel,
    state: KalmanState,
    fresh: BoolArray,
    dt: float,
    *,
    with_rate: bool,
) -> None:
    """Work out the gain of a `step` from `state` over `dt` with such measurements, before they come."""
    pattern = fresh.reshape(len(fresh), -1)[:, 0]
    fused = with_rate and parameters.rate_variance is not None
    _gain(parameters, model, state.covariance, pattern, fused, _period(parameters, state, dt))


def _period(parameters: KalmanParameters, state: KalmanState, dt: float) -> float:
    """The period still, if `dt` is near it; else `dt` is the new one."""
    return state.period if abs(dt - state.period) <= parameters.period_tolerance * state.period else dt


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
    channels, n = len(measurement), parameters.states
    rates = None if parameters.rate_variance is None else measured_rate
    pattern = fresh.reshape(channels, -1)[:, 0]
    period = _period(parameters, state, dt)
    covariance, gain, index, h = _gain(
        parameters, model, state.covariance, pattern, rates is not None, period
    )
    f, b, _, b0, stiffness = _model_matrices(parameters, model, dt)
    acceleration = b0 * command.reshape(channels, -1) - stiffness * state.mean[::n]
    mean = np.dot(f, state.mean) + np.dot(b, acceleration)
    if index.size:
        values = measurement.reshape(channels, -1)[index]
        if rates is not None:
            values = np.concatenate([values, rates.reshape(channels, -1)[index]])
        mean = mean + np.dot(gain, values - np.dot(h, mean))
    return KalmanState(mean, covariance, period), mean[::n].reshape(measurement.shape)
