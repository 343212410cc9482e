"""Telemetry was silent for a moment, and is back: what is believed of it."""

from dataclasses import replace

import pytest

from kffa_offboard.offboard.events import AttitudeReceived, AttitudeTarget, PositionReceived
from kffa_offboard.offboard.segments import Hold, Takeoff
from kffa_offboard.offboard.service import State


@pytest.fixture
def climbing(fake):
    """Climbs at 1 m/s when telemetry falls silent, which it may for 2 s."""
    settings = fake.settings(scenario=(Takeoff(8.0, 1.0), Hold(100.0)))
    silent = replace(settings.telemetry, timeout_s=2.0, position_timeout_s=2.0)
    flight = fake.Lockstep(replace(settings, telemetry=silent)).run_to(State.ENGAGED)
    flight.run(20.0, lambda: flight.vehicle.position > 3.0)
    return flight


def test_a_position_from_before_the_silence_is_not_taken_for_one_of_now(climbing):
    """The position comes after its attitude, so the first attitude after a silence finds an old one."""
    climbing.mute = {AttitudeReceived}
    climbing.tick()
    climbing.mute = {AttitudeReceived, PositionReceived}
    climbing.run(0.5)
    climbing.mute = {PositionReceived}
    climbing.tick()
    height = climbing.vehicle.position
    assert height - climbing.service._known.position.position[2] > 0.3
    assert climbing.service._loop.altitude == pytest.approx(height, abs=0.05)


def test_a_position_stream_that_is_late_for_good_is_still_used(climbing):
    """Only the step that ends a silence does without: height is never left to reckoning alone."""
    kept = []
    late = [0]

    def change(event):
        if not isinstance(event, PositionReceived):
            return event
        kept.append(event)
        late[0] = min(late[0] + 1, 20)
        return kept[-late[0]]

    climbing.change = change
    climbing.run(0.4)
    known, loop = climbing.service._known, climbing.service._loop
    assert known.attitude.sample_time_us - known.position.sample_time_us > 150_000
    assert loop.position_us == known.position.sample_time_us
    assert abs(loop.altitude - known.position.position[2]) < 0.15


def test_the_first_setpoint_after_a_silence_has_not_acted_during_it(climbing):
    """Thrust far below hover for one step weighed as much as the silence was long: it looked like a swing."""
    climbing.run(20.0, lambda: climbing.vehicle.position > 7.9)
    climbing.run(5.0)
    climbing.mute = {AttitudeReceived, PositionReceived}
    climbing.vehicle.weight = 0.7  # a load leaves unseen
    before = len(climbing.sent(AttitudeTarget))
    climbing.run(0.6)
    climbing.mute = set()
    climbing.tick()
    *blind, (_, first) = climbing.sent(AttitudeTarget)[before:]
    acted = [target.thrust for _, target in blind]
    assert len(acted) >= 4 and first.thrust < 0.6 * min(acted)
    assert climbing.service._loop.carrying.short == pytest.approx(acted[-1], rel=0.02)
    climbing.run(0.3)
    assert climbing.service._loop.carrying.short < 0.9 * acted[-1], "and from then on it acts"
