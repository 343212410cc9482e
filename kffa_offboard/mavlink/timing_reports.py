"""The control loop's punctuality on the wire: NAMED_VALUE_FLOAT once a second, and a text when it is late."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import Message
from kffa_offboard.offboard.events import Announce, Severity, StepTiming

TEXT_PERIOD_US = 10_000_000
"""Late steps are said in words no more often than this."""


class TimingReports:
    """Turns `StepTiming` into messages and, now and then, words."""

    def __init__(self) -> None:
        self._late = 0
        self._said_us: int | None = None
        self._longest_s = 0.0

    def take(self, time_us: int, timing: StepTiming) -> list[Message | Announce]:
        """What is to be sent for a report: LATE_STEPS, LATE_DUE (counts) and DELAY_MAX (s)."""
        time_ms = time_us // 1000 % 2**32
        values = (
            (b"LATE_STEPS", float(timing.late_steps)),
            (b"LATE_DUE", float(timing.late_deadlines)),
            (b"DELAY_MAX", timing.longest_s),
        )
        messages = [mavlink.MAVLink_named_value_float_message(time_ms, name, value) for name, value in values]
        return [*messages, *self._in_words(time_us, timing)]

    def _in_words(self, time_us: int, timing: StepTiming) -> list[Announce]:
        late = timing.late_steps + timing.late_deadlines
        self._longest_s = max(self._longest_s, timing.longest_s)
        quiet = self._said_us is not None and time_us - self._said_us < TEXT_PERIOD_US
        if late == self._late or quiet:
            return []
        text = f"late steps: {late - self._late}, longest {1e3 * self._longest_s:.0f} ms"
        self._late, self._said_us, self._longest_s = late, time_us, 0.0
        return [Announce(Severity.WARNING, text)]
