"""What messages of a vehicle become: events in the paper's axes."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.frames import quaternion_from_euler
from kffa_offboard.mavlink.telemetry import BootClock
from kffa_offboard.offboard.events import (
    AttitudeReceived,
    EstimateReported,
    LandedStateReported,
    PositionReceived,
    StatusReceived,
    TargetReported,
    ThrottleReported,
)


def attitude_target(mask=0, q=(1.0, 0.0, 0.0, 0.0), rates=(0.1, 0.2, 0.3), thrust=0.4):
    return mavlink.MAVLink_attitude_target_message(1000, mask, q, *rates, thrust)


def test_nose_up_right_side_down_turning_right_decodes_with_the_papers_signs(autopilot, telemetry):
    message = autopilot.over_the_wire(
        autopilot.attitude(1234, roll=0.1, pitch=0.2, yaw=0.3, p=0.4, q=0.5, r=0.6)
    )
    (event,) = telemetry.decode(message)
    assert isinstance(event, AttitudeReceived)
    assert event.sample_time_us == 1_234_000
    assert event.attitude == pytest.approx((0.1, -0.2, -0.3))
    assert event.body_rates == pytest.approx((0.4, -0.5, -0.6))


def test_flying_5_m_up_north_east_and_climbing_decodes_with_height_and_climb_positive(autopilot, telemetry):
    position = mavlink.MAVLink_local_position_ned_message(20, 1.0, 2.0, -5.0, 0.1, 0.2, -0.5)
    (event,) = telemetry.decode(autopilot.over_the_wire(position))
    assert isinstance(event, PositionReceived)
    assert event.position == pytest.approx((1.0, -2.0, 5.0))
    assert event.velocity == pytest.approx((0.1, -0.2, 0.5))


def test_an_attitude_target_nose_up_decodes_as_negative_pitch(autopilot, telemetry):
    q = quaternion_from_euler((0.0, 0.2, 0.0))
    (event,) = telemetry.decode(autopilot.over_the_wire(attitude_target(q=q)))
    assert isinstance(event, TargetReported)
    assert event.attitude == pytest.approx((0.0, -0.2, 0.0), abs=1e-6)
    assert event.body_rates == pytest.approx((0.1, -0.2, -0.3))
    assert event.thrust == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("flags", "attitude", "height", "position"),
    [
        (0x033F, True, True, True),  # PX4 in flight; without satellites, and 4 s later:
        (0x003F, True, True, True),
        (0x0025, True, True, False),
        (0x03BF, True, True, True),  # PX4 at rest on the ground
        (0x00A7, True, True, False),  # ArduCopter without satellites: a constant position
        (0x002F, True, True, True),  # a place relative to the start, by a camera
        (0x033B, True, False, True),
        (0x031F, True, False, True),
        (0x035F, True, True, True),  # the height above the ground is one
        (0x033E, False, True, True),
        (0x0400, False, False, False),  # EKF_UNINITIALIZED
    ],
)
def test_what_the_autopilot_says_of_its_estimate_decodes(
    autopilot, telemetry, flags, attitude, height, position
):
    expected = [EstimateReported(attitude, height, position)]
    px4 = mavlink.MAVLink_estimator_status_message(0, flags, *[0.0] * 8)
    assert telemetry.decode(autopilot.over_the_wire(px4)) == expected
    ardupilot = mavlink.MAVLink_ekf_status_report_message(flags, *[0.0] * 5)
    assert telemetry.decode(autopilot.over_the_wire(ardupilot)) == expected


@pytest.mark.parametrize(
    ("mask", "missing"),
    [(128, {"attitude"}), (7, {"body_rates"}), (1, {"body_rates"}), (64, {"thrust"}), (0, set())],
)
def test_what_the_type_mask_ignores_is_not_reported(autopilot, telemetry, mask, missing):
    (event,) = telemetry.decode(autopilot.over_the_wire(attitude_target(mask)))
    assert {name for name in ("thrust", "body_rates", "attitude") if getattr(event, name) is None} == missing


def test_a_zero_quaternion_is_no_attitude(autopilot, telemetry):
    (event,) = telemetry.decode(autopilot.over_the_wire(attitude_target(q=(0.0, 0.0, 0.0, 0.0))))
    assert event.attitude is None
    assert event.thrust is not None


def test_nan_is_passed_on_for_the_service_to_judge(autopilot, telemetry):
    (event,) = telemetry.decode(autopilot.over_the_wire(autopilot.attitude(5, roll=math.nan)))
    assert math.isnan(event.attitude[0])
    (target,) = telemetry.decode(autopilot.over_the_wire(attitude_target(q=(math.nan,) * 4)))
    assert all(math.isnan(angle) for angle in target.attitude)


def test_duplicates_and_late_samples_are_passed_on_with_their_own_time(autopilot, telemetry):
    times = [1000, 1010, 1010, 990, 1020]
    events = [telemetry.decode(autopilot.over_the_wire(autopilot.attitude(t)))[0] for t in times]
    assert [event.sample_time_us for event in events] == [t * 1000 for t in times]


def test_time_runs_on_when_the_boot_clock_wraps_after_49_days():
    clock = BootClock()
    before, after = 2**32 - 5, 5
    assert clock.unwrap(before) == before * 1000
    assert clock.unwrap(after) == (2**32 + 5) * 1000
    assert clock.unwrap(2**32 - 3) == (2**32 - 3) * 1000  # a late sample stays before the wrap
    assert clock.unwrap(7) == (2**32 + 7) * 1000


def test_a_reboot_of_the_autopilot_shows_as_time_going_back():
    clock = BootClock()
    clock.unwrap(3_600_000)
    assert clock.unwrap(100) == 100_000


def test_throttle_is_a_fraction(autopilot, telemetry):
    hud = mavlink.MAVLink_vfr_hud_message(0.0, 0.0, 0, 40, 0.0, 0.0)
    assert telemetry.decode(autopilot.over_the_wire(hud)) == [ThrottleReported(0.4)]


@pytest.mark.parametrize(("landed", "on_ground"), [(1, True), (2, False), (3, False), (4, False)])
def test_only_on_ground_counts_as_on_ground(autopilot, telemetry, landed, on_ground):
    state = mavlink.MAVLink_extended_sys_state_message(0, landed)
    assert telemetry.decode(autopilot.over_the_wire(state)) == [LandedStateReported(on_ground)]


def test_an_unknown_landed_state_says_nothing(autopilot, telemetry):
    assert telemetry.decode(autopilot.over_the_wire(mavlink.MAVLink_extended_sys_state_message(0, 0))) == []


def chunk(text, text_id, number):
    return mavlink.MAVLink_statustext_message(4, text, text_id, number)


def texts(autopilot, telemetry, *messages):
    return [event for m in messages for event in telemetry.decode(autopilot.over_the_wire(m))]


def test_a_short_text_is_whole(autopilot, telemetry):
    assert texts(autopilot, telemetry, chunk(b"Gripper grabbed", 0, 0)) == [
        StatusReceived(4, "Gripper grabbed")
    ]


def test_chunks_of_a_long_text_are_joined(autopilot, telemetry):
    events = texts(autopilot, telemetry, chunk(b"a" * 50, 7, 0), chunk(b"b" * 50, 7, 1), chunk(b"c", 7, 2))
    assert events == [StatusReceived(4, "a" * 50 + "b" * 50 + "c")]


def test_a_text_of_exactly_50_characters_ends_with_an_empty_chunk(autopilot, telemetry):
    assert texts(autopilot, telemetry, chunk(b"a" * 50, 7, 0), chunk(b"", 7, 1)) == [
        StatusReceived(4, "a" * 50)
    ]


def test_chunks_in_the_wrong_order_are_put_right(autopilot, telemetry):
    events = texts(autopilot, telemetry, chunk(b"end", 7, 1), chunk(b"a" * 50, 7, 0))
    assert events == [StatusReceived(4, "a" * 50 + "end")]


def test_a_lost_chunk_shows_as_dots_when_the_next_text_begins(autopilot, telemetry):
    events = texts(autopilot, telemetry, chunk(b"a" * 50, 7, 0), chunk(b"end", 7, 2), chunk(b"next", 0, 0))
    assert events == [StatusReceived(4, "a" * 50 + "..." + "end"), StatusReceived(4, "next")]


def test_control_characters_do_not_reach_the_terminal(autopilot, telemetry):
    assert texts(autopilot, telemetry, chunk(b"\x1b[2Jboo", 0, 0)) == [StatusReceived(4, "?[2Jboo")]


def test_messages_that_do_not_concern_control_give_no_events(autopilot, telemetry):
    assert telemetry.decode(autopilot.over_the_wire(mavlink.MAVLink_system_time_message(0, 0))) == []
