"""Finding frames in what arrives, whatever else arrives."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import FrameParser
from kffa_offboard.mavlink.transport import Datagram


def times(messages):
    return [message.time_boot_ms for message in messages]


def test_several_frames_in_one_datagram_come_in_order(autopilot):
    frames = autopilot.pack(*[autopilot.attitude(t) for t in (1, 2, 3)])
    assert times(FrameParser(True).parse(Datagram(0, frames, "a"))) == [1, 2, 3]


def test_a_frame_is_kept_as_it_was_received(autopilot):
    frame = autopilot.pack(autopilot.attitude(1))
    (message,) = FrameParser(True).parse(Datagram(0, frame, "a"))
    assert bytes(message.get_msgbuf()) == frame


def test_a_cut_datagram_does_not_swallow_the_next_one(autopilot):
    parser = FrameParser(True)
    frame = autopilot.pack(autopilot.attitude(1, r=0.1))
    assert parser.parse(Datagram(0, frame[:20], "a")) == []
    assert times(parser.parse(Datagram(0, frame, "a"))) == [1]


def test_a_new_connection_does_not_continue_the_old_ones_frame(autopilot):
    parser = FrameParser(False)
    frame = autopilot.pack(autopilot.attitude(1, r=0.1))
    parser.parse(Datagram(0, frame[:20], 1))
    assert times(parser.parse(Datagram(0, frame, 2))) == [1]


def test_a_wrong_checksum_is_counted_and_left_out(autopilot):
    parser = FrameParser(True)
    frame = bytearray(autopilot.pack(autopilot.attitude(1)))
    frame[-1] ^= 1
    assert parser.parse(Datagram(0, bytes(frame), "a")) == []
    assert parser.damaged_bytes == len(frame)


@pytest.mark.parametrize("whole", [True, False])
@given(data=st.lists(st.binary(max_size=80)))
def test_no_bytes_however_wild_stop_the_parser(whole, data):
    parser = FrameParser(whole)
    for piece in data:
        parser.parse(Datagram(0, b"\xfd" + piece, "a"))
    if whole:  # on a serial line damage may take the next frame with it
        frame = bytes(mavlink.MAVLink_attitude_message(9, 0, 0, 0, 0, 0, 0).pack(mavlink.MAVLink(None)))
        assert times(parser.parse(Datagram(0, frame, "a"))) == [9]
    assert parser.damaged_bytes <= sum(1 + len(piece) for piece in data)


@given(prefix=st.binary(max_size=30).filter(lambda b: b"\xfd" not in b and b"\xfe" not in b))
def test_noise_before_a_frame_on_a_serial_line_does_not_hide_it(prefix):
    packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    frame = bytes(mavlink.MAVLink_attitude_message(9, 0, 0, 0, 0, 0, 0).pack(packer))
    assert times(FrameParser(False).parse(Datagram(0, prefix + frame, "a"))) == [9]
