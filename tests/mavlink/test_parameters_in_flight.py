"""Parameters that are set while the daemon has control: what acts, and what is refused with the reason."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import Overrides, bundled, load


def storage(action):
    return mavlink.MAVLink_command_long_message(
        245, 191, mavlink.MAV_CMD_PREFLIGHT_STORAGE, 0, action, *[0.0] * 6
    )


def test_a_bandwidth_that_the_telemetry_does_not_bear_is_refused_in_flight(talk):
    talk.telemetry(3.0)
    (before,) = (t.value for t in talk.config.tuning.tunables if t.name == "ROLL_OMEGA_O")
    talk.set(b"ROLL_OMEGA_O", 260.0)
    assert talk.set(b"ROLL_OMEGA_O", before)[0] == before, "while it waits anything goes"
    talk.engage()
    flown = talk.session.service.settings
    refused = "ROLL_OMEGA_O refused: 260: attitude at 100 Hz; omega_o = 260 needs 104"
    assert talk.set(b"ROLL_OMEGA_O", 260.0) == (before, refused)
    assert talk.session.service.settings is flown
    assert talk.set(b"ROLL_OMEGA_O", 240.0) == (240.0, f"ROLL_OMEGA_O {before:g} -> 240")


def test_stored_values_that_the_telemetry_does_not_bear_are_not_read_in_flight(talk, monkeypatch):
    talk.engage()
    quick = talk.config.tuning.with_value("YAW_OMEGA_O", 300.0)
    monkeypatch.setattr(type(quick), "original", lambda tuning: quick)
    talk.link.sent.clear()
    talk.hear(talk.ground, storage(2.0))
    assert [answer.result for answer in talk.sent("COMMAND_ACK")] == [mavlink.MAV_RESULT_TEMPORARILY_REJECTED]
    texts = "".join(said.text for said in talk.sent("STATUSTEXT"))
    assert texts == "parameters stay: attitude at 100 Hz; omega_o = 300 needs 120"
    assert talk.session.service.settings is talk.config.service


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        (b"ALT_OMEGA_O", 250.0, "attitude at 100 Hz; omega_o = 250 needs 103"),
        (b"ALT_OMEGA_C", 20.0, "altitude: omega_c from 8 to 20; go in steps of 2 times at most"),
        (b"ROLL_OMEGA_C", 20.0, "roll: omega_c from 8 to 20; go in steps of 2 times at most"),
        (b"ALT_NOISE", 1e-4, "altitude: noise from 0.01 to 0.0001; go in steps of 3 times at most"),
        (b"ALT_RATE_NOISE", 10.0, "altitude: rate noise from 0.02 to 10; go in steps of 3 times at most"),
        (
            b"ALT_DIST_INT",
            1e-3,
            "altitude: disturbance_intensity from 100 to 0.001; go in steps of 10 times at most",
        ),
    ],
)
def test_a_number_that_would_swing_or_end_control_is_refused_in_flight(talk, name, value, reason):
    """One sample less in a second ended control at 250 rad/s; filters so far off swung by up to 0.9 m."""
    talk.engage()
    before = next(t.value for t in talk.config.tuning.tunables if t.name == name.decode())
    answered, said = talk.set(name, value)
    assert answered == pytest.approx(before)
    assert said == f"{name.decode()} refused: {value:g}: {reason}"


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        (b"PID_ROLL_P", 26.0, "roll: PID p from 6.5 to 26; go in steps of 2 times at most"),
        (b"PID_CLIMB_P", 0.0, "altitude: PID d from 4 to 0; go in steps of 2 times at most"),
        (b"PID_CLIMB_I", 1000.0, "altitude: PID i from 2 to 1e+03; go in steps of 4 times at most"),
        (b"PID_ALT_P", 2.0, None),
    ],
)
def test_a_cascade_of_pids_changes_its_gains_in_steps_in_flight(new_talk, name, value, reason):
    """With four times the gain on roll it swung by 0.4 rad, without that on the climb rate it rose by 3 m."""
    config = load(bundled("demo-px4.toml"), Overrides(controller="cascaded-pid"))
    talk = new_talk(config)
    talk.engage()
    answered, said = talk.set(name, value)
    assert (answered == value) == (reason is None)
    assert reason is None or said == f"{name.decode()} refused: {value:g}: {reason}"


def test_a_parameter_set_in_flight_leaves_what_was_worked_out_for_the_others(talk):
    """The gains of a Kalman filter cost milliseconds, which are the next control step's."""
    talk.engage()
    before = talk.session.service.settings
    talk.set(b"ALT_OMEGA_C", 6.0)
    after = talk.session.service.settings
    assert after.controller.law.omega_c[3] == 6.0
    for part in ("kalman", "model", "observer", "actuator", "differentiator", "fuzzy", "limits"):
        assert getattr(after.controller, part) is getattr(before.controller, part), part
    talk.set(b"LIM_FENCE_M", 50.0)
    assert talk.session.service.settings.limits.fence_radius_m == 50.0
    assert talk.session.service.settings.controller is after.controller


def test_two_ground_stations_that_keep_asking_for_the_list_get_all_of_it_at_its_own_pace(talk, scripted):
    """Each request began it anew and sent its first part at once: nobody got past that."""
    for _ in range(100):
        talk.time_us += 10_000
        for sender in (talk.ground, scripted(254, 190)):
            talk.hear(sender, mavlink.MAVLink_param_request_list_message(245, 191))
        talk.session.advance(talk.time_us)
    values = talk.sent("PARAM_VALUE")
    assert {value.param_index for value in values} == set(range(len(talk.config.tuning.tunables)))
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
        talk.hear(talk.ground, storage(2.0))
    results = [answer.result for answer in talk.sent("COMMAND_ACK")[before:]]
    assert results.count(mavlink.MAV_RESULT_TEMPORARILY_REJECTED) >= 15
    talk.time_us += 1_000_000
    assert talk.set(b"ALT_OMEGA_C", 7.5)[0] == 7.5
