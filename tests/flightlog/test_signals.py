"""The controller's inner signals in the log and back."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import astuple, replace
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.flightlog.signals import (
    BLOCKS,
    LATEST_US,
    LIVE_ARRAY_ID,
    STATE_NAMES,
    from_message,
    is_signal_frame,
    is_signals,
    table,
    to_message,
)
from kffa_offboard.frame_codec import decode, pack
from kffa_offboard.offboard.events import Signals
from kffa_offboard.offboard.service import State

four = st.tuples(*[st.floats(width=32)] * 4)
signals_values = st.builds(
    Signals,
    time_us=st.integers(0, LATEST_US - 1),
    state=st.sampled_from(STATE_NAMES),
    dt=st.floats(0.0, 0.25, width=32),
    latency_s=st.floats(0.0, 10.0, width=32),
    saturated=st.tuples(*[st.booleans()] * 4),
    position_reference=st.none() | st.tuples(*[st.floats(width=32)] * 2),
    **{name: four for name in BLOCKS},
)
EXAMPLE = Signals(
    5, "engaged", **{name: tuple(10.0 * b + c for c in range(4)) for b, name in enumerate(BLOCKS)}
)


def over_the_wire(signals):
    return mavlink.MAVLink(None).parse_buffer(pack(to_message(signals), 245, 191, 0))[0]


@given(signals_values)
def test_every_signal_survives_the_log(signals):
    message = over_the_wire(signals)
    assert is_signals(message)
    back = from_message(message)
    for name, want, got in zip(Signals.__struct_fields__, astuple(signals), astuple(back), strict=True):
        if name in BLOCKS or (name == "position_reference" and want is not None):
            np.testing.assert_array_equal(got, want)  # NaN equals NaN here
        else:
            assert got == want


def test_the_layout_in_the_log_is_the_documented_one():
    message = over_the_wire(replace(EXAMPLE, dt=0.5, saturated=(False, True, False, True), latency_s=0.125))
    assert message.name == "kffa"
    assert message.array_id == 0
    assert message.data[:36] == [10.0 * block + channel for block in range(9) for channel in range(4)]
    assert message.data[36:42] == [3.0, 0.5, 0.0, 1.0, 0.0, 1.0]
    assert message.data[57] == 0.125


def test_a_latency_that_is_not_known_is_no_number_in_the_log():
    assert math.isnan(from_message(over_the_wire(EXAMPLE)).latency_s)


def test_signals_that_went_out_live_are_not_taken_for_the_logs_own():
    assert not is_signals(decode(pack(to_message(EXAMPLE, LIVE_ARRAY_ID), 245, 191, 0)))


def test_a_value_beyond_float32_is_logged_as_infinite_instead_of_stopping_the_flight():
    assert from_message(over_the_wire(replace(EXAMPLE, estimate=(1e300, 0, 0, 0)))).estimate[0] == math.inf


def test_every_state_of_the_service_has_a_number():
    assert set(STATE_NAMES) == {state.value for state in State}


def test_a_state_without_a_number_is_refused():
    with pytest.raises(ValueError, match="'flying' is none of waiting, ready"):
        to_message(replace(EXAMPLE, state="flying"))


def test_a_block_without_four_values_is_refused():
    with pytest.raises(ValueError, match=r"signals\.command has 3 values; 4 channels"):
        to_message(replace(EXAMPLE, command=(0.0, 0.0, 0.0)))


def test_other_debug_arrays_are_not_taken_for_signals():
    other = mavlink.MAVLink_debug_float_array_message(0, b"other", 0, [0.0] * 58)
    packed = bytes(other.pack(mavlink.MAVLink(None, srcSystem=1, srcComponent=1)))
    assert not is_signals(mavlink.MAVLink(None).parse_buffer(packed)[0])


def test_a_table_has_one_row_for_each_step_and_one_column_for_each_channel():
    steps = [replace(EXAMPLE, time_us=1_000_000 + 10_000 * n, dt=0.25, state="failsafe") for n in range(3)]
    rows = table(over_the_wire(step) for step in steps)
    for block, name in enumerate(BLOCKS):
        assert getattr(rows, name).shape == (3, 4)
        assert getattr(rows, name)[2].tolist() == [10.0 * block + channel for channel in range(4)]
    assert rows.time_s == pytest.approx([0.0, 0.01, 0.02])
    assert [STATE_NAMES[index] for index in rows.state] == ["failsafe"] * 3
    assert rows.dt.tolist() == [0.25] * 3
    assert rows.saturated.dtype == bool


def test_a_log_without_signals_gives_empty_arrays():
    rows = table([])
    assert rows.time_s.shape == (0,)
    assert rows.disturbance.shape == (0, 4)


@given(signals_values, st.integers(0, 300), st.integers(0, 255), st.sampled_from([0, 1]))
def test_a_frame_of_the_log_is_known_without_decoding_it_and_a_damaged_one_is_not(
    signals, at, bits, array_id
):
    frame = bytearray(pack(to_message(signals, array_id), 245, 191, 0))
    assert is_signal_frame(bytes(frame)) == is_signals(decode(bytes(frame))) == (array_id == 0)
    frame[at % len(frame)] ^= bits
    assert is_signal_frame(bytes(frame)) == (array_id == 0 and bits == 0)


def test_a_log_frame_with_a_state_that_there_is_not_is_no_signal():
    packer = mavlink.MAVLink(None, 245, 191)
    for data in ([0.0] * 36 + [7.0] + [0.0] * 21, [0.0] * 36 + [math.nan] + [0.0] * 21):
        frame = bytes(mavlink.MAVLink_debug_float_array_message(5, b"kffa", 0, data).pack(packer))
        assert not is_signal_frame(frame) and not is_signals(decode(frame))
    other = bytes(mavlink.MAVLink_debug_float_array_message(5, b"theirs", 0, [0.0] * 58).pack(packer))
    assert not is_signal_frame(other) and not is_signals(decode(other))
