"""What the autopilot calls invalid of its own estimate is not flown, and nothing is engaged on it."""

from math import radians

import pytest
from msgspec import structs

from kffa_offboard.control.position import PositionDesign, design_ring
from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import EstimateReported
from kffa_offboard.offboard.segments import Hold
from kffa_offboard.offboard.service import State
from kffa_offboard.offboard.settings import PositionSettings

SOUND = EstimateReported(attitude=True, height=True, position=True)
BAD = {part: structs.replace(SOUND, **{part: False}) for part in ("attitude", "height", "position")}
RING = PositionSettings(design_ring("ladrc", PositionDesign(tilt_max=radians(20.0))), radians(20.0))


def flight_of(fake, ring, **changes):
    position = RING if ring else None
    settings = fake.settings(scenario=(Hold(100.0),), position=position, **changes)
    return fake.Lockstep(settings, fake.airborne())


def hear(flight, reported, seconds):
    """The autopilot says it five times a second."""
    for _ in range(round(5 * seconds)):
        flight.give(reported)
        flight.run(0.2)


@pytest.mark.parametrize(
    ("part", "ring", "ends"),
    [
        ("attitude", False, True),
        ("height", False, True),
        ("position", True, True),
        ("position", False, False),
    ],
)
def test_control_ends_when_what_it_needs_is_invalid_for_a_second(fake, part, ring, ends):
    flight = flight_of(fake, ring).run_to(State.ENGAGED)
    hear(flight, SOUND, 1.0)
    hear(flight, BAD[part], 0.8)
    assert flight.service.state is State.ENGAGED, "an estimator may choose another sensor"
    hear(flight, SOUND, 0.2)
    hear(flight, BAD[part], 1.0)
    assert flight.service.state is State.ENGAGED, "the time counts anew"
    flight.give(BAD[part])
    reason = f"failsafe: autopilot calls its {part} invalid"
    assert (flight.service.state is State.FAILSAFE, reason in flight.texts) == (ends, ends)
    fence = "position invalid: the fence is not watched"
    assert (fence in flight.texts) == (part == "position" and not ring)


def test_without_the_ring_a_lost_position_is_said_once_and_the_fence_is_not_watched(fake):
    flight = flight_of(fake, ring=False).run_to(State.ENGAGED)
    hear(flight, BAD["position"], 3.0)

    def far(event):
        if not isinstance(event, events.PositionReceived):
            return event
        return structs.replace(event, position=(1000.0, 0.0, event.position[2]))

    flight.change = far
    hear(flight, BAD["position"], 1.0)
    assert flight.service.state is State.ENGAGED
    assert flight.texts.count("position invalid: the fence is not watched") == 1
    flight.give(SOUND)
    flight.run(0.1)
    assert "failsafe: 1000.0 m away, fence at 100" in flight.texts


@pytest.mark.parametrize("part", ["attitude", "height", "position"])
def test_it_waits_for_a_valid_estimate_says_so_once_and_then_engages(fake, part):
    flight = flight_of(fake, ring=True)
    hear(flight, BAD[part], 5.0)
    assert flight.service.state is State.WAITING
    assert flight.texts.count(f"not ready: autopilot calls its {part} invalid") == 1
    flight.give(SOUND)
    flight.run_to(State.ENGAGED)


def test_what_becomes_invalid_after_ready_forbids_engaging_at_once_and_is_not_ready_after_a_second(fake):
    flight = flight_of(fake, ring=True, engage=False).run_to(State.READY)
    flight.give(BAD["position"])
    flight.give(events.EngageRequested())
    assert flight.texts[-1] == "not engaged: autopilot calls its position invalid"
    hear(flight, BAD["position"], 1.2)
    assert flight.service.state is State.WAITING
    assert flight.texts[-1] == "not ready: autopilot calls its position invalid"
    flight.give(SOUND)
    flight.run_to(State.READY)


def test_an_autopilot_that_says_nothing_of_its_estimate_is_flown(fake):
    flight = flight_of(fake, ring=True).run_to(State.ENGAGED)
    flight.run(3.0)
    assert flight.service.state is State.ENGAGED


def test_what_was_said_before_the_autopilot_fell_silent_does_not_count(fake):
    flight = flight_of(fake, ring=True)
    hear(flight, BAD["position"], 2.0)
    flight.mute = {events.HeartbeatReceived}
    flight.run(4.0)
    assert flight.service.state is State.WAITING
    flight.mute = set()
    flight.run_to(State.ENGAGED)
    assert flight.texts[-1] == "engaged"
