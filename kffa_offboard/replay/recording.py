"""A flight as it was recorded: header, what came in, what went out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from msgspec import Struct
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.notes import End, Header, Lost, Note, NoteReader, is_note
from kffa_offboard.flightlog.parts import following_parts
from kffa_offboard.flightlog.signals import is_signal_frame
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.frame_codec import decode
from kffa_offboard.mavlink.session import KINDS
from kffa_offboard.offboard.events import ProcessReport
from kffa_offboard.replay.uncollected import uncollected

Incoming: TypeAlias = tuple[int, Any]
"""Time [us] and what came: a message, or, undecoded, the frame of one that no session looks into; or a
request or report of the daemon's own process."""

Frame: TypeAlias = tuple[int, bytes]
"""Time [us] and a frame."""

LONGEST_GAP_US = 86_400_000_000
"""Between two messages; a damaged time would have years of heartbeats replayed."""

_MARKER_V2 = 0xFD
_LOOKED_INTO = frozenset(
    number.to_bytes(3, "little")
    for number, kind in mavlink.mavlink_map.items()
    if kind.msgname in KINDS or number == mavlink.MAVLINK_MSG_ID_TUNNEL
)
"""Types of messages, as in a frame, that a session or a reader of notes needs decoded."""
_LOG_ONLY = tuple(
    number.to_bytes(3, "little")
    for number in (mavlink.MAVLINK_MSG_ID_TUNNEL, mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY)
)
"""Types of messages, as in a frame, that notes and signals are made of; they have to be looked into."""


@dataclass(frozen=True)
class Recording:
    """What a log holds.

    Attributes
    ----------
    path : the (first) file
    header, begin_us : how and when the run began
    incoming : received messages, own requests and reports, in order
    sent, signals : frames that went out, and frames of the controller's inner signals, in order
    end, end_us : how and when the run ended; None and the last record's time if the log breaks off
    lost : how many records are missing after `end_us`; what follows them cannot be replayed, and is left out
    """

    path: Path
    header: Header
    begin_us: int
    incoming: list[Incoming] = field(repr=False)
    sent: list[Frame] = field(repr=False)
    signals: list[Frame] = field(repr=False)
    end: End | None
    end_us: int
    lost: int = 0


@uncollected()
def read_recording(path: Path) -> Recording:
    """Read a flight from its first file, and from the further ones (FLIGHT-2.tlog, ...) if there are any.

    Raises UserError if the file cannot be read, is no telemetry log, or was not written by this program.
    """
    reader = _Reader(path)
    for part in (path, *following_parts(path)):
        log = read_tlog(part)
        try:
            reader.take_all(log.frames())
        except ValueError as problem:
            raise UserError(f"flight log {part}: {problem}; it cannot be replayed") from problem
    return reader.recording()


class _Reader:
    """Sorts the records of a log."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._notes = NoteReader()
        self._header: Header | None = None
        self._own = b""  # system and component, as in a frame
        self._begin_us = 0
        self._last_us = 0
        self._end: End | None = None
        self._lost = 0
        self._incoming: list[Incoming] = []
        self._sent: list[Frame] = []
        self._signals: list[Frame] = []

    def take_all(self, records: Iterable[tuple[int, bytes]]) -> None:
        for record in records:
            time_us, frame = record
            ours = frame[5:7] == self._own and frame[0] == _MARKER_V2
            if self._lost:
                continue
            if ours and frame[7:10] not in _LOG_ONLY:
                self._sent.append(record)
                self._last_us = time_us
            elif ours and is_signal_frame(frame):
                self._signals.append(record)
                self._last_us = time_us
            else:
                self._take(time_us, frame, ours)

    def _take(self, time_us: int, frame: bytes, ours: bool) -> None:
        """What is neither a frame that was sent nor signals."""
        unread = frame[0] == _MARKER_V2 and frame[7:10] not in _LOOKED_INTO
        if unread and not ours and self._header is not None:
            self._last_us = time_us
            self._came(time_us, frame)
            return
        try:
            message = decode(frame)
        except mavlink.MAVError:
            return  # the daemon did not understand it either
        if (ours or self._header is None) and is_note(message):
            self._take_note(time_us, message)  # anybody may send something that looks like one
            return
        if self._header is None:
            raise UserError(
                f"flight log {self._path}: does not begin with a kffa-offboard header; "
                "only logs of `kffa-offboard run` can be replayed (try `kffa-offboard shadow`)"
            )
        self._last_us = time_us
        if ours:
            self._sent.append((time_us, frame))
        else:
            self._came(time_us, message)

    def _came(self, time_us: int, item: Any) -> None:
        """Keep what came in; it came in order, and within a day."""
        before_us = self._incoming[-1][0] if self._incoming else self._begin_us
        if not 0 <= time_us - before_us <= LONGEST_GAP_US:
            raise ValueError(f"time goes from {before_us / 1e6:.6f} s to {time_us / 1e6:.6f} s")
        self._incoming.append((time_us, item))

    def _take_note(self, time_us: int, message: Any) -> None:
        note: Note | None = self._notes.take(message)
        match note:
            case Header():
                if self._header is None:
                    if note.part != 1:
                        raise ValueError(f"is part {note.part} of a flight; name its first file")
                    self._header, self._begin_us, self._last_us = note, time_us, time_us
                    self._own = bytes((message.get_srcSystem(), message.get_srcComponent()))
            case Lost():
                self._lost = note.records
            case End():
                self._end, self._last_us = note, time_us
            case None:
                pass
            case _:
                self._came(time_us, note)
                self._last_us = time_us

    def recording(self) -> Recording:
        if self._header is None:
            raise UserError(f"flight log {self._path}: is empty; there is nothing to replay")
        return Recording(
            self._path,
            self._header,
            self._begin_us,
            self._incoming,
            self._sent,
            self._signals,
            self._end,
            self._last_us,
            self._lost,
        )


def is_message(item: Any) -> bool:
    """True for a received message among the incoming items, decoded or not; the others are events."""
    return not isinstance(item, Struct)


def is_report(item: Any) -> bool:
    """True for a report of the daemon's own process among them."""
    return isinstance(item, ProcessReport)
