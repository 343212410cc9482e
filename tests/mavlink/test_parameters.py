"""Parameters on the wire: how each firmware carries numbers, and requests over a link that loses messages."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.parameter_transfer import ATTEMPTS, INTERVAL_US, WINDOW, ParameterTransfer
from kffa_offboard.mavlink.parameters import decode_value, encode_value, encoding_of

INT32, REAL32, INT8 = mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32, mavlink.MAV_PARAM_TYPE_INT8
BYTEWISE = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE
C_CAST = mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST


def value_of(name, field, kind=REAL32):
    return mavlink.MAVLink_param_value_message(name.encode(), field, kind, 10, 65535)


# ------------------------------------------------------------------------- encoding


def test_px4_puts_the_bytes_of_an_integer_into_the_float_and_ardupilot_the_number():
    seven = struct.unpack("<f", struct.pack("<i", 7))[0]
    assert decode_value(seven, INT32, "bytewise") == 7.0
    assert encode_value(7.0, INT32, "bytewise") == seven
    assert decode_value(7.0, INT32, "c-cast") == 7.0
    assert encode_value(7.0, INT32, "c-cast") == 7.0
    assert decode_value(0.5, REAL32, "bytewise") == encode_value(0.5, REAL32, "bytewise") == 0.5


@given(st.integers(-(2**22), 2**31 - 2**24))
def test_an_integer_survives_the_wire_bytewise(number):
    message = value_of("X", encode_value(float(number), INT32, "bytewise"), INT32)
    packed = message.pack(mavlink.MAVLink(None))
    (received,) = mavlink.MAVLink(None).parse_buffer(packed)
    assert decode_value(received.param_value, received.param_type, "bytewise") == number


def test_the_capability_bits_decide_and_without_them_the_firmwares_custom():
    assert encoding_of("px4", None) == encoding_of("ardupilot", BYTEWISE) == "bytewise"
    assert encoding_of("ardupilot", None) == encoding_of("px4", C_CAST) == "c-cast"
    assert encoding_of("ardupilot", mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT) == "c-cast"


@pytest.mark.parametrize(("value", "kind"), [(float("nan"), REAL32), (0.5, INT32), (300.0, INT8)])
def test_a_value_that_a_parameter_cannot_have_is_never_sent(value, kind):
    for encoding in ("bytewise", "c-cast"):
        with pytest.raises(ValueError, match=r"finite|whole|fit"):
            encode_value(value, kind, encoding)


# ------------------------------------------------------------------------- transfer


@pytest.fixture
def transfer(route):
    return ParameterTransfer(route, "c-cast")


def test_parameters_are_asked_for_by_name_not_as_a_list(transfer):
    transfer.read(["GUID_OPTIONS"])
    (request,) = transfer.run(0)
    assert request.get_type() == "PARAM_REQUEST_READ"
    assert (request.param_id, request.param_index) == ("GUID_OPTIONS", -1)
    assert (request.target_system, request.target_component) == (1, 1)


def test_an_unanswered_request_is_repeated_at_its_deadline_and_then_given_up(transfer):
    transfer.read(["NO_SUCH"])
    sent_at, time_us = [], 0
    while (due := transfer.due_us()) is not None:
        time_us = due
        sent_at += [due for _ in transfer.run(due)]
    assert sent_at == [k * INTERVAL_US for k in range(ATTEMPTS)]
    assert time_us == ATTEMPTS * INTERVAL_US
    assert not transfer.busy
    assert transfer.unanswered == {"NO_SUCH"}


def test_nothing_is_sent_before_the_deadline(transfer):
    transfer.read(["A"])
    transfer.run(0)
    assert transfer.run(INTERVAL_US - 1) == []


def test_only_a_few_requests_are_under_way_at_once(transfer):
    names = [f"P{k}" for k in range(20)]
    transfer.read(names)
    assert len(transfer.run(0)) == WINDOW
    transfer.receive(value_of("P3", 1.0))
    assert [request.param_id for request in transfer.run(0)] == [f"P{WINDOW}"]


def test_a_set_parameter_counts_when_the_vehicle_reports_the_value(transfer):
    transfer.receive(value_of("X", 0.0, INT8))
    transfer.set({"X": 8.0})
    (request,) = transfer.run(0)
    assert (request.get_type(), request.param_value, request.param_type) == ("PARAM_SET", 8.0, INT8)
    transfer.receive(value_of("X", 0.0, INT8))  # the late answer to a read
    assert transfer.busy
    transfer.receive(value_of("X", 8.0, INT8))
    assert not transfer.busy
    assert transfer.unanswered == set()


def test_a_vehicle_that_keeps_the_old_value_has_not_obeyed(transfer):
    transfer.receive(value_of("X", 0.0))
    transfer.set({"X": 8.0})
    while (due := transfer.due_us()) is not None:
        transfer.run(due)
        transfer.receive(value_of("X", 0.0))
    assert transfer.unanswered == {"X"}


def test_an_unknown_name_that_the_vehicle_says_is_unknown_is_not_asked_again(transfer):
    transfer.read(["NO_SUCH"])
    transfer.run(0)
    transfer.receive(mavlink.MAVLink_param_error_message(245, 191, b"NO_SUCH", -1, 1))
    assert not transfer.busy
    assert transfer.unanswered == {"NO_SUCH"}


def test_px4_integers_are_understood_once_the_capabilities_are_known(transfer):
    transfer.receive(value_of("COM_OBL_RC_ACT", encode_value(7.0, INT32, "bytewise"), INT32))
    transfer.encoding = "bytewise"
    assert transfer.values() == {"COM_OBL_RC_ACT": 7.0}
