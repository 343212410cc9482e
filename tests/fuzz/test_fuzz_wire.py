"""Any bytes on the wire: parsers of both ends neither fail, nor hang, nor keep what they cannot use."""

from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import FrameParser, Route
from kffa_offboard.mavlink.rivals import RivalWatch
from kffa_offboard.mavlink.signed_link import SignedLink
from kffa_offboard.mavlink.signing import Signer
from kffa_offboard.mavlink.signing_key import SigningKey
from kffa_offboard.mavlink.transport import Datagram
from sim_vehicle.peer import Peer
from sim_vehicle.signing import Signing

SECRET = bytes(range(1, 33))
NOW_US = 1_790_000_000_000_000


def budget(few, many):
    """How many examples: in CI, in the long mode."""

    def mark(function):
        function.budget = (few, many)
        return function

    return mark


class Wire:
    name, trouble = "wire", ""

    def __init__(self, keeps_frames_whole):
        self.keeps_frames_whole = keeps_frames_whole
        self.arriving = []

    def receive(self, timeout_s):
        arriving, self.arriving = self.arriving, []
        return arriving


@budget(150, 10_000)
def test_the_parser_finds_valid_frames_in_any_bytes_and_nothing_else(hostile, examples):
    def check(data):
        whole = data.draw(st.booleans())
        parser = FrameParser(whole)
        watch = RivalWatch(Route())
        for _ in range(data.draw(st.integers(1, 4))):
            datagram = Datagram(0, data.draw(hostile.streams()), data.draw(st.sampled_from("ab")))
            for message in parser.parse(datagram):
                assert message.get_type() != "BAD_DATA"
                assert bytes(message.get_msgbuf())[0] in (0xFD, 0xFE)
                watch.watch(0, message)
        valid = hostile.frame(0, b"\x00\x00\x00\x00\x02\x0c\x51\x04\x03")
        for _ in range(2 if whole else 30):  # a stream has to get over the beginning of a long frame first
            last = parser.parse(Datagram(0, valid, "a"))
        assert [message.get_type() for message in last] == ["HEARTBEAT"]

    hostile.run(check, examples)


@budget(150, 10_000)
def test_nothing_unsigned_gets_past_a_signing_link(hostile, examples):
    def check(data):
        wire = Wire(data.draw(st.booleans()))
        link = SignedLink(wire, Signer(SigningKey(SECRET)), Signer(SigningKey(SECRET)), lambda: NOW_US)
        for _ in range(data.draw(st.integers(1, 4))):
            stranger = data.draw(st.booleans())
            wire.arriving = [Datagram(NOW_US, data.draw(hostile.streams()), "a", stranger)]
            for datagram in link.receive(0.0):
                messages = FrameParser(True).parse(datagram)
                assert all(message.get_type() == "RADIO_STATUS" for message in messages)
        assert len(link._buffer) < 300
        signing = Signer(SigningKey(SECRET))
        genuine = hostile.frame(0, b"\x00\x00\x00\x00\x02\x0c\x51\x04\x03")
        found = []
        for _ in range(2 if wire.keeps_frames_whole else 30):
            wire.arriving = [Datagram(NOW_US, signing.sign(genuine, NOW_US), "a")]
            found += [datagram.data for datagram in link.receive(0.0)]
        assert genuine in found

    hostile.run(check, examples)


@budget(100, 8_000)
def test_damaged_signed_frames_are_refused_or_unchanged(hostile, examples):
    """Whatever happens to genuine frames on the way, what comes through is one of them."""

    def check(data):
        signer = Signer(SigningKey(SECRET))
        plain = [hostile.frame(30, bytes(range(k, k + 28)), sequence=k) for k in range(3)]
        stream = b"".join(signer.sign(frame, NOW_US) for frame in plain)
        wire = Wire(True)
        link = SignedLink(wire, Signer(SigningKey(SECRET)), Signer(SigningKey(SECRET)), lambda: NOW_US)
        wire.arriving = [Datagram(NOW_US, data.draw(hostile.damaged(stream)), "a")]
        for datagram in link.receive(0.0):
            messages = FrameParser(True).parse(datagram)
            assert all(bytes(message.get_msgbuf()) in plain for message in messages)

    hostile.run(check, examples)


@budget(100, 8_000)
def test_the_simulated_autopilots_parser_takes_any_bytes(hostile, examples):
    def check(data):
        signing = Signing(SECRET, lambda: NOW_US) if data.draw(st.booleans()) else None
        peer = Peer("a", 1, {}, 0, signing)
        for _ in range(data.draw(st.integers(1, 4))):
            messages = peer.parse(data.draw(hostile.streams()))
            known = [message for message in messages if message.get_msgId() in mavlink.mavlink_map]
            assert signing is None or not known
        assert signing is None or peer.codec.signing.stream_timestamps == {}

    hostile.run(check, examples)
