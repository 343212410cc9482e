"""When a flight is given up: its simulated time stands still, or it takes far more of it than a flight needs.

A computer that is slow, or busy with other things, is no reason: everything in lock-step waits for it.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from kffa_offboard.trials.metrics import FlightFailed

STALL_LIMIT_S = 60.0
"""Wall time without any simulated time: the lock-step has stalled."""

BOOT_LIMIT_S = 120.0
"""The same before the first of it: the firmware has not called its physics."""

FLIGHT_LIMIT_S = 300.0
"""Simulated time: more than the scenario and all the autopilot's refusals take."""


class FlightCut(FlightFailed):
    """A limit ended the flight; it is not known what would have become of it."""


class Watch:
    """Sees whether a flight goes on, from now on.

    Parameters
    ----------
    time_s : simulated time so far
    limit_s : simulated time that it may take from here
    clock : wall time, s
    """

    def __init__(
        self, time_s: float, limit_s: float = FLIGHT_LIMIT_S, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._clock, self._limit_s = clock, limit_s
        self._began_s = self._latest_s = time_s
        self._moved_at = clock()

    def see(self, time_s: float, complaint: Callable[[str], str]) -> None:
        """Take the simulated time so far [s]. Raises FlightCut with the `complaint` about the limit."""
        now = self._clock()
        if time_s > self._latest_s:
            self._latest_s, self._moved_at = time_s, now
        limit = STALL_LIMIT_S if self._latest_s > 0.0 else BOOT_LIMIT_S
        if now - self._moved_at > limit:
            stood = f"simulated time stood still at {self._latest_s:.1f} s for {limit:g} s of wall time"
            raise FlightCut(complaint(stood))
        if self._latest_s - self._began_s > self._limit_s:
            raise FlightCut(complaint(f"not over after {self._limit_s:g} s of simulated time"))
