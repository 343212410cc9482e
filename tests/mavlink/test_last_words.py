"""The last setpoint as bytes for somebody else: with the way to the vehicle, and signed so that it counts."""

import socket
from contextlib import closing

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.address import parse_url
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.last_words import FramedLastWords
from kffa_offboard.mavlink.signed_link import SignedLink
from kffa_offboard.mavlink.signing import Signer, Verdict
from kffa_offboard.mavlink.signing_key import SigningKey
from kffa_offboard.mavlink.transport import Posting
from kffa_offboard.mavlink.udp import UdpLink
from kffa_offboard.offboard.events import AttitudeTarget

NOW_US = 1_790_000_000_000_000
KEY = SigningKey(bytes(range(32)))
LEVEL = AttitudeTarget(0.4, attitude=(0.0, 0.0, 0.3))


class Service:
    has_control = True

    def __init__(self, *targets):
        self.targets = targets

    def last_setpoints(self):
        return self.targets


class Wire:
    keeps_frames_whole = True

    def posting(self, data):
        return Posting(3, data)

    def send(self, data):
        self.sent = data
        return True


def words(link, *targets):
    return FramedLastWords(Service(*(targets or (LEVEL,))), link, Route(), lambda: NOW_US)


def test_it_is_one_whole_setpoint_of_ours():
    descriptor, frame, place = words(Wire()).posting()
    message = mavlink.MAVLink(None).decode(bytearray(frame))
    assert (descriptor, place) == (3, None)
    assert (message.get_srcSystem(), message.get_srcComponent()) == (245, 191)
    assert (message.get_type(), message.type_mask) == ("SET_ATTITUDE_TARGET", 7)
    assert message.thrust == pytest.approx(0.4)


def test_nothing_is_framed_where_there_is_nothing_to_say():
    assert FramedLastWords(Service(), Wire(), Route(), lambda: NOW_US).posting() is None
    assert words(Wire(), AttitudeTarget(1.5, attitude=(0.0, 0.0, 0.0))).posting() is None


@pytest.mark.parametrize("signs", [False, True])
def test_two_setpoints_go_in_one_datagram_in_their_order(signs):
    """PX4 is told not to turn on before it is told to be level."""
    link = SignedLink(Wire(), Signer(KEY), Signer(KEY), lambda: NOW_US) if signs else Wire()
    data = words(link, AttitudeTarget(0.4, body_rates=(0.0, 0.0, 0.0)), LEVEL).posting().data
    parser = mavlink.MAVLink(None)
    if signs:
        parser.signing.secret_key, parser.signing.sign_outgoing = bytes(range(32)), True
    assert [message.type_mask for message in parser.parse_buffer(data)] == [128, 7]


def udp(url):
    return closing(UdpLink(parse_url(url), lambda: NOW_US))


def test_a_link_that_listens_gives_the_way_to_the_vehicle_once_it_knows_it():
    with udp("udpin:127.0.0.1:0") as link:
        assert words(link).posting() is None
        link.lock(("127.0.0.1", 14550))
        posting = words(link).posting()
        assert (posting.descriptor, posting.place) == (link.descriptor, ("127.0.0.1", 14550))


def test_a_link_to_one_place_knows_the_way_itself():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle:
        vehicle.bind(("127.0.0.1", 0))
        with udp(f"udpout:127.0.0.1:{vehicle.getsockname()[1]}") as link:
            assert words(link).posting().place is None


def test_signed_words_count_after_what_was_sent_later_and_hide_nothing_of_it():
    wire, vehicle = Wire(), Signer(KEY, timestamp=1)
    link = SignedLink(wire, Signer(KEY), Signer(KEY), lambda: NOW_US)
    said = words(link).posting().data
    later = []
    for _ in range(3):
        link.send(words(Wire()).posting().data)
        later.append(wire.sent)
    assert [vehicle.check(frame, NOW_US) for frame in (*later, said)] == [Verdict.GENUINE] * 4
    fresh = Signer(KEY, timestamp=1)
    assert [fresh.check(frame, NOW_US) for frame in (said, *later)] == [Verdict.GENUINE] * 4
