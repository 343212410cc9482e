"""From the ground into the air and back: take-off, scenario, landing."""

import numpy as np
import pytest
from msgspec.structs import replace

from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget, ModeKind, SetArmed, SetMode
from kffa_offboard.offboard.flight import FlightSample, Phase, begin_flight, step_flight
from kffa_offboard.offboard.segments import Gripper, Hold, Land, Sine, Step, Takeoff
from kffa_offboard.offboard.service import Finished, State

LAND = SetMode(ModeKind.LAND)


@pytest.mark.parametrize("output", ["rates", "attitude"])
@pytest.mark.parametrize(("firmware", "spool_s"), [("px4", 1.0), ("ardupilot", 2.5)])
def test_a_flight_takes_off_holds_and_lands(fake, output, firmware, spool_s):
    flight = fake.fly(fake.Vehicle(firmware=firmware, spool_s=spool_s), output)
    assert flight.service.finished == Finished(True, "scenario done, landed")
    assert flight.states == [State.WAITING, State.ENGAGING, State.ENGAGED, State.RELEASING, State.READY]
    assert not flight.vehicle.armed
    assert max(flight.altitudes) == pytest.approx(2.0, abs=0.03)
    assert len(flight.sent(SetArmed)) == 2
    kinds = {target.body_rates is None for _, target in flight.sent(AttitudeTarget)}
    assert kinds == {output == "attitude"}


def test_a_flight_under_the_papers_own_controller_is_as_good(fake):
    flight = fake.fly(controller=fake.papers_own)
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
        replace(event, position=(0.0, 0.0, event.position[2] + drift[0]))
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
        replace(event, position=(0.0, 0.0, event.position[2] + (flight.time_us - start) * 0.3e-6))
        if isinstance(event, events.PositionReceived)
        else event
    )
    flight.run(0.45)
    sent = flight.thrusts
    np.testing.assert_allclose(np.diff(sent[sent > 0.0]), 0.0035, atol=1e-9)
    assert sent[-1] > 0.15


def test_a_vehicle_that_does_not_lift_off_is_given_up_and_disarmed(fake):
    flight = fake.fly(fake.Vehicle(weight=5.0))
    assert flight.service.finished == Finished(False, "no lift-off at thrust 0.95")
    assert flight.thrusts[-1] == 0.0
    assert not flight.vehicle.armed


def test_a_scenario_moves_the_vehicle_as_it_says(fake):
    scenario = (Takeoff(3.0), Step("altitude", 1.0, 4.0), Sine("roll", 0.1, 2.0, 1.0), Hold(1.0), Land(1.0))
    flight = fake.fly(scenario=scenario)
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
    assert flight.thrusts[-1] == pytest.approx(vertical / np.cos(roll), rel=1e-3)
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
    flight = fake.fly()
    heights = np.array(flight.altitudes)
    down = np.flatnonzero(np.diff(heights) < 0.0)[-1]
    assert (heights[down - 10] - heights[down]) / 0.1 < 0.35
    final = flight.thrusts
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
    flight = fake.fly(fake.Vehicle(armed=True), arm=False)
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
    assert flight.thrusts[-1] > 0.8 * fake.hover


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
