"""Comparing clocks with the autopilot by TIMESYNC: its offset from ours, and the round trip of the link.

Of the last few answers the one with the shortest round trip tells the offset, as in NTP: delay only ever
adds, and what adds to one direction alone shifts the offset by at most half the round trip. PX4
(mavlink_timesync.cpp) and ArduPilot (GCS_Common.cpp, handle_timesync) answer with their time since boot, the
clock of `time_boot_ms`.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import Message
from kffa_offboard.offboard.events import LinkMeasured

REQUEST_PERIOD_US = 200_000
WINDOW = 25
USUAL = 3
"""The usual round trip is the median of so many: a link that becomes slow is noticed within 0.5 s."""

LONGEST_ROUND_TRIP_US = 1_000_000
RESTART_US = 100_000
"""An answer that contradicts the estimate by more than this, beyond its round trip, begins a new one."""

_MARK_NS = 191
"""Our clock has microseconds; the nanoseconds of a request tell our answers from those to others."""


@dataclass(frozen=True, slots=True)
class Exchange:
    """One answer: the autopilot's clock less ours, and how long question and answer took, us."""

    offset_us: int
    round_trip_us: int


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """The last answers, oldest first."""

    exchanges: tuple[Exchange, ...] = ()

    @property
    def measured(self) -> LinkMeasured | None:
        """Offset of the quickest answer and the usual round trip; None before the first answer."""
        if not self.exchanges:
            return None
        best = min(self.exchanges, key=lambda exchange: exchange.round_trip_us)
        newest = self.exchanges[-USUAL:]
        return LinkMeasured(best.offset_us, median(each.round_trip_us for each in newest) * 1e-6)


def timesync_request(time_us: int) -> Message:
    """TIMESYNC that asks, marked as ours."""
    return mavlink.MAVLink_timesync_message(0, time_us * 1000 + _MARK_NS)


def take_answer(estimate: ClockEstimate, received_us: int, message: Message) -> ClockEstimate:
    """The estimate with one more TIMESYNC; one that does not answer us, or not in time, changes nothing."""
    sent_us, mark = divmod(message.ts1, 1000)
    round_trip_us = received_us - sent_us
    if message.tc1 <= 0 or mark != _MARK_NS or not 0 <= round_trip_us <= LONGEST_ROUND_TRIP_US:
        return estimate
    exchange = Exchange(message.tc1 // 1000 - (sent_us + received_us) // 2, round_trip_us)
    before = estimate.exchanges
    if before and abs(exchange.offset_us - before[-1].offset_us) > RESTART_US + round_trip_us:
        before = ()  # the autopilot was restarted
    return ClockEstimate((*before, exchange)[-WINDOW:])
