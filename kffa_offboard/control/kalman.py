"""Kalman filter in front of the observer (paper eq 43-48), on `filterpy.kalman.KalmanFilter`.

Each channel has a filter of its own, which gives covariance and gains (`covariance.py`); these depend on
times alone, and the flights of a batch share them. Only channels with a fresh measurement are
corrected, the others are predicted.

Differs from the paper in: read literally (two states per channel, Q = 0.03 I, R = 0.001) the gain is
0.97 and nothing is filtered; that is `model = "literal"`. The default, `model = "extended"`, has
the states of eq 19: output, rate and the disturbance as a random walk. With it the paper's
claims about noise come out. Where the autopilot's telemetry carries the rate of the output (climb
rate, body rates), it is fused beside the output when `rate_variance` is given: a released load shows
in the climb rate long before it shows in the height.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.control import Array, BoolArray
from kffa_offboard.control.covariance import Covariance, KalmanParameters, Spread, corrected, later, predicted
from kffa_offboard.control.memory import remember
from kffa_offboard.control.observer import Discrete, PlantModel, discretised, moved

__all__ = [
    "KalmanGains",
    "KalmanParameters",
    "KalmanState",
    "advance",
    "covariances",
    "gains",
    "initial_state",
    "step",
]

MEASUREMENT_VARIANCE = 0.001  # the paper's R (section III-C)


class KalmanState(Struct, frozen=True, gc=False):
    """Mean of the filter, and how uncertain it is.

    Attributes
    ----------
    estimate, rate, disturbance : (4[, N])
        The mean; the literal filter has no disturbance, and zeros here.
    spreads : of each channel
    """

    estimate: Array
    rate: Array
    disturbance: Array
    spreads: tuple[Spread, ...]


class KalmanGains(NamedTuple):
    """What an innovation of the output, and one of its rate, change.

    Attributes
    ----------
    output, rate : (3, 4[, 1])
        Of estimate, rate and disturbance; zero where the channel has no fresh measurement.
    """

    output: Array
    rate: Array


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
    balance = disturbance if parameters.states == 3 else zero
    return KalmanState(measurement, zero, balance, _first_spreads(parameters, len(measurement), rate_std))


@remember
def _first_spreads(parameters: KalmanParameters, channels: int, rate_std: float) -> tuple[Spread, ...]:
    """The same ones for each start, so that what follows from them is looked up, too."""
    variances = np.zeros((channels, parameters.states))
    variances[:, 0] = parameters.measurement_variance
    variances[:, 1] = rate_std**2
    if parameters.states == 3:
        variances[:, 2] = parameters.disturbance_intensity
    alike: dict[tuple[float, ...], Covariance] = {}
    return tuple(
        Spread(alike.setdefault(tuple(channel), Covariance(np.diag(channel))))
        for channel in variances.tolist()
    )


def with_disturbance_step(parameters: KalmanParameters, state: KalmanState, step: Array) -> KalmanState:
    """The disturbance is known to have changed by `step` ``(4[, N])``; the literal filter has none."""
    if parameters.states != 3:
        return state
    return replace(state, disturbance=state.disturbance + step)


def covariances(parameters: KalmanParameters, model: PlantModel, state: KalmanState) -> Array:
    """How uncertain the mean is now ``(4, states, states)``."""
    return np.stack(
        [
            spread.covariance.matrix
            if spread.elapsed == 0.0
            else predicted(parameters, model, channel, spread.covariance, spread.elapsed).matrix
            for channel, spread in enumerate(state.spreads)
        ]
    )


def gains(
    parameters: KalmanParameters,
    model: PlantModel,
    state: KalmanState,
    fresh: BoolArray,
    dt: float,
    *,
    with_rate: bool,
) -> tuple[KalmanGains, tuple[Spread, ...]]:
    """Look up what depends on times alone: gains (to go with ``state.estimate``), and the new spreads.

    `fresh` and `with_rate` as in `step`.
    """
    pattern = fresh.reshape(len(fresh), -1)[:, 0]
    fused = with_rate and parameters.rate_variance is not None
    trailing = (1,) * (state.estimate.ndim - 1)
    output, rate = np.zeros((2, 3, len(pattern), *trailing))
    spreads = list(state.spreads)
    for channel, spread in enumerate(state.spreads):
        if not pattern[channel]:
            spreads[channel] = later(parameters, model, channel, spread, dt)
            continue
        gain, spreads[channel] = corrected(parameters, model, channel, fused, spread, dt)
        output[: len(gain), channel].T[...] = gain[:, 0]
        if fused:
            rate[: len(gain), channel].T[...] = gain[:, 1]
    return KalmanGains(output, rate), tuple(spreads)


def advance(
    gains: KalmanGains,
    discrete: Discrete,
    state: KalmanState,
    command: Array,
    measurement: Array,
    fresh: BoolArray,
    measured_rate: Array | None,
) -> KalmanState:
    """Mean after prediction and correction (eq 44, 47); the spreads are left as they are."""
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
        state.spreads,
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
    shaped, spreads = gains(parameters, model, state, fresh, dt, with_rate=rates is not None)
    discrete = discretised(model, dt, state.estimate.ndim)
    state = advance(shaped, discrete, state, command, measurement, fresh, rates)
    return replace(state, spreads=spreads), state.estimate
