"""The command as the plant feels it: transport delay, then first-order lag.

An observer that is told the command at the moment of sending, while the vehicle feels it 30-80 ms
later, takes the difference for a disturbance and oscillates. Here the commands wait in a
short queue, so that input and output of the observer match in time; the lag is that of the motors
or of the autopilot's inner loop. No counterpart in the paper, whose actuators are ideal.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kffa_offboard.control import Array, column


@dataclass(frozen=True)
class ActuatorParameters:
    """Delay and lag of each channel, ``(4,)`` or ``(4, N)``, both in s; zero is an ideal actuator."""

    delay: Array
    lag: Array


@dataclass(frozen=True)
class ActuatorState:
    """Commands under way.

    Attributes
    ----------
    ages : tuple of float, s
        How long ago each queued command was sent, oldest first; the last one is the newest.
    commands : tuple of (4[, N])
    lagged : (4[, N])
        Output of the first-order lag.
    """

    ages: tuple[float, ...]
    commands: tuple[Array, ...]
    lagged: Array


def initial_state(command: Array) -> ActuatorState:
    """`command` ``(4[, N])`` has been acting for ever."""
    return ActuatorState((np.inf,), (command,), command)


def send(state: ActuatorState, command: Array) -> ActuatorState:
    """Put a command in the queue at this moment; one sent at the same moment is replaced."""
    if state.ages[-1] == 0.0:
        return replace(state, commands=(*state.commands[:-1], command))
    return replace(state, ages=(*state.ages, 0.0), commands=(*state.commands, command))


def _mean_acting(
    parameters: ActuatorParameters, ages: tuple[float, ...], state: ActuatorState, dt: Array
) -> tuple[Array, Array]:
    """Mean of delayed, lagged command over the `dt` that ends where the queue has `ages`, and the lag's end.

    The mean of the delayed piecewise-constant command is exact; the lag is applied to that mean as to
    a constant, exactly.
    """
    delay = column(parameters.delay, state.lagged)
    total = np.zeros_like(state.lagged)
    for k, command in enumerate(state.commands):
        # The command acted from (age - delay) ago until the next one took over.
        since = np.clip(ages[k] - delay, 0.0, dt)
        until = np.clip(ages[k + 1] - delay, 0.0, dt) if k + 1 < len(ages) else 0.0
        total = total + (since - until) * command
    mean = total / dt
    lag = column(parameters.lag, state.lagged)
    lagging = lag > 0.0
    safe_lag = np.where(lagging, lag, 1.0)
    decay = np.where(lagging, np.exp(-dt / safe_lag), 0.0)
    transient = state.lagged - mean
    averaged = mean + np.where(lagging, safe_lag / dt * (1.0 - decay), 0.0) * transient
    return averaged, mean + decay * transient


def step(parameters: ActuatorParameters, state: ActuatorState, dt: float) -> tuple[ActuatorState, Array]:
    """Advance by `dt` s and return the mean command ``(4[, N])`` that acted in that time."""
    ages = tuple(age + dt for age in state.ages)
    averaged, lagged = _mean_acting(parameters, ages, state, np.asarray(dt))
    longest = float(np.max(parameters.delay))
    keep = next((k for k in range(len(ages) - 1) if ages[k + 1] < longest), len(ages) - 1)
    return ActuatorState((np.inf, *ages[keep + 1 :]), state.commands[keep:], lagged), averaged


def forecast(parameters: ActuatorParameters, state: ActuatorState, horizon: Array) -> Array:
    """Mean command ``(4[, N])`` that will act during the coming `horizon` s if no other is sent.

    `horizon` is per channel and must be more than 0.
    """
    ahead = column(horizon, state.lagged)
    delay = column(parameters.delay, state.lagged)
    # A shift of the delay by the horizon looks that far ahead in the same queue.
    shifted = replace(parameters, delay=delay - ahead)
    return _mean_acting(shifted, state.ages, state, ahead)[0]
