"""A datagram that is one frame is read as pymavlink reads a stream of bytes, whatever is wrong with it."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle.peer import Peer


def packed(message: mavlink.MAVLink_message) -> bytes:
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=245, srcComponent=191)))


GOOD = packed(mavlink.MAVLink_ping_message(7, 1, 0, 0))
TARGET = packed(
    mavlink.MAVLink_set_attitude_target_message(70, 1, 1, 7, [1.0, 0.0, 0.0, 0.0], 0.1, 0.2, 0.3, 0.4)
)
TEXT = packed(mavlink.MAVLink_statustext_message(6, b"a text", 0, 0))
DAMAGED = [
    TARGET[:k] + bytes([TARGET[k] ^ flip]) + TARGET[k + 1 :] for k in range(len(TARGET)) for flip in (1, 255)
]
SHORT = [TARGET[:k] for k in range(len(TARGET))]
OTHERS = [b"", b"\xfd", b"\xfd\x00\x00" + bytes(9), TARGET + TEXT, TARGET + TARGET[:5], b"noise" + TARGET]


def read(parse, datagrams: list[bytes]) -> list[bytes]:
    messages = [message for data in datagrams for message in parse(data) or []]
    return [bytes(message.get_msgbuf()) for message in messages if message.get_type() != "BAD_DATA"]


@pytest.mark.parametrize(
    "datagrams", [[TARGET, TEXT], DAMAGED, SHORT, OTHERS], ids=["good", "damaged", "short", "other"]
)
def test_a_frame_alone_is_read_like_a_stream(datagrams: list[bytes]) -> None:
    for datagram in datagrams:
        stream = mavlink.MAVLink(None)
        stream.robust_parsing = True
        following = [datagram, *[GOOD] * 20]  # what is half there is waited for, and given up
        ours = read(Peer("peer", 1, {}, 0).parse, following)
        assert ours == read(stream.parse_buffer, following)
        assert ours[-1] == GOOD
