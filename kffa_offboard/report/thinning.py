"""Fewer points for a screen, with every extreme kept, and gaps as gaps."""

from __future__ import annotations

import numpy as np

from kffa_offboard.report.flight import Array, Line

GAP_FACTOR = 20.0
SHORTEST_GAP_S = 0.3
"""A pause longer than this, and than so many median intervals, interrupts a line."""


def thinned(found: Line, points: int) -> Line:
    """At most about `points` points: the least and the greatest value of each of `points` / 2 stretches.

    All stretches have equally many samples. A stretch that holds a NaN keeps one. A line that is short enough
    is returned as it is. Raises ValueError for fewer than 4 points.
    """
    if points < 4:
        raise ValueError(f"thinned to {points} points; 4 are needed")
    count = len(found)
    if count <= points:
        return found
    size = -(-2 * count // points)
    padded = -(-count // size) * size
    values = np.full(padded, np.nan)
    values[:count] = found.values
    blocks = values.reshape(-1, size)
    starts = np.arange(len(blocks)) * size
    lost = ~np.isfinite(blocks)
    least = starts + np.argmin(np.where(lost, np.inf, blocks), axis=1)
    greatest = starts + np.argmax(np.where(lost, -np.inf, blocks), axis=1)
    missing = (starts + np.argmax(lost, axis=1))[lost.any(axis=1)]
    kept = np.unique(np.concatenate([[0], least, greatest, missing, [count - 1]]))
    kept = kept[kept < count]
    return Line(found.time_s[kept], found.values[kept])


def with_gaps(found: Line) -> Line:
    """The line with a NaN in each pause of the samples, so that no stroke is drawn across it."""
    if len(found) < 3:
        return found
    intervals = np.diff(found.time_s)
    limit = max(SHORTEST_GAP_S, GAP_FACTOR * float(np.median(intervals)))
    after = np.flatnonzero(intervals > limit) + 1
    times = np.insert(found.time_s, after, (found.time_s[after - 1] + found.time_s[after]) / 2.0)
    return Line(times, np.insert(found.values, after, np.nan))


def without_turns(time_s: Array, angle: Array) -> Line:
    """An angle (n,) [rad] within -pi..pi, interrupted where it jumps from one end to the other."""
    wrapped = (angle + np.pi) % (2.0 * np.pi) - np.pi
    after = np.flatnonzero(np.abs(np.diff(wrapped)) > np.pi) + 1
    times = np.insert(time_s, after, time_s[after])
    return Line(times, np.insert(wrapped, after, np.nan))
