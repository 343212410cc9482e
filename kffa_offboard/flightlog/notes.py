"""What a log must hold beside frames and signals, so that the flight can be repeated from it.

Five kinds of note: the header (program, versions, configuration), requests from the daemon's own
command line or process and what its link noticed (they come in no MAVLink message), reports of the process,
records that are missing, and the end. Each is a JSON object, cut into TUNNEL messages with a payload type of
our own; ground stations pass over them. They are only ever in the file: none is sent.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias, TypeVar

from msgspec import ValidationError, convert
from msgspec.structs import asdict
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.offboard.events import (
    EngageRequested,
    GiveUpRequested,
    HangNoticed,
    IntrusionNoticed,
    ProcessReport,
    ReleaseRequested,
    StepTiming,
    Trouble,
)

PAYLOAD_TYPE = 52038
"""TUNNEL.payload_type of a note; those from 32768 on are free for private use."""

FORMAT = 1
"""Number of the header's layout; a reader refuses a newer one."""

_CHUNK = struct.Struct("<HH")  # index, count
_PAYLOAD_SIZE = 128
_TEXT_SIZE = _PAYLOAD_SIZE - _CHUNK.size

NoteKind: TypeAlias = Literal["header", "request", "report", "end"]
Request: TypeAlias = EngageRequested | ReleaseRequested | IntrusionNoticed | GiveUpRequested | HangNoticed


@dataclass(frozen=True)
class Header:
    """How a flight was set up.

    Attributes
    ----------
    version : of kffa-offboard
    configuration : tables of the TOML file, with what the command line changed
    options : what the command line said beyond the file ("arm", "engage", ...)
    lockstep : the simulator kept the time
    libraries : versions of what takes part in the arithmetic
    parameters_checked : the vehicle's parameters were read and judged
    changed_parameters : the file with which an earlier run had left old values behind, if there was one
    stored_parameters : the file of the daemon's own changed parameters, if there was one
    part : 1 for the first file of a flight, then 2, ...
    begin_us : when the flight began, the same in all its files; None in logs of older versions
    """

    version: str
    configuration: dict[str, Any]
    options: dict[str, bool]
    lockstep: bool = False
    libraries: dict[str, str] = field(default_factory=dict)
    parameters_checked: bool = False
    changed_parameters: str | None = None
    stored_parameters: str | None = None
    part: int = 1
    begin_us: int | None = None


@dataclass(frozen=True)
class End:
    """How a flight ended: reason, and the frames that the link did not take."""

    reason: str
    frames_dropped: int = 0


@dataclass(frozen=True)
class Lost:
    """How many records are missing at this place: the disk was full, or too slow."""

    records: int


Note: TypeAlias = Header | Request | ProcessReport | Lost | End

Checked = TypeVar("Checked", Header, End, HangNoticed, IntrusionNoticed, Lost, StepTiming, Trouble)


def to_messages(note: Note) -> list[Any]:
    """A note as TUNNEL messages, in order."""
    text = json.dumps(_document(note), sort_keys=True, separators=(",", ":")).encode()
    pieces = [text[start : start + _TEXT_SIZE] for start in range(0, len(text), _TEXT_SIZE)]
    return [_chunk(index, len(pieces), piece) for index, piece in enumerate(pieces)]


def is_note(message: Any) -> bool:
    """True if `message` is a piece of a note."""
    return bool(message.msgname == "TUNNEL" and message.payload_type == PAYLOAD_TYPE)


class NoteReader:
    """Puts notes together again from their pieces."""

    def __init__(self) -> None:
        self._text = b""
        self._next = 0

    def take(self, message: Any) -> Note | None:
        """The note that is complete with this piece; None while pieces are missing.

        Raises ValueError for pieces out of order or a note of another kind or format.
        """
        payload = bytes(message.payload[: message.payload_length])
        if len(payload) < _CHUNK.size:
            raise ValueError("a piece of a note without its number")
        index, count = _CHUNK.unpack_from(payload)
        if index != self._next or index >= count:
            raise ValueError(f"piece {index} of a note where piece {self._next} was expected")
        self._text = (self._text if index else b"") + payload[_CHUNK.size :]
        self._next = (index + 1) % count
        if self._next:
            return None
        return _note(_parse(self._text))


def _chunk(index: int, count: int, text: bytes) -> Any:
    payload = _CHUNK.pack(index, count) + text
    padded = list(payload.ljust(_PAYLOAD_SIZE, b"\0"))
    return mavlink.MAVLink_tunnel_message(0, 0, PAYLOAD_TYPE, len(payload), padded)


def _document(note: Note) -> dict[str, Any]:
    match note:
        case Header():
            return {"note": "header", "format": FORMAT, **vars(note)}
        case End():
            return {"note": "end", **vars(note)}
        case Lost():
            return {"note": "lost", **vars(note)}
        case EngageRequested():
            return {"note": "request", "what": "engage"}
        case ReleaseRequested(reason):
            return {"note": "request", "what": "release", "reason": reason}
        case GiveUpRequested():
            return {"note": "request", "what": "give up"}
        case HangNoticed(seconds):
            return {"note": "request", "what": "hang", "seconds": seconds}
        case IntrusionNoticed(text, consequence):
            return {"note": "request", "what": "intrusion", "text": text, "consequence": consequence}
        case StepTiming():
            return {"note": "report", "what": "timing", **asdict(note)}
        case Trouble(text):
            return {"note": "report", "what": "trouble", "text": text}


def _parse(text: bytes) -> dict[str, Any]:
    try:
        document = json.loads(text)
    except RecursionError as error:
        raise ValueError("a note that is nested too deeply") from error
    if not isinstance(document, dict):
        raise ValueError("a note that is no table")
    return document


def _note(document: dict[str, Any]) -> Note:
    match document:
        case {"note": "header", "format": int(number), **fields} if number <= FORMAT:
            return _checked(Header, fields)
        case {"note": "end", **fields}:
            return _checked(End, fields)
        case {"note": "lost", **fields}:
            return _checked(Lost, fields)
        case {"note": "request", "what": "engage"}:
            return EngageRequested()
        case {"note": "request", "what": "release", "reason": str(reason)}:
            return ReleaseRequested(reason)
        case {"note": "request", "what": "give up" | "put back"}:  # as it was called first
            return GiveUpRequested()
        case {"note": "request", "what": "hang", **fields}:
            return _checked(HangNoticed, fields)
        case {"note": "request", "what": "intrusion", **fields}:
            return _checked(IntrusionNoticed, fields)
        case {"note": "report", "what": "timing", **fields}:
            return _checked(StepTiming, fields)
        case {"note": "report", "what": "trouble", **fields}:
            return _checked(Trouble, fields)
    what = document.get("note", "nothing known")
    raise ValueError(f"note {what!r} of format {document.get('format')}; this version reads format {FORMAT}")


def _checked(kind: type[Checked], fields: dict[str, Any]) -> Checked:
    """A note of that kind. Raises ValueError, one line, for fields of another type or missing ones."""
    try:
        return convert(fields, kind)
    except ValidationError as error:
        text = str(error).replace("`", "")
        raise ValueError(f"{kind.__name__.lower()} of the flight: {text[0].lower()}{text[1:]}") from error


def notes(messages: Iterator[Any]) -> Iterator[Note]:
    """All notes among messages. Raises ValueError as `NoteReader.take`."""
    reader = NoteReader()
    for message in messages:
        if is_note(message) and (note := reader.take(message)) is not None:
            yield note
