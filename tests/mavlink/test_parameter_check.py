"""What is wrong with a parameter, how bad it is, and what to set."""

from dataclasses import replace
from math import radians

import pytest

from kffa_offboard.mavlink import parameter_check_ardupilot, parameter_check_px4
from kffa_offboard.mavlink.parameter_check import CheckSettings, judge_all, relevant
from kffa_offboard.offboard.settings import LimitSettings

SETTINGS = CheckSettings(
    output="rates",
    hover_thrust=0.4,
    limits=LimitSettings(),
    gripper=False,
    resend_s=0.2,
    px4_spool_time_s=1.0,
    ardupilot_spool_time_s=2.6,
)
GOOD = {
    "ardupilot": {
        "GUID_OPTIONS": 8.0,
        "GUID_TIMEOUT": 0.5,
        "ATC_ANGLE_BOOST": 0.0,
        "PILOT_THR_FILT": 0.0,
        "ATC_RATE_FF_ENAB": 1.0,
        "ATC_RATE_R_MAX": 0.0,
        "ATC_ACCEL_R_MAX": 110000.0,
        "ATC_ACCEL_Y_MAX": 27000.0,
        "MOT_THST_HOVER": 0.4,
        "MOT_SPOOL_TIME": 0.5,
        "FS_THR_ENABLE": 1.0,
        "FS_EKF_ACTION": 1.0,
    },
    "px4": {
        "COM_OF_LOSS_T": 1.0,
        "COM_OBL_RC_ACT": 5.0,
        "THR_MDL_FAC": 0.0,
        "MPC_THR_HOVER": 0.4,
        "MC_ROLLRATE_MAX": 100.0,
        "COM_RC_OVERRIDE": 3.0,
        "COM_RC_IN_MODE": 0.0,
    },
}
CHECKS = {"ardupilot": parameter_check_ardupilot.CHECKS, "px4": parameter_check_px4.CHECKS}


def judge(firmware, settings=SETTINGS, **changes):
    checks = relevant(CHECKS[firmware], settings)
    return judge_all(checks, settings, GOOD[firmware] | changes)


@pytest.mark.parametrize("firmware", ["ardupilot", "px4"])
def test_nothing_is_said_of_a_vehicle_that_is_set_up(firmware):
    assert judge(firmware) == ()


@pytest.mark.parametrize(
    ("firmware", "name", "value", "severity", "fix"),
    [
        ("ardupilot", "GUID_OPTIONS", 0.0, "unsafe", 8.0),
        ("ardupilot", "GUID_OPTIONS", 129.0, "unsafe", 137.0),
        ("ardupilot", "ATC_RATE_FF_ENAB", 0.0, "unsafe", 1.0),
        ("ardupilot", "GUID_TIMEOUT", 3.0, "warning", 0.5),
        ("ardupilot", "GUID_TIMEOUT", 0.1, "warning", 0.5),
        ("ardupilot", "ATC_ANGLE_BOOST", 1.0, "warning", 0.0),
        ("ardupilot", "PILOT_THR_FILT", 2.0, "warning", 0.0),
        ("ardupilot", "ATC_RATE_R_MAX", 60.0, "warning", None),
        ("ardupilot", "ATC_ACCEL_R_MAX", 30000.0, "warning", None),
        ("ardupilot", "MOT_THST_HOVER", 0.49, "warning", None),
        ("ardupilot", "MOT_SPOOL_TIME", 1.0, "warning", None),
        ("ardupilot", "MOT_THST_EXPO", 0.65, "information", None),
        ("ardupilot", "FS_THR_ENABLE", 0.0, "information", None),
        ("ardupilot", "FS_EKF_ACTION", 0.0, "information", None),
        ("px4", "COM_OBL_RC_ACT", 7.0, "unsafe", 5.0),
        ("px4", "COM_OBL_RC_ACT", 6.0, "unsafe", 5.0),
        ("px4", "COM_OBL_RC_ACT", 0.0, "information", None),
        ("px4", "COM_OF_LOSS_T", 5.0, "warning", 1.0),
        ("px4", "COM_OF_LOSS_T", 0.1, "warning", 1.0),
        ("px4", "MPC_THR_HOVER", 0.5, "warning", None),
        ("px4", "COM_SPOOLUP_TIME", 2.0, "warning", None),
        ("px4", "THR_MDL_FAC", 0.3, "information", None),
        ("px4", "COM_RC_OVERRIDE", 1.0, "information", None),
        ("px4", "COM_RC_IN_MODE", 4.0, "information", None),
    ],
)
def test_what_is_wrong_is_named_with_its_value_and_what_to_set(firmware, name, value, severity, fix):
    (finding,) = judge(firmware, **{name: value})
    assert (finding.name, finding.severity, finding.fix) == (name, severity, fix)
    assert finding.text.startswith(name)
    if fix is not None:
        assert f"set {name} {fix:g}" in finding.text
        assert judge(firmware, **{name: fix}) == ()


def test_thrust_that_would_be_a_climb_rate_is_refused_with_the_remedy():
    (finding,) = judge("ardupilot", GUID_OPTIONS=0.0)
    assert finding.text == (
        "GUID_OPTIONS bit 3 is off: thrust would be read as climb rate; set GUID_OPTIONS 8"
    )


def test_arducopter_that_does_not_report_guid_options_is_unsafe_and_other_gaps_are_not():
    checks = relevant(CHECKS["ardupilot"], SETTINGS)
    (finding,) = judge_all(checks, SETTINGS, {})
    assert (finding.name, finding.severity) == ("GUID_OPTIONS", "unsafe")
    assert judge_all(relevant(CHECKS["px4"], SETTINGS), SETTINGS, {}) == ()


def test_feed_forward_does_not_matter_to_attitude_setpoints():
    assert judge("ardupilot", replace(SETTINGS, output="attitude"), ATC_RATE_FF_ENAB=0.0) == ()


def test_px4_limits_rates_only_in_its_attitude_loop():
    angles = replace(SETTINGS, output="attitude")
    (finding,) = judge("px4", angles, MC_ROLLRATE_MAX=100.0)
    assert "roll_rate_max_deg_s" in finding.text
    slow = replace(SETTINGS.limits, body_rate_max_rad_s=(radians(90.0), 3.5, 1.5))
    assert judge("px4", replace(angles, limits=slow), MC_ROLLRATE_MAX=100.0) == ()


def test_hover_thrust_within_a_fifth_is_not_worth_a_word():
    for value in (0.33, 0.47):
        assert judge("px4", MPC_THR_HOVER=value) == ()


@pytest.mark.parametrize(("firmware", "name"), [("ardupilot", "GRIP_ENABLE"), ("px4", "PD_GRIPPER_EN")])
def test_the_gripper_is_looked_at_only_if_the_scenario_uses_it(firmware, name):
    assert judge(firmware, **{name: 0.0}) == ()
    working = replace(SETTINGS, gripper=True)
    assert judge(firmware, working, **{name: 1.0}) == ()
    for values in ({name: 0.0}, {}):
        (finding,) = judge(firmware, working, **values)
        assert (finding.name, finding.severity) == (name, "warning")
