"""One direction of a link with faults: frames go in when they are sent and come out when they arrive."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np

from kffa_offboard.faults.edit import split
from kffa_offboard.faults.faults import Fault, Frame


class FaultLine:
    """Faults in a row. Time is in us of any clock that does not go back; `seed` repeats what chance does."""

    def __init__(self, faults: Sequence[Fault], seed: int = 0) -> None:
        self._faults = tuple(faults)
        self._generator = np.random.default_rng(seed)
        self._queue: list[tuple[int, int, bytes]] = []
        self._count = 0
        self._taken_us: int | None = None

    def put(self, time_us: int, data: bytes) -> None:
        """A datagram is sent."""
        if not self._faults:
            self._push(Frame(time_us, data))
            return
        for piece in split(data):
            self._pass(Frame(time_us, piece), 0)

    def take(self, time_us: int) -> list[bytes]:
        """What has arrived by `time_us`, in order of arrival."""
        since_us, self._taken_us = self._taken_us, time_us
        for number, fault in enumerate(self._faults):
            for frame in fault.extra(time_us if since_us is None else since_us, time_us):
                self._pass(frame, number + 1)
        arrived = []
        while self._queue and self._queue[0][0] <= time_us:
            arrived.append(heapq.heappop(self._queue)[2])
        return arrived

    def next_us(self) -> int | None:
        """When the next datagram under way arrives; None if none is."""
        return self._queue[0][0] if self._queue else None

    def _pass(self, frame: Frame, first: int) -> None:
        """Let a frame go through the faults from number `first` on."""
        frames = [frame]
        for fault in self._faults[first:]:
            frames = [out for one in frames for out in fault.passing(one, self._generator)]
        for out in frames:
            self._push(out)

    def _push(self, frame: Frame) -> None:
        self._count += 1
        heapq.heappush(self._queue, (frame.time_us, self._count, frame.data))
