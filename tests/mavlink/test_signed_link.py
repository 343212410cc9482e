"""The signing link: what passes it in either direction, what it refuses and what it says about it."""

import logging

import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.component import Component, Route
from kffa_offboard.mavlink.reception import Reception
from kffa_offboard.mavlink.rivals import RivalWatch
from kffa_offboard.mavlink.signed_link import SignedLink, SigningSettings, clock_problem, sign_link
from kffa_offboard.mavlink.signing import Signer, Verdict, timestamp_at
from kffa_offboard.mavlink.signing_key import SigningKey
from kffa_offboard.mavlink.transport import Datagram

SECRET = bytes(range(1, 33))
NOW_US = 1_790_000_000_000_000
ONE_MINUTE_US = 60_000_000


class Wire:
    """A link whose other end is the test."""

    name = "wire"
    trouble = ""

    def __init__(self, keeps_frames_whole=True):
        self.keeps_frames_whole = keeps_frames_whole
        self.arriving = []
        self.sent = []
        self.closed = 0

    def receive(self, timeout_s):
        arriving, self.arriving = self.arriving, []
        return arriving

    def send(self, data):
        self.sent.append(data)
        return True

    def lock(self, source):
        self.locked = source

    def close(self):
        self.closed += 1


class Vehicle:
    def __init__(self, secret=SECRET, ids=(1, 1), now_us=NOW_US):
        self.codec = mavlink.MAVLink(None, *ids)
        self.codec.signing.secret_key = secret
        self.codec.signing.sign_outgoing = secret is not None
        self.codec.signing.timestamp = timestamp_at(now_us)

    def frame(self, message=None):
        frame = bytes((message or mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 4, 3)).pack(self.codec))
        self.codec.seq = (self.codec.seq + 1) % 256
        return frame


@pytest.fixture
def wire():
    return Wire()


@pytest.fixture
def link(wire):
    return signed(wire)


def signed(wire):
    key = SigningKey(SECRET)
    return SignedLink(wire, Signer(key), Signer(key), lambda: NOW_US)


def arrive(link, wire, *pieces, source="vehicle", stranger=False):
    wire.arriving = [Datagram(NOW_US, piece, source, stranger) for piece in pieces]
    return link.receive(0.0)


def test_genuine_frames_come_without_their_signatures(link, wire):
    vehicle, plain = Vehicle(), Vehicle(None)
    (datagram,) = arrive(link, wire, vehicle.frame() + vehicle.frame())
    assert datagram.data == plain.frame() + plain.frame()
    assert (datagram.time_us, datagram.source) == (NOW_US, "vehicle")
    assert link.refused == {}


def test_what_goes_out_is_signed(link, wire):
    message = mavlink.MAVLink_statustext_message(4, b"ready", 0, 0)
    assert link.send(bytes(message.pack(mavlink.MAVLink(None, 245, 191))))
    (frame,) = wire.sent
    assert Vehicle().codec.decode(bytearray(frame)).get_signed()


@pytest.mark.parametrize(
    ("sender", "verdict", "remedy"),
    [
        (Vehicle(None), Verdict.UNSIGNED, "is signing on there"),
        (Vehicle(bytes(32 * [7])), Verdict.FORGED, "the same key"),
        (Vehicle(now_us=NOW_US - 2 * ONE_MINUTE_US), Verdict.OUTDATED, "its clock is wrong"),
    ],
)
def test_a_refusal_is_said_once_with_sender_and_reason_and_counted(
    link, wire, caplog, sender, verdict, remedy
):
    first = arrive(link, wire, sender.frame())
    assert [(datagram.data, datagram.notice) for datagram in first] == [
        (b"", f"refusing 1/1: {verdict.value}")
    ]
    assert arrive(link, wire, *(sender.frame() for _ in range(9))) == []
    assert link.refused == {(verdict, (1, 1)): 10}
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    assert remedy in caplog.text
    assert link.trouble == f"signing: 10 from 1/1 refused: {verdict.value}"


def test_replayed_frames_are_refused_and_fresh_ones_still_taken(link, wire):
    vehicle = Vehicle()
    recorded = [vehicle.frame() for _ in range(20)]
    assert len(arrive(link, wire, *recorded)) == 20
    assert b"".join(datagram.data for datagram in arrive(link, wire, *recorded)) == b""
    assert link.refused == {(Verdict.REPLAYED, (1, 1)): 20}
    assert len(arrive(link, wire, vehicle.frame())) == 1


def test_a_flood_of_invented_senders_is_told_in_few_words_and_little_memory(link, wire, caplog):
    for system in range(1, 256):
        arrive(link, wire, *(Vehicle(None, (system, component)).frame() for component in range(1, 9)))
    assert sum(link.refused.values()) == 255 * 8
    assert len(link.refused) <= 51
    assert len(caplog.records) <= 51


def test_an_unsigned_radio_status_passes_from_a_radio_only(link, wire):
    status = mavlink.MAVLink_radio_status_message(100, 90, 100, 20, 25, 0, 0)
    radio, vehicle = Vehicle(None, (51, 68)), Vehicle(None)
    (datagram,) = arrive(link, wire, radio.frame(status))
    assert datagram.data[7] == mavlink.MAVLINK_MSG_ID_RADIO_STATUS
    (refused,) = arrive(link, wire, vehicle.frame(status))
    assert refused.data == b""
    (forged,) = arrive(link, wire, Vehicle(bytes(32 * [7]), (51, 68)).frame(status))
    assert forged.data == b""


def test_damaged_frames_are_nobodys_fault(link, wire, caplog):
    frame = bytearray(Vehicle().frame())
    frame[12] ^= 1
    assert arrive(link, wire, bytes(frame), b"noise", b"\xfd", b"\xfd\xff\x01") == []
    assert link.refused == {}
    assert caplog.records == []


def test_messages_that_nobody_knows_do_not_pass(link, wire):
    frame = bytearray(Vehicle().frame())
    frame[7:10] = (12_345_678).to_bytes(3, "little")
    assert arrive(link, wire, bytes(frame)) == []
    unsigned = bytearray(Vehicle(None).frame())
    unsigned[7:10] = (12_345_678).to_bytes(3, "little")
    assert arrive(link, wire, bytes(unsigned)) == []


def test_a_stream_is_put_together_wherever_it_is_cut():
    wire, plain = Wire(keeps_frames_whole=False), Vehicle(None)
    link, vehicle = signed(wire), Vehicle()
    stream = b"noise" + b"".join(vehicle.frame() for _ in range(5))
    received = [arrive(link, wire, stream[at : at + 7]) for at in range(0, len(stream), 7)]
    assert link.keeps_frames_whole
    together = b"".join(datagram.data for datagrams in received for datagram in datagrams)
    assert together == b"".join(plain.frame() for _ in range(5))


def test_an_endless_stream_of_rubbish_is_not_kept():
    wire = Wire(keeps_frames_whole=False)
    link = signed(wire)
    for number in range(300):
        arrive(link, wire, bytes((number * k) % 256 for k in range(1000)))
        assert len(link._buffer) < 300


def test_a_strangers_genuine_frames_do_not_make_the_vehicles_look_old(link, wire):
    vehicle = Vehicle()
    copied = vehicle.frame()
    assert len(arrive(link, wire, copied, source="elsewhere", stranger=True)) == 1
    assert len(arrive(link, wire, copied)) == 1
    assert link.refused == {}


@pytest.mark.parametrize("silent_us", [0, 4_000_000])
def test_recorded_frames_from_elsewhere_are_no_second_vehicle_and_take_no_link(link, wire, silent_us):
    """They forbade engaging, and after 3 s of silence the link followed them."""
    reception = reception_on(link)
    recorded = [Vehicle().frame() for _ in range(3)]
    for datagram in arrive(link, wire, *recorded):
        reception.read(datagram)
    for frame in recorded:
        for datagram in arrive(link, wire, frame, source="elsewhere", stranger=True):
            assert reception.read(replace(datagram, time_us=NOW_US + silent_us)) == []
    assert wire.locked == "vehicle"
    noticed = [(notice.text, notice.consequence) for notice in reception.take_notices()]
    assert noticed == [(f"refusing 1/1: {Verdict.REPLAYED.value}", "said")]


def test_recorded_frames_of_ours_are_no_second_daemon(link, wire):
    """They forbade engaging."""
    rivals = RivalWatch(Route())
    reception = reception_on(link, rivals)
    own = Component(Route())
    for number in range(300):
        frame = own.pack(mavlink.MAVLink_statustext_message(6, f"{number}".encode(), 0, 0))
        rivals.note_sent([frame])
        link.send(frame)
    for frame in wire.sent:
        for datagram in arrive(link, wire, frame):
            assert reception.read(datagram) == []
    noticed = [(notice.text, notice.consequence) for notice in reception.take_notices()]
    assert noticed == [(f"refusing 245/191: {Verdict.REPLAYED.value}", "said")]


def test_an_echo_of_what_we_send_is_not_worth_a_word(link, wire, caplog):
    own = Component(Route())
    for _ in range(3):
        link.send(own.pack(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3)))
        assert arrive(link, wire, wire.sent[-1]) == []
    assert link.refused == {} and caplog.records == []


def reception_on(link, rivals=None):
    return Reception(link, Route(), rivals or RivalWatch(Route()))


# ----------------------------------------------------------------------------- from files, and clocks


@pytest.fixture
def settings(tmp_path):
    key = tmp_path / "vehicle.key"
    key.write_text(SECRET.hex())
    key.chmod(0o600)
    return SigningSettings(key, timestamp_file=tmp_path / "timestamp")


def test_a_restarted_daemon_goes_on_where_it_was_even_if_the_clock_was_set_back(wire, settings, caplog):
    message = bytes(
        mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 3, 3).pack(mavlink.MAVLink(None, 245, 191))
    )
    vehicle = Vehicle()
    first = sign_link(wire, settings, lambda: NOW_US)
    first.send(message)
    assert vehicle.codec.decode(bytearray(wire.sent[-1])).get_signed()
    first.close()
    assert caplog.records == []
    again = sign_link(wire, settings, lambda: NOW_US - 3_600_000_000)
    again.send(message)
    assert vehicle.codec.decode(bytearray(wire.sent[-1])).get_signed()
    assert "clock is 60 minutes behind the last flight" in caplog.text
    assert wire.closed == 1


def test_a_killed_daemon_left_its_start_behind(wire, settings):
    sign_link(wire, settings, lambda: NOW_US)
    assert int(settings.timestamp_file.read_text()) == timestamp_at(NOW_US)


@pytest.mark.parametrize("content", ["yesterday", "-5", "1" * 40, "\u0661", str((1 << 48) - 1)])
def test_a_timestamp_file_that_holds_none_is_an_error(wire, settings, content):
    settings.timestamp_file.write_text(content)
    with pytest.raises(UserError, match=r"holds no timestamp; remove it"):
        sign_link(wire, settings, lambda: NOW_US)


def test_a_timestamp_file_that_cannot_be_written_is_an_error(wire, settings, tmp_path):
    nowhere = SigningSettings(settings.key_file, timestamp_file=tmp_path / "none" / "timestamp")
    with pytest.raises(UserError, match=r"cannot be written: no such file|cannot be written: No such file"):
        sign_link(wire, nowhere, lambda: NOW_US)


def test_a_clock_that_was_never_set_is_said(wire, settings, caplog):
    sign_link(wire, settings, lambda: 60_000_000)
    assert "clock is not set" in caplog.text
    assert clock_problem(NOW_US, timestamp_at(NOW_US)) is None


def test_a_vehicle_whose_clock_is_ahead_is_taken_and_said_once(link, wire, caplog):
    ahead = Vehicle(now_us=NOW_US + 5 * 3_600_000_000)
    assert len(arrive(link, wire, ahead.frame(), ahead.frame())) == 2
    assert [record.getMessage() for record in caplog.records] == [
        "signing: the clock of 1/1 is 5 hours ahead of this computer's; one of them is wrong"
    ]
