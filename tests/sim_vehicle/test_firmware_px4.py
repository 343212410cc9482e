"""The PX4 personality: modes, arming, OFFBOARD and its loss, setpoints, own flight."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
REJECTED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED
SET_MODE = mavlink.MAV_CMD_DO_SET_MODE
ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
GRIPPER = mavlink.MAV_CMD_DO_GRIPPER
OFFBOARD = 6
FORCE = 21196
HOVER = 0.3984


def roll_quaternion(angle: float) -> tuple[float, ...]:
    return (math.cos(angle / 2), math.sin(angle / 2), 0.0, 0.0)


def test_boots_disarmed_in_hold_with_px4s_mode_number(px4):
    px4.run(1.1)
    beat = px4.messages("HEARTBEAT")[0]
    assert beat.autopilot == mavlink.MAV_AUTOPILOT_PX4
    assert beat.custom_mode == 4 << 16 | 3 << 24
    assert not beat.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED


def test_arming_is_refused_until_the_estimator_has_a_position(make_pilot):
    pilot = make_pilot("px4", vehicle={"attitude_ready_s": 0.1, "position_ready_s": 0.5})
    assert pilot.ask(ARM, 1) == REJECTED
    pilot.run(0.5)
    assert pilot.ask(ARM, 1) == ACCEPTED


# ------------------------------------------------------------------------------ OFFBOARD


def test_a_switch_to_offboard_without_a_stream_is_refused(px4):
    assert px4.ask(SET_MODE, 1, OFFBOARD) == REJECTED
    assert px4.mode == "HOLD"


def test_a_switch_to_offboard_after_the_stream_went_stale_is_refused(px4):
    px4.run(0.3, px4.setpoint)
    px4.run(1.1)
    assert px4.ask(SET_MODE, 1, OFFBOARD) == REJECTED


def test_a_switch_to_offboard_with_a_stream_is_accepted_19_to_31_ms_later(px4):
    px4.run(0.3, px4.setpoint)
    asked = px4.now
    px4.command(SET_MODE, 1, OFFBOARD)
    px4.run(0.1, px4.setpoint, every=0.0025)
    assert px4.results(SET_MODE) == [ACCEPTED]
    assert 0.019 <= px4.times("COMMAND_ACK")[0] - asked <= 0.031
    assert px4.mode == "OFFBOARD"


@pytest.mark.parametrize("loss_time", [1.0, 0.3])
def test_a_lost_stream_ends_offboard_in_hold_and_a_resumed_one_brings_it_back(make_pilot, loss_time):
    pilot = make_pilot("px4", parameters={"COM_OF_LOSS_T": loss_time, "COM_OBL_RC_ACT": 5})
    pilot.engage_in_flight()
    last = pilot.now - 0.01
    pilot.run(loss_time + 0.3, every=0.0025)
    lost = pilot.vehicle.truth.time_of("offboard lost")
    assert loss_time + 0.06 < lost - last < loss_time + 0.1
    assert pilot.mode == "HOLD"
    assert pilot.vehicle.firmware.in_failsafe
    resumed = pilot.now
    pilot.run(0.1, pilot.setpoint, every=0.0025)
    assert pilot.mode == "OFFBOARD"
    assert pilot.vehicle.truth.time_of("offboard regained") - resumed < 0.05


def test_a_stream_of_2_hz_holds_offboard(px4):
    px4.engage_in_flight()
    px4.run(3.0, px4.setpoint, every=0.5)
    assert px4.mode == "OFFBOARD"


@pytest.mark.parametrize(
    ("action", "mode"),
    [(0, "POSITION"), (1, "ALTITUDE"), (2, "STABILIZED"), (3, "RTL"), (4, "LAND"), (5, "HOLD")],
)
def test_com_obl_rc_act_chooses_the_mode_after_a_lost_stream(make_pilot, action, mode):
    pilot = make_pilot("px4", parameters={"COM_OBL_RC_ACT": action})
    pilot.engage_in_flight()
    pilot.run(1.2)
    assert pilot.mode == mode
    assert pilot.vehicle.firmware.armed


@pytest.mark.parametrize("action", [6, 7])
def test_terminate_and_disarm_stop_the_motors_after_a_lost_stream(make_pilot, action):
    pilot = make_pilot("px4", parameters={"COM_OBL_RC_ACT": action})
    pilot.engage_in_flight()
    pilot.run(1.5)
    assert pilot.vehicle.firmware.motor_commands == [0.0] * 4
    assert pilot.vehicle.firmware.armed == (action == 6)


def test_a_mode_that_the_pilot_chose_is_not_left_when_setpoints_come(px4):
    px4.engage_in_flight()
    px4.ask(SET_MODE, 1, 4, 3)
    px4.run(1.5, px4.setpoint)
    assert px4.mode == "HOLD"


# ----------------------------------------------------------------------------- setpoints


def test_mask_192_gives_no_thrust_and_stops_the_motors(px4):
    px4.engage_in_flight()
    px4.run(0.1, lambda: px4.setpoint(mask=192))
    assert px4.mode == "OFFBOARD"
    assert max(px4.vehicle.firmware.motor_commands) == 0.0


def test_mask_129_is_refused_so_that_the_mode_is_lost(px4):
    px4.engage_in_flight()
    px4.run(1.2, lambda: px4.setpoint(mask=129))
    assert px4.mode != "OFFBOARD"


@pytest.mark.parametrize("mask", [7, 0])
def test_attitude_is_followed_and_wins_over_body_rates(px4, mask):
    px4.engage_in_flight()
    angle = math.radians(10.0)
    px4.run(0.8, lambda: px4.setpoint(mask, (2.0, 0.0, 0.0), HOVER, roll_quaternion(angle)))
    assert px4.vehicle.state.euler[0] == pytest.approx(angle, abs=0.02)


def test_a_yaw_rate_that_is_no_number_counts_as_none(px4):
    px4.engage_in_flight()
    heading = px4.vehicle.state.euler[2]
    px4.run(1.0, lambda: px4.setpoint(0, (0.0, 0.0, math.nan), HOVER, (1.0, 0.0, 0.0, 0.0)))
    assert px4.mode == "OFFBOARD"
    assert px4.vehicle.state.euler[2] == pytest.approx(heading, abs=0.05)


def test_a_hover_thrust_of_zero_is_survived(px4):
    px4.engage_in_flight()
    px4.vehicle.firmware.parameters.set("MPC_THR_HOVER", 0.0)
    px4.run(0.1)
    assert px4.ask(SET_MODE, 1, 4, 3) == ACCEPTED
    px4.run(0.5)
    assert np.isfinite(px4.vehicle.state.rigid).all()


def test_thrust_is_taken_as_it_is(px4):
    px4.engage_in_flight()
    px4.run(0.5, lambda: px4.setpoint(thrust=0.5))
    assert float(px4.vehicle.state.total_thrust) == pytest.approx(0.5 * 246.0, rel=0.01)


def test_a_thrust_curve_that_the_motors_do_not_have_alters_thrust(make_pilot):
    pilot = make_pilot("px4", parameters={"THR_MDL_FAC": 0.5})
    pilot.engage_in_flight()
    pilot.run(0.5, lambda: pilot.setpoint(thrust=0.5))
    assert float(pilot.vehicle.state.total_thrust) > 0.55 * 246.0


@pytest.mark.parametrize("axis", [0, 1])
def test_roll_and_pitch_rate_reach_63_percent_in_60_to_90_ms(px4, axis):
    px4.engage_in_flight()
    (reached,) = px4.rise_times(axis, (0.632,))
    assert 0.060 <= reached <= 0.090


def test_yaw_rate_takes_about_400_ms(px4):
    px4.engage_in_flight()
    (reached,) = px4.rise_times(2, (0.632,))
    assert 0.35 <= reached <= 0.45


def test_the_rate_loop_has_an_integrator_that_takes_up_a_steady_torque(make_pilot):
    """A load off centre pitches the vehicle; told not to turn, it turns ever more slowly."""

    def mean_pitch_rate(integral):
        parameters = {"MC_PITCHRATE_I": integral}
        pilot = make_pilot("px4", payload={"offset_m": [0.05, 0.0, -0.3]}, parameters=parameters)
        pilot.engage_in_flight()
        pilot.vehicle.set_load(1.0)
        pilot.run(3.0, pilot.setpoint)
        return abs(np.mean([row.state[10] for row in pilot.vehicle.truth.rows[-50:]]))

    assert mean_pitch_rate(0.2) < 0.4 * mean_pitch_rate(0.0)


@pytest.mark.parametrize(("before", "after"), [(128, 7), (7, 128)])
def test_a_setpoint_of_another_kind_counts_when_the_control_mode_is_looked_up(px4, before, after):
    """Twice a second (Commander.cpp); real PX4 held the last thrust of rates for 0.5 s of level attitudes."""
    px4.engage_in_flight()
    waited = []
    for number in range(4):
        px4.run(0.6 + 0.13 * number, lambda: px4.setpoint(mask=before, thrust=0.36))
        for step in range(80):
            px4.run(0.01, lambda: px4.setpoint(mask=after, thrust=0.44))
            if float(px4.vehicle.state.total_thrust) > 0.40 * 246.0:
                waited.append(0.01 * (step + 1))
                break
    assert len(waited) == 4
    assert 0.3 < max(waited) < 0.6
    assert max(waited) - min(waited) > 0.2, "it depends on the moment"


def test_offboard_begins_with_the_kind_that_is_streamed(px4):
    px4.engage_in_flight()
    px4.run(0.7, lambda: px4.setpoint(mask=7))
    assert px4.ask(SET_MODE, 1, 4, 3) == ACCEPTED
    px4.run(0.05, lambda: px4.setpoint(mask=128))
    assert px4.ask(SET_MODE, 1, 6, 0) == ACCEPTED
    px4.run(0.1, lambda: px4.setpoint(mask=128, thrust=0.5))
    assert float(px4.vehicle.state.total_thrust) > 0.45 * 246.0


def test_attitude_target_in_rate_mode_shows_the_thrust_of_the_attitude_setpoint(px4):
    px4.engage_in_flight()
    px4.run(0.2, lambda: px4.setpoint(mask=7, thrust=0.37))
    px4.run(0.3, lambda: px4.setpoint(thrust=0.45))
    target = px4.messages("ATTITUDE_TARGET")[-1]
    assert target.type_mask == 0
    assert target.thrust == pytest.approx(0.37)


# -------------------------------------------------------------------------- flying itself


def test_takes_off_to_mis_takeoff_alt_holds_lands_and_disarms_itself(px4):
    px4.take_off()
    assert px4.mode == "HOLD"
    assert px4.height == pytest.approx(2.5, abs=0.1)
    assert px4.ask(mavlink.MAV_CMD_NAV_LAND) == ACCEPTED
    px4.run(12.0)
    events = [event.text for event in px4.vehicle.truth.events]
    assert events.index("landed") < events.index("disarmed")
    assert not px4.vehicle.firmware.armed
    assert abs(px4.vehicle.state.position[0]) < 0.3


def test_a_take_off_to_a_height_below_the_vehicle_ends_in_hold_on_the_ground(make_pilot):
    """Heights are above the sea: a client that asks for 2 m and means above home is told."""
    pilot = make_pilot("px4", parameters={"COM_DISARM_PRFLT": 3.0})
    pilot.arm()
    assert pilot.ask(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, math.nan, math.nan, math.nan, 2.0) == ACCEPTED
    pilot.run(2.0)
    assert "Already higher than takeoff altitude" in pilot.texts()
    assert (pilot.mode, pilot.height) == ("HOLD", 0.0)
    assert float(pilot.vehicle.state.total_thrust) == 0.0
    pilot.run(1.5)
    assert not pilot.vehicle.firmware.armed


def test_landed_state_goes_through_takeoff_air_landing_ground(px4):
    px4.take_off()
    px4.ask(mavlink.MAV_CMD_NAV_LAND)
    px4.run(12.0)
    states = [message.landed_state for message in px4.messages("EXTENDED_SYS_STATE")]
    order = [state for index, state in enumerate(states) if index == 0 or state != states[index - 1]]
    assert order == [
        mavlink.MAV_LANDED_STATE_ON_GROUND,
        mavlink.MAV_LANDED_STATE_TAKEOFF,
        mavlink.MAV_LANDED_STATE_IN_AIR,
        mavlink.MAV_LANDED_STATE_LANDING,
        mavlink.MAV_LANDED_STATE_ON_GROUND,
    ]


def test_disarming_in_flight_is_refused_unless_forced(px4):
    px4.engage_in_flight()
    assert px4.ask(ARM, 0) == REJECTED
    assert px4.vehicle.firmware.armed
    assert px4.ask(ARM, 0, FORCE) == ACCEPTED
    assert not px4.vehicle.firmware.armed


def test_disarming_right_after_touchdown_is_refused_and_it_disarms_itself(px4):
    px4.engage_in_flight(height=0.3)
    px4.run(0.6, lambda: px4.setpoint(thrust=0.3))
    assert px4.height == 0.0
    px4.command(ARM, 0)
    px4.run(0.05, lambda: px4.setpoint(thrust=0.0))
    assert px4.results(ARM)[-1] == REJECTED
    px4.run(3.5, lambda: px4.setpoint(thrust=0.0))
    assert not px4.vehicle.firmware.armed


def test_an_armed_vehicle_that_does_not_take_off_disarms_after_com_disarm_prflt(make_pilot):
    pilot = make_pilot("px4", parameters={"COM_DISARM_PRFLT": 2.0})
    pilot.arm()
    pilot.run(1.8)
    assert pilot.vehicle.firmware.armed
    pilot.run(0.4)
    assert not pilot.vehicle.firmware.armed


def test_returns_home_and_lands_there(make_pilot):
    pilot = make_pilot("px4", parameters={"RTL_RETURN_ALT": 6.0})
    pilot.engage_in_flight(height=5.0)
    pilot.vehicle.state.rigid[0:2] = (12.0, -5.0)
    assert pilot.ask(mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH) == ACCEPTED
    pilot.run(25.0)
    assert math.hypot(*pilot.vehicle.state.position[0:2]) < 1.5
    assert pilot.height == 0.0


def test_its_own_height_loop_moves_05_to_08_m_at_a_pick_up_and_a_drop(px4):
    px4.engage_in_flight()
    px4.ask(SET_MODE, 1, 4, 3)
    px4.run(2.0)
    assert 0.5 < px4.peak_after(5.0, 6.0) < 0.8
    px4.run(4.0)
    assert 0.5 < px4.peak_after(0.0, 4.0) < 0.8


# ------------------------------------------------------------------------------- gripper


def test_the_gripper_is_in_progress_then_accepted_after_its_timeout(px4):
    px4.engage_in_flight()
    asked = px4.now
    px4.command(GRIPPER, 1, mavlink.GRIPPER_ACTION_GRAB)
    px4.run(1.3, lambda: px4.setpoint(thrust=0.6))
    assert px4.results(GRIPPER) == [mavlink.MAV_RESULT_IN_PROGRESS, ACCEPTED]
    assert px4.times("COMMAND_ACK")[-1] - asked == pytest.approx(1.02, abs=0.02)
    assert px4.vehicle.state.load_mass == 5.0
    px4.command(GRIPPER, 1, mavlink.GRIPPER_ACTION_RELEASE)
    px4.run(0.1, px4.setpoint)
    assert px4.vehicle.state.load_mass == 0.0


def test_a_disabled_gripper_does_not_even_answer(make_pilot):
    pilot = make_pilot("px4", parameters={"PD_GRIPPER_EN": 0})
    assert pilot.ask(GRIPPER, 1, mavlink.GRIPPER_ACTION_GRAB, wait=3.0) is None
    assert pilot.vehicle.state.load_mass == 0.0
