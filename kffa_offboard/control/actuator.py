"""The command as the plant feels it: transport delay, then first-order lag.

An observer that is told the command at the moment of sending, while the vehicle feels it 30-80 ms
later, takes the difference for a disturbance and oscillates. Here the commands wait in a
short queue, so that input and output of the observer match in time; the lag is that of the motors
or of the autopilot's inner loop. No counterpart in the paper, whose actuators are ideal.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from msgspec import Struct

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


class ActuatorState(Struct, frozen=True, gc=False):
    """Commands under way.

    Attributes
    ----------
    ages : tuple of float, s
        How long ago each queued command was sent, oldest first; the last one is the newest. Below zero: sent
        since the state was made.
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


def send(state: ActuatorState, command: Array, after: float = 0.0) -> ActuatorState:
    """Put a command in the queue `after` s from this moment; one of that moment or later is replaced."""
    ages, kept = state.ages, state.commands
    while ages[-1] <= -after:
        ages, kept = ages[:-1], kept[:-1]
    return ActuatorState((*ages, -after), np.concatenate((kept, command[None])), state.lagged)


class Line(Struct, frozen=True, gc=False):
    """Commands under way on one channel of one vehicle: `ActuatorState` in plain floats."""

    ages: tuple[float, ...]
    commands: tuple[float, ...]
    lagged: float


def initial_line(command: float) -> Line:
    """`command` has been acting for ever."""
    return Line((np.inf,), (command,), command)


def send_one(line: Line, command: float) -> Line:
    """Put a command in the queue at this moment; one of this moment is replaced."""
    ages, kept = line.ages, line.commands
    while ages[-1] <= 0.0:
        ages, kept = ages[:-1], kept[:-1]
    return Line((*ages, 0.0), (*kept, command), line.lagged)


NOW = np.zeros(())


class Window(NamedTuple):
    """A time, as commands under way see it; each ``(4[, N])`` or broadcast to it.

    Attributes
    ----------
    delay : s, of the actuator, seen from the end of that time
    span : s, how long it is
    held : share of the lag's first transient in the mean of its output
    decay : the same at the end
    """

    delay: Array
    span: Array
    held: Array
    decay: Array


@remember
def window(parameters: ActuatorParameters, ahead: Array, dt: float | Array, axes: int) -> Window:
    """The `dt` that ends `ahead` s from the moment of the ages, for commands of so many axes."""
    like = np.empty((1,) * axes)
    delay, lag = column(parameters.delay, like) - column(ahead, like), column(parameters.lag, like)
    span = column(dt, like)
    lagging = lag > 0.0
    safe_lag = np.where(lagging, lag, 1.0)
    decay = np.where(lagging, np.exp(-span / safe_lag), 0.0)
    held = np.where(lagging, safe_lag / span * (1.0 - decay), 0.0)
    return Window(delay, span, held, decay)


def shares(ages: tuple[float, ...], delay: Array, span: Array) -> Array:
    """How long each of the K commands acted in a `Window`, over its span ``(K, 4[, N])``.

    A command acted from (age - delay) ago until the next one took over.
    """
    age = np.array(ages).reshape(-1, *(1,) * delay.ndim)
    parts: Array = np.minimum(np.maximum(age - delay, 0.0), span)
    parts[:-1] -= parts[1:]
    parts /= span
    return parts


def shares_of_one(ages: tuple[float, ...], delay: float, span: float) -> list[tuple[int, float]]:
    """`shares` of one channel of one vehicle, without those that are zero: place and share, in order."""
    found, since, place = [], span, 0  # the oldest has acted for longer, as far as is known
    for younger in ages[1:]:
        ended = 0.0 if younger <= delay else span if younger - delay >= span else younger - delay
        if since > ended:
            found.append((place, (since - ended) / span))
        if ended == 0.0:
            return found
        since, place = ended, place + 1
    return [*found, (place, since / span)]


@remember
def acting(ages: tuple[float, ...], delay: Array, span: Array) -> tuple[slice, Array]:
    """Those of the commands that act in a `Window`, and the `shares` of these."""
    parts = shares(ages, delay, span)
    (numbers,) = np.nonzero(parts.reshape(len(parts), -1).any(axis=1))
    piece = slice(numbers[0], numbers[-1] + 1)
    return piece, parts[piece]


@remember
def _acting(
    parameters: ActuatorParameters, ages: tuple[float, ...], dt: float, axes: int
) -> tuple[Array, Array, Array]:
    """Shares, `held` and `decay` of the `dt` that ends at the moment of the ages."""
    delay, span, held, decay = window(parameters, NOW, dt, axes)
    return shares(ages, delay, span), held, decay


def average(shares: Array, commands: Array) -> Array:
    """Mean of the delayed, piecewise constant command ``(4[, N])``, from the shares of a window; exact."""
    mean: Array
    if commands.ndim == 2:
        mean = np.add.reduce(shares * commands)
    else:  # the products of many flights are not kept
        mean = np.einsum("k...,k...->...", shares, commands)
    return mean


def lagging(average: Array, held: Array, decay: Array, lagged: Array) -> tuple[Array, Array]:
    """Mean of the lag's output over a window, and its end.

    The lag is applied to the window's mean command as to a constant, exactly.
    """
    transient = lagged - average
    return average + held * transient, average + decay * transient


def step(parameters: ActuatorParameters, state: ActuatorState, dt: float) -> tuple[ActuatorState, Array]:
    """Advance by `dt` s and return the mean command ``(4[, N])`` that acted in that time."""
    ages = aged(state.ages, dt)
    parts, held, decay = _acting(parameters, ages, dt, state.lagged.ndim)
    acted, lagged = lagging(average(parts, state.commands), held, decay, state.lagged)
    over = count_over(parameters, ages)
    return ActuatorState(kept(ages, over), state.commands[over:], lagged), acted


@lru_cache(maxsize=256)
def _window_of_one(parameters: ActuatorParameters, dt: float) -> tuple[float, float, float, float]:
    delay, span, held, decay = (number.item() for number in window(parameters, NOW, dt, 1))
    return delay, span, held, decay


@lru_cache(maxsize=256)
def _acting_of_one(
    parameters: ActuatorParameters, ages: tuple[float, ...], dt: float
) -> tuple[list[tuple[int, float]], int, tuple[float, ...]]:
    """What acts in the `dt` s after these ages (`shares_of_one`), how many act no more, the others' ages."""
    delay, span, _, _ = _window_of_one(parameters, dt)
    later = aged(ages, dt)
    over = count_over(parameters, later)
    return shares_of_one(later, delay, span), over, kept(later, over)


def step_one(parameters: ActuatorParameters, line: Line, dt: float) -> tuple[Line, float]:
    """`step` for one channel of one vehicle."""
    _, _, held, decay = _window_of_one(parameters, dt)
    acting, over, ages = _acting_of_one(parameters, line.ages, dt)
    mean, commands = 0.0, line.commands
    for place, share in acting:
        mean += share * commands[place]
    transient = line.lagged - mean
    return Line(ages, commands[over:], mean + decay * transient), mean + held * transient


def aged(ages: tuple[float, ...], dt: float) -> tuple[float, ...]:
    """The ages `dt` s later."""
    return tuple([age + dt for age in ages])


def count_over(parameters: ActuatorParameters, ages: tuple[float, ...]) -> int:
    """How many of the oldest commands act no more."""
    over = 0
    while over + 1 < len(ages) and ages[over + 1] >= parameters.longest_delay:
        over += 1
    return over


def kept(ages: tuple[float, ...], over: int) -> tuple[float, ...]:
    """The ages of what is left; the oldest counts as having acted for ever."""
    return (np.inf, *ages[over + 1 :])


def forecast(parameters: ActuatorParameters, state: ActuatorState, horizon: Array) -> Array:
    """Mean command ``(4[, N])`` that will act during the coming `horizon` s if no other is sent.

    `horizon` is per channel and must be more than 0.
    """
    delay, span, held, decay = window(parameters, horizon, horizon, state.lagged.ndim)
    mean = average(shares(state.ages, delay, span), state.commands)
    return lagging(mean, held, decay, state.lagged)[0]
