"""Byte streams (TCP, serial): what they share. Frames may arrive in pieces and must not leave in pieces.

A line that is slower than our traffic makes frames wait. An old setpoint helps nobody: a new one takes the
place of the one that waits, so that what the vehicle gets after a stall is one setpoint, the last. It takes
the place of waiting signals for graphs, too, which must not keep setpoints from a vehicle.
"""

from __future__ import annotations

import select
from abc import ABC, abstractmethod
from collections.abc import Hashable

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.transport import Clock, Datagram, Posting

READ_SIZE = 4096
UNSENT_LIMIT = 2048
"""Bytes that may wait to be sent. Beyond it new frames are dropped."""

_ID_IN_FRAME = slice(7, 10)  # of MAVLink 2
_SETPOINT = mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET.to_bytes(3, "little")
_PERISHABLE = {
    _SETPOINT,
    *(
        number.to_bytes(3, "little")
        for number in (
            mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT,
            mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY,
            mavlink.MAVLINK_MSG_ID_DEBUG_VECT,
        )
    ),
}
"""What a new setpoint takes the place of."""


class StreamLink(ABC):
    """A byte stream that never makes the caller wait longer than it asked for (see `transport.Link`)."""

    keeps_frames_whole = False

    def __init__(self, name: str, clock: Clock) -> None:
        self.name = name
        self.trouble = ""
        self._clock = clock
        self._begun = b""  # the rest of a frame
        self._waiting: list[bytes] = []
        self._locked = False
        self._connection = 0  # numbers the connections: bytes of an old one are not continued

    @abstractmethod
    def _is_open(self) -> bool:
        """Is there a stream to read from and write to?"""

    @abstractmethod
    def _connect(self, timeout_s: float) -> None:
        """Spend at most `timeout_s` on getting a stream."""

    @abstractmethod
    def _file_descriptor(self) -> int:
        """Descriptor of the stream, for select."""

    @abstractmethod
    def _read(self) -> bytes:
        """Read what is there, without waiting; empty bytes or OSError mean that the other side is gone."""

    @abstractmethod
    def _write(self, data: bytes) -> int:
        """Write what fits, without waiting; return how much did."""

    @abstractmethod
    def _lost(self, reason: str) -> None:
        """The other side is gone: say so, and get ready for its return."""

    @abstractmethod
    def close(self) -> None:
        """See `transport.Link`."""

    def lock(self, source: Hashable) -> None:
        """See `transport.Link`. A stream has only one sender; losing it is now losing the vehicle."""
        self._locked = True

    @property
    def descriptor(self) -> int | None:
        """See `transport.Link`."""
        return self._file_descriptor() if self._is_open() else None

    @abstractmethod
    def take_news(self) -> str | None:
        """See `transport.Link`."""

    def receive(self, timeout_s: float) -> list[Datagram]:
        """See `transport.Link`."""
        if not self._is_open():
            self._connect(timeout_s)
            return []
        descriptor = self._file_descriptor()
        readable, writable, _ = select.select(
            [descriptor], [descriptor] if self._unsent else [], [], max(timeout_s, 0.0)
        )
        if writable:
            self._flush()
        if not readable or not self._is_open():
            return []
        try:
            data = self._read()
        except BlockingIOError:
            return []
        except OSError as error:
            self._lost((error.strerror or str(error)).lower())
            return []
        if not data:
            self._lost("closed by the other side")
            return []
        self.trouble = ""
        return [Datagram(self._clock(), data, self._connection)]

    def send(self, data: bytes) -> bool:
        """See `transport.Link`. What does not fit now leaves later: whole frames, at most one setpoint."""
        if not self._is_open():
            return False
        if self._unsent:
            self._flush()
            if not self._is_open():
                return False
        if data[_ID_IN_FRAME] == _SETPOINT:
            self._waiting = [frame for frame in self._waiting if frame[_ID_IN_FRAME] not in _PERISHABLE]
        if self._unsent + len(data) > UNSENT_LIMIT:
            self.trouble = "the line is too slow for this traffic, or nobody reads it"
            return False
        self._waiting.append(data)
        self._flush()
        return self._is_open()

    def posting(self, data: bytes) -> Posting | None:
        """See `transport.Link`. After a frame that is only half on its way, that half is lost."""
        return Posting(self._file_descriptor(), data) if self._is_open() else None

    @property
    def _unsent(self) -> int:
        """Bytes that wait."""
        return len(self._begun) + sum(map(len, self._waiting))

    def _flush(self) -> None:
        try:
            _, writable, _ = select.select([], [self._file_descriptor()], [], 0.0)
            if writable and self._unsent:
                self._wrote(self._write(self._begun + b"".join(self._waiting)))
        except BlockingIOError:
            return
        except OSError as error:
            self._lost((error.strerror or str(error)).lower())

    def _wrote(self, count: int) -> None:
        """So many bytes are on their way; of a frame that they end in, the rest has to follow."""
        while count > len(self._begun):
            count -= len(self._begun)
            self._begun = self._waiting.pop(0)
        self._begun = self._begun[count:]

    def _start_connection(self) -> None:
        """Forget what belonged to the connection before."""
        self._begun, self._waiting = b"", []
        self._connection += 1
