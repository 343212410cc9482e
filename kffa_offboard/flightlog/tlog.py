"""Telemetry logs (.tlog) as ground stations write them: 8-byte big-endian microseconds, then the frame."""

from __future__ import annotations

import gzip
import io
import struct
import zlib
from collections.abc import Collection, Iterator
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.even_clock import EvenClock
from kffa_offboard.flightlog.signals import LATEST_US, SignalTable, is_signals, table
from kffa_offboard.frame_codec import decode

TIMESTAMP = struct.Struct(">Q")
_STAMP_SIZE = TIMESTAMP.size
GZIP_MAGIC = b"\x1f\x8b"

_Source: TypeAlias = io.BufferedReader | gzip.GzipFile

_MARKER_V1 = 0xFE
_MARKER_V2 = 0xFD
_HEAD_SIZE = 3  # marker, payload length, incompatibility flags: enough to know the frame's length
_RECORD = struct.Struct(">QBBB")  # how one begins
_OVERHEAD_V1 = 8
_OVERHEAD_V2 = 12
_SIGNATURE_SIZE = 13
_BLOCK = 1 << 16

SIGNAL_KINDS = (mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY,)


def frame_size(marker: int, payload_size: int, flags: int) -> int | None:
    """Length of the MAVLink frame that begins with these 3 bytes; None if they begin none."""
    if marker == _MARKER_V2:
        signed = flags & mavlink.MAVLINK_IFLAG_SIGNED
        return _OVERHEAD_V2 + payload_size + (_SIGNATURE_SIZE if signed else 0)
    return _OVERHEAD_V1 + payload_size if marker == _MARKER_V1 else None


def message_id(frame: bytes) -> int:
    """Of a whole frame of either version."""
    return int.from_bytes(frame[7:10], "little") if frame[0] == _MARKER_V2 else frame[5]


class TlogReader:
    """Iterates over (time in us, pymavlink message) of a log, in the order in which it was written.

    Attributes
    ----------
    truncated
        True once the end was reached and the last record is incomplete: the computer lost power, or
        the log is still being written. Everything before it was given out.
    damaged
        How many frames so far had a wrong checksum or an impossible time; they are left out.
    clock_steps_s
        By how much the clock was set while the log was written, each time so far; noticed with `even` only,
        which takes the steps out of the times.

    """

    def __init__(self, path: Path, *, even: bool = False, kinds: Collection[int] | None = None) -> None:
        self._path = path
        self._even = even
        self._kinds = kinds
        self.clock_steps_s: list[float] = []
        self.truncated = False
        self.damaged = 0

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        """Read from the beginning.

        Raises UserError if the file cannot be read or is no telemetry log.
        """
        for time_us, frame in self.frames():
            if self._kinds is not None and message_id(frame) not in self._kinds:
                continue
            try:
                yield time_us, decode(frame)
            except mavlink.MAVError:
                self.damaged += 1

    def frames(self) -> Iterator[tuple[int, bytes]]:
        """Read from the beginning: time [us] and frame, not decoded. Raises UserError as iterating does.

        A file that is compressed (gzip), whatever its name, is decompressed on the way.
        """
        self.truncated = False
        self.damaged = 0
        try:
            with _open(self._path) as file:
                records = chain.from_iterable(self._blocks(file))
                yield from self._evened(records) if self._even else records
        except EOFError:  # a compressed file that was cut short
            self.truncated = True
        except (OSError, zlib.error) as error:
            raise UserError(
                f"cannot read flight log {self._path}: {getattr(error, 'strerror', None) or error}; "
                "check the path"
            ) from error

    def _blocks(self, file: _Source) -> Iterator[list[tuple[int, bytes]]]:
        """Records, as they are read."""
        data, at = b"", 0  # what of the file was read last, and where in it the next record begins
        position = 0  # of this part in the file
        while True:
            more = self._more(file)
            data, position = data[at:] + more, position + at
            records, at = self._whole_records(data)
            yield records
            head = data[at + _STAMP_SIZE : at + _STAMP_SIZE + _HEAD_SIZE]
            if len(head) == _HEAD_SIZE and frame_size(*head) is None:
                self._end_or_damage(file, data[at:], position + at)
                return
            if not more:
                self.truncated = self.truncated or at < len(data)
                return

    def _whole_records(self, data: bytes) -> tuple[list[tuple[int, bytes]], int]:
        """The records that the data begins with, and where the first one begins that is not whole."""
        found, at, end = [], 0, len(data)
        beginning, begun = _RECORD.size, _RECORD.unpack_from
        while end - at >= beginning:
            time_us, marker, payload_size, flags = begun(data, at)
            ordinary = marker == _MARKER_V2 and flags == 0
            size = _OVERHEAD_V2 + payload_size if ordinary else frame_size(marker, payload_size, flags)
            begins = at + _STAMP_SIZE
            if size is None or begins + size > end:
                break
            at = begins + size
            if time_us < LATEST_US:
                found.append((time_us, data[begins:at]))
            else:
                self.damaged += 1
        return found, at

    def _more(self, file: _Source) -> bytes:
        """The next bytes of the file; none at its end, or where a compressed one was cut short."""
        try:
            return file.read1(_BLOCK)
        except EOFError:
            self.truncated = True
            return b""

    def _evened(self, records: Iterator[tuple[int, bytes]]) -> Iterator[tuple[int, bytes]]:
        clock = EvenClock()
        self.clock_steps_s = clock.steps_s
        return clock.even(records)

    def _end_or_damage(self, file: _Source, rest: bytes, position: int) -> None:
        """Zeros up to the end are what a file system leaves after a power cut; anything else is no log."""
        if any(rest) or any(file.read()):
            raise UserError(
                f"flight log {self._path}: no MAVLink frame at byte {position}; "
                "the file is damaged or not a .tlog"
            )
        self.truncated = True


def _open(path: Path) -> _Source:
    file = path.open("rb")
    if not file.peek(2).startswith(GZIP_MAGIC):
        return file
    file.close()
    return gzip.open(path, "rb")


def read_tlog(path: Path, *, even: bool = False, kinds: Collection[int] | None = None) -> TlogReader:
    """Open a log for reading: ``for time_us, message in read_tlog(path)``.

    With `kinds`, messages with other ids are passed over without a look.
    """
    return TlogReader(path, even=even, kinds=kinds)


def clock_remarks(reader: TlogReader) -> list[str]:
    """A line if the clock was set while the log was written."""
    if not reader.clock_steps_s:
        return []
    steps = ", ".join(f"{step:+.1f}" for step in reader.clock_steps_s)
    return [f"the clock of the computer that wrote the log was set by {steps} s; times go on as if not"]


def read_signals(path: Path) -> SignalTable:
    """All controller signals of a log.

    Raises UserError if the file is missing or no telemetry log.
    """
    return table(message for _, message in read_tlog(path, kinds=SIGNAL_KINDS) if is_signals(message))
