"""Frames taken apart, changed and put together again, with the same sender and a valid checksum."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

MAGIC = 0xFD
HEADER_SIZE = 10
CHECKSUM_SIZE = 2
SIGNATURE_SIZE = 13
_SIGNED = 0x01
_PARSER = mavlink.MAVLink(None)


def split(data: bytes) -> list[bytes]:
    """The MAVLink 2 frames of a datagram; what is no frame stays one piece."""
    frames = []
    while len(data) > HEADER_SIZE and data[0] == MAGIC:
        size = HEADER_SIZE + data[1] + CHECKSUM_SIZE + (SIGNATURE_SIZE if data[2] & _SIGNED else 0)
        frames.append(data[:size])
        data = data[size:]
    return [*frames, data] if data else frames


def message_id(frame: bytes) -> int:
    """Number of the message in a MAVLink 2 frame; -1 if it is none."""
    if len(frame) < HEADER_SIZE or frame[0] != MAGIC:
        return -1
    return int.from_bytes(frame[7:10], "little")


def number_of(name: str) -> int:
    """Message id of a name. Raises KeyError if there is none."""
    number = getattr(mavlink, f"MAVLINK_MSG_ID_{name}", None)
    if number is None:
        raise KeyError(f"{name}: no MAVLink message has this name")
    return int(number)


def edited(frame: bytes, change: Callable[[Any], None]) -> bytes:
    """The frame with its message changed in place by `change`; a damaged frame as it is."""
    message = decoded(frame)
    if message is None:
        return frame
    packer = mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
    packer.seq = message.get_seq()
    change(message)
    return bytes(message.pack(packer))


def decoded(frame: bytes) -> Any | None:
    """The message of a frame; None if it is damaged, or of a kind that nobody knows."""
    try:
        message = _PARSER.decode(bytearray(frame))  # frame by frame: nothing is remembered
    except mavlink.MAVError:
        return None
    return None if isinstance(message, mavlink.MAVLink_unknown) else message


def set_fields(message: Any, values: Mapping[str, Any]) -> None:
    """Give fields of a message other values. Raises KeyError for a field that it does not have."""
    for name, value in values.items():
        if name not in message.get_fieldnames():
            raise KeyError(f"{message.get_type()} has no field {name}")
        setattr(message, name, value)
