"""Telemetry logs (.tlog) as ground stations write them: 8-byte big-endian microseconds, then the frame."""

from __future__ import annotations

import logging
import queue
import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.signals import SignalTable, is_signals, table, to_message
from kffa_offboard.offboard.events import Signals

LOG = logging.getLogger(__name__)

TIMESTAMP = struct.Struct(">Q")

_MARKER_V1 = 0xFE
_MARKER_V2 = 0xFD
_HEAD_SIZE = 3  # marker, payload length, incompatibility flags: enough to know the frame's length
_OVERHEAD_V1 = 8
_OVERHEAD_V2 = 12
_SIGNATURE_SIZE = 13

FLUSH_PERIOD_S = 0.5
QUEUE_SIZE = 100_000
"""Records that may wait for the disk: minutes of traffic. Beyond it records are dropped and counted."""


def frame_size(head: bytes) -> int | None:
    """Length of the MAVLink frame that begins with these 3 bytes; None if they begin none."""
    marker, payload_size, flags = head
    if marker == _MARKER_V1:
        return _OVERHEAD_V1 + payload_size
    if marker == _MARKER_V2:
        signed = flags & mavlink.MAVLINK_IFLAG_SIGNED
        return _OVERHEAD_V2 + payload_size + (_SIGNATURE_SIZE if signed else 0)
    return None


class TlogReader:
    """Iterates over (time in us, pymavlink message) of a log, in the order in which it was written.

    Attributes
    ----------
    truncated
        True once the end was reached and the last record is incomplete: the computer lost power, or
        the log is still being written. Everything before it was given out.
    damaged
        How many frames so far had a wrong checksum; they are left out.

    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.truncated = False
        self.damaged = 0

    def __iter__(self) -> Iterator[tuple[int, Any]]:
        """Read from the beginning.

        Raises UserError if the file cannot be read or is no telemetry log.
        """
        self.truncated = False
        self.damaged = 0
        parser = mavlink.MAVLink(None)
        try:
            with self._path.open("rb") as file:
                for time_us, frame in self._records(file):
                    try:
                        message = parser.decode(bytearray(frame))
                    except mavlink.MAVError:
                        self.damaged += 1
                        continue
                    yield time_us, message
        except OSError as error:
            raise UserError(
                f"cannot read flight log {self._path}: {error.strerror}; check the path"
            ) from error

    def _records(self, file: BinaryIO) -> Iterator[tuple[int, bytes]]:
        while head := file.read(TIMESTAMP.size + _HEAD_SIZE):
            if len(head) < TIMESTAMP.size + _HEAD_SIZE:
                self.truncated = True
                return
            size = frame_size(head[TIMESTAMP.size :])
            if size is None:
                self._end_or_damage(file, head)
                return
            rest = file.read(size - _HEAD_SIZE)
            if len(rest) < size - _HEAD_SIZE:
                self.truncated = True
                return
            yield TIMESTAMP.unpack_from(head)[0], head[TIMESTAMP.size :] + rest

    def _end_or_damage(self, file: BinaryIO, head: bytes) -> None:
        """Zeros up to the end are what a file system leaves after a power cut; anything else is no log."""
        position = file.tell() - len(head)
        if any(head) or any(file.read()):
            raise UserError(
                f"flight log {self._path}: no MAVLink frame at byte {position}; "
                "the file is damaged or not a .tlog"
            )
        self.truncated = True


def read_tlog(path: Path) -> TlogReader:
    """Open a log for reading: ``for time_us, message in read_tlog(path)``."""
    return TlogReader(path)


def read_signals(path: Path) -> SignalTable:
    """All controller signals of a log.

    Raises UserError if the file is missing or no telemetry log.
    """
    return table(message for _, message in read_tlog(path) if is_signals(message))


class TlogWriter:
    """A log being written, by a thread of its own so that a slow disk never delays control.

    `write` and `write_signals` only put the record in a queue. What was recorded is in the file half a
    second later, and all of it after `close`. An existing file is never overwritten. A context manager.

    Parameters
    ----------
    path
        The file; missing directories are made. Raises UserError if it exists or cannot be made.
    system_id, component_id
        Whose frames the signals become.

    """

    def __init__(self, path: Path, *, system_id: int = 245, component_id: int = 191) -> None:
        self.path = path
        self._file = _create(path)
        self._packer = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)
        self._queue: queue.Queue[bytes | None] = queue.Queue(QUEUE_SIZE)
        self._dropped = 0
        self._problem: str | None = None
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="flight log", daemon=True)
        self._thread.start()

    def write(self, time_us: int, frame: bytes) -> None:
        """Record one frame. Never waits."""
        if self._closed:
            raise ValueError(f"flight log {self.path} is closed")
        try:
            self._queue.put_nowait(TIMESTAMP.pack(time_us) + frame)
        except queue.Full:
            self._dropped += 1

    def write_signals(self, signals: Signals) -> None:
        """Record signals at their own time. Never waits. Raises ValueError as `signals.to_message` does."""
        frame = bytes(to_message(signals).pack(self._packer))
        self._packer.seq = (self._packer.seq + 1) % 256
        self.write(signals.time_us, frame)

    def close(self) -> None:
        """Write what is waiting and close the file. May be called twice.

        Raises UserError if the log is not complete: a full disk, or one that is too slow.
        """
        if self._closed:
            return
        self._closed = True
        self._queue.put(None)
        self._thread.join()
        if self._problem is not None:
            raise UserError(f"flight log {self.path} is not complete: {self._problem}; is the disk full?")
        if self._dropped:
            raise UserError(
                f"flight log {self.path} is not complete: {self._dropped} records were dropped; "
                "the disk is too slow, log to another one"
            )

    def __enter__(self) -> TlogWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        try:
            self.close()
        except UserError as problem:
            if error is None:
                raise
            LOG.error("%s", problem)  # what ended the run comes first

    def _run(self) -> None:
        """The thread: write records as they come, flush every half second, stop at None."""
        flush_due = time.monotonic() + FLUSH_PERIOD_S
        done = False
        while not done:
            try:
                record = self._queue.get(timeout=max(flush_due - time.monotonic(), 0.0))
            except queue.Empty:
                record = b""
            done = record is None
            flush = done or time.monotonic() >= flush_due
            if flush:
                flush_due = time.monotonic() + FLUSH_PERIOD_S
            try:
                if record:
                    self._file.write(record)
                if flush:
                    self._file.flush()
            except OSError as error:
                # Keep emptying the queue: the vehicle flies on, and `close` tells.
                self._note(error)
        try:
            self._file.close()
        except OSError as error:
            self._note(error)

    def _note(self, error: OSError) -> None:
        if self._problem is None:
            self._problem = error.strerror or str(error)
            LOG.error("flight log %s: %s", self.path, self._problem)


def _create(path: Path) -> BinaryIO:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"cannot make directory {path.parent} for the flight log: {error.strerror}; "
            "choose another log.directory"
        ) from error
    try:
        return path.open("xb")
    except FileExistsError as error:
        raise UserError(f"flight log {path} exists already; choose another name or move it away") from error
    except OSError as error:
        raise UserError(
            f"cannot write flight log {path}: {error.strerror}; choose another log.directory"
        ) from error
