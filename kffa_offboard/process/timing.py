"""How punctual the control loop is: every late step and every late deadline is counted.

A step is late if its setpoint was ready more than a limit after the sample that it answers had arrived: in
the operating system's buffer where that is known (UDP), else when it was read. A deadline is late if the
loop came to it more than the limit after its time.
"""

from __future__ import annotations

from kffa_offboard.offboard.events import StepTiming

REPORT_PERIOD_US = 1_000_000


class StepClock:
    """Counts, and says once a second what it has counted. Times are microseconds of the loop's clock."""

    def __init__(self, late_s: float) -> None:
        self._late_us = round(late_s * 1e6)
        self._steps = 0
        self._late_steps = 0
        self._late_deadlines = 0
        self._longest_us = 0
        self._reported_us: int | None = None

    def step(self, arrived_us: int, done_us: int) -> None:
        """Note that what had arrived was answered."""
        took_us = done_us - arrived_us
        self._steps += 1
        self._late_steps += took_us > self._late_us
        self._longest_us = max(self._longest_us, took_us)

    def deadline(self, due_us: int, done_us: int) -> None:
        """Note that the loop came to what was due."""
        late_us = done_us - due_us
        self._late_deadlines += late_us > self._late_us
        self._longest_us = max(self._longest_us, late_us)

    def report(self, now_us: int) -> StepTiming | None:
        """The counts since the beginning and the longest delay since the last report, once a second."""
        if self._reported_us is None:
            self._reported_us = now_us
        if now_us - self._reported_us < REPORT_PERIOD_US:
            return None
        self._reported_us = now_us
        return self._counts()

    def last_report(self) -> StepTiming:
        """What has been counted since the last report, at the end of a run."""
        return self._counts()

    def summary(self) -> dict[str, int]:
        """Steps and what was late, since the start."""
        return {
            "steps": self._steps,
            "late_steps": self._late_steps,
            "late_deadlines": self._late_deadlines,
        }

    def _counts(self) -> StepTiming:
        counts = StepTiming(self._steps, self._late_steps, self._late_deadlines, self._longest_us * 1e-6)
        self._longest_us = 0
        return counts
