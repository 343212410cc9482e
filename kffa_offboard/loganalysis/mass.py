"""Total mass along a recorded flight, and the moments when it changed.

Thrust that carries the empty vehicle at `hover_thrust` gives it b0 u; the loaded one gets the share
empty mass / total mass of that (the model of the altitude channel):

    dv/dt = ratio b0 lag(u) cos(roll) cos(pitch) - g.

In a recording both sides of a moment are known, so the ratio is the slope of v + g t over the integral of
b0 u ... in a window before and in one after it, and a change shows as the difference of the two. The mass of
everything that flies is (empty mass) / ratio.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.signal import find_peaks, lfilter

from kffa_offboard.loganalysis.identify import flying
from kffa_offboard.loganalysis.record import Array, FlightRecord

GRAVITY = 9.80665
GRID_S = 0.01
WINDOW_S = 0.8
LEAST_CHANGE = 0.05
"""Share of the empty mass: the least change that is called a pick-up or a drop."""
SIGNIFICANT = 6.0
"""Standard deviations of the fit that a change must exceed."""
UNUSUAL = 4.5
"""Standard deviations of what the difference does in the rest of the flight that a change must exceed."""
MOTOR_LAG_S = 0.05
USUAL_DELAY_S = 0.04
"""Of the loop, where the flight does not tell it."""
CONTACT_S = 2.0
"""So long after lift-off and before landing the ground may carry a part of the weight."""
CLEARANCE_M = 0.3
"""Above the height at which it stood landed; lower than that the ground may still carry it."""
STEADY_S = 2.0
_STEADY_CLIMB_M_S, _STEADY_TILT_RAD = 0.2, 0.3  # leaning against the wind is hover, too


@dataclass(frozen=True)
class MassChange:
    """A pick-up (positive) or drop (negative): when, and by what share of the empty mass."""

    time_s: float
    share: float


@dataclass(frozen=True)
class MassTrack:
    """Total over empty mass ``(n,)`` and its standard deviation, NaN on the ground, and what changed it."""

    time_s: Array
    mass_ratio: Array
    std: Array
    changes: tuple[MassChange, ...]


def steady_hover_thrust(record: FlightRecord) -> float | None:
    """Median vertical thrust in the first steady hover of `STEADY_S`; None if there is none."""
    if not record.thrust or not record.velocity:
        return None
    time_s = record.velocity.time_s
    angles = record.attitude.interpolated(time_s)
    steady = (
        (flying(record, time_s) != 0.0)
        & (np.abs(record.velocity.values[:, 2]) < _STEADY_CLIMB_M_S)
        & (np.hypot(angles[:, 0], angles[:, 1]) < _STEADY_TILT_RAD)
    )
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(int), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if time_s[end - 1] - time_s[begin] >= STEADY_S:
            span = slice(int(np.searchsorted(time_s, time_s[begin] + 0.25 * STEADY_S)), int(end))
            chosen = time_s[span][time_s[span] <= time_s[begin] + 2.0 * STEADY_S]
            factor = np.prod(np.cos(record.attitude.interpolated(chosen)[:, :2]), axis=1)
            return float(np.median(record.thrust.held(chosen)[:, 0] * factor))
    return None


def track_mass(record: FlightRecord, hover_thrust: float, delay_s: float) -> MassTrack | None:
    """Follow the mass; thrust acts `delay_s` after its command. None without thrust, climb rate or flight."""
    if not record.thrust or len(record.velocity) < 10:
        return None
    begin = max(record.velocity.time_s[0], record.thrust.time_s[0])
    end = min(record.velocity.time_s[-1], record.thrust.time_s[-1])
    grid = np.arange(begin, end, GRID_S)
    half = round(WINDOW_S / GRID_S)
    if len(grid) < 4 * half:
        return None
    angles = record.attitude.interpolated(grid)
    decay = np.exp(-GRID_S / MOTOR_LAG_S)
    commanded = record.thrust.held(grid - delay_s)[:, 0]
    lagged, _ = lfilter([1.0 - decay], [1.0, -decay], commanded, zi=[decay * commanded[0]])
    push = GRAVITY / hover_thrust * lagged * np.cos(angles[:, 0]) * np.cos(angles[:, 1])
    air = (flying(record, grid) != 0.0) & _clear_of_ground(record, grid)
    climb = record.velocity.interpolated(grid)[:, 2]
    slope, variance = _sliding_slope(np.cumsum(push) * GRID_S, climb + GRAVITY * (grid - begin), half)
    contact = 2 * round(CONTACT_S / GRID_S) + 1
    usable = uniform_filter1d(air.astype(float), contact, mode="constant") > 0.999
    samples = max(np.median(np.diff(record.velocity.time_s)) / GRID_S, 1.0)
    std = np.sqrt(variance * samples)  # the grid is finer than the samples
    ratio, ratio_std = np.where(usable, slope, np.nan), np.where(usable, std, np.nan)
    mass = 1.0 / np.clip(ratio, 0.1, 10.0)
    scatter = _scatter(mass, half)
    spread = np.hypot(ratio_std * mass**2, scatter / np.sqrt(2.0))
    return MassTrack(grid, mass, spread, _changes(grid, mass, ratio_std * mass**2, scatter, half))


def _differences(values: Array, half: int) -> Array:
    """The window after each moment less the window before it, NaN at the ends."""
    reach = half // 2 + 1
    difference = np.full(len(values), np.nan)
    difference[reach:-reach] = values[2 * reach :] - values[: -2 * reach]
    return difference


def _scatter(mass: Array, half: int) -> float:
    """Standard deviation of such differences in ordinary flight: gusts push like masses that come and go.

    From the median, which the few moments of real changes do not move.
    """
    size = np.abs(_differences(mass, half))
    return 1.4826 * float(np.nanmedian(size)) if np.any(np.isfinite(size)) else 0.0


def _clear_of_ground(record: FlightRecord, grid: Array) -> Array:
    """Higher than where it stood: autopilots say "landed" seconds after the ground has taken the weight."""
    if not record.position or not record.landed or np.all(record.landed.values == 0.0):
        return np.ones(len(grid), dtype=bool)
    on_ground = record.landed.held(record.position.time_s)[:, 0] != 0.0
    heights = record.position.values[on_ground, 2]
    if not heights.size:
        return np.ones(len(grid), dtype=bool)
    lowest = float(np.median(heights)) + CLEARANCE_M
    return np.asarray(record.position.interpolated(grid)[:, 2] > lowest)


def _sliding_slope(x: Array, y: Array, width: int) -> tuple[Array, Array]:
    """Slope of y over x, and its variance, in the window of 2 * (width // 2) + 1 points around each point."""
    size = 2 * (width // 2) + 1
    trend = np.arange(len(x)) * ((x[-1] - x[0]) / max(len(x) - 1, 1))
    x0, y0 = x - trend, y - trend  # keeps the differences of large numbers small

    def mean(values: Array) -> Array:
        return np.asarray(uniform_filter1d(values, size, mode="nearest"))

    index = np.arange(len(x), dtype=float)
    step = float(trend[1]) if len(trend) > 1 else 0.0
    var_i = (size**2 - 1.0) / 12.0
    cov_ix, cov_iy = mean(index * x0) - index * mean(x0), mean(index * y0) - index * mean(y0)
    var_x0, cov_xy0 = mean(x0 * x0) - mean(x0) ** 2, mean(x0 * y0) - mean(x0) * mean(y0)
    var_y0 = mean(y0 * y0) - mean(y0) ** 2
    var_x = var_x0 + 2.0 * step * cov_ix + step**2 * var_i
    cov_xy = cov_xy0 + step * (cov_ix + cov_iy) + step**2 * var_i
    var_y = var_y0 + 2.0 * step * cov_iy + step**2 * var_i
    slope = cov_xy / np.maximum(var_x, 1e-12)
    residual = np.maximum(var_y - slope * cov_xy, 0.0)
    return slope, residual / np.maximum(var_x, 1e-12) / max(size - 2, 1)


def _changes(grid: Array, mass: Array, std: Array, scatter: float, half: int) -> tuple[MassChange, ...]:
    """Peaks of the difference between the window after and the window before each moment."""
    reach = half // 2 + 1
    difference = _differences(mass, half)
    noise = np.full(len(mass), np.nan)
    noise[reach:-reach] = np.hypot(std[2 * reach :], std[: -2 * reach])
    size = np.nan_to_num(np.abs(difference))
    size[size < SIGNIFICANT * np.nan_to_num(noise, nan=np.inf)] = 0.0
    size[size < UNUSUAL * scatter] = 0.0
    peaks, _ = find_peaks(size, height=LEAST_CHANGE, distance=half)
    kept = []
    for peak in peaks:
        before, after = mass[max(peak - 2 * half, 0) : peak - reach], mass[peak + reach : peak + 2 * half]
        if not np.any(np.isfinite(before)) or not np.any(np.isfinite(after)):
            continue
        lasting = float(np.nanmedian(after) - np.nanmedian(before))
        if abs(lasting) >= LEAST_CHANGE and lasting * difference[peak] > 0.0:
            kept.append(MassChange(float(grid[peak]), lasting))
    return tuple(kept)
