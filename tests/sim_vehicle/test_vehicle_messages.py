"""The MAVLink side: telemetry rates, parameters, missions, commands, good manners."""

from __future__ import annotations

import math
import random
import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
DENIED = mavlink.MAV_RESULT_DENIED
FAILED = mavlink.MAV_RESULT_FAILED
UNSUPPORTED = mavlink.MAV_RESULT_UNSUPPORTED
SET_INTERVAL = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE
QUATERNION = mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION
POSITION = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
PERSONALITIES = ("px4", "ardupilot")

EVERYTHING = (
    "HEARTBEAT",
    "SYS_STATUS",
    "GPS_RAW_INT",
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "VFR_HUD",
    "ATTITUDE_TARGET",
    "ALTITUDE",
    "BATTERY_STATUS",
    "AUTOPILOT_VERSION",
    "HOME_POSITION",
    "EXTENDED_SYS_STATE",
)


@pytest.fixture(params=PERSONALITIES)
def pilot(request, make_pilot):
    return make_pilot(request.param)


def rate_of(pilot, kind: str, seconds: float = 2.0) -> float:
    """Messages of a kind per second from now on."""
    start = pilot.now
    pilot.run(seconds)
    return len(pilot.messages(kind, start)) / seconds


# -------------------------------------------------------------------------------------- rates


@pytest.mark.parametrize(("kind", "rate"), [("ATTITUDE", 100), ("ATTITUDE_QUATERNION", 50)])
def test_px4s_offboard_link_starts_with_its_default_rates(px4, kind, rate):
    px4.run(0.1)
    assert rate_of(px4, kind) == pytest.approx(rate, abs=0.5)


@pytest.mark.parametrize(
    ("asked", "message_id", "kind", "kept"),
    [
        (50, ATTITUDE, "ATTITUDE", 50),
        (100, ATTITUDE, "ATTITUDE", 100),
        (200, ATTITUDE, "ATTITUDE", 125),
        (250, ATTITUDE, "ATTITUDE", 237),
        (250, QUATERNION, "ATTITUDE_QUATERNION", 239),
        (250, POSITION, "LOCAL_POSITION_NED", 125),
    ],
)
def test_px4_keeps_the_rates_that_were_measured(px4, asked, message_id, kind, kept):
    assert px4.ask(SET_INTERVAL, message_id, 1e6 / asked) == ACCEPTED
    assert rate_of(px4, kind) == pytest.approx(kept, abs=1.0)


@pytest.mark.parametrize(
    ("asked_us", "answer"),
    [(2999, DENIED), (2500, DENIED), (3000, ACCEPTED), (5000, ACCEPTED), (10_000, ACCEPTED)],
)
def test_arducopter_denies_more_than_08_of_its_loop_rate(copter, asked_us, answer):
    assert copter.ask(SET_INTERVAL, ATTITUDE, asked_us) == answer


def test_arducopter_takes_whole_milliseconds(copter):
    assert copter.ask(SET_INTERVAL, ATTITUDE, 10_900) == ACCEPTED
    assert rate_of(copter, "ATTITUDE") == pytest.approx(100.0, abs=0.5)
    copter.command(mavlink.MAV_CMD_GET_MESSAGE_INTERVAL, ATTITUDE)
    copter.run(0.05)
    assert copter.messages("MESSAGE_INTERVAL")[-1].interval_us == 10_000


def test_a_stream_of_100_hz_is_even(pilot):
    pilot.ask(SET_INTERVAL, ATTITUDE, 10_000)
    start = pilot.now
    pilot.run(1.0)
    times = [message.time_boot_ms for message in pilot.messages("ATTITUDE", start)]
    assert set(np.diff(times)) == {10}


def test_interval_minus_1_stops_a_message_and_0_restores_the_default(pilot):
    pilot.run(0.1)
    default = rate_of(pilot, "ATTITUDE")
    assert pilot.ask(SET_INTERVAL, ATTITUDE, -1) == ACCEPTED
    assert rate_of(pilot, "ATTITUDE") == 0.0
    assert pilot.ask(SET_INTERVAL, ATTITUDE, 0) == ACCEPTED
    assert rate_of(pilot, "ATTITUDE") == pytest.approx(default, abs=1.0)


def test_an_unknown_message_cannot_have_a_rate(pilot):
    assert pilot.ask(SET_INTERVAL, 9999, 10_000) == FAILED
    assert pilot.ask(SET_INTERVAL, math.nan, 10_000) == FAILED


def test_a_rate_belongs_to_the_link_that_asked(px4):
    px4.vehicle.add_peer("other")
    px4.ask(SET_INTERVAL, ATTITUDE, 20_000)
    counts = {"pilot": 0, "other": 0}
    until = px4.vehicle.time_us + 1_000_000
    while px4.vehicle.time_us < until:
        px4.vehicle.advance(px4.vehicle.time_us + 10_000)
        for key, data in px4.vehicle.outgoing():
            messages = px4.codec.parse_buffer(data) or []
            counts[key] += sum(message.get_type() == "ATTITUDE" for message in messages)
    assert counts == {"pilot": 50, "other": 100}


def test_arducopters_streams_slow_down_fourfold_while_it_sends_parameters(copter):
    copter.ask(SET_INTERVAL, ATTITUDE, 10_000)
    start = copter.now
    copter.send(mavlink.MAVLink_param_request_list_message(1, 1))
    copter.run(0.2)
    assert 4 <= len(copter.messages("ATTITUDE", start)) <= 7
    copter.run(1.0)
    assert rate_of(copter, "ATTITUDE") == pytest.approx(100.0, abs=0.5)


def test_arducopter_answers_request_data_stream_and_px4_has_none(make_pilot):
    for personality, kept in (("ardupilot", 20.0), ("px4", 10.0)):
        pilot = make_pilot(personality)
        request = mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_ALL, 20, 1)
        pilot.send(request)
        pilot.run(0.1)
        assert rate_of(pilot, "VFR_HUD") == pytest.approx(kept, abs=1.0)


def test_local_position_is_not_sent_before_there_is_a_position(make_pilot):
    pilot = make_pilot("ardupilot", vehicle={"position_ready_s": 2.0})
    pilot.ask(SET_INTERVAL, POSITION, 100_000)
    pilot.run(1.8)
    assert pilot.messages("LOCAL_POSITION_NED") == []
    pilot.run(1.0)
    assert len(pilot.messages("LOCAL_POSITION_NED")) >= 8


@pytest.mark.parametrize("kind", EVERYTHING)
def test_every_message_that_ground_stations_want_can_be_requested(pilot, kind):
    pilot.run(0.1)
    number = getattr(mavlink, f"MAVLINK_MSG_ID_{kind}")
    start = pilot.now
    assert pilot.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == ACCEPTED
    assert pilot.messages(kind, start)


def test_a_heartbeat_comes_every_second(pilot):
    pilot.run(5.05)
    assert np.diff(pilot.times("HEARTBEAT")) == pytest.approx([1.0] * 4, abs=0.02)


# ------------------------------------------------------------------------------------ content


def test_telemetry_carries_the_time_of_its_sample_and_arrives_later(make_pilot):
    pilot = make_pilot("px4", link={"telemetry_delay_s": 0.03, "command_delay_s": 0.0})
    pilot.run(1.0)
    late = [time - message.time_boot_ms * 1e-3 for time, message in pilot.received if _is_attitude(message)]
    assert late == pytest.approx([0.03] * len(late), abs=0.0101)
    assert len(late) > 90


def _is_attitude(message) -> bool:
    return message.get_type() == "ATTITUDE"


def test_attitude_and_position_are_in_mavlinks_axes(make_pilot):
    quiet = dict.fromkeys(
        (
            "attitude_noise_rad",
            "body_rate_noise_rad_s",
            "altitude_noise_m",
            "climb_rate_noise_m_s",
            "horizontal_position_noise_m",
            "horizontal_velocity_noise_m_s",
        ),
        0.0,
    )
    pilot = make_pilot("px4", sensors=quiet)
    pilot.vehicle.state.rigid[:] = [1.0, 2.0, 30.0, 0.1, 0.2, 0.3, 0.01, 0.02, 0.5, 0.0, 0.0, 0.0]
    pilot.run(0.1)
    attitude, position = pilot.messages("ATTITUDE")[0], pilot.messages("LOCAL_POSITION_NED")[0]
    assert (attitude.roll, attitude.pitch, attitude.yaw) == pytest.approx((0.01, -0.02, -0.5), abs=1e-3)
    assert (position.x, position.y, position.z) == pytest.approx((1.0, -2.0, -30.0), abs=0.1)
    q = pilot.messages("ATTITUDE_QUATERNION")[0]
    assert (q.q1, q.q4) == pytest.approx((math.cos(0.25), -math.sin(0.25)), abs=1e-3)


def test_the_course_is_where_it_moves_to_and_the_heading_where_it_looks(make_pilot):
    pilot = make_pilot("px4", sensors={"horizontal_velocity_noise_m_s": 0.0, "attitude_noise_rad": 0.0})
    pilot.vehicle.state.rigid[:] = [0.0, 0.0, 30.0, 3.0, -3.0, 0.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
    pilot.run(0.25)
    assert pilot.messages("GPS_RAW_INT")[0].cog == pytest.approx(4500, abs=100)
    heading = pilot.messages("GLOBAL_POSITION_INT")[0].hdg
    assert heading == pytest.approx(36000 - round(math.degrees(0.5) * 100.0), abs=100)


def test_a_vehicle_that_is_farther_than_its_fields_reach_is_shown_at_their_end(pilot):
    pilot.vehicle.state.rigid[:3] = [1e9, 1e9, 1e7]
    pilot.run(1.1)
    seen = pilot.messages("GLOBAL_POSITION_INT")[-1]
    assert (seen.lat, seen.alt) == (2**31 - 1, 2**31 - 1)


def test_sensor_noise_has_the_size_that_was_set(make_pilot):
    pilot = make_pilot("px4", sensors={"attitude_noise_rad": 0.01, "altitude_noise_m": 0.05})
    pilot.run(10.0)
    assert np.std([m.roll for m in pilot.messages("ATTITUDE")]) == pytest.approx(0.01, rel=0.1)
    assert np.std([m.z for m in pilot.messages("LOCAL_POSITION_NED")]) == pytest.approx(0.05, rel=0.15)


# --------------------------------------------------------------------------------- parameters


def test_the_parameter_list_is_complete_and_in_order(pilot):
    pilot.send(mavlink.MAVLink_param_request_list_message(1, 1))
    pilot.run(1.0)
    values = [m for m in pilot.messages("PARAM_VALUE") if m.param_id != "_HASH_CHECK"]
    assert [m.param_id for m in values] == list(pilot.vehicle.firmware.parameters.names)
    assert [m.param_index for m in values] == list(range(values[0].param_count))


@pytest.mark.parametrize("value", [5, -1, 2_000_000_000])
def test_px4_puts_the_bytes_of_an_integer_into_the_float_field(px4, value):
    field = struct.unpack("<f", struct.pack("<i", value))[0]
    px4.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", field, mavlink.MAV_PARAM_TYPE_INT32))
    px4.run(0.05)
    assert px4.vehicle.firmware.parameters["COM_OBL_RC_ACT"] == value
    answer = px4.messages("PARAM_VALUE")[-1]
    assert answer.param_type == mavlink.MAV_PARAM_TYPE_INT32
    assert struct.unpack("<i", struct.pack("<f", answer.param_value))[0] == value


def test_px4_refuses_an_integer_parameter_sent_as_a_float(px4):
    px4.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OBL_RC_ACT", 5.0, mavlink.MAV_PARAM_TYPE_REAL32))
    px4.run(0.05)
    assert px4.vehicle.firmware.parameters["COM_OBL_RC_ACT"] == 0
    assert any("COM_OBL_RC_ACT" in text for text in px4.texts())


def test_arducopter_puts_the_number_into_the_float_field(copter):
    copter.send(mavlink.MAVLink_param_set_message(1, 1, b"GUID_OPTIONS", 24.0, mavlink.MAV_PARAM_TYPE_INT32))
    copter.run(0.05)
    assert copter.vehicle.firmware.parameters["GUID_OPTIONS"] == 24
    answer = copter.messages("PARAM_VALUE")[-1]
    assert (answer.param_value, answer.param_type) == (24.0, mavlink.MAV_PARAM_TYPE_INT32)


def test_a_parameter_is_read_by_name_and_by_index(pilot):
    names = pilot.vehicle.firmware.parameters.names
    pilot.send(mavlink.MAVLink_param_request_read_message(1, 1, names[7].encode(), -1))
    pilot.send(mavlink.MAVLink_param_request_read_message(1, 1, b"", 7))
    pilot.run(0.05)
    assert [message.param_id for message in pilot.messages("PARAM_VALUE")] == [names[7]] * 2


def test_a_changed_parameter_counts_at_once(px4):
    px4.engage_in_flight()
    px4.send(mavlink.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", 0.2, mavlink.MAV_PARAM_TYPE_REAL32))
    px4.run(0.35)
    assert px4.mode != "OFFBOARD"


@pytest.mark.parametrize("name", ["CAL_GYRO0_ID", "CAL_ACC0_ID", "CAL_MAG0_ID", "SYS_HITL", "COM_OF_LOSS_T"])
def test_px4_has_the_parameters_that_mavsdk_looks_at(px4, name):
    assert name in px4.vehicle.firmware.parameters


# ----------------------------------------------------------------------------------- commands


def test_a_command_that_is_not_supported_is_answered_so(pilot):
    assert pilot.ask(mavlink.MAV_CMD_DO_PARACHUTE, 1) == UNSUPPORTED
    message = mavlink.MAVLink_command_int_message(
        1, 1, 0, mavlink.MAV_CMD_DO_PARACHUTE, 0, 0, 0, 0, 0, 0, 0, 0, 0
    )
    pilot.send(message)
    pilot.run(0.05)
    assert pilot.results(mavlink.MAV_CMD_DO_PARACHUTE) == [UNSUPPORTED] * 2


def test_command_int_does_what_command_long_does(pilot):
    mode = (6 if pilot.personality == "ardupilot" else 4, 5)
    message = mavlink.MAVLink_command_int_message(
        1, 1, 0, mavlink.MAV_CMD_DO_SET_MODE, 0, 0, 1, *mode, 0, 0, 0, 0
    )
    pilot.send(message)
    pilot.run(0.05)
    assert pilot.results(mavlink.MAV_CMD_DO_SET_MODE) == [ACCEPTED]
    assert pilot.mode == "RTL"


def test_set_mode_works_and_is_answered(pilot):
    custom = 6 if pilot.personality == "ardupilot" else 4 << 16 | 5 << 24
    pilot.send(mavlink.MAVLink_set_mode_message(1, 1, custom))
    pilot.run(0.05)
    assert pilot.mode == "RTL"
    assert [message.result for message in pilot.messages("COMMAND_ACK")] == [ACCEPTED]


def test_an_answer_is_addressed_to_who_asked(pilot):
    pilot.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, 0)
    answer = pilot.messages("COMMAND_ACK")[0]
    assert (answer.target_system, answer.target_component) == (255, 190)
    assert (answer.get_srcSystem(), answer.get_srcComponent()) == (1, 1)


def test_messages_for_another_system_are_neither_obeyed_nor_answered(pilot):
    pilot.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1, system=7)
    pilot.send(mavlink.MAVLink_param_request_list_message(7, 1))
    pilot.send(mavlink.MAVLink_mission_request_list_message(7, 1))
    pilot.send(mavlink.MAVLink_set_mode_message(7, 1, 6))
    pilot.run(0.5)
    for kind in ("COMMAND_ACK", "PARAM_VALUE", "MISSION_COUNT", "STATUSTEXT"):
        assert pilot.messages(kind) == []


def test_any_parameters_of_any_command_are_survived_and_answered(pilot):
    commands = [number for number in range(600) if number != mavlink.MAV_CMD_DO_GRIPPER]
    for number in commands:
        pilot.command(number, *[math.nan] * 7)
    pilot.run(0.2)
    assert sorted(message.command for message in pilot.messages("COMMAND_ACK")) == commands


def test_garbage_is_survived(pilot):
    noise = random.Random(1)
    for _ in range(200):
        pilot.vehicle.receive(noise.randbytes(noise.randrange(1, 300)), "pilot")
        pilot.run(0.01)
    pilot.run(1.0)
    assert pilot.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, 0, wait=0.5) == ACCEPTED


@pytest.mark.parametrize("name", ["px4", "copter"])
def test_setpoints_without_sense_are_survived(request, name):
    pilot = request.getfixturevalue(name)
    pilot.engage_in_flight()
    for value in (math.nan, math.inf, -math.inf, 1e30):
        for mask in range(256):
            pilot.setpoint(mask, (value, value, value), value, (value,) * 4)
        pilot.setpoint(7, attitude=(0.0,) * 4)
        pilot.run(0.05)
    assert np.all(np.isfinite(pilot.vehicle.state.rigid))


# -------------------------------------------------------------------------------------- other


def test_a_time_synchronisation_request_is_answered_with_its_own_time(pilot):
    pilot.run(1.0)
    pilot.send(mavlink.MAVLink_timesync_message(0, 12345))
    pilot.run(0.05)
    answer = pilot.messages("TIMESYNC")[0]
    assert answer.ts1 == 12345
    assert answer.tc1 == pytest.approx(1e9, abs=2e7)


def test_the_mission_is_empty_and_an_upload_is_accepted_and_given_back(pilot):
    pilot.send(mavlink.MAVLink_mission_request_list_message(1, 1))
    pilot.run(0.05)
    assert pilot.messages("MISSION_COUNT")[0].count == 0
    pilot.send(mavlink.MAVLink_mission_count_message(1, 1, 2))
    pilot.run(0.05)
    for sequence in range(2):
        assert pilot.messages("MISSION_REQUEST_INT")[-1].seq == sequence
        item = mavlink.MAVLink_mission_item_int_message(
            1, 1, sequence, 6, mavlink.MAV_CMD_NAV_WAYPOINT, 0, 1, 0, 0, 0, 0, 473977420, 85455940, 5.0
        )
        pilot.send(item)
        pilot.run(0.05)
    assert pilot.messages("MISSION_ACK")[-1].type == mavlink.MAV_MISSION_ACCEPTED
    pilot.send(mavlink.MAVLink_mission_request_list_message(1, 1))
    pilot.send(mavlink.MAVLink_mission_request_int_message(1, 1, 1))
    pilot.run(0.05)
    assert pilot.messages("MISSION_COUNT")[-1].count == 2
    assert pilot.messages("MISSION_ITEM_INT")[-1].x == 473977420


def test_file_transfer_is_declined_so_that_clients_need_not_wait(pilot):
    payload = bytearray(251)
    payload[0:4] = (5, 0, 0, 4)
    pilot.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
    pilot.run(0.05)
    answer = bytes(pilot.messages("FILE_TRANSFER_PROTOCOL")[0].payload)
    assert (answer[0], answer[3], answer[5]) == (6, 129, 4)
