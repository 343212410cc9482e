"""MAVLink 2 frames to and from messages, for what comes and goes hundreds of times a second.

What a message looks like is pymavlink's: its message classes say which fields they have, in which order they
lie in the frame (`unpacker`) and what goes into the checksum. pymavlink works out for every single frame what
depends on the type of the message only; here that is kept. The outcome is the same, byte for byte and field
for field. What is no ordinary frame (damaged, signed, MAVLink 1, of an unknown type) is left to pymavlink.
"""

from __future__ import annotations

import struct
import sys
from array import array
from collections.abc import Callable, Sequence
from functools import cache
from operator import attrgetter, itemgetter
from typing import Any, NamedTuple

from fastcrc.crc16 import mcrf4xx
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20.development import MAVLink_current_mode_message

_MARKER = 0xFD
_HEAD = struct.Struct("<BBBBBBHB")  # length, two flags, sequence, system, component, message id
_PAYLOAD = 1 + _HEAD.size  # where it begins, behind marker and head
_CHECKSUM = struct.Struct("<H")
OVERHEAD = _PAYLOAD + _CHECKSUM.size
"""Bytes of a frame beside its payload, whose length is the second byte."""
CURRENT_MODE: int = MAVLink_current_mode_message.id
"""PX4 sends it, and ArduPilot's dialect lacks it. From here on pymavlink's own parser knows it, too."""

mavlink.mavlink_map.setdefault(CURRENT_MODE, MAVLink_current_mode_message)

_PYMAVLINK = mavlink.MAVLink(None)


class _Layout(NamedTuple):
    """What is always the same about one type of message.

    Attributes
    ----------
    number : the lower 16 bits of the message id, and the others
    payload : layout of the frame between head and checksum
    crc_extra : goes into the checksum behind the frame, one byte
    wire_values : of a message: its values in the order of the frame, an array as one
    arrays : places of the arrays among them, the last first
    fields : of the frame's numbers and texts: the message's fields, in its own order, an array as a tuple
    finished : whether they are the fields as they are, without arrays and texts
    front, tail, tail_size : the layout without an array at its end, and that array's type and length; "" and
        0 if there is none, or the machine has another order of bytes
    """

    number: tuple[int, int]
    payload: struct.Struct
    crc_extra: bytes
    wire_values: Callable[[Any], tuple[Any, ...]]
    arrays: tuple[int, ...]
    fields: Callable[[tuple[Any, ...]], tuple[Any, ...]]
    finished: bool
    front: struct.Struct
    tail: str
    tail_size: int


@cache
def _layout(kind: Any) -> _Layout:
    """Of one of pymavlink's message classes."""
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    sizes, at = kind.lengths, 0
    names: list[str] = []
    places: list[int | slice] = []
    for name, size in zip(kind.ordered_fieldnames, sizes, strict=True):
        text = types[name] == "char"
        names.append(f"_{name}_raw" if text and kind.array_lengths[len(names)] else name)
        places.append(at if size == 1 else slice(at, at + size))
        at += size
    arrays = [place for place, size in enumerate(sizes) if size > 1]
    return _Layout(
        (kind.id & 0xFFFF, kind.id >> 16),
        kind.unpacker,
        bytes((kind.crc_extra,)),
        _several(attrgetter, names),
        tuple(reversed(arrays)),
        _several(itemgetter, [places[order] for order in kind.orders]),
        not arrays and "char" not in types.values(),
        *_split(kind.unpacker.format, sizes[-1]),
    )


def _split(layout: str, last: int) -> tuple[struct.Struct, str, int]:
    """`_Layout.front`, `tail`, `tail_size`; `last` is the size of the last field."""
    ending = f"{last}{layout[-1]}"
    if last < 2 or sys.byteorder != "little" or layout[-1] not in "fd" or not layout.endswith(ending):
        return struct.Struct("<"), "", 0
    return struct.Struct(layout.removesuffix(ending)), layout[-1], last


def _several(getter: Callable[..., Callable[[Any], Any]], which: Sequence[Any]) -> Callable[[Any], Any]:
    """Gets a tuple, of one thing, too."""
    if len(which) > 1:
        return getter(*which)
    only = getter(*which)
    return lambda holder: (only(holder),)


def checksum(covered: bytes, crc_extra: bytes) -> bytes:
    """The two bytes behind a frame; `covered` is the frame without them and without its first byte."""
    return _CHECKSUM.pack(mcrf4xx(covered + crc_extra))


def _payload(layout: _Layout, values: tuple[Any, ...]) -> bytes:
    """All of it. An array at its end may be one of the machine's own kind, which lies there as it is sent."""
    last = values[-1]
    if type(last) is array and last.typecode == layout.tail and len(last) == layout.tail_size:
        return layout.front.pack(*values[:-1]) + last.tobytes()
    for place in layout.arrays:
        values = (*values[:place], *values[place], *values[place + 1 :])
    return layout.payload.pack(*values)


def pack(message: Any, system: int, component: int, sequence: int) -> bytes:
    """A message of `system`/`component` as a frame: what ``message.pack`` of pymavlink gives.

    Raises struct.error for a value that its field cannot hold.
    """
    kind: Any = type(message)
    layout = _layout(kind)
    payload = _payload(layout, layout.wire_values(message)).rstrip(b"\0") or b"\0"  # zeros are not sent
    covered = _HEAD.pack(len(payload), 0, 0, sequence, system, component, *layout.number) + payload
    return b"\xfd" + covered + checksum(covered, layout.crc_extra)


def is_whole(frame: bytes, kind: Any) -> bool:
    """True for a whole, undamaged, unsigned MAVLink 2 frame of one of pymavlink's message classes."""
    if len(frame) < OVERHEAD or frame[0] != _MARKER or frame[2] or len(frame) != frame[1] + OVERHEAD:
        return False
    known = int.from_bytes(frame[7:10], "little") == kind.id
    return known and checksum(frame[1:-2], _layout(kind).crc_extra) == frame[-2:]


def unpack(frame: bytes) -> Any | None:
    """The message in a whole, undamaged, unsigned MAVLink 2 frame of a known type; None for anything else."""
    if len(frame) < OVERHEAD or frame[0] != _MARKER or frame[2] or len(frame) != frame[1] + OVERHEAD:
        return None
    length, flags, other_flags, sequence, system, component, low, high = _HEAD.unpack_from(frame, 1)
    kind = mavlink.mavlink_map.get(low | high << 16)
    if kind is None:
        return None
    layout = _layout(kind)
    if checksum(frame[1:-2], layout.crc_extra) != frame[-2:]:
        return None
    size = layout.payload.size
    fields = layout.fields(layout.payload.unpack(frame[_PAYLOAD:-2].ljust(size, b"\0")[:size]))
    message = kind(*(fields if layout.finished else map(_finished, fields)))
    message._msgbuf = frame
    message._payload = frame[6:-2]  # so pymavlink has it
    (message._crc,) = _CHECKSUM.unpack(frame[-2:])
    header = message._header
    header.mlen, header.incompat_flags, header.compat_flags = length, flags, other_flags
    header.seq, header.srcSystem, header.srcComponent = sequence, system, component
    return message


def _finished(value: Any) -> Any:
    """An array as a list, a text without the zeros behind it."""
    if isinstance(value, tuple):
        return list(value)
    return value.rstrip(b"\0") if isinstance(value, bytes) else value


def decode(frame: bytes) -> Any:
    """The message in a whole frame of any kind. Raises pymavlink's MAVError if it is damaged."""
    message = unpack(frame)
    return _PYMAVLINK.decode(bytearray(frame)) if message is None else message


class Packer:
    """Packs the messages of one sender, each with the next sequence number (0..255, then 0 again)."""

    def __init__(self, system: int, component: int) -> None:
        self._sender = system, component
        self._sequence = 0

    def pack(self, message: Any) -> bytes:
        """One MAVLink 2 frame; raises as `pack`."""
        frame = pack(message, *self._sender, self._sequence)
        self._sequence = (self._sequence + 1) % 256
        return frame
