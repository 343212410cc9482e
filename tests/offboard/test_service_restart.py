"""A daemon that was started again in flight takes control only if it is told to."""

import pytest

from kffa_offboard.offboard import events
from kffa_offboard.offboard.service import State

OBSERVING = "restarted in flight: only observing"


def flying(fake, **settings):
    """The vehicle flies in a mode of its own when the daemon comes up."""
    return fake.Lockstep(fake.settings(engage=True, **settings), fake.airborne())


def test_after_an_interruption_an_armed_vehicle_is_only_observed(fake):
    flight = flying(fake, interrupted=True)
    flight.run(6.0)
    assert flight.texts == [OBSERVING, "ready"]
    assert flight.service.state is State.READY
    assert flight.sent(events.AttitudeTarget) == flight.sent(events.SetMode) == []


def test_who_asks_gets_control_all_the_same(fake):
    flight = flying(fake, interrupted=True)
    flight.run_to(State.READY)
    flight.give(events.EngageRequested())
    flight.run_to(State.ENGAGED)


@pytest.mark.parametrize("interrupted", [True, False])
def test_an_interruption_in_another_flight_forbids_nothing(fake, interrupted):
    flight = fake.Lockstep(fake.settings(engage=True, arm=True, interrupted=interrupted))
    flight.run_to(State.ENGAGED)
    assert OBSERVING not in flight.texts


def test_a_start_in_the_air_is_no_restart(fake):
    flight = flying(fake)
    flight.run_to(State.ENGAGED)
