"""PX4 and ArduPilot: modes, rates, answers, and what each is believed."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20.development import MAVLink_current_mode_message

from kffa_offboard.frame_codec import CURRENT_MODE
from kffa_offboard.mavlink.ardupilot import ArduPilot
from kffa_offboard.mavlink.autopilot import result_name
from kffa_offboard.mavlink.commands import EncodingError
from kffa_offboard.mavlink.px4 import Px4, custom_mode
from kffa_offboard.offboard.events import (
    AttitudeTarget,
    HeartbeatReceived,
    ModeKind,
    RequestMessageRates,
    SetArmed,
    SetMode,
)

ASKABLE = (ModeKind.OFFBOARD, ModeKind.HOLD, ModeKind.LAND)
PX4_ACRO = custom_mode(5)
PX4_HOLD = custom_mode(4, 3)
PX4_OFFBOARD = custom_mode(6)
RATES = AttitudeTarget(thrust=0.4, body_rates=(0.0, 0.0, 0.0))
ANGLES = AttitudeTarget(thrust=0.4, attitude=(0.0, 0.0, 0.0))


@pytest.fixture
def px4(route, telemetry):
    return Px4(route, telemetry)


@pytest.fixture
def ardupilot(route, telemetry):
    return ArduPilot(route, telemetry)


@pytest.mark.parametrize(
    ("number", "kind", "name"),
    [
        (6 << 16, ModeKind.OFFBOARD, "OFFBOARD"),
        (3 << 24 | 4 << 16, ModeKind.HOLD, "AUTO.LOITER"),
        (6 << 24 | 4 << 16, ModeKind.LAND, "AUTO.LAND"),
        (9 << 24 | 4 << 16, ModeKind.LAND, "AUTO.PRECLAND"),
        (5 << 24 | 4 << 16, ModeKind.OTHER, "AUTO.RTL"),
        (2 << 24 | 4 << 16, ModeKind.OTHER, "AUTO.TAKEOFF"),
        (1 << 16, ModeKind.OTHER, "MANUAL"),
        (2 << 16, ModeKind.OTHER, "ALTCTL"),
        (3 << 16, ModeKind.OTHER, "POSCTL"),
        (1 << 24 | 3 << 16, ModeKind.OTHER, "POSCTL.ORBIT"),
        (7 << 16, ModeKind.OTHER, "STABILIZED"),
        (99 << 16, ModeKind.OTHER, "mode 99.0"),
    ],
)
def test_px4_mode_numbers_are_understood(px4, number, kind, name):
    assert px4.mode_of(number) == (kind, name)


@pytest.mark.parametrize(
    ("number", "kind", "name"),
    [
        (4, ModeKind.OFFBOARD, "GUIDED"),
        (20, ModeKind.OFFBOARD, "GUIDED_NOGPS"),
        (17, ModeKind.HOLD, "BRAKE"),
        (9, ModeKind.LAND, "LAND"),
        (0, ModeKind.OTHER, "STABILIZE"),
        (5, ModeKind.OTHER, "LOITER"),
        (6, ModeKind.OTHER, "RTL"),
        (16, ModeKind.OTHER, "POSHOLD"),
        (99, ModeKind.OTHER, "mode 99"),
    ],
)
def test_arducopter_mode_numbers_are_understood(ardupilot, number, kind, name):
    assert ardupilot.mode_of(number) == (kind, name)


@pytest.mark.parametrize("kind", ASKABLE)
def test_a_mode_that_was_asked_for_is_recognised_when_it_comes(px4, ardupilot, kind):
    (command,) = px4.encode(SetMode(kind), 0)
    assert (command.command, command.param1) == (mavlink.MAV_CMD_DO_SET_MODE, 1)
    assert px4.mode_of(custom_mode(int(command.param2), int(command.param3)))[0] is kind
    (command,) = ardupilot.encode(SetMode(kind), 0)
    assert (command.command, command.param1) == (mavlink.MAV_CMD_DO_SET_MODE, 1)
    assert ardupilot.mode_of(int(command.param2))[0] is kind


def test_offboard_is_px4_main_mode_6_and_arducopter_guided(px4, ardupilot):
    assert [(c.param2, c.param3) for c in px4.encode(SetMode(ModeKind.OFFBOARD), 0)] == [(6, 0)]
    assert [c.param2 for c in ardupilot.encode(SetMode(ModeKind.OFFBOARD), 0)] == [4]


def test_nobody_can_ask_for_some_other_mode(px4, ardupilot):
    for firmware in (px4, ardupilot):
        with pytest.raises(EncodingError, match="other"):
            firmware.encode(SetMode(ModeKind.OTHER), 0)


def test_a_heartbeat_tells_mode_and_arming(px4, autopilot):
    message = autopilot.over_the_wire(autopilot.heartbeat(custom_mode=PX4_OFFBOARD, armed=True))
    assert px4.decode(message) == [
        HeartbeatReceived("px4", ModeKind.OFFBOARD, "OFFBOARD", PX4_OFFBOARD, True)
    ]


def test_px4_tells_of_a_mode_before_its_next_heartbeat(px4, autopilot):
    """HEARTBEAT comes once a second, CURRENT_MODE as often as is asked for."""
    hold = autopilot.over_the_wire(MAVLink_current_mode_message(0, PX4_HOLD, PX4_HOLD))
    assert px4.decode(hold) == [], "whether it is armed is not known yet"
    offboard = autopilot.heartbeat(custom_mode=PX4_OFFBOARD, armed=True)
    px4.decode(autopilot.over_the_wire(offboard))
    expected = HeartbeatReceived("px4", ModeKind.HOLD, "AUTO.LOITER", PX4_HOLD, True)
    assert px4.decode(hold) == [expected]
    assert px4.decode(hold) == [], "nothing new"
    again = autopilot.over_the_wire(MAVLink_current_mode_message(0, PX4_OFFBOARD, PX4_OFFBOARD))
    assert [event.mode for event in px4.decode(again)] == [ModeKind.OFFBOARD]


def test_arducopter_s_modes_come_with_heartbeats_alone(ardupilot, autopilot):
    ardupilot.decode(autopilot.over_the_wire(autopilot.heartbeat(custom_mode=4, armed=True)))
    assert ardupilot.decode(autopilot.over_the_wire(MAVLink_current_mode_message(0, 5, 5))) == []


# ------------------------------------------------------------------------ rates


def intervals(firmware, hz):
    messages = firmware.encode(RequestMessageRates(hz, hz, hz, 2.0), 0)
    assert all(m.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL for m in messages)
    return {int(m.param1): int(m.param2) for m in messages}


def test_everything_that_the_service_needs_is_asked_for(px4, ardupilot):
    needed = {
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_VFR_HUD,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
    }
    own = {
        px4: {CURRENT_MODE, mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS},
        ardupilot: {mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT},
    }
    for firmware in (px4, ardupilot):
        asked = intervals(firmware, 100.0)
        assert asked.keys() == needed | own[firmware]
        assert asked[mavlink.MAVLINK_MSG_ID_ATTITUDE] == 10_000
        assert asked[mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE] == 500_000


@pytest.mark.parametrize(("hz", "px4_us", "ardupilot_us"), [(30, 33_333, 33_000), (150, 6_667, 6_000)])
def test_ardupilot_intervals_are_whole_milliseconds_and_not_slower_than_asked(
    px4, ardupilot, hz, px4_us, ardupilot_us
):
    assert intervals(px4, hz)[mavlink.MAVLINK_MSG_ID_ATTITUDE] == px4_us
    assert intervals(ardupilot, hz)[mavlink.MAVLINK_MSG_ID_ATTITUDE] == ardupilot_us


def test_a_whole_millisecond_rate_is_not_lost_to_rounding(ardupilot):
    for interval_ms in range(3, 2001):
        assert ardupilot.interval_us(1000.0 / interval_ms) == 1000 * interval_ms


def test_ardupilot_is_never_asked_for_a_rate_that_it_denies(ardupilot, caplog):
    assert ardupilot.interval_us(500.0) == 3000
    assert "333 Hz" in caplog.text


@pytest.mark.parametrize("hz", [0.0, -1.0, float("nan"), float("inf"), 2000.0])
def test_an_impossible_rate_is_refused(px4, hz):
    with pytest.raises(EncodingError, match="message rate"):
        px4.encode(RequestMessageRates(hz, 50.0, 50.0, 2.0), 0)


def test_the_mode_is_asked_for_five_times_a_second_px4_has_a_message_of_its_own(px4, ardupilot):
    assert intervals(ardupilot, 100.0)[mavlink.MAVLINK_MSG_ID_HEARTBEAT] == 200_000
    asked = intervals(px4, 100.0)
    assert asked[CURRENT_MODE] == 200_000
    assert mavlink.MAVLINK_MSG_ID_HEARTBEAT not in asked  # PX4 answers FAILED to that


# ------------------------------------------------------------- rates that are refused


def refuse(firmware, autopilot, result, accepted_before=0):
    """Answer the requests in their order, the one after `accepted_before` with `result`."""
    command = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    events = []
    for answer in [0] * accepted_before + [result]:
        events += firmware.decode(autopilot.over_the_wire(acknowledged(command, answer)))
    return [event for event in events if not event.accepted]


def test_ardupilot_with_a_slow_loop_is_asked_for_what_it_can_send(ardupilot, autopilot):
    ardupilot.decode(autopilot.over_the_wire(parameter(b"SCHED_LOOP_RATE", 100.0)))
    assert ardupilot.interval_us(100.0) == 12_000
    ardupilot.decode(autopilot.over_the_wire(parameter(b"SCHED_LOOP_RATE", 50.0)))
    assert ardupilot.interval_us(100.0) == 25_000


@pytest.mark.parametrize("nonsense", [0.0, -400.0, float("nan")])
def test_a_loop_rate_that_cannot_be_is_not_taken(ardupilot, autopilot, nonsense):
    ardupilot.decode(autopilot.over_the_wire(parameter(b"SCHED_LOOP_RATE", nonsense)))
    assert ardupilot.interval_us(100.0) == 10_000


def test_a_denied_attitude_rate_is_asked_for_again_one_millisecond_slower(ardupilot, autopilot):
    intervals(ardupilot, 100.0)
    assert refuse(ardupilot, autopilot, mavlink.MAV_RESULT_DENIED) == []
    (again,) = ardupilot.requests()
    assert (again.param1, again.param2) == (mavlink.MAVLINK_MSG_ID_ATTITUDE, 11_000)
    assert ardupilot.requests() == []


def test_a_rate_that_is_denied_however_slow_is_told_to_the_service(ardupilot, autopilot):
    ardupilot.encode(RequestMessageRates(100.0, 100.0, 20.0, 5.0), 0)
    refuse(ardupilot, autopilot, mavlink.MAV_RESULT_DENIED)
    refuse(ardupilot, autopilot, 0, accepted_before=5)  # all the others
    slowest, told = 0, []
    while not told:
        (again,) = ardupilot.requests()
        slowest = again.param2
        told = refuse(ardupilot, autopilot, mavlink.MAV_RESULT_DENIED)
    assert slowest == 20_000
    assert [event.result_name for event in told] == ["denied"]


def test_a_message_that_an_old_firmware_does_not_have_is_not_asked_for_again(ardupilot, px4, autopilot):
    for firmware, result in ((ardupilot, mavlink.MAV_RESULT_DENIED), (px4, mavlink.MAV_RESULT_FAILED)):
        intervals(firmware, 50.0)
        assert refuse(firmware, autopilot, result, accepted_before=2) == []
        assert firmware.requests() == []
        assert mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET not in intervals(firmware, 50.0)
        assert mavlink.MAVLINK_MSG_ID_ATTITUDE in intervals(firmware, 50.0)


def test_ardupilot_without_message_intervals_is_asked_for_groups_of_messages(ardupilot, autopilot):
    ardupilot.encode(RequestMessageRates(100.0, 50.0, 20.0, 5.0), 0)
    assert refuse(ardupilot, autopilot, mavlink.MAV_RESULT_UNSUPPORTED) == []
    asked = {(m.req_stream_id, m.req_message_rate) for m in ardupilot.requests()}
    assert asked == {
        (mavlink.MAV_DATA_STREAM_EXTRA1, 100),
        (mavlink.MAV_DATA_STREAM_POSITION, 50),
        (mavlink.MAV_DATA_STREAM_EXTRA2, 5),
        (mavlink.MAV_DATA_STREAM_EXTRA3, 5),
    }
    for message in ardupilot.encode(RequestMessageRates(100.0, 50.0, 20.0, 5.0), 0):
        assert message.get_type() == "REQUEST_DATA_STREAM"


def test_a_group_of_messages_is_asked_for_in_whole_hz_and_no_slower_than_wanted(ardupilot, autopilot):
    ardupilot.encode(RequestMessageRates(100.0, 12.5, 20.0, 0.4), 0)
    refuse(ardupilot, autopilot, mavlink.MAV_RESULT_UNSUPPORTED)
    asked = {message.req_stream_id: message.req_message_rate for message in ardupilot.requests()}
    assert asked[mavlink.MAV_DATA_STREAM_POSITION] == 13
    assert asked[mavlink.MAV_DATA_STREAM_EXTRA2] == 1, "0 would be never"


# ---------------------------------------------------------------------- answers


def acknowledged(command, result, system=245, component=191):
    return mavlink.MAVLink_command_ack_message(command, result, 0, 0, system, component)


@pytest.mark.parametrize(
    ("command", "action"),
    [
        (mavlink.MAV_CMD_DO_SET_MODE, "mode"),
        (mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, "message-rate"),
        (mavlink.MAV_CMD_DO_GRIPPER, "gripper"),
        (mavlink.MAV_CMD_NAV_TAKEOFF, "other"),
    ],
)
def test_an_answer_names_what_it_answers(px4, autopilot, command, action):
    (event,) = px4.decode(autopilot.over_the_wire(acknowledged(command, 0)))
    assert (event.action, event.command, event.accepted) == (action, command, True)


@pytest.mark.parametrize("armed", [True, False])
def test_the_answer_to_arming_and_to_disarming_can_be_told_apart(px4, autopilot, armed):
    px4.encode(SetArmed(armed), 0)
    message = autopilot.over_the_wire(acknowledged(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 4))
    (event,) = px4.decode(message)
    assert event.action == ("arm" if armed else "disarm")
    assert not event.accepted


def test_a_gripper_in_progress_is_neither_accepted_nor_refused(px4, autopilot):
    (event,) = px4.decode(autopilot.over_the_wire(acknowledged(mavlink.MAV_CMD_DO_GRIPPER, 5)))
    assert (event.accepted, event.in_progress, event.result_name) == (False, True, "in progress")


def test_answers_to_somebody_else_are_not_ours(px4, autopilot):
    for system, component in ((255, 190), (245, 1)):
        ack = acknowledged(mavlink.MAV_CMD_DO_SET_MODE, 0, system, component)
        assert px4.decode(autopilot.over_the_wire(ack)) == []


def test_an_answer_without_addressee_counts(px4, autopilot):
    ack = acknowledged(mavlink.MAV_CMD_DO_SET_MODE, 0, 0, 0)
    assert len(px4.decode(autopilot.over_the_wire(ack))) == 1


def test_results_have_names():
    assert result_name(1) == "temporarily rejected"
    assert result_name(200) == "result 200"


# ------------------------------------------------------------------------ trust


def reported(firmware, autopilot):
    target = mavlink.MAVLink_attitude_target_message(0, 0, (1.0, 0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.5)
    (event,) = firmware.decode(autopilot.over_the_wire(target))
    return (event.thrust, event.body_rates, event.attitude)


def beat(firmware, autopilot, number):
    firmware.decode(autopilot.over_the_wire(autopilot.heartbeat(custom_mode=number)))


def test_px4_is_not_believed_while_it_follows_our_body_rates(px4, autopilot):
    px4.encode(RATES, 0)
    beat(px4, autopilot, PX4_OFFBOARD)
    assert reported(px4, autopilot) == (None, None, None)


def test_px4_is_not_believed_in_acro(px4, autopilot):
    beat(px4, autopilot, PX4_ACRO)
    assert reported(px4, autopilot) == (None, None, None)


def test_px4_is_believed_in_hold_and_when_it_follows_our_attitudes(px4, autopilot):
    beat(px4, autopilot, PX4_HOLD)
    assert None not in reported(px4, autopilot)
    px4.encode(ANGLES, 0)
    beat(px4, autopilot, PX4_OFFBOARD)
    assert None not in reported(px4, autopilot)


def test_px4_is_not_believed_between_the_mode_command_and_the_heartbeat_that_confirms_it(px4, autopilot):
    beat(px4, autopilot, PX4_HOLD)
    px4.encode(RATES, 0)
    px4.encode(SetMode(ModeKind.OFFBOARD), 0)
    assert reported(px4, autopilot) == (None, None, None)
    beat(px4, autopilot, PX4_HOLD)  # sent before the command took effect, perhaps
    assert reported(px4, autopilot) == (None, None, None)
    beat(px4, autopilot, PX4_HOLD)  # it did not switch
    assert None not in reported(px4, autopilot)


def test_ardupilot_is_believed_in_guided(ardupilot, autopilot):
    ardupilot.encode(RATES, 0)
    beat(ardupilot, autopilot, 4)
    assert None not in reported(ardupilot, autopilot)


# ---------------------------------------------------------- ArduPilot parameters


def parameter(name, value):
    return mavlink.MAVLink_param_value_message(name, value, mavlink.MAV_PARAM_TYPE_REAL32, 1, 0)


def test_guided_nogps_is_asked_for_if_so_configured(route, telemetry, px4):
    indoor = ArduPilot(route, telemetry, "guided_nogps")
    assert [c.param2 for c in indoor.encode(SetMode(ModeKind.OFFBOARD), 0)] == [20]
    assert [c.param2 for c in indoor.encode(SetMode(ModeKind.LAND), 0)] == [9]


def test_setpoints_are_refused_where_arducopter_would_take_thrust_for_a_climb_rate(ardupilot, autopilot):
    ardupilot.decode(autopilot.over_the_wire(parameter(b"GUID_OPTIONS", 0.0)))
    with pytest.raises(EncodingError, match="GUID_OPTIONS 0 makes thrust a climb rate: add 8"):
        ardupilot.encode(RATES, 0)
    ardupilot.decode(autopilot.over_the_wire(parameter(b"GUID_OPTIONS", 9.0)))
    assert len(ardupilot.encode(RATES, 0)) == 1
