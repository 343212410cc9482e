"""The last setpoint before the daemon falls silent."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget, ModeKind
from kffa_offboard.offboard.segments import Hold, Land, Takeoff
from kffa_offboard.offboard.service import Finished, State
from kffa_offboard.offboard.settings import FlightSettings


@pytest.mark.parametrize("output", ["rates", "attitude"])
def test_the_last_setpoint_of_a_failsafe_in_the_air_is_level_with_the_thrust_that_carried(fake, output):
    flight = fake.hovering(output=output, failsafe_action="stop")
    flight.vehicle.weight = 1.5  # a load of half its own mass
    flight.run(3.0)
    carried = flight.sent(AttitudeTarget)[-1][1].thrust
    assert carried > 1.4 * fake.hover
    before = len(flight.sent(AttitudeTarget))
    flight.mute = {events.AttitudeReceived}
    flight.run(1.0)
    assert flight.service.state is State.FAILSAFE
    farewell = flight.sent(AttitudeTarget)[before:][-1][1]
    assert farewell.body_rates is None
    assert farewell.attitude == pytest.approx((0.0, 0.0, flight.vehicle.attitude[2]))
    assert farewell.thrust == pytest.approx(carried, abs=0.02)


def test_the_last_setpoint_keeps_the_heading_that_the_vehicle_has(fake):
    flight = fake.hovering(output="rates")
    flight.vehicle.attitude = np.array([0.0, 0.0, 0.2])
    flight.run(0.03)
    still, last, _ = flight.service.last_words()
    assert still == AttitudeTarget(last.thrust, body_rates=(0.0, 0.0, 0.0)), "PX4 sees the attitude later"
    assert flight.vehicle.attitude[2] > 0.1
    assert last.attitude == pytest.approx((0.0, 0.0, flight.vehicle.attitude[2]), abs=0.03)


def test_the_last_setpoint_to_a_vehicle_that_has_touched_down_does_not_raise_thrust_again(fake):
    """Its mean is still that of the descent: a vehicle that stands got nearly the thrust of a hover."""
    flight = fake.Lockstep(fake.settings(scenario=(Takeoff(2.0, 1.0), Land(0.7)))).run_to(State.ENGAGED)
    flight.run(20.0, lambda: flight.vehicle.position > 1.5)
    flight.run(20.0, lambda: flight.vehicle.grounded)
    flight.run(0.4)
    assert flight.service.state is State.ENGAGED
    last = flight.sent(AttitudeTarget)[-1][1].thrust
    assert 0.0 < last < 0.8 * fake.hover
    flight.mute = {events.AttitudeReceived}
    flight.run_to(State.FAILSAFE, 0.3)
    assert flight.sent(AttitudeTarget)[-1][1].thrust == pytest.approx(last)
    assert not flight.vehicle.armed, "and it asks to disarm"


def test_a_program_that_fails_in_the_middle_of_a_step_still_has_last_words(fake, monkeypatch):
    """Whatever comes then may fail again; the last words need none of it."""
    flight = fake.hovering(output="rates")
    flight.vehicle.attitude = np.array([0.1, 0.0, 0.0])

    def broken(*arguments):
        raise ZeroDivisionError

    monkeypatch.setattr(type(flight.service), "_watch_payload", broken)
    with pytest.raises(ZeroDivisionError):
        flight.run(1.0)
    with pytest.raises(ZeroDivisionError):
        flight.run(1.0)
    _, last, said = flight.service.last_words()
    assert last.body_rates is None and last.attitude[:2] == (0.0, 0.0)
    assert last.thrust == pytest.approx(fake.hover, rel=0.02)
    assert (said.severity, said.text) == (events.Severity.CRITICAL, "failsafe: the daemon ended")
    assert flight.service.finished == Finished(False, "failsafe: the daemon ended")
    assert flight.service.last_words() == []


def test_a_program_that_ends_without_control_has_no_last_words(fake):
    flight = fake.Lockstep(fake.settings(engage=False), fake.airborne()).run_to(State.READY)
    assert flight.service.last_words() == []
    assert flight.service.state is State.READY


def test_the_last_setpoint_at_the_end_of_a_landing_is_not_raised_to_the_least_thrust_of_flight(fake):
    """Thrust goes to zero in a ramp once the vehicle stands."""
    flight = fake.Lockstep(fake.settings(flight=FlightSettings(touchdown_ramp_s=2.0))).run_to(State.ENGAGED)
    flight.run(20.0, lambda: flight.vehicle.position > 1.0)
    flight.run(20.0, lambda: flight.vehicle.grounded)
    least = flight.service.settings.limits.thrust_min
    assert flight.run(3.0, lambda: flight.thrusts[-1] < 0.8 * least)
    before = flight.thrusts[-1]
    still, last, _ = flight.service.last_words()
    assert 0.0 < last.thrust <= before < least and still.thrust == last.thrust


def test_there_is_no_farewell_on_the_ground_nor_to_a_pilot_who_took_over(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGED)
    flight.mute = {events.AttitudeReceived}
    flight.run(0.4)
    assert flight.service.state is State.FAILSAFE
    assert all(target.thrust == 0.0 for _, target in flight.sent(AttitudeTarget))
    flight = fake.hovering()
    flight.vehicle.mode = ModeKind.OTHER
    flight.give(flight.vehicle.heartbeat())
    assert flight.service.state is State.READY
    assert all(target.attitude is None for _, target in flight.sent(AttitudeTarget))


@pytest.mark.parametrize("granted", [False, True])
def test_only_a_setpoint_that_the_autopilot_follows_is_told_to_the_observer_in_a_silence(fake, granted):
    """Before OFFBOARD is granted level setpoints go out, too; what acts is the autopilot's own command."""
    settings = fake.settings(scenario=(Hold(100.0),))
    silent = replace(settings.telemetry, timeout_s=2.0, position_timeout_s=2.0)
    vehicle = fake.airborne(firmware="ardupilot", grants_mode=granted)
    flight = fake.Lockstep(replace(settings, telemetry=silent), vehicle).run_to(State.ENGAGING)
    flight.run_to(State.ENGAGED if granted else State.ENGAGING).run(0.5)
    before = flight.service._loop
    flight.mute = {events.AttitudeReceived}
    flight.log.clear()
    flight.run(0.5)
    assert {target.attitude[:2] for _, target in flight.sent(AttitudeTarget)} == {(0.0, 0.0)}
    assert (flight.service._loop.controller is before.controller) == (not granted)


def test_what_would_be_said_last_is_known_while_in_control_and_only_then(fake):
    flight = fake.Lockstep(fake.settings(scenario=(Hold(100.0),)), fake.airborne())
    flight.run(0.1)
    assert flight.service.state is State.WAITING
    assert not flight.service.has_control and flight.service.last_setpoints() == ()
    flight.run_to(State.ENGAGED)
    flight.run(1.0)
    still, target = flight.service.last_setpoints()
    assert still == AttitudeTarget(target.thrust, body_rates=(0.0, 0.0, 0.0)), "PX4 sees the attitude later"
    assert flight.service.has_control
    assert target.attitude == (0.0, 0.0, pytest.approx(0.0, abs=1e-3)) and target.body_rates is None
    assert target.thrust == pytest.approx(fake.hover, abs=0.01)
    assert flight.service.state is State.ENGAGED
    assert flight.service.last_words()[:2] == [still, target]
    assert not flight.service.has_control and flight.service.last_setpoints() == ()


def test_the_heading_that_was_told_in_a_silence_is_not_told_anew(fake):
    """Samples that come again, and end control, may have turned: 2 degrees in a hundredth of a second."""
    flight = fake.Lockstep(
        fake.settings(scenario=(Hold(100.0),)), fake.airborne(firmware="ardupilot")
    ).run_to(State.ENGAGED)
    flight.run(1.0)
    flight.mute = {events.AttitudeReceived, events.PositionReceived}
    flight.run(0.12)
    flight.mute = {events.PositionReceived}
    flight.change = lambda event: (
        structs.replace(event, attitude=(1.2, 0.0, 0.1))
        if isinstance(event, events.AttitudeReceived)
        else event
    )
    flight.tick()
    assert flight.service.state is State.FAILSAFE
    (_, told), (_, last) = flight.sent(events.AttitudeTarget)[-2:]
    assert told.attitude == last.attitude == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
