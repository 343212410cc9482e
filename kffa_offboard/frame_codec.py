"""MAVLink 2 frames to and from messages, for what comes and goes hundreds of times a second.

What a message looks like is pymavlink's: its message classes say which fields they have, in which order they
lie in the frame (`unpacker`) and what goes into the checksum. pymavlink works out for every single frame what
depends on the type of the message only; here that is kept. The outcome is the same, byte for byte and field
for field. What is no ordinary frame (damaged, signed, MAVLink 1, of an unknown type) is left to pymavlink.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from functools import cache
from operator import attrgetter, itemgetter
from typing import Any

from fastcrc.crc16 import mcrf4xx
from msgspec import Struct
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20.development import MAVLink_current_mode_message

_MARKER = 0xFD
_HEAD = struct.Struct("<BBBBBBHB")  # length, two flags, sequence, system, component, message id
_FRONT = struct.Struct("<BBBBBBB3s")  # marker and the same, the id as bytes
_PAYLOAD = 1 + _HEAD.size  # where it begins, behind marker and head
_CHECKSUM = struct.Struct("<H")
OVERHEAD = _PAYLOAD + _CHECKSUM.size
"""Bytes of a frame beside its payload, whose length is the second byte."""
CURRENT_MODE: int = MAVLink_current_mode_message.id
"""PX4 sends it, and ArduPilot's dialect lacks it. From here on pymavlink's own parser knows it, too."""

mavlink.mavlink_map.setdefault(CURRENT_MODE, MAVLink_current_mode_message)

_PYMAVLINK = mavlink.MAVLink(None)


class Outgoing(Struct, frozen=True, gc=False):
    """A message that is only to be sent.

    Attributes
    ----------
    kind : pymavlink's class of it
    values : in the order of the frame, an array's one by one, a text as bytes. An array at the end may be its
        bytes in the frame.
    """

    kind: Any
    values: tuple[Any, ...]


class _Layout(Struct, frozen=True, gc=False):
    """What is always the same about one type of message.

    Attributes
    ----------
    number : message id, as in the frame
    payload : layout of the frame between head and checksum, and its bytes
    crc_extra : goes into the checksum behind the frame, one byte
    wire_values : of a message: its values in the order of the frame, an array as one
    arrays : places of the arrays among them, the last first
    fields : of the frame's numbers and texts: the message's fields, in its own order, an array as a tuple
    unfinished : places of arrays and texts among them
    front : layout without an array at its end, and the bytes of this array; 0 if there is none
    """

    number: bytes
    payload: struct.Struct
    size: int
    crc_extra: bytes
    wire_values: Callable[[Any], tuple[Any, ...]]
    arrays: tuple[int, ...]
    fields: Callable[[tuple[Any, ...]], tuple[Any, ...]]
    unfinished: tuple[int, ...]
    front: struct.Struct
    rear: int


@cache
def _layout(kind: Any) -> _Layout:
    """Of one of pymavlink's message classes."""
    types = dict(zip(kind.fieldnames, kind.fieldtypes, strict=True))
    sizes, at = kind.lengths, 0
    texts = [types[name] == "char" for name in kind.ordered_fieldnames]
    names: list[str] = []
    places: list[int | slice] = []
    for name, size, text in zip(kind.ordered_fieldnames, sizes, texts, strict=True):
        names.append(f"_{name}_raw" if text and kind.array_lengths[len(names)] else name)
        places.append(at if size == 1 else slice(at, at + size))
        at += size
    arrays = [place for place, size in enumerate(sizes) if size > 1]
    layout, last = kind.unpacker.format, sizes[-1]
    front = struct.Struct(layout.removesuffix(f"{last}{layout[-1]}") if last > 1 else layout)
    return _Layout(
        kind.id.to_bytes(3, "little"),
        kind.unpacker,
        kind.unpacker.size,
        bytes((kind.crc_extra,)),
        _several(attrgetter, names),
        tuple(reversed(arrays)),
        _several(itemgetter, [places[order] for order in kind.orders]),
        tuple(place for place, order in enumerate(kind.orders) if sizes[order] > 1 or texts[order]),
        front,
        kind.unpacker.size - front.size,
    )


def _several(getter: Callable[..., Callable[[Any], Any]], which: Sequence[Any]) -> Callable[[Any], Any]:
    """Gets a tuple, of one thing, too."""
    if len(which) > 1:
        return getter(*which)
    only = getter(*which)
    return lambda holder: (only(holder),)


def checksum(covered: bytes, crc_extra: bytes) -> bytes:
    """The two bytes behind a frame; `covered` is the frame without them and without its first byte."""
    return _CHECKSUM.pack(mcrf4xx(covered + crc_extra))


def pack(message: Any, system: int, component: int, sequence: int) -> bytes:
    """A message, `Outgoing` or pymavlink's, of `system`/`component` as a frame: what its ``pack`` gives.

    Raises struct.error for a value that its field cannot hold.
    """
    kind: Any = type(message)
    if kind is Outgoing:
        layout, values = _layout(message.kind), message.values
    else:
        layout = _layout(kind)
        values = layout.wire_values(message)
        for place in layout.arrays:
            values = (*values[:place], *values[place], *values[place + 1 :])
    if layout.rear and isinstance(values[-1], bytes) and len(values[-1]) == layout.rear:
        payload = layout.front.pack(*values[:-1]) + values[-1]
    else:
        payload = layout.payload.pack(*values)
    payload = payload.rstrip(b"\0") or b"\0"  # zeros are not sent
    head = _FRONT.pack(_MARKER, len(payload), 0, 0, sequence, system, component, layout.number)
    frame = head + payload
    return frame + _CHECKSUM.pack(mcrf4xx(frame[1:] + layout.crc_extra))


def is_whole(frame: bytes, kind: Any) -> bool:
    """True for a whole, undamaged, unsigned MAVLink 2 frame of one of pymavlink's message classes."""
    if len(frame) < OVERHEAD or frame[0] != _MARKER or frame[2] or len(frame) != frame[1] + OVERHEAD:
        return False
    layout = _layout(kind)
    return frame[7:10] == layout.number and checksum(frame[1:-2], layout.crc_extra) == frame[-2:]


def unpack(frame: bytes) -> Any | None:
    """The message in a whole, undamaged, unsigned MAVLink 2 frame of a known type; None for anything else."""
    if len(frame) < OVERHEAD or frame[0] != _MARKER or frame[2] or len(frame) != frame[1] + OVERHEAD:
        return None
    length, flags, other_flags, sequence, system, component, low, high = _HEAD.unpack_from(frame, 1)
    kind = mavlink.mavlink_map.get(low | high << 16)
    if kind is None:
        return None
    layout = _layout(kind)
    crc = mcrf4xx(frame[1:-2] + layout.crc_extra)
    if crc != frame[-2] | frame[-1] << 8:
        return None
    if length == layout.size:
        values = layout.payload.unpack_from(frame, _PAYLOAD)
    else:
        values = layout.payload.unpack(frame[_PAYLOAD:-2].ljust(layout.size, b"\0")[: layout.size])
    fields = layout.fields(values)
    message = kind(*(_finished(fields, layout.unfinished) if layout.unfinished else fields))
    message._msgbuf = frame
    message._payload = frame[6:-2]  # so pymavlink has it
    message._crc = crc
    header = message._header
    header.mlen, header.incompat_flags, header.compat_flags = length, flags, other_flags
    header.seq, header.srcSystem, header.srcComponent = sequence, system, component
    return message


def _finished(fields: tuple[Any, ...], unfinished: tuple[int, ...]) -> list[Any]:
    """An array as a list, a text without the zeros behind it."""
    finished = [*fields]
    for place in unfinished:
        value = finished[place]
        finished[place] = [*value] if isinstance(value, tuple) else value.rstrip(b"\0")
    return finished


def decode(frame: bytes) -> Any:
    """The message in a whole frame of any kind. Raises pymavlink's MAVError if it is damaged."""
    message = unpack(frame)
    return _PYMAVLINK.decode(bytearray(frame)) if message is None else message


class Packer:
    """Packs the messages of one sender, each with the next sequence number (0..255, then 0 again)."""

    def __init__(self, system: int, component: int) -> None:
        self._system, self._component = system, component
        self._sequence = 0

    def pack(self, message: Any) -> bytes:
        """One MAVLink 2 frame; raises as `pack`."""
        frame = pack(message, self._system, self._component, self._sequence)
        self._sequence = (self._sequence + 1) % 256
        return frame
