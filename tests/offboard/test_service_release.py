"""Giving control back: in the air, on the ground, half-way through engaging, and after a failsafe."""

import numpy as np
import pytest

from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget, ModeKind, SetArmed, SetMode
from kffa_offboard.offboard.segments import Hold, Takeoff
from kffa_offboard.offboard.service import Finished, State
from kffa_offboard.offboard.settings import FlightSettings, SequenceSettings

HOLD = SetMode(ModeKind.HOLD)
LAND = SetMode(ModeKind.LAND)


def in_flight(fake, **changes):
    """Engaged in the air at 2 m, in a long hold."""
    flight = fake.Lockstep(fake.settings(scenario=(Hold(100.0),), **changes), fake.airborne(position=2.0))
    flight.run_to(State.ENGAGED)
    flight.run(0.5)
    flight.log.clear()
    return flight


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
    flight.run(3.0, lambda: flight.thrusts[-1] >= thrust)
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
    flight = fake.fly(scenario=(Takeoff(2.0), Hold(0.5)))
    assert flight.service.finished == Finished(True, "scenario done, in the air")
    assert flight.vehicle.mode is ModeKind.HOLD


def test_releasing_before_takeoff_disarms(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.give(events.ReleaseRequested("by hand"))
    flight.run(1.2)
    assert not flight.vehicle.armed
    assert flight.service.finished == Finished(True, "by hand")


@pytest.mark.parametrize(("answers", "wait_s"), [(True, 3.0), (False, 10.0)])
def test_who_refuses_to_disarm_on_the_ground_is_asked_for_land_mode_in_three_seconds(fake, answers, wait_s):
    """ArduCopter's land detector may never notice the ground; without an answer, much may still happen."""
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.vehicle.grants_arming = False
    if not answers:
        flight.mute = {events.CommandAnswered}
    asked_us = flight.time_us
    flight.give(events.ReleaseRequested("by hand"))
    flight.run(12.0, lambda: flight.vehicle.mode is ModeKind.LAND)
    (land_us,) = [time for time, mode in flight.sent(SetMode) if mode == LAND]
    assert (land_us - asked_us) * 1e-6 == pytest.approx(wait_s, abs=0.02)
    assert "still armed on the ground: keep away" in flight.texts


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
    flight.run(3.0, lambda: flight.thrusts[-1] > 0.2)
    flight.give(events.ReleaseRequested("by hand"))
    flight.run(2.0)
    assert flight.thrusts.max() < 0.25
    assert not flight.vehicle.armed
    assert flight.service.finished == Finished(True, "by hand")


def test_an_autopilot_that_disarms_while_thrust_is_taken_back_ends_the_release(fake):
    flight = fake.Lockstep(fake.settings(flight=FlightSettings(touchdown_ramp_s=5.0)))
    flight.run_to(State.ENGAGED).run(3.0, lambda: flight.thrusts[-1] > 0.2)
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
    flight.run(3.0, lambda: flight.thrusts[-1] > 0.2)
    if landing:
        flight.run(20.0, lambda: flight.vehicle.position > 1.0)
        flight.run(20.0, lambda: flight.vehicle.grounded)
        flight.run(3.0, lambda: flight.thrusts[-1] < flight.service.settings.limits.thrust_min)
    flight.mute = {events.AttitudeReceived}
    flight.run_to(State.FAILSAFE, 0.3)
    assert flight.thrusts[-1] > 0.0, "the last setpoint is the ramp's"
    flight.run(1.1)
    assert not flight.vehicle.armed
    assert flight.service.finished == Finished(False, "failsafe: no attitude for 0.25 s")


def test_a_failsafe_in_a_thrust_ramp_of_a_vehicle_that_has_left_the_ground_asks_for_land_mode(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.run(3.0, lambda: flight.thrusts[-1] > 0.2)
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
