"""`[companion] allow`: who may command; who may not is told so, and may still read."""

import dataclasses

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import ConfigError, build, bundled, load, read_toml
from kffa_offboard.config_log import make_companion
from kffa_offboard.mavlink.component import Route
from kffa_offboard.offboard.events import Announce, EngageRequested, PositionSetpoint, SettingsChanged

CONFIG = load(bundled("demo-px4.toml"))
TIME_US = 5_000_000
ENGAGE = mavlink.MAVLink_command_long_message(
    245, 191, mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 0, 1, 0, 0, 0, 0, 0, 0
)
SET = mavlink.MAVLink_param_set_message(245, 191, b"ALT_OMEGA_C", 4.5, mavlink.MAV_PARAM_TYPE_REAL32)
SETPOINT = mavlink.MAVLink_set_position_target_local_ned_message(
    1, 245, 191, 1, 2552 + 3 + 1024, 0, 0, -5, 0, 0, 0, 0, 0, 0, 0, 0
)


@pytest.fixture
def companion():
    return make_companion(dataclasses.replace(CONFIG, allowed=((255, None), (1, 100))), Route())


@pytest.fixture
def hear(companion, scripted):
    """What the service is told and what is replied when somebody sends a message."""

    def hear(ids, message):
        events = companion.receive(TIME_US, scripted(*ids).over_the_wire(message))
        return [type(event) for event in events], companion.take()

    return hear


@pytest.mark.parametrize("ids", [(255, 190), (255, 1), (1, 100)])
@pytest.mark.parametrize(
    ("message", "event"),
    [(ENGAGE, EngageRequested), (SET, SettingsChanged), (SETPOINT, PositionSetpoint)],
)
def test_those_who_are_allowed_are_obeyed(hear, ids, message, event):
    assert hear(ids, message)[0] == [event]


@pytest.mark.parametrize("ids", [(254, 190), (1, 1), (1, 101)])
@pytest.mark.parametrize("message", [ENGAGE, SET, SETPOINT])
def test_the_others_are_not_and_that_is_said_once(hear, ids, message):
    first, again = hear(ids, message), hear(ids, message)
    assert first[0] == again[0] == []
    texts = [reply.text for reply in first[1] if isinstance(reply, Announce)]
    assert len(texts) == 1
    assert texts[0].endswith(f" of {ids[0]}/{ids[1]} not allowed")
    assert not any(isinstance(reply, Announce) for reply in again[1])


def test_a_refused_command_is_answered_denied_and_a_refused_parameter_with_its_present_value(hear):
    acknowledged = hear((254, 1), ENGAGE)[1][-1]
    assert acknowledged.get_type() == "COMMAND_ACK"
    assert (acknowledged.result, acknowledged.target_system) == (mavlink.MAV_RESULT_DENIED, 254)
    value = hear((254, 1), SET)[1][-1]
    assert value.get_type() == "PARAM_VALUE"
    assert value.param_value == pytest.approx(CONFIG.service.controller.law.omega_c[3])


def test_a_refusal_does_not_become_the_answer_to_somebody_elses_repetition(hear):
    assert hear((255, 190), ENGAGE)[1][-1].result == mavlink.MAV_RESULT_ACCEPTED
    hear((254, 1), ENGAGE)
    again = mavlink.MAVLink_command_long_message(245, 191, 92, 1, 1, 0, 0, 0, 0, 0, 0)
    assert hear((255, 190), again)[1][-1].result == mavlink.MAV_RESULT_ACCEPTED


def test_everybody_may_read(hear):
    ask = mavlink.MAVLink_command_long_message(245, 191, 512, 0, 148, 0, 0, 0, 0, 0, 0)
    assert [reply.get_type() for reply in hear((254, 1), ask)[1]] == ["AUTOPILOT_VERSION", "COMMAND_ACK"]
    read = mavlink.MAVLink_param_request_read_message(245, 191, b"ALT_OMEGA_C", -1)
    assert [reply.get_type() for reply in hear((254, 1), read)[1]] == ["PARAM_VALUE"]


def test_nobody_is_allowed_with_an_empty_list(scripted):
    closed = make_companion(dataclasses.replace(CONFIG, allowed=()), Route())
    assert closed.receive(TIME_US, scripted(255, 190).over_the_wire(ENGAGE)) == []


def configured(companion_table):
    path = bundled("demo-px4.toml")
    return build(read_toml(path) | {"companion": companion_table}, path, CONFIG.overrides)


def test_the_list_is_read_from_the_configuration_and_left_out_allows_everybody():
    assert CONFIG.allowed is None
    assert configured({"allow": ["255", "1/100"]}).allowed == ((255, None), (1, 100))
    assert configured({"allow": []}).allowed == ()


@pytest.mark.parametrize("text", ["", "0", "256", "255/0", "1/2/3", "gcs", "-1", "255/", "٣", "1" * 5000])
def test_what_is_no_sender_is_an_error(text):
    with pytest.raises(ConfigError, match="is no sender; write"):
        configured({"allow": [text]})
