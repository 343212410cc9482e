"""Gain, phase and delay margin of a sampled loop from its frequency response."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.loganalysis.record import Array

_LOWEST_RAD_S = 0.05
_POINTS = 120


@dataclass(frozen=True)
class Margins:
    """How far the loop is from instability.

    Attributes
    ----------
    gain_db : least change of gain, up or down, that makes it oscillate
    phase_deg : least phase at any gain crossover
    delay_s : least further delay that makes it oscillate
    crossover_rad_s : where `phase_deg` is
    phase_crossover_rad_s : where `gain_db` is
    """

    gain_db: float
    phase_deg: float
    delay_s: float
    crossover_rad_s: float
    phase_crossover_rad_s: float

    def meet(self, wanted: Wanted) -> bool:
        """All three are at least what is wanted."""
        return (
            self.gain_db >= wanted.gain_db
            and self.phase_deg >= wanted.phase_deg
            and self.delay_s >= wanted.delay_s
        )


@dataclass(frozen=True)
class Wanted:
    """The margins that a loop is to have."""

    gain_db: float = 6.0
    phase_deg: float = 45.0
    delay_s: float = 0.02


def frequencies(period_s: float) -> Array:
    """Frequencies up to half the sampling frequency, rad/s."""
    return np.geomspace(_LOWEST_RAD_S, 0.999 * np.pi / period_s, _POINTS)


def margins(omega: Array, loop: NDArray[np.complex128]) -> Margins:
    """Margins of the open loop `loop` ``(n,)`` at `omega` ``(n,)``; infinite where nothing is crossed."""
    magnitude = np.log(np.abs(loop))
    phase = np.unwrap(np.angle(loop))
    gain, phase_crossover = np.inf, np.nan
    turns = np.floor((phase + np.pi) / (2.0 * np.pi))
    for k in np.flatnonzero(np.diff(turns) != 0.0):
        target = 2.0 * np.pi * max(turns[k], turns[k + 1]) - np.pi
        share = (target - phase[k]) / (phase[k + 1] - phase[k])
        size = abs(magnitude[k] + share * (magnitude[k + 1] - magnitude[k]))
        if size < gain:
            gain, phase_crossover = size, omega[k] * (omega[k + 1] / omega[k]) ** share
    least, delay, crossover = np.inf, np.inf, np.nan
    for k in np.flatnonzero(np.diff(np.sign(magnitude)) != 0.0):
        share = -magnitude[k] / (magnitude[k + 1] - magnitude[k])
        angle = phase[k] + share * (phase[k + 1] - phase[k]) + np.pi
        here = omega[k] * (omega[k + 1] / omega[k]) ** share
        distance = abs((angle + np.pi) % (2.0 * np.pi) - np.pi)
        delay = min(delay, (angle % (2.0 * np.pi)) / here)
        if distance < least:
            least, crossover = distance, here
    return Margins(
        float(20.0 / np.log(10.0) * gain),
        float(np.degrees(least)),
        float(delay),
        float(crossover),
        float(phase_crossover),
    )
