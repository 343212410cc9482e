"""The command as the plant feels it: transport delay, then first-order lag.

An observer that is told the command at the moment of sending, while the vehicle feels it 30-80 ms
later, takes the difference for a disturbance and oscillates. Here the commands wait in a
short queue, so that input and output of the observer match in time; the lag is that of the motors
or of the autopilot's inner loop. No counterpart in the paper, whose actuators are ideal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from kffa_offboard.control import Array, column
from kffa_offboard.control.memory import remember


@dataclass(frozen=True, eq=False)
class ActuatorParameters:
    """Delay and lag of each channel, ``(4,)`` or ``(4, N)``, both in s; zero is an ideal actuator."""

    delay: Array
    lag: Array

    @cached_property
    def longest_delay(self) -> float:
        """Of all channels (and flights), s."""
        return float(np.max(self.delay))

    @cached_property
    def longest_lag(self) -> float:
        """Of all channels (and flights), s."""
        return float(np.max(self.lag))


class ActuatorState(NamedTuple):
    """Commands under way.

    Attributes
    ----------
    ages : tuple of float, s
        How long ago each queued command was sent, oldest first; the last one is the newest.
    commands : (K, 4[, N]), one for each age
    lagged : (4[, N])
        Output of the first-order lag.
    """

    ages: tuple[float, ...]
    commands: Array
    lagged: Array


def initial_state(command: Array) -> ActuatorState:
    """`command` ``(4[, N])`` has been acting for ever."""
    return ActuatorState((np.inf,), command[None], command)


def send(state: ActuatorState, command: Array) -> ActuatorState:
    """Put a command in the queue at this moment; one sent at the same moment is replaced."""
    ages, kept = state.ages, state.commands
    if ages[-1] == 0.0:
        ages, kept = ages[:-1], kept[:-1]
    return ActuatorState((*ages, 0.0), np.concatenate((kept, command[None])), state.lagged)


@remember
def _window(
    parameters: ActuatorParameters, ages: tuple[float, ...], ahead: Array, dt: float | Array, axes: int
) -> tuple[Array, Array, Array]:
    """What the `dt` that ends `ahead` s after the moment of `ages` makes of queued commands and lag.

    Returns
    -------
    shares : (K, 4[, N]), how long each of the K commands acted, over `dt`
    held : share of the lag's first transient in the mean of its output
    decay : the same at the end
    """
    delay, span, held, decay = _lag(parameters, ahead, dt, axes)
    # A command acted from (age - delay) ago until the next one took over.
    age = np.array(ages).reshape(-1, *(1,) * axes)
    shares = np.minimum(np.maximum(age - delay, 0.0), span)
    shares[:-1] -= shares[1:]
    return shares / span, held, decay


@remember
def _lag(
    parameters: ActuatorParameters, ahead: Array, dt: float | Array, axes: int
) -> tuple[Array, Array, Array, Array]:
    """Delay seen from `ahead` s later, `dt`, and `held` and `decay` of `_window`, all for so many axes."""
    like = np.empty((1,) * axes)
    delay, lag = column(parameters.delay, like) - column(ahead, like), column(parameters.lag, like)
    span = column(dt, like)
    lagging = lag > 0.0
    safe_lag = np.where(lagging, lag, 1.0)
    decay = np.where(lagging, np.exp(-span / safe_lag), 0.0)
    held = np.where(lagging, safe_lag / span * (1.0 - decay), 0.0)
    return delay, span, held, decay


def _mean_acting(state: ActuatorState, window: tuple[Array, Array, Array]) -> tuple[Array, Array]:
    """Mean of delayed, lagged command over a window, and the lag's end.

    The mean of the delayed piecewise-constant command is exact; the lag is applied to that mean as to
    a constant, exactly.
    """
    shares, held, decay = window
    mean = np.add.reduce(shares * state.commands)
    transient = state.lagged - mean
    return mean + held * transient, mean + decay * transient


_NOW = np.zeros(())


def step(parameters: ActuatorParameters, state: ActuatorState, dt: float) -> tuple[ActuatorState, Array]:
    """Advance by `dt` s and return the mean command ``(4[, N])`` that acted in that time."""
    ages = tuple([age + dt for age in state.ages])
    averaged, lagged = _mean_acting(state, _window(parameters, ages, _NOW, dt, state.lagged.ndim))
    over = _over(parameters, ages)
    return ActuatorState((np.inf, *ages[over + 1 :]), state.commands[over:], lagged), averaged


def _over(parameters: ActuatorParameters, ages: tuple[float, ...]) -> int:
    """How many of the oldest commands act no more."""
    over = 0
    while over + 1 < len(ages) and ages[over + 1] >= parameters.longest_delay:
        over += 1
    return over


def forecast(parameters: ActuatorParameters, state: ActuatorState, horizon: Array) -> Array:
    """Mean command ``(4[, N])`` that will act during the coming `horizon` s if no other is sent.

    `horizon` is per channel and must be more than 0.
    """
    window = _window(parameters, state.ages, horizon, horizon, state.lagged.ndim)
    return _mean_acting(state, window)[0]


def prepare(parameters: ActuatorParameters, state: ActuatorState, dt: float, horizon: Array | None) -> None:
    """Work out what `step` over `dt`, and then `forecast` over `horizon`, will look up."""
    ages = tuple([age + dt for age in state.ages])
    _window(parameters, ages, _NOW, dt, state.lagged.ndim)
    if horizon is not None:
        kept = (np.inf, *ages[_over(parameters, ages) + 1 :])
        _window(parameters, kept, horizon, horizon, state.lagged.ndim)
