"""One flight, whatever file it came from: time series in the paper's axes.

World x north, y west, z up; body x forward, y left, z up; radians and SI units. Signs are changed by
`mavlink.frames` only, in the readers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Source = Literal["tlog", "dataflash", "ulog"]


@dataclass(frozen=True)
class Series:
    """Samples of one quantity in strictly ascending time.

    Attributes
    ----------
    time_s : (n,) s, when the sample was taken (or the command given), on the clock of the record
    values : (n, k)
    arrival_s : (n,) s, when it arrived at the computer that wrote the log, on that one's clock; None where
        the file was written on board
    """

    time_s: Array
    values: Array
    arrival_s: Array | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    def __bool__(self) -> bool:
        return len(self.time_s) > 0

    def between(self, start_s: float, end_s: float) -> Series:
        """Samples with start <= time < end."""
        first, last = np.searchsorted(self.time_s, [start_s, end_s])
        arrival = None if self.arrival_s is None else self.arrival_s[first:last]
        return Series(self.time_s[first:last], self.values[first:last], arrival)

    def held(self, time_s: Array) -> Array:
        """Values ``(len(time_s), k)`` as they were last given at each time; the first one before it."""
        index = np.clip(np.searchsorted(self.time_s, time_s, side="right") - 1, 0, len(self) - 1)
        return self.values[index]

    def interpolated(self, time_s: Array) -> Array:
        """Values ``(len(time_s), k)`` between samples by straight lines; constant beyond the ends."""
        columns = [np.interp(time_s, self.time_s, column) for column in self.values.T]
        return np.stack(columns, axis=1)


def empty(columns: int) -> Series:
    """No samples."""
    return Series(np.zeros(0), np.zeros((0, columns)))


def series(
    time_s: Sequence[float] | Array, values: Sequence[Sequence[float]] | Array, columns: int
) -> Series:
    """Build a series in order: samples that are not finite, repeated or out of order are left out."""
    return series_with_arrival(time_s, values, None, columns)


def series_with_arrival(
    time_s: Sequence[float] | Array,
    values: Sequence[Sequence[float]] | Array,
    arrival_s: Sequence[float] | Array | None,
    columns: int,
) -> Series:
    """As `series`, with the time of arrival of each sample."""
    times = np.asarray(time_s, dtype=float)
    rows = np.asarray(values, dtype=float).reshape(len(times), columns)
    good = np.isfinite(times) & np.all(np.isfinite(rows), axis=1)
    latest = np.maximum.accumulate(np.where(good, times, -np.inf)) if len(times) else times
    good &= np.concatenate([[True], times[1:] > latest[:-1]]) if len(times) else good
    arrival = None if arrival_s is None else np.asarray(arrival_s, dtype=float)[good]
    return Series(times[good], rows[good], arrival)


@dataclass(frozen=True)
class Note:
    """Something that happened, in words; `kind` is "mode", "armed", "text", "reboot" or "dropout"."""

    time_s: float
    kind: str
    text: str


@dataclass(frozen=True)
class FlightRecord:
    """One flight as it was recorded.

    Attributes
    ----------
    attitude : (n, 3) roll, pitch, yaw
    body_rates : (n, 3)
    position, velocity : (n, 3)
    attitude_setpoint, rates_setpoint : (n, 3) what the autopilot was commanded to follow
    thrust : (n, 1) collective thrust that was applied, 0..1 of full thrust
    armed, landed : (n, 1) 0 or 1 from that time on
    notes : modes, arming, texts
    autopilot : "px4", "ardupilot" or "" if the file does not say
    commands_sent : the set points are those that a companion computer sent, at the vehicle's time of the
        newest telemetry that it had: their delay is that of the whole loop. False: the delay is that of the
        vehicle alone.
    clock_offset_s : arrival time less sample time, median; None without arrival times
    damage : what is wrong with the file; empty for a whole one
    remarks : what else a reader should know of it
    """

    path: Path
    source: Source
    attitude: Series = field(default_factory=lambda: empty(3))
    body_rates: Series = field(default_factory=lambda: empty(3))
    position: Series = field(default_factory=lambda: empty(3))
    velocity: Series = field(default_factory=lambda: empty(3))
    attitude_setpoint: Series = field(default_factory=lambda: empty(3))
    rates_setpoint: Series = field(default_factory=lambda: empty(3))
    thrust: Series = field(default_factory=lambda: empty(1))
    armed: Series = field(default_factory=lambda: empty(1))
    landed: Series = field(default_factory=lambda: empty(1))
    notes: tuple[Note, ...] = ()
    autopilot: str = ""
    commands_sent: bool = False
    clock_offset_s: float | None = None
    damage: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def start_s(self) -> float:
        """Time of the first attitude."""
        return float(self.attitude.time_s[0]) if self.attitude else 0.0

    @property
    def duration_s(self) -> float:
        """From the first to the last attitude."""
        return float(self.attitude.time_s[-1]) - self.start_s if self.attitude else 0.0

    @property
    def partial(self) -> bool:
        """The file is damaged: what is here is what could be read."""
        return bool(self.damage)
