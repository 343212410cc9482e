"""The ArduCopter personality: modes, arming, guided setpoints and their loss, own flight."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
FAILED = mavlink.MAV_RESULT_FAILED
SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
TAKEOFF = mavlink.MAV_CMD_NAV_TAKEOFF
GRIPPER = mavlink.MAV_CMD_DO_GRIPPER
GUIDED, LOITER, LAND, BRAKE, GUIDED_NOGPS = 4, 5, 9, 17, 20
HOVER = 0.3984


def tilt(pilot) -> float:
    return math.hypot(*pilot.vehicle.state.euler[0:2])


def test_boots_disarmed_in_stabilize(copter):
    copter.run(1.1)
    beat = copter.messages("HEARTBEAT")[0]
    assert beat.autopilot == mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    assert beat.custom_mode == 0
    assert not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


@pytest.mark.parametrize(
    ("number", "name"),
    [
        (0, "STABILIZE"),
        (2, "ALT_HOLD"),
        (4, "GUIDED"),
        (5, "LOITER"),
        (6, "RTL"),
        (9, "LAND"),
        (17, "BRAKE"),
        (20, "GUIDED_NOGPS"),
    ],
)
def test_modes_have_arducopters_numbers(copter, number, name):
    assert copter.ask(SET_MODE, 1, number) == ACCEPTED
    assert copter.mode == name
    copter.run(1.0)
    assert copter.messages("HEARTBEAT")[-1].custom_mode == number


@pytest.mark.parametrize("number", [1, 3, 77])
def test_a_mode_that_it_cannot_fly_is_refused(copter, number):
    assert copter.ask(SET_MODE, 1, number) == FAILED
    assert copter.mode == "STABILIZE"


def test_guided_arms_once_there_is_a_position_and_guided_nogps_before(make_pilot):
    pilot = make_pilot("ardupilot", vehicle={"attitude_ready_s": 0.2, "position_ready_s": 1.0})
    assert pilot.ask(SET_MODE, 1, GUIDED) == FAILED
    assert pilot.ask(SET_MODE, 1, GUIDED_NOGPS) == ACCEPTED
    assert pilot.ask(ARM, 1) == FAILED
    pilot.run(0.2)
    assert pilot.ask(ARM, 1) == ACCEPTED
    assert pilot.ask(SET_MODE, 1, GUIDED) == FAILED
    pilot.run(1.0)
    assert pilot.ask(SET_MODE, 1, GUIDED) == ACCEPTED


def test_arming_is_refused_in_a_mode_without_takeoff(copter):
    copter.ask(SET_MODE, 1, LAND)
    assert copter.ask(ARM, 1) == FAILED


def test_arms_in_stabilize_stays_down_and_takes_off_from_guided(copter):
    """What MAVSDK does: arm in whatever mode it finds, then GUIDED, then take off."""
    assert copter.ask(ARM, 1) == ACCEPTED
    copter.run(3.0)
    assert copter.height == 0.0
    assert copter.ask(SET_MODE, 1, GUIDED) == ACCEPTED
    assert copter.ask(TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == ACCEPTED
    copter.run(5.0)
    assert copter.height == pytest.approx(2.0, abs=0.15)


def test_outputs_stay_low_for_2_s_and_spool_up_for_half_a_second(copter):
    copter.arm()
    armed = copter.vehicle.truth.time_of("armed")
    while max(copter.vehicle.firmware.motor_commands) == 0.0 and copter.now < 5.0:
        copter.run(0.01, lambda: copter.setpoint(thrust=0.2))
    assert copter.now - armed == pytest.approx(2.5, abs=0.05)


def test_spooling_starts_when_thrust_is_first_asked_for(copter):
    copter.arm()
    copter.run(3.0)
    asked = copter.now
    while max(copter.vehicle.firmware.motor_commands) == 0.0 and copter.now < 6.0:
        copter.run(0.01, lambda: copter.setpoint(thrust=0.2))
    assert copter.now - asked == pytest.approx(0.5, abs=0.03)


# --------------------------------------------------------------------------------- setpoints


def test_setpoints_are_ignored_outside_guided(copter):
    copter.engage_in_flight()
    copter.ask(SET_MODE, 1, LOITER)
    copter.run(1.0, lambda: copter.setpoint(rates=(1.0, 0.0, 0.0)))
    assert tilt(copter) < 0.1


@pytest.mark.parametrize("mode", [GUIDED, GUIDED_NOGPS])
def test_rates_and_thrust_are_followed_in_both_guided_modes(copter, mode):
    copter.engage_in_flight(mode)
    copter.run(0.3, lambda: copter.setpoint(rates=(0.5, 0.0, 0.0), thrust=0.5))
    assert copter.vehicle.state.body_rates[0] == pytest.approx(0.5, abs=0.05)
    assert float(copter.vehicle.state.total_thrust) == pytest.approx(0.5 * 246.0, rel=0.02)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_rate_step_passes_10_50_90_percent_at_31_55_90_ms(copter, axis):
    copter.engage_in_flight()
    times = copter.rise_times(axis, (0.1, 0.5, 0.9))
    for measured, expected in zip(times, (0.031, 0.055, 0.090), strict=True):
        assert measured == pytest.approx(expected, abs=0.010)


def test_a_rate_step_is_faster_without_the_acceleration_limit(make_pilot):
    pilot = make_pilot("ardupilot", parameters={"GUID_OPTIONS": 8, "ATC_ACCEL_R_MAX": 0})
    pilot.engage_in_flight()
    first, half, _ = pilot.rise_times(0, (0.1, 0.5, 0.9))
    assert first < 0.025
    assert half < 0.050


def test_body_rates_are_limited_by_atc_rate_max(make_pilot):
    pilot = make_pilot("ardupilot", parameters={"GUID_OPTIONS": 8, "ATC_RATE_R_MAX": 20})
    pilot.engage_in_flight()
    pilot.run(0.4, lambda: pilot.setpoint(rates=(2.0, 0.0, 0.0)))
    assert pilot.vehicle.state.body_rates[0] == pytest.approx(math.radians(20.0), abs=0.05)


def test_attitude_is_followed(copter):
    copter.engage_in_flight()
    angle = math.radians(10.0)
    attitude = (math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0)
    copter.run(1.0, lambda: copter.setpoint(7, attitude=attitude))
    assert copter.vehicle.state.euler[0] == pytest.approx(angle, abs=0.02)


@pytest.mark.parametrize(
    ("mask", "attitude"),
    [(192, (1.0, 0.0, 0.0, 0.0)), (129, (1.0, 0.0, 0.0, 0.0)), (7, (1.1, 0.0, 0.0, 0.0))],
)
def test_a_mask_or_quaternion_that_it_cannot_use_starts_the_mode_afresh(copter, mask, attitude):
    """It stops where it is, instead of turning on or stopping its motors."""
    copter.engage_in_flight()
    copter.run(0.3, lambda: copter.setpoint(rates=(0.6, 0.0, 0.0)))
    copter.setpoint(mask, (0.6, 0.0, 0.0), 0.0, attitude)
    copter.run(3.0)
    assert copter.mode == "GUIDED"
    assert tilt(copter) < 0.1
    assert abs(copter.vehicle.state.velocity[2]) < 0.3


def test_without_guid_options_8_thrust_is_a_climb_rate(make_pilot):
    pilot = make_pilot("ardupilot")
    pilot.arm()
    pilot.run(2.7, lambda: pilot.setpoint(thrust=0.9))
    pilot.place()
    pilot.run(0.3, lambda: pilot.setpoint(thrust=0.9))
    pilot.run(2.0, lambda: pilot.setpoint(thrust=0.5))
    start = pilot.height
    pilot.run(2.0, lambda: pilot.setpoint(thrust=0.5))
    assert pilot.height == pytest.approx(start, abs=0.1)
    pilot.run(3.0, lambda: pilot.setpoint(thrust=1.0))
    assert pilot.vehicle.state.velocity[2] == pytest.approx(2.5, abs=0.2)
    pilot.run(5.0, lambda: pilot.setpoint(thrust=0.0))
    assert pilot.vehicle.state.velocity[2] == pytest.approx(-1.5, abs=0.2)


@pytest.mark.parametrize(("boost", "factor"), [(0, 1.0), (1, 1.0 / math.cos(0.4))])
def test_angle_boost_raises_thrust_against_tilt(make_pilot, boost, factor):
    pilot = make_pilot("ardupilot", parameters={"GUID_OPTIONS": 8, "ATC_ANGLE_BOOST": boost})
    pilot.engage_in_flight()
    attitude = (math.cos(0.2), math.sin(0.2), 0.0, 0.0)
    pilot.run(1.0, lambda: pilot.setpoint(7, attitude=attitude))
    assert float(pilot.vehicle.state.total_thrust) == pytest.approx(HOVER * 246.0 * factor, rel=0.02)


def test_attitude_target_shows_what_is_followed(copter):
    copter.engage_in_flight()
    copter.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET, 20_000)
    copter.run(0.3, lambda: copter.setpoint(rates=(0.3, 0.0, 0.0), thrust=0.45))
    target = copter.messages("ATTITUDE_TARGET")[-1]
    assert target.thrust == pytest.approx(0.45)
    assert target.body_roll_rate == pytest.approx(0.3, abs=0.1)


# ------------------------------------------------------------------------- loss of the stream


@pytest.mark.parametrize("timeout", [0.5, 2.0])
def test_stale_rates_run_on_for_guid_timeout_then_it_levels(make_pilot, timeout):
    pilot = make_pilot("ardupilot", parameters={"GUID_OPTIONS": 8, "GUID_TIMEOUT": timeout})
    pilot.engage_in_flight(height=60.0)
    rate = 0.2
    pilot.run(0.1, lambda: pilot.setpoint(rates=(rate, 0.0, 0.0)))
    pilot.run(timeout - 0.05)
    assert pilot.vehicle.state.euler[0] > 0.7 * rate * timeout
    pilot.run(2.5)
    assert tilt(pilot) < 0.03
    assert abs(pilot.vehicle.state.velocity[2]) < 0.3
    assert math.hypot(*pilot.vehicle.state.velocity[0:2]) > 0.2, "there is no horizontal hold"
    assert pilot.mode == "GUIDED"


def test_guid_timeout_is_never_shorter_than_a_tenth_of_a_second(make_pilot):
    pilot = make_pilot("ardupilot", parameters={"GUID_OPTIONS": 8, "GUID_TIMEOUT": 0.0})
    pilot.engage_in_flight()
    pilot.run(0.5, lambda: pilot.setpoint(rates=(0.5, 0.0, 0.0)), every=0.05)
    assert pilot.vehicle.state.euler[0] > 0.15


# ------------------------------------------------------------------------------ flying itself


def test_takes_off_in_guided_holds_lands_and_disarms_itself(copter):
    copter.take_off(3.0)
    assert copter.mode == "GUIDED"
    assert copter.height == pytest.approx(3.0, abs=0.1)
    assert copter.ask(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    copter.run(10.0)
    assert not copter.vehicle.firmware.armed
    assert copter.height == 0.0
    assert math.hypot(*copter.vehicle.state.position[0:2]) < 0.3


def test_takeoff_in_guided_nogps_does_not_lift_off(copter):
    copter.arm(GUIDED_NOGPS)
    copter.ask(TAKEOFF, 0, 0, 0, 0, 0, 0, 3.0)
    copter.run(5.0)
    assert copter.height == 0.0


def test_takeoff_is_refused_while_disarmed(copter):
    copter.ask(SET_MODE, 1, GUIDED)
    assert copter.ask(TAKEOFF, 0, 0, 0, 0, 0, 0, 3.0) == FAILED


def test_disarming_in_flight_is_refused_unless_forced(copter):
    copter.engage_in_flight()
    assert copter.ask(ARM, 0) == FAILED
    assert copter.ask(ARM, 0, 21196) == ACCEPTED
    assert not copter.vehicle.firmware.armed


def test_brake_stops_the_vehicle(copter):
    copter.engage_in_flight()
    copter.vehicle.state.rigid[3] = 3.0
    copter.ask(SET_MODE, 1, BRAKE)
    copter.run(5.0)
    assert math.hypot(*copter.vehicle.state.velocity[0:2]) < 0.1


def test_returns_home_and_lands_there(make_pilot):
    pilot = make_pilot("ardupilot", parameters={"GUID_OPTIONS": 8, "RTL_ALT": 600, "LAND_SPEED": 100})
    pilot.engage_in_flight(height=5.0)
    pilot.vehicle.state.rigid[0:2] = (12.0, -5.0)
    assert pilot.ask(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    pilot.run(20.0)
    assert math.hypot(*pilot.vehicle.state.position[0:2]) < 1.5
    assert not pilot.vehicle.firmware.armed


def test_its_own_height_loop_is_stiffer_than_px4s(copter):
    copter.engage_in_flight()
    copter.ask(SET_MODE, 1, LOITER)
    copter.run(2.0)
    assert 0.15 < copter.peak_after(5.0, 5.0) < 0.35
    assert 0.15 < copter.peak_after(0.0, 5.0) < 0.35


# ----------------------------------------------------------------------------------- gripper


def test_the_gripper_answers_at_once_and_says_so_half_a_second_later(copter):
    copter.run(0.2)
    asked = copter.now
    assert copter.ask(GRIPPER, 1, mavlink.GRIPPER_ACTION_GRAB) == ACCEPTED
    assert copter.vehicle.state.load_mass == 5.0
    copter.run(0.6)
    assert "Gripper load grabbed" in copter.texts()
    assert copter.times("COMMAND_ACK")[-1] - asked <= 0.0101
    assert copter.times("STATUSTEXT")[-1] - asked == pytest.approx(0.5, abs=0.02)


def test_a_disabled_gripper_fails(make_pilot):
    pilot = make_pilot("ardupilot", parameters={"GRIP_ENABLE": 0})
    assert pilot.ask(GRIPPER, 1, mavlink.GRIPPER_ACTION_GRAB) == FAILED
    assert pilot.vehicle.state.load_mass == 0.0
