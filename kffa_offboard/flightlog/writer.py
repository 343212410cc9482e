"""Writing flight logs, by a thread of its own so that a slow or full disk never delays control."""

from __future__ import annotations

import logging
import os
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.notes import End, Header, Lost, Note, Request, to_messages
from kffa_offboard.flightlog.parts import part_path
from kffa_offboard.flightlog.signals import to_message
from kffa_offboard.flightlog.tlog import TIMESTAMP
from kffa_offboard.frame_codec import Packer
from kffa_offboard.offboard.events import ProcessReport, Signals

LOG = logging.getLogger(__name__)

FLUSH_PERIOD_S = 0.5
"""What is recorded is with the operating system this much later; a killed process loses no more."""

BATCH_SIZE = 1000
"""So many records are written sooner: it is twice what a flight brings, but simulated time runs faster."""

QUEUE_SIZE = 100_000
"""Records that may wait for the disk: minutes of traffic. Beyond it records are dropped and counted."""


class LogExists(UserError):
    """A file of that name is there already; nothing is overwritten."""


class TlogWriter:
    """A log being written. Nothing here waits for the disk but `close`. A context manager.

    Every file begins with the header. A file that reaches `part_size` is closed and the next part
    begun. While the disk is full, records are lost and counted, and the file ends with a whole record;
    when there is room again the log goes on. An existing file is never overwritten.

    Parameters
    ----------
    path
        The first file; missing directories are made. Raises LogExists if it exists, UserError if it cannot be
        made.
    header
        How the flight is set up; None for a log without.
    system_id, component_id
        Whose frames signals and notes become.
    part_size
        Bytes of a file after which the next one begins; None for one file.

    """

    def __init__(
        self,
        path: Path,
        *,
        header: Header | None = None,
        system_id: int = 245,
        component_id: int = 191,
        part_size: int | None = None,
    ) -> None:
        self.path = path
        self._header = header
        self._notes = _NotePacker(system_id, component_id)
        self._signals = Packer(system_id, component_id)
        self._sink = _Sink(path, header, self._notes, part_size)
        self._records: deque[bytes] = deque()
        self._due = threading.Event()
        self._dropped = 0
        self._said: set[str] = set()
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="flight log", daemon=True)
        self._thread.start()

    def write(self, time_us: int, frame: bytes) -> None:
        """Record one frame. Never waits."""
        self._put(TIMESTAMP.pack(time_us) + frame)

    def write_signals(self, signals: Signals) -> None:
        """Record signals at their own time. Never waits. Raises ValueError as `signals.to_message` does."""
        self.write(signals.time_us, self._signals.pack(to_message(signals)))

    def write_begin(self, time_us: int) -> None:
        """Record the header, at the time when the run began. Never waits."""
        if self._header is not None:
            self._header = replace(self._header, begin_us=time_us)
            self._sink.header = self._header
            self._put(self._notes.records(time_us, self._header))

    def write_request(self, time_us: int, request: Request) -> None:
        """Record what the daemon's own process asked for. Never waits."""
        self._put(self._notes.records(time_us, request))

    def write_report(self, time_us: int, report: ProcessReport) -> None:
        """Record what the daemon's own process reports. Never waits."""
        self._put(self._notes.records(time_us, report))

    def write_end(self, time_us: int, reason: str, frames_dropped: int) -> None:
        """Record how the flight ended. Never waits."""
        self._put(self._notes.records(time_us, End(reason, frames_dropped)))

    def _put(self, records: bytes) -> None:
        if self._closed:
            raise ValueError(f"flight log {self.path} is closed")
        waiting = len(self._records)
        if waiting < QUEUE_SIZE:
            self._records.append(records)
        else:
            self._dropped += 1
        if waiting >= BATCH_SIZE and not self._due.is_set():
            self._due.set()

    def take_trouble(self) -> str | None:
        """Why records are being lost or a further file could not be begun; each reason once, else None."""
        trouble = self._sink.trouble
        if trouble is None and self._dropped:
            trouble = "the disk is too slow"
        if trouble is None or trouble in self._said:
            return None
        self._said.add(trouble)
        return f"flight log: {trouble}"

    def close(self) -> None:
        """Write what is waiting and close the file. May be called twice.

        Raises UserError if the log is not complete: a full disk, or one that is too slow.
        """
        if self._closed:
            return
        self._closed = True
        self._due.set()
        self._thread.join()
        if self._sink.problem is not None:
            raise UserError(
                f"flight log {self.path} is not complete: {self._sink.problem} "
                f"({self._sink.lost} records lost); is the disk full?"
            )
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
        """The thread: write what has come, every half second, when it is much, and at the end.

        All at once: taking records one by one would have to wait for the interpreter each time, and fall
        behind a busy main thread.
        """
        done, told = False, 0
        while not done:
            self._due.wait(FLUSH_PERIOD_S)
            self._due.clear()
            done = self._closed  # set after the last record
            batch: list[bytes] = []
            while self._records:
                batch.append(self._records.popleft())
            self._sink.write(batch)
            dropped = self._dropped  # after the batch that is being written
            self._sink.untold += dropped - told
            told = dropped
        self._sink.close()


class _NotePacker:
    """Notes as records of a log."""

    def __init__(self, system_id: int, component_id: int) -> None:
        self._packer = mavlink.MAVLink(None, srcSystem=system_id, srcComponent=component_id)

    def records(self, time_us: int, note: Note) -> bytes:
        stamp = TIMESTAMP.pack(time_us)
        return b"".join(stamp + bytes(message.pack(self._packer)) for message in to_messages(note))


class _Sink:
    """The files. Only whole batches stay in them: what a full disk cuts short is taken back.

    Attributes
    ----------
    header : what further files begin with
    problem : why records were lost first, None if none were
    lost : how many
    untold : how many of them, and of those that never came here, a note in the file does not tell yet
    trouble : what is wrong now; None while all is well
    """

    def __init__(self, path: Path, header: Header | None, notes: _NotePacker, part_size: int | None) -> None:
        self.problem: str | None = None
        self.trouble: str | None = None
        self.lost = 0
        self.untold = 0
        self._last_us = 0
        self._path = path
        self.header = header
        self._notes = notes
        self._part_size = part_size
        self._part = 1
        self._no_parts: str | None = None
        self._size = 0
        self._file: Any = _create(path)

    def write(self, batch: Sequence[bytes]) -> None:
        """Append records; on trouble lose them, note it, and stay able to go on."""
        if not batch:
            return
        try:
            for records in self._parts(batch):
                self._append(records)
            self.trouble, self.untold = self._no_parts, 0
        except OSError as error:
            self.lost += len(batch)
            self.untold += len(batch)
            self._note(error)

    def close(self) -> None:
        """Not before: waiting for the disk would keep the next records in a process that may be killed."""
        try:
            if self.untold:  # there may be room for this
                self._append(self._notes.records(self._last_us, Lost(self.untold)))
            os.fsync(self._file.fileno())
            self._file.close()
        except OSError as error:
            self._note(error)

    def _parts(self, batch: Sequence[bytes]) -> list[bytes]:
        """The batch, behind a header of its own if it begins a further file."""
        if self._part_size is not None and self._size >= self._part_size:
            self._begin_next_part()
        (time_us,) = TIMESTAMP.unpack_from(batch[0])
        (self._last_us,) = TIMESTAMP.unpack_from(batch[-1])
        missing = self._notes.records(time_us, Lost(self.untold)) if self.untold else b""
        body = missing + b"".join(batch)
        if self.header is None or self._part == 1 or self._size > 0:
            return [body]
        return [self._notes.records(time_us, replace(self.header, part=self._part)), body]

    def _begin_next_part(self) -> None:
        try:
            following = _create(part_path(self._path, self._part + 1))
        except UserError as problem:
            LOG.error("%s; the log goes on in the file it is in", problem)
            self._no_parts = "no further file; goes on in this one"
            self._part_size = None
            return
        self._file.close()
        self._file, self._part, self._size = following, self._part + 1, 0

    def _append(self, data: bytes) -> None:
        written = 0
        try:
            while written < len(data):
                written += self._file.write(memoryview(data)[written:])
        except OSError:
            self._file.truncate(self._size)
            self._file.seek(self._size)
            raise
        self._size += len(data)

    def _note(self, error: OSError) -> None:
        self.trouble = error.strerror or str(error)
        if self.problem is None:
            self.problem = self.trouble
            LOG.error("flight log %s: %s", self._path, self.problem)


def _create(path: Path) -> Any:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(
            f"cannot make directory {path.parent} for the flight log: {error.strerror}; "
            "choose another --log or log.directory"
        ) from error
    try:
        return path.open("xb", buffering=0)
    except FileExistsError as error:
        raise LogExists(f"flight log {path} exists already; choose another name or move it away") from error
    except OSError as error:
        raise UserError(
            f"cannot write flight log {path}: {error.strerror}; choose another --log or log.directory"
        ) from error
