"""How flights of a batch go, summed up while they fly: nothing of a flight has to be kept."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.campaign.settings import FailedTable
from kffa_offboard.control import Array, BoolArray

FAILURES = ("", "altitude", "tilt", "ground", "not recovered")
"""Why a flight failed, by number; the first one is for those that did not."""
ALTITUDE, TILT, GROUND, NOT_RECOVERED = range(1, len(FAILURES))

HOVER_S = 1.0
"""The hover is measured in the last second before the pick-up."""
_EPSILON = 1e-9


@dataclass(frozen=True)
class Outcomes:
    """What came out, ``(N,)`` each; of a failed flight until it failed.

    Attributes
    ----------
    hover_rms_m : height error in the last second before the pick-up
    pickup_peak_m, pickup_iae_m_s, pickup_recovery_s : largest and integrated height error in the
        `recovery_max_s` after the pick-up (until the drop, if that comes earlier), and how long after it the
        height was last further off than `recovered_m`; 0 if it never was
    drop_peak_m, drop_iae_m_s, drop_recovery_s : the same of the drop
    tilt_max_rad : largest angle between thrust and vertical
    saturated_share : of the control steps whose thrust command was limited
    failure : number in `FAILURES`
    failed_at_s : since the start; NaN if it did not fail
    """

    hover_rms_m: Array
    pickup_peak_m: Array
    pickup_iae_m_s: Array
    pickup_recovery_s: Array
    drop_peak_m: Array
    drop_iae_m_s: Array
    drop_recovery_s: Array
    tilt_max_rad: Array
    saturated_share: Array
    failure: NDArray[np.int64]
    failed_at_s: Array


class Observation:
    """The running sums of N flights.

    Attributes
    ----------
    lost : (N,)
        Flights that have left what can be flown.
    """

    def __init__(self, failed: FailedTable, pickup_s: float, drop_s: Array, dt: float) -> None:
        count = len(drop_s)
        pickup = np.full(count, pickup_s)
        self._limits, self._dt = failed, dt
        self._level = np.cos(np.radians(failed.tilt_max_deg))
        self._hover_from, self._pickup_s = pickup_s - HOVER_S, pickup_s
        self._begin = np.stack([pickup, drop_s]) - _EPSILON
        longest = failed.recovery_max_s
        self._end = np.stack([np.minimum(pickup + longest, drop_s), drop_s + longest]) - _EPSILON
        self._peak, self._area, self._out_until = np.zeros((3, 2, count))
        self._hover, self._hover_steps = np.zeros(count), 0
        self._saturated, self._steps = np.zeros(count), np.zeros(count)
        self._cosine = np.ones(count)
        self._failure = np.zeros(count, dtype=np.int64)
        self._failed_at = np.full(count, np.nan)
        self.lost: BoolArray = np.zeros(count, dtype=bool)
        self._done_at = float(self._end.max())

    def see(self, time: float, height: Array, error: Array, cosine: Array, saturated: BoolArray) -> None:
        """Take note of the states at `time`: height above the ground and off its set point, cos(tilt)."""
        size = np.abs(error)
        over = time >= self._end[1]
        self._fail(time, height, size, cosine, over)
        counted = ~(self.lost | over)
        size = np.where(counted, size, 0.0)
        within = (time >= self._begin) & (time < self._end)
        seen = np.where(within, size, 0.0)
        np.maximum(self._peak, seen, out=self._peak)
        self._area += seen
        self._out_until[seen > self._limits.recovered_m] = time + self._dt
        np.minimum(self._cosine, np.where(counted, cosine, 1.0), out=self._cosine)
        self._saturated += saturated & counted
        self._steps += counted
        if self._hover_from - _EPSILON <= time < self._pickup_s - _EPSILON:
            self._hover += size * size
            self._hover_steps += 1

    def _fail(self, time: float, height: Array, size: Array, cosine: Array, over: BoolArray) -> None:
        reasons = (  # what is no number is not within limits either
            (ALTITUDE, ~(size <= self._limits.altitude_error_max_m)),
            (TILT, ~(cosine >= self._level)),
            (GROUND, height <= 0.0),
        )
        failing: BoolArray = (reasons[0][1] | reasons[1][1] | reasons[2][1]) & ~over & ~self.lost
        if not failing.any():
            return
        for reason, found in reasons:
            self._failure[failing & found] = reason
        self._failed_at[failing] = time
        self.lost = self.lost | failing

    def outcomes(self) -> Outcomes:
        """The figures, when all flights are over."""
        recovery = np.clip(self._out_until - self._begin - _EPSILON, 0.0, self._limits.recovery_max_s)
        # Still out in the last step of its window.
        late = (self._out_until >= self._end - _EPSILON) & (self._out_until > 0.0)
        unrecovered = late.any(axis=0) & ~self.lost
        self._failure[unrecovered] = NOT_RECOVERED
        self._failed_at[unrecovered] = np.where(late[0], self._end[0], self._end[1])[unrecovered] + _EPSILON
        return Outcomes(
            hover_rms_m=np.sqrt(self._hover / max(self._hover_steps, 1)),
            pickup_peak_m=self._peak[0],
            pickup_iae_m_s=self._area[0] * self._dt,
            pickup_recovery_s=recovery[0],
            drop_peak_m=self._peak[1],
            drop_iae_m_s=self._area[1] * self._dt,
            drop_recovery_s=recovery[1],
            tilt_max_rad=np.arccos(np.minimum(self._cosine, 1.0)),
            saturated_share=self._saturated / np.maximum(self._steps, 1.0),
            failure=self._failure,
            failed_at_s=self._failed_at,
        )
