"""How well a flight went. Everything is measured on the true output.

Arrays have time first; what follows is kept, so one call measures all channels and flights.
"""

from __future__ import annotations

import numpy as np

from kffa_offboard.control import Array


def settling_time(time: Array, output: Array, step: Array, band: float) -> Array:
    """First time after which `output` stays within `band` times the step of its end; inf if it never does.

    The crossing is interpolated between samples, because two controllers may differ by less than one.

    Parameters
    ----------
    time : (T,), s, from the step on
    output : (T, ...), output from where it stood before the step
    step : (...), signed height of the step
    band : 0.02 for 2 %
    """
    distance = np.abs(output - step) / np.abs(step)
    outside = distance > band
    last = len(time) - 1 - np.argmax(outside[::-1], axis=0)
    following = np.minimum(last + 1, len(time) - 1)
    before = np.take_along_axis(distance, last[None], axis=0)[0]
    after = np.take_along_axis(distance, following[None], axis=0)[0]
    falling = before > after
    share = np.where(falling, (before - band) / np.where(falling, before - after, 1.0), 1.0)
    crossing = time[last] + np.clip(share, 0.0, 1.0) * (time[following] - time[last])
    settled = np.where(outside.any(axis=0), crossing, 0.0)
    return np.where(outside[-1], np.inf, settled)


def overshoot_percent(output: Array, step: Array) -> Array:
    """Largest excursion beyond the step, in % of it; 0 if there is none."""
    return np.asarray(100.0 * np.maximum(np.max(output / step, axis=0) - 1.0, 0.0))


def rms(values: Array) -> Array:
    """Root mean square over time."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def lag(time: Array, reference: Array, output: Array, longest: float = 0.5) -> Array:
    """Delay [s] by which the reference must be shifted to come closest (rms) to the output.

    Searched on a grid of a fifth of the sample time, up to `longest`; the first `longest` seconds
    are not compared. `reference` and `output` are ``(T, ...)`` of the same shape.
    """
    shifts = np.arange(0.0, longest, (time[1] - time[0]) / 5.0)
    compared = time >= longest
    flat_reference = reference.reshape(len(time), -1)
    flat_output = output.reshape(len(time), -1)[compared]
    best = np.empty(flat_reference.shape[1])
    for column in range(flat_reference.shape[1]):
        errors = [
            np.mean((flat_output[:, column] - np.interp(at, time, flat_reference[:, column])) ** 2)
            for at in (time[compared] - shift for shift in shifts)
        ]
        best[column] = shifts[int(np.argmin(errors))]
    return best.reshape(reference.shape[1:])


def recovery_time(time: Array, error: Array, band: float) -> float:
    """First time after which ``|error|`` ``(T,)`` stays within `band`; 0 if always, inf if never."""
    return float(settling_time(time, error[:, None] + 1.0, np.ones(1), band)[0])
