"""Signatures against pymavlink's own, which PX4's and ArduPilot's C library agrees with on the wire."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.signing import EPOCH_US, Signer, Verdict, timestamp_at, without_signature
from kffa_offboard.mavlink.signing_key import SigningKey

SECRET = bytes(range(1, 33))
KEY = SigningKey(SECRET)
NOW_US = 1_790_000_000_000_000
SECOND = 100_000
NOW = timestamp_at(NOW_US)


class Other:
    """pymavlink at the other end, with its time in units of 10 us."""

    def __init__(self, secret=SECRET, system=1, component=1, link_id=3, timestamp=NOW):
        self.codec = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
        self.codec.signing.secret_key = secret
        self.codec.signing.sign_outgoing = secret is not None
        self.codec.signing.link_id = link_id
        self.codec.signing.timestamp = timestamp

    def pack(self, message=None):
        message = message or mavlink.MAVLink_attitude_message(1234, 0.1, -0.2, 3.0, 0.0, 0.5, 0.0)
        frame = bytes(message.pack(self.codec))
        self.codec.seq = (self.codec.seq + 1) % 256
        return frame

    def takes(self, frame):
        return self.codec.decode(bytearray(frame))


@pytest.fixture
def signer():
    return Signer(KEY, link_id=7)


def unsigned(message):
    return bytes(message.pack(mavlink.MAVLink(None, srcSystem=245, srcComponent=191)))


MESSAGES = [
    mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3),
    mavlink.MAVLink_set_attitude_target_message(7, 1, 1, 128, [1.0, 0, 0, 0], 0.1, 0.2, 0.3, 0.5),
    mavlink.MAVLink_statustext_message(4, b"a line for people", 1, 0),
    mavlink.MAVLink_attitude_message(0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),  # payload cut to one byte
]


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.get_type())
def test_pymavlink_takes_what_we_sign_and_reads_the_same(signer, message):
    frame = unsigned(message)
    taken = Other().takes(signer.sign(frame, NOW_US))
    assert taken.get_signed()
    assert taken.get_link_id() == 7
    assert taken.to_dict() == mavlink.MAVLink(None).decode(bytearray(frame)).to_dict()


@pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.get_type())
def test_what_pymavlink_signs_is_genuine_and_the_same_without_its_signature(signer, message):
    other, plain = Other(), Other(None)
    frame = other.pack(message)
    assert signer.check(frame, NOW_US) is Verdict.GENUINE
    assert without_signature(frame) == plain.pack(message)


def test_timestamps_count_10_us_from_2015_and_follow_the_clock(signer):
    frame = unsigned(MESSAGES[0])

    def stamp(time_us):
        return int.from_bytes(signer.sign(frame, time_us)[-12:-6], "little")

    assert timestamp_at(EPOCH_US + 1_000_000) == SECOND
    assert stamp(NOW_US) == (NOW_US - EPOCH_US) // 10
    assert stamp(NOW_US) == timestamp_at(NOW_US) + 1  # twice at once
    assert stamp(NOW_US + 3_000_000) == timestamp_at(NOW_US) + 3 * SECOND
    assert stamp(NOW_US - 3_600_000_000) == timestamp_at(NOW_US) + 3 * SECOND + 1  # set back an hour


def test_another_key_is_not_genuine(signer):
    assert signer.check(Other(bytes(32 * [9])).pack(), NOW_US) is Verdict.FORGED
    with pytest.raises(mavlink.MAVError):
        Other(bytes(32 * [9])).takes(signer.sign(unsigned(MESSAGES[0]), NOW_US))


def test_no_bit_of_a_frame_can_be_changed(signer):
    frame = Other().pack()
    for at in range(len(frame)):
        for bit in range(8):
            changed = bytearray(frame)
            changed[at] ^= 1 << bit
            assert signer.check(bytes(changed), NOW_US) is not Verdict.GENUINE
    assert signer.check(frame, NOW_US) is Verdict.GENUINE


def test_unsigned_frames_of_both_versions_are_not_genuine(signer):
    message = mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)
    codec = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    for first in (False, True):
        assert signer.check(bytes(message.pack(codec, force_mavlink1=first)), NOW_US) is Verdict.UNSIGNED


def test_a_frame_is_genuine_only_once_and_no_older_one_after_it(signer):
    other = Other()
    first, second, third = other.pack(), other.pack(), other.pack()
    assert signer.check(second, NOW_US) is Verdict.GENUINE
    assert signer.check(second, NOW_US) is Verdict.REPLAYED
    assert signer.check(first, NOW_US) is Verdict.REPLAYED
    assert signer.check(third, NOW_US) is Verdict.GENUINE


@pytest.mark.parametrize(("late_s", "verdict"), [(59, Verdict.GENUINE), (61, Verdict.OUTDATED)])
def test_a_new_sender_may_be_a_minute_late(signer, late_s, verdict):
    late = Other(timestamp=timestamp_at(NOW_US) - late_s * SECOND)
    assert signer.check(late.pack(), NOW_US) is verdict


def test_each_sender_and_each_of_its_links_has_a_time_of_its_own(signer):
    ahead = Other(timestamp=timestamp_at(NOW_US) + 30 * SECOND)
    assert signer.check(ahead.pack(), NOW_US) is Verdict.GENUINE
    for other in (Other(link_id=4), Other(component=190), Other(system=255)):
        assert signer.check(other.pack(), NOW_US) is Verdict.GENUINE


def test_a_forged_frame_from_the_future_does_not_shut_its_sender_out(signer):
    future = Other(bytes(32 * [9]), timestamp=(1 << 48) - 5)
    assert signer.check(future.pack(), NOW_US) is Verdict.FORGED
    assert signer.check(Other().pack(), NOW_US) is Verdict.GENUINE
    assert signer.timestamp < timestamp_at(NOW_US) + 10


def test_forged_senders_leave_nothing_behind(signer):
    for number in range(2000):
        forger = Other(bytes(32 * [9]), system=number % 255 + 1, component=number // 255 + 1)
        signer.check(forger.pack(), NOW_US)
    assert signer._newest == {}


def test_a_late_clock_is_understood_once_it_has_heard_the_vehicle():
    vehicle, late = Other(), Signer(KEY)
    vehicle.codec.signing.stream_timestamps[(0, 245, 191)] = timestamp_at(NOW_US) - SECOND  # the last flight
    year_1970 = 1_000_000
    frame = unsigned(MESSAGES[0])
    with pytest.raises(mavlink.MAVError):
        vehicle.takes(late.sign(frame, year_1970))
    assert late.check(vehicle.pack(), year_1970) is Verdict.GENUINE
    assert vehicle.takes(late.sign(frame, year_1970)).get_signed()


@pytest.mark.parametrize(("before_the_end", "verdict"), [(1, Verdict.ENDLESS), (3650, Verdict.GENUINE)])
def test_nobody_with_the_key_takes_us_to_the_end_of_time(signer, before_the_end, verdict):
    """Every frame of ours would have had the last timestamp there is: the vehicle had refused all but one."""
    late = Other(timestamp=(1 << 48) - 1 - before_the_end * 86_400 * SECOND)
    assert signer.check(late.pack(), NOW_US) is verdict
    first, second = (signer.sign(unsigned(MESSAGES[0]), NOW_US)[-12:-6] for _ in range(2))
    assert int.from_bytes(second, "little") == int.from_bytes(first, "little") + 1


def test_the_last_timestamp_there_is_does_not_overflow():
    signer = Signer(KEY, timestamp=(1 << 48) - 1)
    assert len(signer.sign(unsigned(MESSAGES[0]), NOW_US)) == len(unsigned(MESSAGES[0])) + 13
    assert signer.check(Other(timestamp=(1 << 48) - 1).pack(), NOW_US) is Verdict.ENDLESS


def test_what_we_signed_ourselves_is_not_genuine_when_it_comes_back(signer):
    recorded = [signer.sign(unsigned(message), NOW_US) for message in MESSAGES]
    assert {signer.check(frame, NOW_US) for frame in recorded} == {Verdict.REPLAYED}
