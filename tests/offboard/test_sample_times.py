"""Attitude and position are sampled at times of their own."""

import numpy as np
import pytest

from kffa_offboard.offboard.events import PositionReceived
from kffa_offboard.offboard.segments import Hold, Takeoff
from kffa_offboard.offboard.service import State


@pytest.mark.parametrize("ages_us", [(0, 4000), (4000, 12_000, 8000)])
def test_thrust_does_not_shake_in_a_climb_because_positions_are_older_by_turns(fake, ages_us):
    """As PX4 sends them: thrust left the mean of its neighbours by 0.05 rms at 1 m/s."""
    flight = fake.Lockstep(fake.settings(scenario=(Takeoff(8.0, 1.0), Hold(100.0)))).run_to(State.ENGAGED)
    flight.run(20.0, lambda: flight.vehicle.position > 3.0)
    count = [0]

    def older(event):
        if not isinstance(event, PositionReceived):
            return event
        count[0] += 1
        age_us = ages_us[count[0] % len(ages_us)]
        (x, y, z), climb_rate = event.position, event.velocity[2]
        before = PositionReceived(
            event.sample_time_us - age_us, (x, y, z - climb_rate * age_us * 1e-6), event.velocity
        )
        return before

    flight.change = older
    flight.run(0.5)
    flight.log.clear()
    flight.run(2.0)
    assert flight.vehicle.velocity == pytest.approx(1.0, abs=0.02)
    thrusts = flight.thrusts
    assert np.std(thrusts[1:-1] - 0.5 * (thrusts[:-2] + thrusts[2:])) < 2e-3
