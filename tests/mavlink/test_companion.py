"""The daemon as a component among others, message by message, with the real service behind it."""

import math
from dataclasses import replace
from statistics import median

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import bundled, load
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.offboard.service import Service, State

CONFIG = load(bundled("demo-px4.toml"))
START_US = 1_700_000_000_000_000
LATE_US = 30_000  # age of a sample when it arrives


def command(number, *parameters, system=245, component=191, again=0):
    padded = (*parameters, *[0.0] * (7 - len(parameters)))
    return mavlink.MAVLink_command_long_message(system, component, number, again, *padded)


def test_latency_is_the_samples_age_and_the_way_out(new_talk, scripted):
    talk = new_talk(compare_clocks=True)
    talk.telemetry(0.2)
    assert math.isnan(talk.signals[-1].latency_s)
    round_trips_s = []
    for _ in range(5):
        talk.telemetry(0.5)
        asked = talk.sent("TIMESYNC")[-1]
        asked_us = asked.ts1 // 1000
        talk.time_us = max(talk.time_us, asked_us + 24_000)
        round_trips_s.append((talk.time_us - asked_us) * 1e-6)
        # As long there as back; the autopilot had been running for 10 s at the start.
        there_us = (asked_us + talk.time_us) // 2 - START_US + 10_000_000
        talk.hear(talk.autopilot, scripted.timesync(asked.ts1, there_us * 1000))
    talk.telemetry(0.1)
    way_out_s = median(round_trips_s[-3:]) / 2
    assert talk.signals[-1].latency_s == pytest.approx(LATE_US * 1e-6 + way_out_s, abs=1e-3)


def test_clocks_are_compared_five_times_a_second_and_never_unless_told(new_talk, talk):
    talk.telemetry(3.0)
    assert talk.sent("TIMESYNC") == []
    comparing = new_talk(compare_clocks=True)
    comparing.telemetry(3.0)
    requests = comparing.sent("TIMESYNC")
    assert [(message.tc1, message.ts1 // 1000 - START_US) for message in requests] == [
        (0, 200_000 * k) for k in range(16)
    ]


def test_a_restarted_autopilots_clock_gives_no_latency_instead_of_a_wrong_one(new_talk, scripted):
    talk = new_talk(compare_clocks=True)
    talk.telemetry(0.5)
    asked = talk.sent("TIMESYNC")[-1]
    talk.hear(talk.autopilot, scripted.timesync(asked.ts1, 10**18))
    talk.telemetry(0.1)
    assert math.isnan(talk.signals[-1].latency_s)


def test_only_we_are_addressed(talk):
    for system, component in ((1, 1), (245, 1), (245, 0), (0, 191), (0, 0)):
        asked = command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1.0, system=system, component=component)
        talk.hear(talk.ground, asked)
        talk.hear(talk.ground, mavlink.MAVLink_param_set_message(system, component, b"ALT_OMEGA_C", 5.0, 9))
    assert talk.sent("COMMAND_ACK") == talk.sent("PARAM_VALUE") == talk.sent("STATUSTEXT") == []


def test_engaging_too_early_is_temporarily_rejected_and_later_accepted(talk):
    engage = mavlink.MAV_CMD_NAV_GUIDED_ENABLE
    talk.hear(talk.ground, command(engage, 1.0))
    talk.telemetry(2.0)
    talk.hear(talk.autopilot, mavlink.MAVLink_extended_sys_state_message(0, 2))
    talk.hear(talk.ground, command(engage, 1.0))
    acks = [(m.result, m.target_system, m.target_component) for m in talk.sent("COMMAND_ACK")]
    assert acks == [
        (mavlink.MAV_RESULT_TEMPORARILY_REJECTED, 255, 190),
        (mavlink.MAV_RESULT_ACCEPTED, 255, 190),
    ]
    assert any(message.text.startswith("not engaged: ") for message in talk.sent("STATUSTEXT"))


def test_engaging_in_shadow_mode_is_denied_for_good(new_talk):
    talk = new_talk()
    talk.session.service.settings = replace(CONFIG.service, shadow=True)
    talk.hear(talk.ground, command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1.0))
    talk.hear(talk.ground, command(mavlink.MAV_CMD_DO_GRIPPER, 1.0, 0.0))
    assert [message.result for message in talk.sent("COMMAND_ACK")] == [mavlink.MAV_RESULT_DENIED] * 2


def test_a_repeated_command_is_answered_again_but_a_new_one_is_done(talk):
    release = command(mavlink.MAV_CMD_DO_GRIPPER, 1.0, 0.0)
    talk.hear(talk.ground, release)
    talk.hear(talk.ground, command(mavlink.MAV_CMD_DO_GRIPPER, 1.0, 0.0, again=1))
    talk.hear(talk.ground, command(mavlink.MAV_CMD_DO_GRIPPER, 1.0, 1.0, again=1))
    talk.hear(talk.ground, release)
    assert len(talk.sent("COMMAND_ACK")) == 4
    grippers = [m for m in talk.sent("COMMAND_LONG") if m.command == mavlink.MAV_CMD_DO_GRIPPER]
    assert [message.param2 for message in grippers] == [0.0, 1.0, 0.0]


def test_a_repetition_is_known_whatever_others_have_asked_since(talk, scripted):
    """Two ground stations: while one waits for its answer, the other one talks, too."""
    talk.engage()
    other = scripted(254, 190)
    talk.hear(other, command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HEARTBEAT))
    talk.hear(talk.ground, command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HEARTBEAT))
    talk.hear(talk.autopilot, scripted.heartbeat(custom_mode=3 << 16, armed=True))  # the pilot's mode
    assert talk.session.service.state is State.READY
    talk.hear(talk.ground, command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1.0, again=1))
    assert talk.session.service.state is State.READY, "the pilot has it"
    assert talk.sent("COMMAND_ACK")[-1].result == mavlink.MAV_RESULT_ACCEPTED
    talk.hear(other, command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1.0))
    assert talk.session.service.state is State.ENGAGING, "another one asks anew"


def test_repetitions_three_seconds_apart_are_one_command(talk):
    """QGroundControl repeats that often; all its answers are lost."""
    for count in range(4):
        talk.hear(talk.ground, command(mavlink.MAV_CMD_DO_GRIPPER, 1.0, 0.0, again=count))
        talk.telemetry(3.0)
    assert [answer.result for answer in talk.sent("COMMAND_ACK")] == [mavlink.MAV_RESULT_ACCEPTED] * 4
    passed_on = [each for each in talk.sent("COMMAND_LONG") if each.command == mavlink.MAV_CMD_DO_GRIPPER]
    assert len(passed_on) == 1


@pytest.mark.parametrize("way", ["COMMAND_LONG", "COMMAND_INT"])
def test_a_frame_that_comes_by_two_ways_is_one_command(talk, read, way):
    release = command(mavlink.MAV_CMD_DO_GRIPPER, 1.0, 0.0)
    if way == "COMMAND_INT":
        asked = (245, 191, 0, mavlink.MAV_CMD_DO_GRIPPER, 0, 0, 1.0, 0.0, 0, 0, 0, 0, 0)
        release = mavlink.MAVLink_command_int_message(*asked)
    frame = talk.ground.pack(release)
    for _ in range(2):
        talk.session.handle(talk.time_us, read(frame)[0])
        talk.telemetry(0.2)
    talk.hear(talk.ground, release)
    assert [answer.result for answer in talk.sent("COMMAND_ACK")] == [mavlink.MAV_RESULT_ACCEPTED] * 3
    passed_on = [each for each in talk.sent("COMMAND_LONG") if each.command == mavlink.MAV_CMD_DO_GRIPPER]
    assert len(passed_on) == 2


def test_a_repetition_is_known_by_parameters_that_are_not_used_too(talk):
    """MAVSDK and others fill them with NaN, which is not equal to itself."""
    release = (mavlink.MAV_CMD_DO_GRIPPER, 1.0, 0.0, *[math.nan] * 5)
    for count in range(3):
        talk.hear(talk.ground, command(*release, again=count))
    assert [answer.result for answer in talk.sent("COMMAND_ACK")] == [mavlink.MAV_RESULT_ACCEPTED] * 3
    passed_on = [each for each in talk.sent("COMMAND_LONG") if each.command == mavlink.MAV_CMD_DO_GRIPPER]
    assert len(passed_on) == 1


def test_command_int_is_understood_too(talk):
    version = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    asked = (245, 191, 0, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 0, version, 0, 0, 0, 0, 0, 0)
    talk.hear(talk.ground, mavlink.MAVLink_command_int_message(*asked))
    assert len(talk.sent("AUTOPILOT_VERSION")) == len(talk.sent("COMMAND_ACK")) == 1


def test_storing_without_a_file_fails_with_the_remedy(talk):
    talk.hear(talk.ground, command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 1.0))
    assert talk.sent("COMMAND_ACK")[0].result == mavlink.MAV_RESULT_FAILED
    text = "".join(message.text for message in talk.sent("STATUSTEXT"))
    assert text == "nowhere to store: no [parameters] file in the configuration"


def test_a_daemon_without_parameters_says_so(new_talk):
    talk = new_talk()
    talk.session = Session(Service(CONFIG.service), talk.link, Route())
    talk.hear(talk.ground, mavlink.MAVLink_param_request_list_message(245, 191))
    talk.hear(talk.ground, mavlink.MAVLink_param_request_read_message(245, 191, b"ALT_OMEGA_C", -1))
    talk.hear(talk.ground, command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 2.0))
    assert talk.sent("PARAM_VALUE") == []
    assert talk.sent("COMMAND_ACK")[0].result == mavlink.MAV_RESULT_FAILED


number = st.floats(width=32) | st.integers(-5, 600).map(float)
names = st.sampled_from([tunable.name.encode() for tunable in CONFIG.tuning.tunables])
byte, index = st.integers(0, 255), st.integers(-(2**15), 2**15 - 1)
ours = st.just(245), st.just(191) | byte
commands = st.sampled_from([92, 211, 245, 510, 511, 512]) | st.integers(0, 2**16 - 1)
anything = st.one_of(
    st.builds(
        mavlink.MAVLink_param_set_message,
        *ours,
        names | st.binary(max_size=16),
        number,
        st.just(9) | byte,
    ),
    st.builds(mavlink.MAVLink_param_request_read_message, *ours, names | st.binary(max_size=16), index),
    st.builds(mavlink.MAVLink_param_request_list_message, *ours),
    st.builds(mavlink.MAVLink_command_long_message, *ours, commands, st.integers(0, 2), *[number] * 7),
    st.builds(
        mavlink.MAVLink_command_int_message,
        *ours,
        byte,
        commands,
        byte,
        byte,
        *[number] * 4,
        *[st.integers(-(2**31), 2**31 - 1)] * 2,
        number,
    ),
    st.builds(
        mavlink.MAVLink_set_position_target_local_ned_message,
        st.integers(0, 2**32 - 1),
        *ours,
        st.just(1) | byte,
        st.sampled_from([2552, 2555, 2556, 3576]) | st.integers(0, 2**16 - 1),
        *[number] * 11,
    ),
    st.builds(
        mavlink.MAVLink_set_attitude_target_message,
        st.integers(0, 2**32 - 1),
        *ours,
        st.just(71) | byte,
        st.just((1.0, 0.0, 0.0, 0.0)) | st.tuples(*[number] * 4),
        *[number] * 4,
    ),
    st.builds(mavlink.MAVLink_ping_message, st.integers(0, 2**64 - 1), st.integers(0, 2**32 - 1), byte, byte),
    st.builds(mavlink.MAVLink_timesync_message, *[st.integers(-(2**63), 2**63 - 1)] * 2),
)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(anything, max_size=12), st.booleans())
def test_whatever_somebody_sends_the_daemon_flies_on(new_talk, messages, as_autopilot):
    talk = new_talk(compare_clocks=True)
    for message in messages:
        talk.hear(talk.autopilot if as_autopilot else talk.ground, message)
        talk.telemetry(0.03)
    before = len(talk.signals)
    talk.telemetry(0.1)
    assert len(talk.signals) > before or talk.session.service.finished is not None
    assert talk.session.refusal is None
