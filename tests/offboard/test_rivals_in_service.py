"""A rival for the vehicle: engaging is refused while he is there, control that is fought over is given up."""

import pytest

from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import IntrusionNoticed
from kffa_offboard.offboard.service import State

SETPOINTS = IntrusionNoticed("255/190 sends setpoints to the vehicle", "ends")
SECOND = IntrusionNoticed("another vehicle is 1/1: 10.0.0.7:9999", "forbids")
REFUSED = IntrusionNoticed("refusing 255/190: not signed", "said")


@pytest.fixture
def ready(fake):
    flight = fake.Lockstep(fake.settings(engage=False))
    flight.run_to(State.READY)
    return flight


@pytest.fixture
def engaged(ready):
    ready.give(events.EngageRequested())
    ready.run_to(State.ENGAGED)
    return ready


@pytest.mark.parametrize("rival", [SETPOINTS, SECOND])
def test_a_rival_forbids_engaging_for_five_seconds_and_is_announced(ready, rival):
    ready.give(rival)
    assert rival.text in ready.texts
    ready.run(4.9)
    ready.give(events.EngageRequested())
    assert f"not engaged: {rival.text}" in ready.texts
    assert ready.service.state is State.READY
    ready.run(0.2)
    ready.give(events.EngageRequested())
    assert ready.service.state is State.ENGAGING


def test_what_is_only_said_forbids_nothing(ready):
    ready.give(REFUSED)
    assert REFUSED.text in ready.texts
    ready.give(events.EngageRequested())
    assert ready.service.state is State.ENGAGING


def test_a_stray_setpoint_is_announced_and_control_is_kept(engaged):
    for _ in range(2):
        engaged.give(SETPOINTS)
    engaged.run(2.1)
    engaged.give(SETPOINTS)
    assert engaged.service.state is State.ENGAGED
    assert engaged.texts.count(SETPOINTS.text) == 1


def test_a_second_sender_of_setpoints_ends_control_at_the_third_within_two_seconds(engaged):
    for _ in range(2):
        engaged.give(SETPOINTS)
        engaged.run(0.9)
    assert engaged.service.state is State.ENGAGED
    engaged.give(SETPOINTS)
    assert engaged.service.state is State.FAILSAFE
    assert f"failsafe: {SETPOINTS.text}" in engaged.texts


def test_what_is_not_heard_anyway_never_ends_control(engaged):
    """Else anybody who can send one datagram could."""
    for _ in range(50):
        engaged.give(SECOND)
        engaged.run(0.02)
    assert engaged.service.state is State.ENGAGED


def test_a_flood_of_inventions_is_told_in_few_words(ready):
    before = len(ready.texts)
    for number in range(500):
        ready.give(IntrusionNoticed(f"refusing 1/{number}: not signed", "said"))
        ready.run(0.01)
    assert 1 <= len(ready.texts) - before <= 6
    assert len(ready.service._rivals.said) <= 8


def test_the_same_is_said_again_after_half_a_minute(ready):
    for _ in range(40):
        ready.give(SECOND)
        ready.run(1.0)
    assert ready.texts.count(SECOND.text) == 2
