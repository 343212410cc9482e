"""What really happened: true states and events, in memory and as CSV.

Units SI and radians, axes of the paper (x north, y west, z up).
"""

from __future__ import annotations

import csv
from typing import NamedTuple, TextIO

COLUMNS = (
    *("time_s", "x", "y", "z", "vx", "vy", "vz", "roll", "pitch", "yaw", "p", "q", "r"),
    *("thrust_n", "load_mass_kg", "load_swing", "armed", "mode", "event"),
)
"""Columns of the CSV."""

FIRST_LINE = ",".join(COLUMNS)
"""With which a file of true states begins."""

PERIOD_US = 10_000
"""A row every 10 ms of simulated time."""


class TruthRow(NamedTuple):
    """One instant: time [s], rigid-body state (12), total thrust [N], load [kg], armed, mode, event text.

    `load_swing` is the angle [rad] of a rope with a load from the vertical; 0 without.
    """

    time_s: float
    state: tuple[float, ...]
    thrust_n: float
    load_mass_kg: float
    armed: bool
    mode: str
    event: str
    load_swing: float = 0.0


class TruthEvent(NamedTuple):
    """Something that happened at a time [s]: "armed", "pick-up 5 kg", "mode OFFBOARD", ..."""

    time_s: float
    text: str


class TruthRecorder:
    """Collects rows and events. An event stands in the first row at or after it."""

    def __init__(self) -> None:
        self.rows: list[TruthRow] = []
        self.events: list[TruthEvent] = []
        self._pending: list[str] = []
        self._last_us = 0

    def event(self, time_us: int, text: str) -> None:
        """Note that something happened."""
        self.events.append(TruthEvent(time_us * 1e-6, text))
        self._pending.append(text)

    def due(self, time_us: int) -> bool:
        """Is it time for a row?"""
        return time_us // PERIOD_US > self._last_us // PERIOD_US

    def record(
        self,
        time_us: int,
        state: list[float],
        thrust_n: float,
        load_mass_kg: float,
        armed: bool,
        mode: str,
        load_swing: float = 0.0,
    ) -> None:
        """Append a row."""
        text = "; ".join(self._pending)
        self._pending.clear()
        self._last_us = time_us
        row = TruthRow(time_us * 1e-6, tuple(state), thrust_n, load_mass_kg, armed, mode, text, load_swing)
        self.rows.append(row)

    def time_of(self, text: str) -> float | None:
        """Time [s] of the first event whose text starts with `text`."""
        return next((event.time_s for event in self.events if event.text.startswith(text)), None)


class TruthFile:
    """CSV of a recorder, written as rows come; what is written is not kept."""

    def __init__(self, stream: TextIO, recorder: TruthRecorder) -> None:
        self._stream = stream
        self._recorder = recorder
        self._writer = csv.writer(stream, lineterminator="\n")
        self._writer.writerow(COLUMNS)

    def flush(self) -> None:
        """Write the rows that came since the last time."""
        fresh = self._recorder.rows[:]
        self._recorder.rows.clear()
        for row in fresh:
            self._writer.writerow(
                (
                    f"{row.time_s:.4f}",
                    *(f"{value:.6g}" for value in row.state),
                    f"{row.thrust_n:.6g}",
                    f"{row.load_mass_kg:.6g}",
                    f"{row.load_swing:.6g}",
                    int(row.armed),
                    row.mode,
                    row.event,
                )
            )
        self._stream.flush()
