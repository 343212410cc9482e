"""Who we are on the MAVLink network, and frames as bytes.

This file and its neighbours are where pymavlink is used; it has no types, so a message is `Any`.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard import frame_codec
from kffa_offboard.mavlink.transport import Datagram

Message: TypeAlias = Any
"""A pymavlink message; which fields it has depends on its type (`msgname`, "" for none that is known)."""


@dataclass(frozen=True, slots=True)
class Route:
    """Our own identity and the one vehicle we listen and talk to (MAVLink system and component ids)."""

    own_system: int = 245
    own_component: int = 191
    target_system: int = 1
    target_component: int = 1

    def from_target(self, message: Message) -> bool:
        """True if the vehicle's autopilot itself sent `message`."""
        header = message.get_header()
        same: bool = header.srcSystem == self.target_system and header.srcComponent == self.target_component
        return same

    def addresses_us(self, system: int, component: int) -> bool:
        """True if an answer to `system`/`component` is ours; 0 is everybody (or an older MAVLink)."""
        return system in (0, self.own_system) and component in (0, self.own_component)


class Component(frame_codec.Packer):
    """Packs messages as frames of ours: identity, sequence number, checksum."""

    def __init__(self, route: Route) -> None:
        super().__init__(route.own_system, route.own_component)


def _new_parser() -> Any:
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True  # damaged bytes become BAD_DATA messages instead of exceptions
    return parser


class FrameParser:
    """Finds the messages in what a link received.

    Parameters
    ----------
    keeps_frames_whole
        As the link says. If a frame cannot span datagrams, the rest of a damaged one is forgotten,
        so that it does not swallow the frame after it; a stream keeps the beginning of a frame until
        the rest arrives, separately for each source.

    Attributes
    ----------
    damaged_bytes
        How many bytes were not part of a valid frame.

    """

    def __init__(self, keeps_frames_whole: bool) -> None:
        self._keeps_frames_whole = keeps_frames_whole
        self._source: Hashable = None
        self._parser = _new_parser()
        self.damaged_bytes = 0

    def parse(self, datagram: Datagram) -> list[Message]:
        """Messages that are complete with this datagram, in order; damage is counted and left out."""
        unfinished = self._parser.buf_len() > 0
        if unfinished and (self._keeps_frames_whole or datagram.source != self._source):
            self._parser, unfinished = _new_parser(), False
        self._source = datagram.source
        messages: list[Message] = []
        for message in self._found(datagram.data, unfinished):
            if not message.msgname and message.get_type() == "BAD_DATA":
                self.damaged_bytes += len(message.data)
            elif message.msgname == "SETUP_SIGNING":
                messages.append(_without_key(message))
            else:
                messages.append(message)
        return messages

    def _found(self, data: bytes, unfinished: bool) -> list[Message]:
        """What is in the data. Ordinary frames at its beginning need no parser, unless one is unfinished."""
        found: list[Message] = []
        while not unfinished and len(data) > 1:
            size = data[1] + frame_codec.OVERHEAD
            message = frame_codec.unpack(data[:size])
            if message is None:
                break
            found.append(message)
            data = data[size:]
        return found + (self._parser.parse_buffer(data) or []) if data else found


def _without_key(message: Message) -> Message:
    """SETUP_SIGNING with nothing in it but its addresses: somebody's signing key must not get into a log."""
    blank = mavlink.MAVLink_setup_signing_message(
        message.target_system, message.target_component, [0] * 32, 0
    )
    packer = mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
    packer.seq = message.get_seq()
    return mavlink.MAVLink(None).decode(bytearray(blank.pack(packer)))
