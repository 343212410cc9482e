"""Motors that are stopped in flight: what the law goes on with, and what is left when it does not."""

import pytest
from msgspec import structs

from kffa_offboard.offboard import events
from kffa_offboard.offboard.carrying import Carrying
from kffa_offboard.offboard.events import PositionReceived
from kffa_offboard.offboard.falling import NO_FALL, carried_before, shows, watch_fall
from kffa_offboard.offboard.segments import Hold
from kffa_offboard.offboard.service import State

BEFORE, MEANWHILE = Carrying(0.4, 0.4, 0.4), Carrying(0.9, 0.9, 0.9)
HOVER = 0.4


def followed(acceleration, seconds, thrust=HOVER, noise=(0.0,), gap_s=0.0):
    """What is known after so long with this acceleration, in samples of 10 ms."""
    fall = NO_FALL
    for k in range(round(seconds * 100) + 1):
        time_us = 10_000 * k + (round(gap_s * 1e6) if k > 5 else 0)
        rate = acceleration * 0.01 * k + noise[k % len(noise)]
        position = PositionReceived(time_us, (0.0, 0.0, 5.0), (0.0, 0.0, rate))
        fall = watch_fall(fall, position, thrust, HOVER, BEFORE if k < 4 else MEANWHILE)
    return fall


def test_after_a_tenth_of_a_second_what_carried_before_the_fall_counts():
    fall = followed(-9.8, 0.2)
    assert shows(fall) and carried_before(fall, MEANWHILE) == BEFORE


@pytest.mark.parametrize("acceleration", [-3.9, -5.0, 0.0, 5.0])
def test_a_heavy_load_or_half_of_the_thrust_is_no_fall(acceleration):
    assert not shows(followed(acceleration, 1.0, noise=(0.0, 0.05, -0.05)))


def test_noise_of_the_climb_rate_hides_no_fall():
    assert shows(followed(-9.8, 0.3, noise=(0.0, 0.05, -0.05, 0.02)))


def test_a_vehicle_that_is_told_to_fall_does_what_it_is_told():
    assert not shows(followed(-9.8, 0.5, thrust=0.2))


def test_over_a_gap_nothing_is_concluded():
    assert not shows(followed(-9.8, 0.13, gap_s=0.2))


def killed(flight, armed=True):
    return structs.replace(flight.vehicle.heartbeat(), killed=True, armed=armed)


def engaged(fake):
    return fake.Lockstep(fake.settings(scenario=(Hold(100.0),)), fake.airborne()).run_to(State.ENGAGED)


def test_a_kill_switch_ends_control_without_a_last_setpoint(fake):
    flight = engaged(fake)
    flight.run(1.0)
    sent = len(flight.sent(events.AttitudeTarget))
    flight.give(killed(flight))
    flight.run(0.5)
    assert flight.texts[-1] == "control given up: kill switch"
    assert flight.service.state is not State.ENGAGED
    assert len(flight.sent(events.AttitudeTarget)) == sent


def test_in_a_fall_the_law_goes_on_and_the_kill_switch_is_said_once(fake):
    settings = fake.settings(scenario=(Hold(100.0),))
    flight = fake.Lockstep(settings, fake.airborne(position=40.0)).run_to(State.ENGAGED)
    flight.run(1.0)
    flight.vehicle.weight = 1e9
    flight.change = lambda event: (
        structs.replace(event, killed=True) if isinstance(event, events.HeartbeatReceived) else event
    )
    flight.run(0.3)
    for _ in range(2):
        flight.give(flight.vehicle.heartbeat())
    assert flight.service.state is State.ENGAGED
    assert flight.texts.count("kill switch: the motors are stopped") == 1
    assert flight.sent(events.AttitudeTarget)[-1][1].thrust > 0.9
    (*_, last) = flight.service.last_setpoints()
    assert last.thrust == pytest.approx(fake.hover, rel=0.1), "not what the fall looks like"


def test_an_estimate_that_falls_through_the_ground_ends_control(fake):
    """PX4's did after the impact, for 3 m and 0.7 s, in which the law asked for all thrust."""
    flight = engaged(fake)
    flight.run(1.0)
    begun_us = flight.time_us

    def falling(event):
        if not isinstance(event, PositionReceived):
            return event
        seconds = (flight.time_us - begun_us) * 1e-6
        return structs.replace(
            event, position=(0.0, 0.0, 3.0 - 4.9 * seconds**2), velocity=(0.0, 0.0, -9.8 * seconds)
        )

    flight.change = falling
    flight.run(0.76)
    assert flight.service.state is State.ENGAGED
    flight.run(0.05)
    assert "failsafe: fell to the ground" in flight.texts
    last = flight.sent(events.AttitudeTarget)[-1][1]
    assert last.attitude is not None and last.thrust == pytest.approx(fake.hover, rel=0.1)


def test_with_the_kill_switch_on_nothing_is_ready_or_engaged(fake):
    settings = fake.settings(engage=False, scenario=(Hold(100.0),))
    flight = fake.Lockstep(settings, fake.airborne()).run_to(State.READY)
    flight.give(killed(flight))
    flight.give(events.EngageRequested())
    assert flight.texts[-1] == "not engaged: kill switch is on"
    flight.give(flight.vehicle.heartbeat())
    flight.give(events.EngageRequested())
    assert flight.texts[-1] == "engaging in the air"
