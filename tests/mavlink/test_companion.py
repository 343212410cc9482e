"""The daemon as a component among others, message by message, with the real service behind it."""

import math
from dataclasses import replace
from statistics import median

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import bundled, load
from kffa_offboard.config_log import make_companion
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.offboard.events import Signals
from kffa_offboard.offboard.service import Service, State

CONFIG = load(bundled("demo-px4.toml"))
START_US = 1_700_000_000_000_000
LATE_US = 30_000  # age of a sample when it arrives


class ListLink:
    name = "test"
    keeps_frames_whole = True
    trouble = ""

    def __init__(self):
        self.sent = []

    def send(self, data):
        self.sent.append(data)
        return True

    def lock(self, source):
        pass


class Talk:
    """A session with a scripted PX4 in the air, its telemetry, and a ground station."""

    def __init__(self, scripted, read, **options):
        self.autopilot, self.ground = scripted(), scripted(255, 190)
        self._scripted, self._read = scripted, read
        self.time_us = START_US
        self.link, self.signals = ListLink(), []
        self.session = Session(
            Service(CONFIG.service),
            self.link,
            Route(),
            companion=make_companion(CONFIG, Route()),
            observer=lambda time_us, item: self.signals.append(item) if isinstance(item, Signals) else None,
            **options,
        )
        self.hear(self.autopilot, scripted.heartbeat(armed=True))

    def hear(self, sender, message):
        self.session.handle(self.time_us, self._read(sender.pack(message))[0])

    def telemetry(self, seconds):
        """Attitude and position at 100 Hz, sampled `LATE_US` before they arrive; a heartbeat each second."""
        for k in range(round(seconds * 100)):
            self.time_us += 10_000
            self.session.advance(self.time_us)
            boot_ms = (self.time_us - START_US + 10_000_000 - LATE_US) // 1000
            self.hear(self.autopilot, self._scripted.attitude(boot_ms))
            position = mavlink.MAVLink_local_position_ned_message(boot_ms, 0, 0, -5.0, 0, 0, 0)
            self.hear(self.autopilot, position)
            if k % 100 == 0:
                self.hear(self.autopilot, self._scripted.heartbeat(armed=True))

    def sent(self, kind):
        frames = [self._read(data)[0] for data in self.link.sent]
        return [message for message in frames if message.get_type() == kind]


@pytest.fixture
def talk(scripted, read):
    return Talk(scripted, read)


def command(number, *parameters, system=245, component=191, again=0):
    padded = (*parameters, *[0.0] * (7 - len(parameters)))
    return mavlink.MAVLink_command_long_message(system, component, number, again, *padded)


def test_latency_is_the_samples_age_and_the_way_out(scripted, read):
    talk = Talk(scripted, read, compare_clocks=True)
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


def engage(talk):
    """Take control in the air."""
    talk.telemetry(3.0)
    flies = mavlink.MAV_LANDED_STATE_IN_AIR
    talk.hear(talk.autopilot, mavlink.MAVLink_extended_sys_state_message(0, flies))
    talk.hear(talk.ground, command(mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 1.0))
    assert talk.session.service.state is State.ENGAGING


def set_bandwidth(talk, name, value):
    """Set it: the value that is answered, and what is said."""
    talk.link.sent.clear()
    talk.hear(talk.ground, mavlink.MAVLink_param_set_message(245, 191, name, value, 9))
    (answered,) = talk.sent("PARAM_VALUE")
    return answered.param_value, "".join(said.text for said in talk.sent("STATUSTEXT"))


def test_a_bandwidth_that_the_telemetry_does_not_bear_is_refused_in_flight(talk):
    talk.telemetry(3.0)
    (before,) = (t.value for t in CONFIG.tuning.tunables if t.name == "ROLL_OMEGA_O")
    set_bandwidth(talk, b"ROLL_OMEGA_O", 260.0)
    assert set_bandwidth(talk, b"ROLL_OMEGA_O", before)[0] == before, "while it waits anything goes"
    engage(talk)
    flown = talk.session.service.settings
    refused = "ROLL_OMEGA_O refused: 260: attitude at 100 Hz; omega_o = 260 needs 104"
    assert set_bandwidth(talk, b"ROLL_OMEGA_O", 260.0) == (before, refused)
    assert talk.session.service.settings is flown
    assert set_bandwidth(talk, b"ROLL_OMEGA_O", 240.0) == (240.0, f"ROLL_OMEGA_O {before:g} -> 240")


def test_stored_values_that_the_telemetry_does_not_bear_are_not_read_in_flight(talk, monkeypatch):
    engage(talk)
    quick = CONFIG.tuning.with_value("YAW_OMEGA_O", 300.0)
    monkeypatch.setattr(type(quick), "original", lambda tuning: quick)
    talk.link.sent.clear()
    talk.hear(talk.ground, command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 2.0))
    assert [answer.result for answer in talk.sent("COMMAND_ACK")] == [mavlink.MAV_RESULT_TEMPORARILY_REJECTED]
    texts = "".join(said.text for said in talk.sent("STATUSTEXT"))
    assert texts == "parameters stay: attitude at 100 Hz; omega_o = 300 needs 120"
    assert talk.session.service.settings is CONFIG.service


def test_a_parameter_set_in_flight_leaves_what_was_worked_out_for_the_others(talk):
    """The gains of a Kalman filter cost milliseconds, which are the next control step's."""
    engage(talk)
    before = talk.session.service.settings
    set_bandwidth(talk, b"ALT_OMEGA_C", 6.0)
    after = talk.session.service.settings
    assert after.controller.law.omega_c[3] == 6.0
    for part in ("kalman", "model", "observer", "actuator", "differentiator", "fuzzy", "limits"):
        assert getattr(after.controller, part) is getattr(before.controller, part), part
    set_bandwidth(talk, b"LIM_FENCE_M", 50.0)
    assert talk.session.service.settings.limits.fence_radius_m == 50.0
    assert talk.session.service.settings.controller is after.controller


def test_clocks_are_compared_five_times_a_second_and_never_unless_told(scripted, read, talk):
    talk.telemetry(3.0)
    assert talk.sent("TIMESYNC") == []
    comparing = Talk(scripted, read, compare_clocks=True)
    comparing.telemetry(3.0)
    requests = comparing.sent("TIMESYNC")
    assert [(message.tc1, message.ts1 // 1000 - START_US) for message in requests] == [
        (0, 200_000 * k) for k in range(16)
    ]


def test_a_restarted_autopilots_clock_gives_no_latency_instead_of_a_wrong_one(scripted, read):
    talk = Talk(scripted, read, compare_clocks=True)
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


def test_engaging_in_shadow_mode_is_denied_for_good(scripted, read):
    talk = Talk(scripted, read)
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


def test_a_repetition_is_known_whatever_others_have_asked_since(talk):
    """Two ground stations: while one waits for its answer, the other one talks, too."""
    engage(talk)
    other = talk._scripted(254, 190)
    talk.hear(other, command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HEARTBEAT))
    talk.hear(talk.ground, command(mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_HEARTBEAT))
    talk.hear(talk.autopilot, talk._scripted.heartbeat(custom_mode=3 << 16, armed=True))  # the pilot's mode
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
def test_a_frame_that_comes_by_two_ways_is_one_command(talk, way):
    release = command(mavlink.MAV_CMD_DO_GRIPPER, 1.0, 0.0)
    if way == "COMMAND_INT":
        asked = (245, 191, 0, mavlink.MAV_CMD_DO_GRIPPER, 0, 0, 1.0, 0.0, 0, 0, 0, 0, 0)
        release = mavlink.MAVLink_command_int_message(*asked)
    frame = talk.ground.pack(release)
    for _ in range(2):
        talk.session.handle(talk.time_us, talk._read(frame)[0])
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


def test_a_daemon_without_parameters_says_so(scripted, read):
    talk = Talk(scripted, read)
    talk.session = Session(Service(CONFIG.service), talk.link, Route())
    talk.hear(talk.ground, mavlink.MAVLink_param_request_list_message(245, 191))
    talk.hear(talk.ground, mavlink.MAVLink_param_request_read_message(245, 191, b"ALT_OMEGA_C", -1))
    talk.hear(talk.ground, command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 2.0))
    assert talk.sent("PARAM_VALUE") == []
    assert talk.sent("COMMAND_ACK")[0].result == mavlink.MAV_RESULT_FAILED


def test_two_ground_stations_that_keep_asking_for_the_list_get_all_of_it_at_its_own_pace(talk):
    """Each request began it anew and sent its first part at once: nobody got past that."""
    for _ in range(100):
        talk.time_us += 10_000
        for sender in (talk.ground, talk._scripted(254, 190)):
            talk.hear(sender, mavlink.MAVLink_param_request_list_message(245, 191))
        talk.session.advance(talk.time_us)
    values = talk.sent("PARAM_VALUE")
    assert {value.param_index for value in values} == set(range(len(CONFIG.tuning.tunables)))
    assert len(values) <= 105, "100 a second"


def test_more_changes_than_there_is_time_for_are_as_if_lost(talk):
    """Each takes milliseconds: two ground stations at 100 Hz kept control from running."""
    wanted = [7.0, 9.0]
    for _ in range(100):
        talk.time_us += 10_000
        for value in wanted:
            talk.hear(talk.ground, mavlink.MAVLink_param_set_message(245, 191, b"ALT_OMEGA_C", value, 9))
    said = "".join(message.text for message in talk.sent("STATUSTEXT"))
    assert 15 <= said.count("->") <= 25, "20 a second"
    assert said.count("PARAM_SET: more than 20 a second are not answered; send them again") == 1
    before = len(talk.sent("COMMAND_ACK"))
    for _ in range(20):
        talk.hear(talk.ground, command(mavlink.MAV_CMD_PREFLIGHT_STORAGE, 2.0))
    results = [answer.result for answer in talk.sent("COMMAND_ACK")[before:]]
    assert results.count(mavlink.MAV_RESULT_TEMPORARILY_REJECTED) >= 15
    talk.time_us += 1_000_000
    assert set_bandwidth(talk, b"ALT_OMEGA_C", 7.5)[0] == 7.5


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
def test_whatever_somebody_sends_the_daemon_flies_on(scripted, read, messages, as_autopilot):
    talk = Talk(scripted, read, compare_clocks=True)
    for message in messages:
        talk.hear(talk.autopilot if as_autopilot else talk.ground, message)
        talk.telemetry(0.03)
    before = len(talk.signals)
    talk.telemetry(0.1)
    assert len(talk.signals) > before or talk.session.service.finished is not None
    assert talk.session.refusal is None
