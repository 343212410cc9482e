"""Setpoints while telemetry is silent, and what falls due in which order."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from kffa_offboard.control import vehicle
from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.offboard.service import State


def blind(fake, output="rates", **vehicle):
    """Turning in the air when telemetry falls silent, which it may for 2 s."""
    settings = fake.settings(output)
    silent = replace(settings.telemetry, timeout_s=2.0, position_timeout_s=2.0)
    flight = fake.hovering("ardupilot", output=output, controller=settings.controller, telemetry=silent)
    flight.vehicle.attitude[:] = 0.1, -0.05, 0.1
    flight.run(0.1)  # rates are asked for that take this back
    flight.mute = {events.AttitudeReceived, events.PositionReceived}
    flight.log.clear()
    return flight


@pytest.mark.parametrize("output", ["rates", "attitude"])
def test_a_vehicle_that_cannot_be_seen_is_told_to_be_level(fake, output):
    flight = blind(fake, output)
    before = flight.vehicle.attitude.copy()
    flight.run(1.9)
    assert flight.service.state is State.ENGAGED
    assert {(t.body_rates, t.attitude[:2]) for _, t in flight.sent(AttitudeTarget)} == {(None, (0.0, 0.0))}
    assert np.abs(flight.vehicle.attitude[:2]).max() < 0.01
    assert abs(flight.vehicle.attitude[2] - before[2]) < 0.1  # no turning on
    assert abs(flight.vehicle.velocity) < 0.3


@pytest.mark.parametrize(("output", "tilt"), [("rates", 0.015), ("attitude", 0.03)])
def test_control_goes_on_from_there_when_telemetry_is_back(fake, output, tilt):
    """The observer knows that what it had asked for did not act all that time; else it is 0.032 and 0.031."""
    flight = blind(fake, output)
    flight.run(0.7)
    flight.mute = set()
    seen = []
    for _ in range(100):
        flight.run(0.01)
        seen.append(np.abs(flight.vehicle.attitude[:2]).max())
    assert max(seen) < tilt
    assert flight.service.state is State.ENGAGED


@pytest.mark.parametrize("output", ["rates", "attitude"])
def test_the_command_before_the_silence_acts_until_the_level_setpoint_goes_out(fake, output):
    """That is 0.1 s after the last sample; and of its thrust what the tilt leaves is vertical."""
    flight = blind(fake, output)
    last_us = flight.service._loop.sent_us
    flight.run(0.15)
    ((time_us, level),) = flight.sent(AttitudeTarget)
    loop = flight.service._loop
    under_way = vehicle.as_arrays(loop.controller).actuator
    assert under_way.ages[-1] == pytest.approx(-(time_us - last_us) * 1e-6)
    roll, pitch, _ = flight.service._known.attitude.attitude
    assert under_way.commands[-1][3] == pytest.approx(level.thrust * np.cos(roll) * np.cos(pitch))
    assert loop.vertical_thrust == under_way.commands[-1][3]


def test_on_the_ground_the_last_setpoint_is_repeated(fake):
    settings = fake.settings()
    silent = replace(settings.telemetry, timeout_s=2.0)
    flight = fake.Lockstep(fake.settings(telemetry=silent))
    flight.run_to(State.ENGAGING)
    flight.run(0.3)
    flight.mute = {events.AttitudeReceived}
    last = flight.sent(AttitudeTarget)[-1][1]
    flight.log.clear()
    flight.run(0.7)
    sent = flight.sent(AttitudeTarget)
    assert len(sent) == 7 and {target for _, target in sent} == {last}
    assert last.thrust == 0.0


def test_something_is_heard_at_10_hz_while_telemetry_is_silent(fake):
    settings = fake.settings()
    slow = replace(settings.telemetry, timeout_s=0.8)
    flight = fake.hovering(telemetry=slow)
    last_us = flight.time_us
    flight.mute = {events.AttitudeReceived}
    flight.run(0.7)
    sent = flight.sent(AttitudeTarget)
    assert [(time - last_us) * 1e-6 for time, _ in sent] == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
    assert len({target for _, target in sent}) == 1
    flight.run(2.0)
    assert flight.service.state is State.FAILSAFE
    assert (flight.sent(AttitudeTarget)[-1][0] - last_us) * 1e-6 == pytest.approx(0.8)  # the farewell


def test_the_own_heartbeat_goes_out_once_a_second_from_the_first_call_on(fake):
    flight = fake.Lockstep(fake.settings())
    flight.run(5.5)
    beats = [((time - flight.start_us) * 1e-6, beat.state) for time, beat in flight.sent(events.OwnHeartbeat)]
    assert [time for time, _ in beats] == pytest.approx([0.01, 1.01, 2.01, 3.01, 4.01, 5.01])
    assert [state for _, state in beats] == ["standby", "standby", "active", "active", "active", "active"]


def test_one_late_call_runs_every_deadline_in_order_at_its_own_time(fake):
    """Called once after 3.2 s or at every deadline: the outputs are the same."""
    late, punctual = fake.hovering(failsafe_action="hold"), fake.hovering(failsafe_action="hold")
    end = late.time_us + 3_200_000
    at_once = late.service.advance(end)
    one_by_one = []
    while (due := punctual.service.next_deadline()) <= end:
        one_by_one += punctual.service.advance(due)
    assert at_once == one_by_one + punctual.service.advance(end)
    kinds = [type(output).__name__ for output in at_once]
    failsafe = next(k for k, output in enumerate(at_once) if "failsafe" in getattr(output, "text", ""))
    assert kinds.index("AttitudeTarget") < failsafe < kinds.index("SetMode")
    assert late.service.next_deadline() == punctual.service.next_deadline() > end


def test_time_that_goes_back_is_refused(fake):
    flight = fake.hovering()
    with pytest.raises(ValueError, match="keep them in order"):
        flight.service.advance(flight.time_us - 1)


def test_a_heartbeat_that_was_lost_and_came_back_is_greeted_with_a_request(fake):
    flight = fake.Lockstep(fake.settings(engage=False)).run_to(State.READY)
    flight.mute = {events.HeartbeatReceived}
    flight.run(4.0)
    assert flight.service.state is State.WAITING
    flight.log.clear()
    flight.mute = set()
    flight.run(1.1)
    assert len(flight.sent(events.RequestMessageRates)) == 1
    flight.run_to(State.READY, 2.0)


# ------------------------------------------------------------------------ rates in flight


def asked_s(flight, since_us):
    return [
        (time - since_us) * 1e-6 for time, _ in flight.sent(events.RequestMessageRates) if time > since_us
    ]


@pytest.mark.parametrize("kind", [events.AttitudeReceived, events.PositionReceived])
def test_rates_are_asked_for_again_before_silence_ends_control(fake, kind):
    """A ground station behind the same router has asked for 4 Hz: that was the end of the flight."""
    flight = fake.hovering()
    last_us = flight.time_us
    flight.mute = {kind}
    flight.run(0.2)
    assert asked_s(flight, last_us) == pytest.approx([0.1])
    flight.mute = set()
    flight.run(3.0)
    assert len(asked_s(flight, last_us)) == 1
    assert flight.service.state is State.ENGAGED
    assert flight.texts == ["telemetry slows down: asked for it again"]


def thinned(flight, kept_of):
    """One of so many attitudes arrives."""
    count = itertools.count()

    def change(event):
        if type(event) is events.AttitudeReceived and next(count) % kept_of:
            return events.StatusReceived(6, "")
        return event

    return change


@pytest.mark.parametrize(("kept_of", "asks"), [(2, 0), (3, 1), (5, 1)])
def test_rates_that_fall_below_what_is_needed_are_asked_for_again_within_a_quarter_of_a_second(
    fake, kept_of, asks
):
    """50 Hz are needed, of which four fifths will do."""
    flight = fake.hovering()
    last_us = flight.time_us
    flight.change = thinned(flight, kept_of)
    flight.run(0.26)
    assert len(asked_s(flight, last_us)) == asks


def test_a_link_that_stays_slow_is_asked_once_a_second_and_ten_times_in_a_flight(fake):
    flight = fake.hovering()
    last_us = flight.time_us
    flight.change = thinned(flight, 4)
    flight.run(14.0)
    assert flight.service.state is State.ENGAGED
    times = asked_s(flight, last_us)
    assert len(times) == 10
    assert np.diff(times) == pytest.approx(1.0, abs=0.05)
    assert flight.texts == ["telemetry slows down: asked for it again"]


def test_rates_are_not_asked_for_again_while_control_is_given_back(fake):
    flight = fake.hovering()
    flight.give(events.ReleaseRequested("enough"))
    assert flight.service.state is State.RELEASING
    last_us = flight.time_us
    flight.mute = {events.AttitudeReceived}
    flight.run(0.2)
    assert asked_s(flight, last_us) == []


def test_what_was_asked_for_in_flight_does_not_count_on_the_ground_afterwards(fake):
    flight = fake.hovering()
    flight.change = thinned(flight, 4)
    flight.run(12.0)
    flight.give(events.ReleaseRequested("enough", stay=True))
    flight.run(2.0)
    assert flight.service.state in (State.READY, State.WAITING)
    landed_us = flight.time_us
    flight.run(3.0)
    assert len(asked_s(flight, landed_us)) >= 2
