"""What leaves together: messages for graphs share datagrams, and nothing else about them changes."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.rivals import RivalWatch
from kffa_offboard.mavlink.signed_link import SignedLink
from kffa_offboard.mavlink.signing import Signer, Verdict
from kffa_offboard.mavlink.signing_key import SigningKey
from kffa_offboard.mavlink.transmission import DATAGRAM_LIMIT, Transmission, grouped
from kffa_offboard.mavlink.transport import Datagram

NOW_US = 1_790_000_000_000_000
KEY = SigningKey(bytes(range(1, 33)))


class Wire:
    """A link that remembers what was sent, and refuses what is due in `refuses`."""

    def __init__(self, keeps_frames_whole=True):
        self.keeps_frames_whole = keeps_frames_whole
        self.sent, self.refuses = [], 0

    def send(self, data):
        if self.refuses:
            self.refuses -= 1
            return False
        self.sent.append(data)
        return True


class Log:
    def __init__(self):
        self.frames = []

    def write(self, time_us, frame):
        self.frames.append((time_us, frame))


def transmission(link, log=None):
    return Transmission(link, Route(), RivalWatch(Route()), log)


def values(count):
    return [mavlink.MAVLink_named_value_float_message(1, b"ALT_EST", float(k)) for k in range(count)]


def read(*pieces):
    return [message.value for piece in pieces for message in mavlink.MAVLink(None).parse_buffer(piece)]


def test_messages_of_one_moment_share_datagrams_and_are_logged_one_by_one():
    wire, log = Wire(), Log()
    sent = transmission(wire, log)
    sent.send_together(7, values(21))
    assert len(wire.sent) == 2 and max(map(len, wire.sent)) <= DATAGRAM_LIMIT
    assert read(*wire.sent) == [float(k) for k in range(21)]
    assert b"".join(frame for _, frame in log.frames) == b"".join(wire.sent)
    assert [(time_us, len(read(frame))) for time_us, frame in log.frames] == [(7, 1)] * 21
    assert sent.counters.frames_sent == 21


def test_onto_a_byte_stream_frames_go_one_by_one_so_that_it_can_drop_the_old_ones():
    wire = Wire(keeps_frames_whole=False)
    transmission(wire).send_together(7, values(21))
    assert [read(data) for data in wire.sent] == [[float(k)] for k in range(21)]


def test_a_datagram_that_the_link_does_not_take_is_dropped_and_not_logged():
    wire, log = Wire(), Log()
    sent = transmission(wire, log)
    wire.refuses = 1
    sent.send_together(7, values(21))
    (second,) = wire.sent
    assert [frame for _, frame in log.frames] == grouped_again(second)
    assert sent.counters.frames_sent + sent.counters.frames_dropped == 21
    assert sent.counters.frames_dropped > 10


def test_a_message_that_the_link_does_not_take_was_not_sent():
    wire = Wire()
    sent = transmission(wire)
    wire.refuses = 1
    assert [sent.send(7, message) for message in values(2)] == [False, True]


def test_each_of_the_frames_of_a_datagram_is_known_again_as_ours():
    wire, rivals = Wire(), RivalWatch(Route())
    Transmission(wire, Route(), rivals, None).send_together(7, values(21))
    echoes = [echo for data in wire.sent for echo in mavlink.MAVLink(None).parse_buffer(data)]
    assert [rivals.is_impostor(echo) for echo in echoes] == [False] * 21


def grouped_again(datagram):
    return [bytes(message.get_msgbuf()) for message in mavlink.MAVLink(None).parse_buffer(datagram)]


@pytest.mark.parametrize("keeps_frames_whole", [True, False])
def test_on_a_signing_link_each_frame_is_signed(keeps_frames_whole):
    wire = Wire(keeps_frames_whole)
    link = SignedLink(wire, Signer(KEY), Signer(KEY), lambda: NOW_US)
    transmission(link).send_together(7, values(21))
    assert len(wire.sent) == (2 if keeps_frames_whole else 21)
    frames = [frame for data in wire.sent for frame in grouped_again(data)]
    other = Signer(KEY, link_id=1)
    assert [other.check(frame, NOW_US) for frame in frames] == [Verdict.GENUINE] * 21
    assert max(map(len, wire.sent)) < 1000, "what PX4 on a flight controller reads of a datagram"


def test_an_echo_of_any_of_the_signed_frames_is_no_refusal():
    wire = Wire()
    link = SignedLink(wire, Signer(KEY), Signer(KEY), lambda: NOW_US)
    transmission(link).send_together(7, values(21))
    wire.receive = lambda timeout_s: [Datagram(NOW_US, data, "peer") for data in wire.sent]
    assert link.receive(0.0) == []
    assert not link.refused


def test_of_frames_that_go_one_by_one_each_is_tried_and_all_must_be_taken():
    wire = Wire(keeps_frames_whole=False)
    link = SignedLink(wire, Signer(KEY), Signer(KEY), lambda: NOW_US)
    pair = b"".join(message.pack(mavlink.MAVLink(None, 1, 1)) for message in values(2))
    wire.refuses = 1
    assert not link.send(pair) and len(wire.sent) == 1
    assert link.send(pair) and len(wire.sent) == 3


def test_groups_keep_order_and_limit_and_a_larger_frame_goes_alone():
    frames = [b"a" * 200, b"b" * 200, b"c" * 100, b"d" * 600, b"e" * 10]
    assert grouped(frames, 512) == [frames[:3], frames[3:4], frames[4:]]
    assert grouped(frames, 0) == [[frame] for frame in frames]
    assert grouped([], 512) == []
