"""Times of a telemetry log as if nobody had set the clock of the computer that wrote it.

A ground station, or a computer without a battery for its clock, gets the time from the network or from
satellites in mid-flight. The vehicle's own clock, in its attitudes, tells such a step from a pause.
"""

from __future__ import annotations

from collections.abc import Iterator

from pymavlink.dialects.v20 import ardupilotmega as mavlink

BACK_US = 1_000_000
"""Records that come later and are older by more than this were written after the clock was set back."""

FORWARD_US = 60_000_000
"""A pause of more than this may be a clock that was set forward."""

_ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE
_MARKER_V2 = 0xFD


def boot_clock(frame: bytes) -> tuple[int, int] | None:
    """Who sent an ATTITUDE, and its `time_boot_ms`; None for any other frame."""
    if frame[0] == _MARKER_V2:
        kind, system, payload = int.from_bytes(frame[7:10], "little"), frame[5], frame[10 : 10 + frame[1]]
    else:
        kind, system, payload = frame[5], frame[3], frame[6 : 6 + frame[1]]
    return (system, int.from_bytes(payload[:4], "little")) if kind == _ATTITUDE else None


class EvenClock:
    """Takes the steps out of the times of records.

    Attributes
    ----------
    steps_s : by how much the clock was set, each time

    """

    def __init__(self) -> None:
        self.steps_s: list[float] = []
        self._shift_us = 0
        self._last_us: int | None = None
        self._attitudes: dict[int, tuple[int, int]] = {}
        self._waiting: list[tuple[int, bytes]] = []

    def even(self, records: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
        """The records, in order; those after a long pause as soon as an attitude tells what it was."""
        for time_us, frame in records:
            clock = boot_clock(frame)
            now_us = time_us - self._shift_us
            if self._waiting and self._goes_on(now_us):
                yield from self._damaged()
            last_us = self._waiting[-1][0] - self._shift_us if self._waiting else self._last_us
            if last_us is not None and now_us < last_us - BACK_US:
                yield from self._released()
                self._set(now_us - last_us)
            elif self._waiting or (last_us is not None and now_us > last_us + FORWARD_US):
                self._waiting.append((time_us, frame))
                if clock is not None and clock[0] in self._attitudes:
                    self._set(self._step_us(now_us, *clock))
                    yield from self._released()
                continue
            yield self._note(time_us, frame)
        yield from self._released()

    def _goes_on(self, now_us: int) -> bool:
        """True if there was no pause before this record: those that wait have a wrong time."""
        return self._last_us is not None and -BACK_US <= now_us - self._last_us <= FORWARD_US

    def _damaged(self) -> Iterator[tuple[int, bytes]]:
        yield from ((time_us - self._shift_us, frame) for time_us, frame in self._waiting)
        self._waiting.clear()

    def _step_us(self, now_us: int, system: int, boot_ms: int) -> int:
        """What of a pause the vehicle's clock does not know; nothing if it began anew."""
        then_us, then_ms = self._attitudes[system]
        step_us = now_us - then_us - 1000 * (boot_ms - then_ms)
        return step_us if boot_ms >= then_ms and step_us > FORWARD_US else 0

    def _set(self, step_us: int) -> None:
        if step_us:
            self._shift_us += step_us
            self.steps_s.append(step_us / 1e6)

    def _released(self) -> Iterator[tuple[int, bytes]]:
        for record in self._waiting:
            yield self._note(*record)
        self._waiting.clear()

    def _note(self, time_us: int, frame: bytes) -> tuple[int, bytes]:
        self._last_us = time_us - self._shift_us
        if (clock := boot_clock(frame)) is not None:
            self._attitudes[clock[0]] = self._last_us, clock[1]
        return self._last_us, frame
