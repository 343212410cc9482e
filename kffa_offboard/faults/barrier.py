"""Faults of a link in lock-step: their clock is the barrier's, so that a flight with them repeats itself.

The barrier (`mavlink.shell`) is the vehicle's TIMESYNC request (tc1 = 0) and the daemon's answer. Both pass
untouched; everything else goes through the faults. Frames towards the daemon arrive before a barrier, frames
towards the vehicle before its answer.
"""

from __future__ import annotations

from kffa_offboard.faults.edit import decoded, message_id, number_of
from kffa_offboard.faults.line import FaultLine

_TIMESYNC = number_of("TIMESYNC")


class BarrierFaults:
    """Both directions of a link in lock-step.

    Attributes
    ----------
    down, up : faults towards the daemon and towards the vehicle; their clock is simulated time
    time_us : simulated time of the last barrier; None before the first
    """

    def __init__(self, down: FaultLine, up: FaultLine) -> None:
        self.down, self.up = down, up
        self.time_us: int | None = None
        self._barrier_ns = 0
        self._waiting: list[bytes] = []

    def from_vehicle(self, data: bytes) -> list[bytes]:
        """A datagram of the vehicle; what the daemon receives for it, in order."""
        request_ns = _time_ns(data, asks=True)
        if request_ns is None:
            self._waiting.append(data)
            return []
        self._barrier_ns = request_ns
        self.time_us = request_ns // 1000
        for waiting in self._waiting:
            self.down.put(self.time_us, waiting)
        self._waiting.clear()
        return [*self.down.take(self.time_us), data]

    def from_daemon(self, data: bytes) -> list[bytes]:
        """A datagram of the daemon; what the vehicle receives for it, in order."""
        if self.time_us is None:
            return [data]  # it says hello before there is any time
        if _time_ns(data, asks=False) == self._barrier_ns:
            return [*self.up.take(self.time_us), data]
        self.up.put(self.time_us, data)
        return []


def _time_ns(data: bytes, asks: bool) -> int | None:
    """The time of a TIMESYNC request, or of an answer; None for anything else."""
    if message_id(data) != _TIMESYNC:
        return None
    message = decoded(data)
    if message is None or (message.tc1 == 0) is not asks:
        return None
    return int(message.ts1)
