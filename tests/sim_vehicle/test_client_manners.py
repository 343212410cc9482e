"""What MAVSDK and MAVProxy stumbled over: answers that they wait for, texts that they show."""

from __future__ import annotations

import struct
from itertools import groupby

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pymavlink.dialects.v20 import development
from pymavlink.dialects.v20.development import MAVLink_current_mode_message

from sim_vehicle.firmware import Severity
from sim_vehicle.flight_modes import Px4Mode


@pytest.fixture(params=("px4", "ardupilot"))
def pilot(request, make_pilot):
    return make_pilot(request.param)


def texts_received(pilot) -> list[str]:
    """Texts as a ground station puts them together: pieces with one id, in order, up to a short one."""
    pieces = sorted((m.id, m.chunk_seq, m.text) for m in pilot.messages("STATUSTEXT"))
    return ["".join(text for _, _, text in group) for _, group in groupby(pieces, lambda piece: piece[0])]


@pytest.mark.parametrize(("length", "lengths"), [(51, [50, 1]), (100, [50, 50, 0]), (120, [50, 50, 20])])
def test_a_long_text_comes_whole_in_pieces_that_end_with_a_short_one(pilot, length, lengths):
    first, second = "a" * length, "b" * length
    pilot.vehicle.firmware.texts += [(Severity.INFO, first), (Severity.INFO, second)]
    pilot.run(0.1)
    assert texts_received(pilot) == [first, second]
    assert [len(message.text) for message in pilot.messages("STATUSTEXT")] == lengths * 2
    assert 0 not in [message.id for message in pilot.messages("STATUSTEXT")]


def test_a_short_text_is_one_message_without_number(pilot):
    pilot.vehicle.firmware.texts.append((Severity.INFO, "c" * 50))
    pilot.run(0.1)
    (message,) = pilot.messages("STATUSTEXT")
    assert (message.text, message.id, message.chunk_seq) == ("c" * 50, 0, 0)


def test_a_request_for_the_logs_is_answered_with_none(pilot):
    pilot.send(mavlink.MAVLink_log_request_list_message(1, 1, 0, 65535))
    pilot.run(0.1)
    (answer,) = pilot.messages("LOG_ENTRY")
    assert (answer.num_logs, answer.size) == (0, 0)


def test_a_fence_that_is_not_there_is_not_breached(pilot):
    pilot.run(1.1)
    status = pilot.messages("SYS_STATUS")[-1]
    assert not status.onboard_control_sensors_present & mavlink.MAV_SYS_STATUS_GEOFENCE
    assert status.onboard_control_sensors_health & mavlink.MAV_SYS_STATUS_GEOFENCE


def test_arducopter_sends_its_heartbeat_as_often_as_asked_and_px4_refuses(copter, px4):
    accepted, failed = 0, 4
    interval, heartbeat = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_HEARTBEAT
    for pilot, result, count in ((copter, accepted, 10), (px4, failed, 2)):
        assert pilot.ask(interval, heartbeat, 200_000) == result
        start = pilot.now
        pilot.run(2.0)
        assert len(pilot.messages("HEARTBEAT", start)) == pytest.approx(count, abs=1)


def test_px4_says_that_it_speaks_mavlink_2_or_qgroundcontrol_would_fall_back_to_1(copter, px4):
    accepted, failed, unsupported, number = 0, 4, 3, 300
    assert px4.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == accepted
    assert px4.ask(mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION, 1) == accepted
    frames = [bytes(m.get_msgbuf()) for _, m in px4.received if m.get_type() == f"UNKNOWN_{number}"]
    assert [frame[10:-2] for frame in frames] == [struct.pack("<HHH", 200, 100, 200).rstrip(b"\0")] * 2
    checksum = mavlink.x25crc(frames[0][1:-2] + b"\xd9")  # CRC_EXTRA of message 300 is 217
    assert frames[0][-2:] == struct.pack("<H", checksum.crc)
    assert copter.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, number) == failed
    assert copter.ask(mavlink.MAV_CMD_REQUEST_PROTOCOL_VERSION, 1) == unsupported


def test_px4_tells_its_mode_five_times_a_second_when_asked_and_arducopter_does_not_know_how(copter, px4):
    accepted, failed, number = 0, 4, MAVLink_current_mode_message.id
    interval, modes = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, development.MAVLink(None)
    assert copter.ask(interval, number, 200_000) == failed
    assert px4.ask(interval, number, 200_000) == accepted
    for mode in (Px4Mode.POSCTL, Px4Mode.LOITER):
        px4.vehicle.firmware.set_custom_mode(mode)
        start = px4.now
        px4.run(1.0)
        frames = [bytearray(m.get_msgbuf()) for time, m in px4.received if time > start]
        said = [frame for frame in frames if int.from_bytes(frame[7:10], "little") == number]
        assert len(said) == pytest.approx(5, abs=1)
        assert {modes.decode(frame).custom_mode for frame in said[1:]} == {mode}
