"""From the ground into the air and back: take-off, scenario, landing, release."""

import numpy as np
import pytest

from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget, ModeKind, SetArmed, SetMode
from kffa_offboard.offboard.flight import FlightSample, Phase, begin_flight, step_flight
from kffa_offboard.offboard.segments import Gripper, Hold, Land, Sine, Step, Takeoff
from kffa_offboard.offboard.service import Finished, State
from kffa_offboard.offboard.settings import FlightSettings, SequenceSettings

HOLD = SetMode(ModeKind.HOLD)
LAND = SetMode(ModeKind.LAND)


def fly(fake, vehicle=None, output="rates", seconds=60.0, **changes):
    """Fly until the service has finished."""
    flight = fake.Lockstep(fake.settings(output, **changes), vehicle)
    flight.run(seconds, lambda: flight.service.finished is not None)
    return flight


def in_flight(fake, **changes):
    """Engaged in the air at 2 m, in a long hold."""
    flight = fake.Lockstep(fake.settings(scenario=(Hold(100.0),), **changes), fake.airborne(position=2.0))
    flight.run_to(State.ENGAGED)
    flight.run(0.5)
    flight.log.clear()
    return flight


def thrusts(flight):
    return np.array([target.thrust for _, target in flight.sent(AttitudeTarget)])


@pytest.mark.parametrize("output", ["rates", "attitude"])
@pytest.mark.parametrize(("firmware", "spool_s"), [("px4", 1.0), ("ardupilot", 2.5)])
def test_a_flight_takes_off_holds_and_lands(fake, output, firmware, spool_s):
    flight = fly(fake, fake.Vehicle(firmware=firmware, spool_s=spool_s), output)
    assert flight.service.finished == Finished(True, "scenario done, landed")
    assert flight.states == [State.WAITING, State.ENGAGING, State.ENGAGED, State.RELEASING, State.READY]
    assert not flight.vehicle.armed
    assert max(flight.altitudes) == pytest.approx(2.0, abs=0.03)
    assert len(flight.sent(SetArmed)) == 2
    kinds = {target.body_rates is None for _, target in flight.sent(AttitudeTarget)}
    assert kinds == {output == "attitude"}


def test_a_flight_under_the_papers_own_controller_is_as_good(fake):
    flight = fly(fake, controller=fake.papers_own)
    assert flight.service.finished == Finished(True, "scenario done, landed")
    assert max(flight.altitudes) == pytest.approx(2.0, abs=0.03)


def test_thrust_stays_zero_until_the_motors_have_spooled_up_and_then_ramps(fake):
    flight = fake.Lockstep(fake.settings(), fake.Vehicle(firmware="ardupilot", spool_s=2.5))
    flight.run_to(State.ENGAGED)
    armed_at = flight.time_us
    flight.run(5.0, lambda: flight.vehicle.position > 0.005)
    sent = [((time - armed_at) * 1e-6, target.thrust) for time, target in flight.sent(AttitudeTarget)]
    assert all(thrust == 0.0 for time, thrust in sent if time <= 2.6)
    ramp = np.array([[time, thrust] for time, thrust in sent if thrust > 0.0])
    slopes = np.diff(ramp[:, 1]) / np.diff(ramp[:, 0])
    np.testing.assert_allclose(slopes, 0.35, rtol=1e-6)
    assert ramp[-1, 1] == pytest.approx(fake.hover, abs=0.06)


@pytest.mark.parametrize("weight", [1.0, 1.5])
def test_liftoff_has_no_hop(fake, weight):
    flight = fake.Lockstep(fake.settings(), fake.Vehicle(weight=weight)).run_to(State.ENGAGED)
    flight.run(10.0, lambda: flight.vehicle.position > 0.5)
    climb = np.diff(flight.altitudes) / 0.01
    first = np.flatnonzero(climb > 0.15)[0]
    assert climb[first:].min() > 0.14, "it must not sink back"
    assert climb.max() < 1.0


def test_the_takeoff_altitude_counts_from_the_ground_where_it_stood(fake):
    flight = fake.Lockstep(fake.settings(scenario=(Takeoff(2.0), Hold(100.0))))
    drift = [0.0]
    flight.change = lambda event: (
        event._replace(position=(0.0, 0.0, event.position[2] + drift[0]))
        if isinstance(event, events.PositionReceived)
        else event
    )
    flight.run(1.2)
    drift[0] = 0.4  # the estimate wanders while the vehicle stands
    flight.run_to(State.ENGAGED)
    flight.run(8.0)
    assert flight.vehicle.position == pytest.approx(2.0, abs=0.05)


def test_a_drifting_estimate_on_the_ground_is_no_liftoff(fake):
    flight = fake.Lockstep(fake.settings(), fake.Vehicle(spool_s=1.0)).run_to(State.ENGAGED)
    flight.run(1.1)
    start = flight.time_us
    flight.change = lambda event: (
        event._replace(position=(0.0, 0.0, event.position[2] + (flight.time_us - start) * 0.3e-6))
        if isinstance(event, events.PositionReceived)
        else event
    )
    flight.run(0.45)
    sent = thrusts(flight)
    np.testing.assert_allclose(np.diff(sent[sent > 0.0]), 0.0035, atol=1e-9)
    assert sent[-1] > 0.15


def test_a_vehicle_that_does_not_lift_off_is_given_up_and_disarmed(fake):
    flight = fly(fake, fake.Vehicle(weight=5.0))
    assert flight.service.finished == Finished(False, "no lift-off at thrust 0.95")
    assert thrusts(flight)[-1] == 0.0
    assert not flight.vehicle.armed


def test_a_scenario_moves_the_vehicle_as_it_says(fake):
    scenario = (Takeoff(3.0), Step("altitude", 1.0, 4.0), Sine("roll", 0.1, 2.0, 1.0), Hold(1.0), Land(1.0))
    flight = fly(fake, scenario=scenario)
    assert max(flight.altitudes) == pytest.approx(4.0, abs=0.05)
    roll = np.array([signal.measurement[0] for _, signal in flight.sent(events.Signals)])
    assert roll.max() == pytest.approx(0.1, abs=0.03)
    assert flight.service.finished.successful


@pytest.mark.parametrize("output", ["rates", "attitude"])
def test_a_tilted_vehicle_gets_more_thrust(fake, output):
    scenario = (Hold(0.5), Step("roll", 0.3, 100.0))
    flight = fake.Lockstep(fake.settings(output, scenario=scenario), fake.airborne()).run_to(State.ENGAGED)
    flight.run(3.0)
    roll = flight.vehicle.attitude[0]
    assert roll == pytest.approx(0.3, abs=0.02)
    vertical = flight.sent(events.Signals)[-1][1].command[3]
    assert thrusts(flight)[-1] == pytest.approx(vertical / np.cos(roll), rel=1e-3)
    assert vertical == pytest.approx(fake.hover, rel=0.01)


@pytest.mark.parametrize(
    ("climb_rate", "thrust", "lands"), [(-0.1, 0.1, True), (-0.5, 0.1, False), (-0.1, 0.3, False)]
)
def test_touchdown_is_little_thrust_and_no_movement(fake, climb_rate, thrust, lands):
    state = begin_flight(0, True, 2.0, 0.0)
    for tick in range(60):
        sample = FlightSample(tick * 10_000, 2.0, climb_rate, thrust, thrust, None, 0)
        state, _ = step_flight(fake.settings(), (Land(0.5),), state, sample)
    assert (state.phase is Phase.TOUCHDOWN) == lands


def test_a_landing_touches_down_slowly_and_takes_thrust_back_within_a_third_of_a_second(fake):
    flight = fly(fake)
    heights = np.array(flight.altitudes)
    down = np.flatnonzero(np.diff(heights) < 0.0)[-1]
    assert (heights[down - 10] - heights[down]) / 0.1 < 0.35
    final = thrusts(flight)
    stop = np.flatnonzero(final > 0.0)[-1] + 1
    ramp = final[stop - 30 : stop + 1]
    np.testing.assert_allclose(ramp, ramp[0] * np.linspace(1.0, 0.0, 31), atol=1e-6)


def test_disarming_is_repeated_every_half_second_until_the_autopilot_agrees(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.run(6.0)
    flight.vehicle.grants_arming = False
    flight.run_to(State.RELEASING, 15.0)
    flight.run(1.9)
    times = [time * 1e-6 for time, sent in flight.log if sent == SetArmed(False)]
    assert np.diff(times) == pytest.approx([0.5, 0.5, 0.5])
    flight.vehicle.armed = False  # the autopilot disarms itself
    flight.run(1.1)
    assert flight.service.finished == Finished(True, "scenario done, landed")


def test_a_vehicle_that_cannot_be_disarmed_is_left_in_land_mode_with_a_warning(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.run(6.0)
    flight.vehicle.grants_arming = False
    flight.run(40.0, lambda: flight.service.finished is not None)
    assert flight.service.finished == Finished(False, "disarming was refused")
    assert "still armed on the ground: keep away" in flight.texts
    assert flight.vehicle.mode is ModeKind.LAND


def test_disarming_that_was_accepted_and_does_not_show_is_no_normal_end(fake):
    """The answer to an arming request that comes late, for instance, or somebody who arms again."""
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.vehicle.set_armed = lambda time_us, armed: flight.vehicle.answer("disarm", True)
    flight.give(events.ReleaseRequested("by hand"))
    flight.run(30.0, lambda: flight.service.finished is not None)
    assert "still armed on the ground: keep away" in flight.texts
    assert flight.service.finished == Finished(False, "disarming was refused")


def land_after_refusal(fake):
    """A landing whose disarming is refused, up to LAND mode."""
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.run(6.0)
    flight.vehicle.grants_arming = False
    flight.run(40.0, lambda: flight.vehicle.mode is ModeKind.LAND)
    flight.run(1.5)
    assert flight.service.finished is None
    return flight


def test_land_mode_that_disarms_after_a_refusal_is_a_normal_end(fake):
    flight = land_after_refusal(fake)
    flight.vehicle.armed = False  # ArduCopter's LAND mode does when it has noticed the ground
    flight.run(1.1)
    assert flight.service.finished == Finished(True, "scenario done, landed")


def test_another_mode_after_a_refusal_ends_the_wait_for_land_mode(fake):
    flight = land_after_refusal(fake)
    flight.vehicle.mode = ModeKind.HOLD
    flight.run(1.1)
    assert flight.service.finished == Finished(False, "disarming was refused")


def test_what_a_person_armed_is_not_disarmed_but_left_in_land_mode(fake):
    flight = fly(fake, fake.Vehicle(armed=True), arm=False)
    assert not flight.sent(SetArmed)
    assert flight.sent(SetMode)[-1][1] == LAND
    assert flight.service.finished == Finished(True, "scenario done, landed")


def test_the_autopilots_own_disarming_after_touchdown_is_a_normal_end(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.run(20.0, lambda: flight.vehicle.position > 1.0)
    flight.run(20.0, lambda: flight.vehicle.grounded)
    flight.run(0.3)
    assert flight.service.state is State.ENGAGED
    flight.vehicle.armed = False
    flight.run(1.0)
    assert flight.service.finished == Finished(True, "scenario done, landed")


def test_an_old_report_of_being_on_the_ground_does_not_stop_the_motors_in_the_air(fake):
    scenario = (Takeoff(3.0), Land(0.1))
    flight = fake.Lockstep(fake.settings(scenario=scenario)).run_to(State.ENGAGED)
    flight.mute = {events.LandedStateReported}
    flight.run(12.0)
    assert flight.vehicle.position > 1.5
    assert thrusts(flight)[-1] > 0.8 * fake.hover


def with_gripper(fake):
    """Engaged in the air, the gripper command just sent and not yet answered."""
    scenario = (Hold(0.5), Gripper("grab"), Hold(100.0))
    flight = fake.Lockstep(fake.settings(scenario=scenario), fake.airborne()).run_to(State.ENGAGED)
    flight.mute = {events.CommandAnswered}
    flight.run(1.0, lambda: bool(flight.sent(events.SetGripper)))
    flight.mute = set()
    return flight


def test_the_gripper_command_is_sent_once_and_silence_is_announced(fake):
    flight = with_gripper(fake)
    flight.run(4.9)
    assert "gripper: no answer; is it enabled?" not in flight.texts
    flight.run(0.2)
    assert "gripper: no answer; is it enabled?" in flight.texts
    assert [sent.action for _, sent in flight.sent(events.SetGripper)] == ["grab"]


def test_a_gripper_in_progress_has_more_time_and_a_refusal_is_announced(fake):
    flight = with_gripper(fake)
    flight.run(3.0)
    flight.give(events.CommandAnswered("gripper", 211, False, True, "IN_PROGRESS"))
    flight.run(3.0)
    flight.give(events.CommandAnswered("gripper", 211, False, False, "FAILED"))
    flight.run(3.0)
    assert [text for text in flight.texts if "gripper" in text] == ["gripper refused: FAILED"]


# -------------------------------------------------------------------------------- release


def test_releasing_in_the_air_holds_until_the_autopilot_confirms_and_then_is_silent(fake):
    flight = in_flight(fake)
    flight.give(events.ReleaseRequested("by hand"))
    assert flight.service.state is State.RELEASING
    assert flight.log[-1][1] == HOLD
    flight.run(0.01)
    assert flight.sent(AttitudeTarget)
    flight.run(1.0)
    assert flight.service.finished == Finished(True, "by hand")
    flight.log.clear()
    flight.run(2.0)
    assert not flight.sent(AttitudeTarget) and not flight.sent(SetMode)
    assert flight.vehicle.position == pytest.approx(2.0, abs=0.05)


def test_a_release_that_nobody_confirms_is_asked_every_half_second_and_ends_after_two(fake):
    flight = in_flight(fake)
    flight.vehicle.grants_mode = False
    start = flight.time_us
    flight.give(events.ReleaseRequested("by hand"))
    flight.run(3.0)
    asked = [(time - start) * 1e-6 for time, sent in flight.log if sent == HOLD]
    assert asked == pytest.approx([0.0, 0.5, 1.0, 1.5])
    last = (flight.sent(AttitudeTarget)[-1][0] - start) * 1e-6
    assert last == pytest.approx(2.0, abs=0.011)
    assert flight.service.finished == Finished(False, "HOLD not confirmed; setpoints stopped")


def test_a_release_that_was_accepted_and_does_not_show_ends_with_a_level_setpoint(fake):
    """The answer to an earlier mode request that comes late, for instance: nobody has taken over."""
    flight = in_flight(fake)
    flight.vehicle.set_mode = lambda mode: flight.vehicle.answer("mode", True)
    flight.give(events.ReleaseRequested("by hand"))
    flight.run(3.0)
    assert flight.sent(AttitudeTarget)[-1][1].attitude == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert flight.service.finished == Finished(False, "HOLD not confirmed; setpoints stopped")


def test_told_to_give_up_it_leaves_a_level_setpoint(fake):
    patient = SequenceSettings(hold_timeout_s=5.0)
    swinging = fake.airborne(position=2.0, attitude=np.array([0.15, 0.0, 0.0]))
    settings = fake.settings(scenario=(Hold(100.0),), sequence=patient)
    flight = fake.Lockstep(settings, swinging).run_to(State.ENGAGED)
    flight.vehicle.grants_mode = False
    flight.give(events.ReleaseRequested("stop requested"))
    flight.run(0.2)
    assert flight.sent(AttitudeTarget)[-1][1].body_rates is not None
    flight.give(events.GiveUpRequested())
    assert flight.sent(AttitudeTarget)[-1][1].attitude == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert flight.service.finished == Finished(False, "HOLD not confirmed; setpoints stopped")


@pytest.mark.parametrize("thrust", [0.0, 0.2])
def test_told_to_give_up_on_the_ground_it_warns_and_asks_for_land_mode(fake, thrust):
    """Before the thrust ramp, and while it is taken back, which may be told to take 10 s."""
    slowly = FlightSettings(touchdown_ramp_s=10.0)
    flight = fake.Lockstep(fake.settings(flight=slowly)).run_to(State.ENGAGED)
    flight.run(3.0, lambda: thrusts(flight)[-1] >= thrust)
    flight.vehicle.grants_arming = False
    flight.give(events.ReleaseRequested("stop requested"))
    flight.run(2.0)
    flight.give(events.ReleaseRequested("commanded", stay=True))
    flight.run(1.0)
    flight.give(events.GiveUpRequested())
    assert "still armed on the ground: keep away" in flight.texts
    assert flight.sent(SetMode)[-1][1] == LAND
    assert flight.service.finished == Finished(False, "disarming was refused")
    assert flight.sent(AttitudeTarget)[-1][1].thrust <= thrust


def test_a_scenario_that_ends_in_the_air_is_released_into_hold(fake):
    flight = fly(fake, scenario=(Takeoff(2.0), Hold(0.5)))
    assert flight.service.finished == Finished(True, "scenario done, in the air")
    assert flight.vehicle.mode is ModeKind.HOLD


def test_releasing_before_takeoff_disarms(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.give(events.ReleaseRequested("by hand"))
    flight.run(1.2)
    assert not flight.vehicle.armed
    assert flight.service.finished == Finished(True, "by hand")


@pytest.fixture
def arming_open(fake):
    """A flight that has asked to arm; neither that nor disarming shows or is accepted."""
    flight = fake.Lockstep(fake.settings(), fake.Vehicle(grants_arming=False)).run_to(State.ENGAGING)
    flight.run(3.0, lambda: flight.sent(SetArmed))
    flight.run(0.1)
    return flight


def arm_late(flight):
    """A heartbeat from before, then the open request takes effect."""
    flight.give(flight.vehicle.heartbeat())
    flight.vehicle.grants_arming = flight.vehicle.armed = True


def test_arming_that_takes_effect_after_the_release_is_undone(arming_open):
    arming_open.give(events.ReleaseRequested("by hand"))
    arm_late(arming_open)
    assert arming_open.service.state is State.RELEASING
    arming_open.run(2.1)
    assert not arming_open.vehicle.armed
    assert arming_open.service.finished == Finished(True, "by hand")


def test_a_pilot_who_takes_over_while_arming_is_open_is_told_and_it_is_undone(arming_open):
    """Who changes the mode to stop it must not find it armed a moment later."""
    arming_open.vehicle.mode = ModeKind.OTHER
    arming_open.give(arming_open.vehicle.heartbeat())
    assert arming_open.service.state is State.READY
    assert arming_open.sent(SetArmed)[-1][1] == SetArmed(False)
    assert {"may still arm: keep away", "control given up: mode OTHER"} <= set(arming_open.texts)
    arming_open.log.clear()
    arming_open.run(3.0)
    assert not arming_open.sent((AttitudeTarget, SetMode, SetArmed)), "once; then it is the pilot's"


def test_arming_that_takes_effect_after_a_failsafe_is_undone(arming_open):
    arming_open.mute = {events.AttitudeReceived}
    arming_open.run_to(State.FAILSAFE, 0.3)
    arm_late(arming_open)
    arming_open.run(2.1)
    assert not arming_open.vehicle.armed
    assert not arming_open.service.finished.successful


def test_arming_that_stays_open_is_said_at_the_end(arming_open):
    arming_open.give(events.ReleaseRequested("by hand"))
    arming_open.run(11.0)
    assert "may still arm: keep away" in arming_open.texts
    assert arming_open.service.finished == Finished(False, "disarming was not confirmed")


def test_arming_that_took_effect_and_cannot_be_undone_is_left_in_land_mode_with_a_warning(arming_open):
    arming_open.give(events.ReleaseRequested("by hand"))
    arming_open.vehicle.armed = True
    arming_open.run(11.0)
    assert "still armed on the ground: keep away" in arming_open.texts
    assert arming_open.vehicle.mode is ModeKind.LAND


def test_releasing_in_the_thrust_ramp_takes_thrust_back(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.run(3.0, lambda: thrusts(flight)[-1] > 0.2)
    flight.give(events.ReleaseRequested("by hand"))
    flight.run(2.0)
    assert thrusts(flight).max() < 0.25
    assert not flight.vehicle.armed
    assert flight.service.finished == Finished(True, "by hand")


def test_an_autopilot_that_disarms_while_thrust_is_taken_back_ends_the_release(fake):
    flight = fake.Lockstep(fake.settings(flight=FlightSettings(touchdown_ramp_s=5.0)))
    flight.run_to(State.ENGAGED).run(3.0, lambda: thrusts(flight)[-1] > 0.2)
    flight.give(events.ReleaseRequested("by hand"))
    flight.vehicle.armed = False
    flight.run(1.1)
    assert flight.service.finished == Finished(True, "by hand")


def failsafe_on_the_ground(fake):
    """Engaged, armed by the daemon and before take-off; then attitude stays away."""
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    assert flight.vehicle.grounded and flight.vehicle.armed
    flight.mute = {events.AttitudeReceived}
    return flight


@pytest.mark.parametrize("answers", [False, True])
def test_a_failsafe_on_the_ground_whose_disarming_is_refused_says_so_and_asks_for_land_mode(fake, answers):
    flight = failsafe_on_the_ground(fake)
    flight.vehicle.grants_arming, flight.vehicle.answers = False, answers
    flight.run_to(State.FAILSAFE, 0.3)
    last = len(flight.sent(AttitudeTarget))
    flight.run(2.5)
    assert "still armed on the ground: keep away" in flight.texts
    assert flight.sent(SetMode)[-1][1] == LAND
    flight.run(2.1)
    assert len(flight.sent(AttitudeTarget)) == last, "in failsafe there are no setpoints"
    assert flight.service.finished == Finished(False, "failsafe: no attitude for 0.25 s")


@pytest.mark.parametrize("landing", [False, True])
def test_a_failsafe_in_a_thrust_ramp_disarms(fake, landing):
    """It ended with an armed vehicle on the ground, at the ramp's thrust until the autopilot's timeout."""
    flight = fake.Lockstep(fake.settings(flight=FlightSettings(touchdown_ramp_s=2.0))).run_to(State.ENGAGED)
    flight.run(3.0, lambda: thrusts(flight)[-1] > 0.2)
    if landing:
        flight.run(20.0, lambda: flight.vehicle.position > 1.0)
        flight.run(20.0, lambda: flight.vehicle.grounded)
        flight.run(3.0, lambda: thrusts(flight)[-1] < flight.service.settings.limits.thrust_min)
    flight.mute = {events.AttitudeReceived}
    flight.run_to(State.FAILSAFE, 0.3)
    assert thrusts(flight)[-1] > 0.0, "the last setpoint is the ramp's"
    flight.run(1.1)
    assert not flight.vehicle.armed
    assert flight.service.finished == Finished(False, "failsafe: no attitude for 0.25 s")


def test_a_failsafe_in_a_thrust_ramp_of_a_vehicle_that_has_left_the_ground_asks_for_land_mode(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.run(3.0, lambda: thrusts(flight)[-1] > 0.2)
    flight.vehicle.grants_arming = False
    flight.mute = {events.AttitudeReceived}
    flight.run_to(State.FAILSAFE, 0.3)
    flight.run(2.5)
    assert flight.sent(SetMode)[-1][1] == LAND


def test_a_failsafe_on_the_ground_does_not_end_with_an_answer_that_nothing_shows(fake):
    """That to the request to arm, for instance, which comes late."""
    flight = failsafe_on_the_ground(fake)
    flight.vehicle.set_armed = lambda time_us, armed: flight.vehicle.answer("disarm", True)
    flight.run_to(State.FAILSAFE, 0.3)
    flight.run(2.5)
    assert "still armed on the ground: keep away" in flight.texts


def test_a_failsafe_on_the_ground_ends_when_a_heartbeat_shows_it_disarmed(fake):
    flight = failsafe_on_the_ground(fake)
    flight.run_to(State.FAILSAFE, 0.3)
    flight.run(1.1)
    assert not flight.vehicle.armed
    assert flight.service.finished == Finished(False, "failsafe: no attitude for 0.25 s")
    assert "still armed on the ground: keep away" not in flight.texts


@pytest.mark.parametrize("seconds", [0.1, 0.5])
def test_releasing_while_engaging_on_the_ground_stops(fake, seconds):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGING)
    flight.run(seconds)
    flight.give(events.ReleaseRequested("by hand"))
    assert flight.service.finished == Finished(True, "by hand")
    assert not flight.sent(SetArmed)


def test_releasing_while_engaging_in_the_air_stops_or_asks_for_hold(fake):
    flight = fake.Lockstep(fake.settings(), fake.airborne()).run_to(State.ENGAGING)
    flight.run(0.1)
    flight.give(events.ReleaseRequested("by hand"))
    assert flight.service.finished is not None and not flight.sent(SetMode)
    flight = fake.Lockstep(fake.settings(), fake.airborne()).run_to(State.ENGAGING)
    flight.run(0.4)
    flight.give(events.ReleaseRequested("by hand"))
    assert flight.service.state is State.RELEASING and flight.log[-1][1] == HOLD


def released_before_granted(fake, vehicle, **release):
    """OFFBOARD was asked for, and neither granted nor answered; then control is to be given back."""
    flight = fake.Lockstep(fake.settings(arm=False), vehicle).run_to(State.ENGAGING)
    flight.run(0.5)
    flight.log.clear()
    flight.give(events.ReleaseRequested("by hand", **release))
    return flight


@pytest.mark.parametrize("position", [0.0, 2.0])
@pytest.mark.parametrize("answers", [False, True])
def test_a_release_before_the_mode_was_granted_leaves_the_pilots_mode(fake, position, answers):
    vehicle = fake.airborne(mode=ModeKind.OTHER, position=position, grants_mode=False, answers=answers)
    flight = released_before_granted(fake, vehicle)
    flight.run(2.1)
    assert not flight.sent(SetMode) and flight.vehicle.mode is ModeKind.OTHER
    assert flight.service.finished == Finished(True, "by hand")


@pytest.mark.parametrize("answers", [False, True])
@pytest.mark.parametrize(("position", "asked"), [(0.0, LAND), (2.0, HOLD)])
def test_a_mode_that_is_granted_after_the_release_is_given_back(fake, position, asked, answers):
    vehicle = fake.airborne(mode=ModeKind.OTHER, position=position, grants_mode=False, answers=False)
    flight = released_before_granted(fake, vehicle)
    flight.run(0.5)
    flight.vehicle.grants_mode, flight.vehicle.answers = True, answers
    for event in flight.vehicle.set_mode(ModeKind.OFFBOARD) or [flight.vehicle.heartbeat()]:
        flight.give(event)
    assert flight.sent(SetMode) == [(flight.time_us, asked)]
    flight.run(1.2)
    assert flight.vehicle.mode is asked.mode
    assert flight.service.finished == Finished(True, "by hand")


def test_a_stop_before_the_mode_is_granted_stays_one(fake):
    vehicle = fake.airborne(grants_mode=False)
    flight = released_before_granted(fake, vehicle)
    flight.give(events.ReleaseRequested("commanded", stay=True))
    flight.run(2.1)
    assert flight.service.finished == Finished(True, "by hand")


@pytest.mark.parametrize("lost", [False, True])
def test_setpoints_that_act_from_the_first_on_are_given_back_as_later_ones(fake, lost):
    """It is in OFFBOARD already while the first setpoints are streamed."""
    vehicle = fake.airborne(mode=ModeKind.OFFBOARD, attitude=np.array([0.15, 0.0, 0.0]))
    patient = SequenceSettings(stream_time_s=1.0)
    flight = fake.Lockstep(fake.settings(failsafe_action="hold", sequence=patient), vehicle)
    flight.run_to(State.ENGAGING).run(0.1)
    if lost:
        flight.mute = {events.AttitudeReceived}
        flight.run_to(State.FAILSAFE, 0.3)
        assert flight.sent(AttitudeTarget)[-1][1].attitude is not None
    else:
        flight.give(events.ReleaseRequested("by hand"))
    assert flight.sent(SetMode) == [(pytest.approx(flight.time_us, abs=10_000), HOLD)]


def test_releasing_when_nothing_is_held_finishes_at_once(fake):
    flight = fake.Lockstep(fake.settings())
    flight.run(0.3)
    flight.give(events.ReleaseRequested("stopped"))
    assert flight.service.finished == Finished(True, "stopped")
    flight.run(3.0)
    assert not flight.sent(AttitudeTarget)
    flight.give(events.EngageRequested())
    assert flight.texts[-1] == "not engaged: finished; start the daemon again"


def test_a_release_before_control_was_taken_leaves_engaging_to_a_request(fake):
    flight = fake.Lockstep(fake.settings())
    flight.run(0.3)
    flight.give(events.ReleaseRequested("commanded", stay=True))
    flight.run(5.0)
    assert flight.states == [State.WAITING, State.READY]
    assert flight.texts == ["engages only when asked to", "ready"]
    flight.give(events.EngageRequested())
    flight.run_to(State.ENGAGED)


def test_a_release_that_stays_at_hand_keeps_no_failsafe_from_ending_the_run(fake):
    flight = in_flight(fake, failsafe_action="hold")
    flight.vehicle.grants_mode = flight.vehicle.answers = False
    flight.mute = {events.AttitudeReceived}
    flight.run(5.0, lambda: flight.service.state is State.FAILSAFE)
    flight.give(events.ReleaseRequested("commanded", stay=True))
    flight.run(3.0)
    assert flight.service.finished == Finished(False, "failsafe: no attitude for 0.25 s")


def test_a_release_that_stays_at_hand_does_not_undo_a_stop(fake):
    flight = in_flight(fake)
    flight.vehicle.grants_mode = False
    flight.give(events.ReleaseRequested("stop requested"))
    flight.give(events.ReleaseRequested("commanded", stay=True))
    flight.run(3.0)
    assert flight.service.finished is not None


def test_a_setpoint_leaves_before_what_only_the_log_and_people_want(fake):
    flight = fake.Lockstep(fake.settings(), fake.airborne()).run_to(State.ENGAGED)
    flight.run(0.5)
    service, now = flight.service, flight.time_us + 10_000
    service.advance(now)
    sample = events.AttitudeReceived(now, tuple(flight.vehicle.attitude), (1e-9, 0.0, 0.0))
    assert [type(output) for output in service.handle(now, sample)] == [AttitudeTarget]
    assert service.next_deadline() == now
    (log,) = (output for output in service.advance(now) if isinstance(output, events.Signals))
    assert log.time_us == now
    assert service.next_deadline() > now


def test_the_last_step_of_a_flight_is_in_the_log(fake):
    flight = fake.Lockstep(fake.settings())
    flight.run(60.0, lambda: flight.service.finished is not None)
    steps = [time for time, _ in flight.sent(events.Signals)]
    assert flight.service.finished.successful
    assert flight.sent(AttitudeTarget)[-1][0] in steps
