"""Frames made and read without pymavlink's parser are pymavlink's frames, for every type of message."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard import frame_codec

BYTE = st.integers(0, 255)
KINDS = sorted(mavlink.mavlink_map.values(), key=lambda kind: kind.id)


def frame_of(kind, payload, sequence=0, system=1, component=1, compatibility=0):
    """A frame by the rules of the protocol, with pymavlink's checksum."""
    low, high = kind.id & 0xFFFF, kind.id >> 16
    head = struct.pack("<7BHB", 0xFD, len(payload), 0, compatibility, sequence, system, component, low, high)
    checksum = mavlink.x25crc(head[1:] + payload + bytes([kind.crc_extra])).crc
    return head + payload + struct.pack("<H", checksum)


def content(message):
    """Everything that can be known of a message."""
    fields = {name: repr(getattr(message, name)) for name in message.get_fieldnames()}
    raw = {name: value for name, value in vars(message).items() if name.endswith("_raw")}
    frame = bytes(message.get_msgbuf()), bytes(message.get_payload() or b""), message.get_crc()
    link = message.get_link_id(), message.get_signed()
    return type(message), message.get_type(), fields, raw, frame, link, vars(message.get_header())


@st.composite
def frames(draw):
    """A frame of any type: cut short as zeros at the end are, or longer, as of a newer dialect."""
    kind = draw(st.sampled_from(KINDS))
    whole = st.binary(min_size=kind.unpacker.size, max_size=kind.unpacker.size)
    payload = draw(st.one_of(whole, st.binary(max_size=255)))
    return frame_of(kind, payload, *(draw(BYTE) for _ in range(4)))


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.msgname)
def test_each_type_of_message_is_read_and_packed_as_pymavlink_does(kind):
    payload = bytes((7 * k + kind.id) % 100 + 1 for k in range(kind.unpacker.size))
    frame = frame_of(kind, payload, 5, 1, 2)
    message = frame_codec.unpack(frame)
    assert content(message) == content(mavlink.MAVLink(None).decode(bytearray(frame)))
    packer = mavlink.MAVLink(None, 245, 191)
    packer.seq = 255
    assert frame_codec.pack(message, 245, 191, 255) == bytes(message.pack(packer))


@given(frame=frames())
def test_every_undamaged_frame_is_read_as_pymavlink_reads_it(frame):
    assert content(frame_codec.unpack(frame)) == content(mavlink.MAVLink(None).decode(bytearray(frame)))


@given(frame=frames(), sequence=BYTE)
def test_every_message_is_packed_as_pymavlink_packs_it(frame, sequence):
    message = mavlink.MAVLink(None).decode(bytearray(frame))
    packer = mavlink.MAVLink(None, 245, 191)
    packer.seq = sequence
    assert frame_codec.pack(message, 245, 191, sequence) == bytes(message.pack(packer))


@given(frame=frames(), place=st.integers(0, 10_000), bits=st.integers(1, 255))
def test_a_damaged_frame_is_left_to_pymavlink(frame, place, bits):
    damaged = bytearray(frame)
    damaged[place % len(frame)] ^= bits
    message = frame_codec.unpack(bytes(damaged))
    # A message id that is another one may have a checksum that begins otherwise and fits by chance.
    assert message is None or content(message) == content(mavlink.MAVLink(None).decode(bytearray(damaged)))


@given(data=st.binary(max_size=40))
def test_no_bytes_however_wild_are_taken_for_a_frame_or_stop_it(data):
    assert frame_codec.unpack(data) is None
    assert frame_codec.unpack(b"\xfd" + data) is None


def test_a_signed_frame_is_left_to_pymavlink():
    packer = mavlink.MAVLink(None, 1, 1)
    packer.signing.secret_key, packer.signing.sign_outgoing = bytes(32), True
    frame = bytes(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(packer))
    assert frame_codec.unpack(frame) is None
    assert frame_codec.decode(frame).get_type() == "ATTITUDE"


def test_frames_of_mavlink_1_and_of_unknown_types_are_left_to_pymavlink():
    old = mavlink.MAVLink_attitude_message(9, 0, 0, 0, 0, 0, 0)
    frame = bytes(old.pack(mavlink.MAVLink(None, 1, 1), force_mavlink1=True))
    assert frame_codec.unpack(frame) is None
    assert frame_codec.decode(frame).time_boot_ms == 9
    unknown = struct.pack("<7BHB", 0xFD, 1, 0, 0, 0, 1, 1, 0xFFFF, 0) + b"\1\2\3"
    assert frame_codec.unpack(unknown) is None
    assert frame_codec.decode(unknown).get_type().startswith("UNKNOWN")


def test_decoding_a_damaged_frame_is_an_error():
    frame = bytearray(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(mavlink.MAVLink(None, 1, 1)))
    frame[-1] ^= 1
    with pytest.raises(mavlink.MAVError):
        frame_codec.decode(bytes(frame))


def test_a_value_that_its_field_cannot_hold_is_an_error():
    with pytest.raises(struct.error):
        frame_codec.pack(mavlink.MAVLink_attitude_message(-1, 0, 0, 0, 0, 0, 0), 1, 1, 0)


def test_a_message_without_pymavlink_s_object_is_the_same_frame():
    data = [0.5 * k for k in range(58)]
    array = mavlink.MAVLink_debug_float_array_message(5, b"name", 7, data)
    value = mavlink.MAVLink_named_value_float_message(6, b"value", 0.25)
    packed_data = struct.pack("<58f", *data)
    for message, values in (
        (array, (5, 7, b"name", *data)),
        (array, (5, 7, b"name", packed_data)),
        (value, (6, 0.25, b"value")),
    ):
        outgoing = frame_codec.Outgoing(type(message), values)
        assert frame_codec.pack(outgoing, 245, 191, 9) == frame_codec.pack(message, 245, 191, 9)


@pytest.mark.parametrize("data", [b"", bytes(4 * 57), bytes(4 * 58 + 1)])
def test_an_array_whose_bytes_are_too_few_or_too_many_is_an_error(data):
    kind = mavlink.MAVLink_debug_float_array_message
    with pytest.raises(struct.error):
        frame_codec.pack(frame_codec.Outgoing(kind, (5, 7, b"name", data)), 245, 191, 9)


def test_an_empty_text_behind_an_array_is_packed():
    """It is no array, which may be given as bytes."""
    message = mavlink.MAVLink_open_drone_id_self_id_message(1, 2, list(range(20)), 3, b"")
    frame = bytes(message.pack(mavlink.MAVLink(None, 245, 191)))
    assert frame_codec.pack(message, 245, 191, 0) == frame


def test_frames_of_one_sender_are_numbered_and_begin_again_after_255():
    packer = frame_codec.Packer(245, 191)
    message = mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0)
    assert [packer.pack(message)[4] for _ in range(258)] == [*range(256), 0, 1]
