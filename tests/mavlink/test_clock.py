"""Comparing clocks: offset and round trip from TIMESYNC."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.clock import ClockEstimate, take_answer, timesync_request

BOOTED_US = 1_700_000_000_000_000  # our clock when the autopilot's began


def answered(estimate, sent_us, out_us, back_us, booted_us=BOOTED_US):
    """The estimate after a question that took `out_us` there and `back_us` back."""
    request = timesync_request(sent_us)
    answer = mavlink.MAVLink_timesync_message((sent_us + out_us - booted_us) * 1000, request.ts1)
    return take_answer(estimate, sent_us + out_us + back_us, answer)


def test_before_the_first_answer_nothing_is_known():
    assert ClockEstimate().measured is None


def test_a_request_asks():
    assert timesync_request(5).tc1 == 0


@given(st.integers(0, 300_000), st.integers(0, 300_000))
def test_the_offset_is_off_by_half_the_difference_of_the_ways_at_most(out_us, back_us):
    measured = answered(ClockEstimate(), BOOTED_US + 10**7, out_us, back_us).measured
    assert measured.round_trip_s == pytest.approx((out_us + back_us) * 1e-6)
    assert abs(measured.clock_offset_us + BOOTED_US) <= abs(out_us - back_us) / 2 + 1


def test_the_quickest_of_the_last_answers_tells_the_offset():
    estimate = ClockEstimate()
    for k, late_us in enumerate([40_000, 2_000, 60_000, 30_000]):
        estimate = answered(estimate, BOOTED_US + (k + 1) * 500_000, 5_000, 5_000 + late_us)
    assert estimate.measured.clock_offset_us == pytest.approx(-BOOTED_US, abs=1_001)
    assert estimate.measured.round_trip_s == pytest.approx(0.040)  # of the last three
    for k in range(10):
        estimate = answered(estimate, BOOTED_US + (k + 10) * 500_000, 8_000, 8_000)
    assert estimate.measured.round_trip_s == pytest.approx(0.016)


def test_answers_to_others_late_ones_and_requests_do_not_count():
    sent_us = BOOTED_US + 10**7
    ours = timesync_request(sent_us).ts1
    for tc1, ts1, received_us in (
        (10**10, ours + 1, sent_us + 5_000),
        (10**10, sent_us * 1000, sent_us + 5_000),
        (10**10, ours, sent_us + 1_000_001),
        (10**10, ours, sent_us - 1),
        (0, ours, sent_us + 5_000),
        (-5, ours, sent_us + 5_000),
    ):
        message = mavlink.MAVLink_timesync_message(tc1, ts1)
        assert take_answer(ClockEstimate(), received_us, message) == ClockEstimate()


def test_a_restarted_autopilot_begins_a_new_comparison():
    estimate = ClockEstimate()
    for k in range(5):
        estimate = answered(estimate, BOOTED_US + (k + 1) * 500_000, 5_000, 5_000)
    restarted_us = BOOTED_US + 3_000_000
    estimate = answered(estimate, restarted_us + 500_000, 20_000, 20_000, restarted_us)
    assert estimate.measured.clock_offset_us == -restarted_us
    assert estimate.measured.round_trip_s == pytest.approx(0.04)
