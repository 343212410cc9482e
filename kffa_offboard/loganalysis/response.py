"""What a channel answers to the recorded command, for given parameters: the models that `identify` fits.

Commands are held between the moments at which they were given; transport delay and lag are exact for them
up to
the 5 ms grid. What a model cannot know (trim, initial state, slow disturbance) is a linear combination of a
few known functions of time, the nuisance basis, which the fit projects out (variable projection: G. Golub and
V. Pereyra, "Separable nonlinear least squares", Inverse Problems 19, 2003).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.signal import cont2discrete, lfilter

from kffa_offboard.loganalysis.record import Array, Series

GRID_S = 0.005
LEAD_IN_S = 1.0

Kind = Literal["rates", "attitude", "altitude"]


@dataclass(frozen=True)
class Window:
    """A stretch of flight in which a channel was excited.

    Attributes
    ----------
    time_s : (n,) s, of the samples
    output : (n,) measured: body rate, angle or climb rate
    grid_s : (m + 1,) s, uniform, from `LEAD_IN_S` before the first sample
    knots_s, integral : (k,) when commands were given, and the command's integral until then
    tilt_factor : (m,) cos(roll) cos(pitch) in each cell of the grid
    """

    time_s: Array
    output: Array
    grid_s: Array
    knots_s: Array
    integral: Array
    tilt_factor: Array

    @property
    def duration_s(self) -> float:
        """From the first to the last sample."""
        return float(self.time_s[-1] - self.time_s[0])

    def delayed(self, delay_s: float) -> Array:
        """Mean command in each cell of the grid, ``(m,)``, when commands act `delay_s` after being given."""
        ends = np.interp(self.grid_s - delay_s, self.knots_s, self.integral)
        return np.diff(ends) / GRID_S

    def sampled(self, at_ends: Array) -> Array:
        """Values at the ends of the cells ``(m,)`` -> at the times of the samples ``(n,)``."""
        return np.interp(self.time_s, self.grid_s[1:], at_ends)


def make_window(time_s: Array, output: Array, command: Series, channel: int, tilt: Series | None) -> Window:
    """Join samples and the commands before and in them; `tilt` holds cos(roll) cos(pitch), None for 1."""
    cells = int(np.ceil((time_s[-1] - time_s[0] + LEAD_IN_S) / GRID_S)) + 1
    grid = time_s[0] - LEAD_IN_S + GRID_S * np.arange(cells + 1)
    knots, values = command.time_s, command.values[:, channel]
    knots = np.concatenate([[min(knots[0], grid[0]) - 1.0], knots, [max(knots[-1], grid[-1]) + 1.0]])
    held = np.concatenate([[values[0]], values])
    integral = np.concatenate([[0.0], np.cumsum(held * np.diff(knots))])
    centres = grid[:-1] + 0.5 * GRID_S
    factor = np.ones(cells) if tilt is None else tilt.interpolated(centres)[:, 0]
    return Window(time_s, output, grid, knots, integral, factor)


def _lagged(command: Array, lag_s: float) -> Array:
    """First-order lag with unit gain, at the ends of the cells; begins in balance."""
    decay = np.exp(-GRID_S / lag_s)
    out, _ = lfilter([1.0 - decay], [1.0, -decay], command, zi=[decay * command[0]])
    return np.asarray(out)


def _rates(parameters: Array, window: Window) -> tuple[Array, Array]:
    """Body rate behind a first-order lag. Parameters: time constant, delay."""
    time_constant, delay = parameters
    since = window.time_s - window.time_s[0]
    simulated = window.sampled(_lagged(window.delayed(delay), time_constant))
    return simulated, np.stack([np.ones_like(since), np.exp(-since / time_constant)], axis=1)


def _attitude(parameters: Array, window: Window) -> tuple[Array, Array]:
    """Angle as a second-order system. Parameters: natural frequency, damping ratio, delay."""
    omega, damping, delay = parameters
    numerator, denominator, _ = cont2discrete(
        ([omega**2], [1.0, 2.0 * damping * omega, omega**2]), GRID_S, "zoh"
    )
    command = window.delayed(delay)
    shifted = lfilter(np.ravel(numerator), denominator, command - command[0]) + command[0]
    # lfilter's output k is the state at the beginning of cell k.
    ends = np.append(shifted[1:], shifted[-1])
    since = window.time_s - window.time_s[0]
    root = np.emath.sqrt(damping**2 - 1.0)
    first, second = np.exp(omega * (-damping + root) * since), np.exp(omega * (-damping - root) * since)
    free = [np.real(first), np.imag(first) if np.iscomplexobj(first) else np.real(second)]
    return window.sampled(ends), np.stack([np.ones_like(since), *free], axis=1)


def _altitude(parameters: Array, window: Window) -> tuple[Array, Array]:
    """Climb rate under lagged thrust. Parameters: b0, lag, delay; slow disturbances are projected out."""
    b0, lag, delay = parameters
    acceleration = b0 * _lagged(window.delayed(delay), lag) * window.tilt_factor
    speed = window.sampled(GRID_S * np.cumsum(acceleration - np.mean(acceleration)))
    since = (window.time_s - window.time_s[0]) / window.duration_s
    return speed, np.stack([np.ones_like(since), since, since**2], axis=1)


@dataclass(frozen=True)
class ResponseModel:
    """A channel's model.

    Attributes
    ----------
    names : of the parameters, as in the configuration where they are keys of it
    start, lower, upper : where the fit begins and may go
    predict : (parameters, window) -> response ``(n,)`` and nuisance basis ``(n, k)``
    """

    names: tuple[str, ...]
    start: tuple[float, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    predict: Callable[[Array, Window], tuple[Array, Array]]


MODELS: dict[Kind, ResponseModel] = {
    "rates": ResponseModel(
        ("rate_time_constant_s", "delay_s"), (0.08, 0.04), (0.005, 0.0), (3.0, 0.5), _rates
    ),
    "attitude": ResponseModel(
        ("natural_frequency_rad_s", "damping_ratio", "delay_s"),
        (8.0, 0.9, 0.04),
        (0.3, 0.05, 0.0),
        (100.0, 3.0, 0.5),
        _attitude,
    ),
    "altitude": ResponseModel(
        ("b0", "lag_s", "delay_s"), (20.0, 0.05, 0.04), (1.0, 0.005, 0.0), (200.0, 0.5, 0.5), _altitude
    ),
}
