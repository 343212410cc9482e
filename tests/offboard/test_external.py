"""Setpoints from outside become a reference that can be flown."""

import math
from itertools import pairwise

import pytest

from kffa_offboard.offboard import external
from kffa_offboard.offboard.events import AttitudeSetpoint, PositionSetpoint
from kffa_offboard.offboard.reference import ScenarioState
from kffa_offboard.offboard.segments import External, Move
from kffa_offboard.offboard.service import State
from kffa_offboard.offboard.settings import FlightSettings

FLIGHT = FlightSettings()
HOME = ScenarioState(hold_altitude=3.0, yaw=0.0, ground=0.0)


def path(state, seconds):
    """Offset x, y and altitude every 10 ms."""
    rows = []
    for k in range(round(seconds * 100)):
        moved = external.hold(state, HOME, (0.0, 0.0), state.begun_us + 10_000 * k)
        rows.append((*moved.offset, moved.hold_altitude))
    return rows


def test_a_jump_is_flown_as_a_move_of_a_scenario():
    state = external.go_to(FLIGHT, None, PositionSetpoint((3.0, -4.0, None)), (0.0, 0.0, 3.0), 0)
    profile = Move(3.0, 4.0, 10.0).profile(FLIGHT.acceleration_m_s2)
    rows = path(state, profile.duration + 0.1)
    for x, y, z in rows:
        assert x / 3.0 == pytest.approx(-y / 4.0, abs=1e-9)
        assert z == 3.0
    speeds = [math.hypot(b[0] - a[0], b[1] - a[1]) * 100 for a, b in pairwise(rows)]
    assert max(speeds) == pytest.approx(2.0, abs=1e-6)
    assert rows[-1] == pytest.approx((3.0, -4.0, 3.0))


def test_the_same_place_again_changes_nothing():
    asked = PositionSetpoint((5.0, 0.0, 4.0))
    state = external.go_to(FLIGHT, None, asked, (0.0, 0.0, 3.0), 0)
    assert external.go_to(FLIGHT, state, asked, (1.0, 0.0, 3.2), 1_000_000) == state


def test_a_place_that_moves_is_followed_without_stopping():
    state, here, speeds = None, (0.0, 0.0, 3.0), []
    for k in range(400):  # 20 Hz, moving at 1 m/s
        asked = PositionSetpoint((2.0 + 0.05 * k, 0.0, None))
        state = external.go_to(FLIGHT, state, asked, here, 50_000 * k)
        moved = external.hold(state, HOME, (0.0, 0.0), 50_000 * (k + 1))
        speeds.append((moved.offset[0] - here[0]) / 0.05)
        here = (*moved.offset, moved.hold_altitude)
    assert here[0] == pytest.approx(2.0 + 0.05 * 399, abs=1.0)
    assert speeds[-1] == pytest.approx(1.0, abs=0.15)
    assert max(abs(b - a) for a, b in pairwise(speeds)) < 1.2 * 0.05


def test_height_alone_leaves_the_place_and_heading_alone_leaves_both():
    state = external.go_to(FLIGHT, None, PositionSetpoint((None, None, 5.0)), (0.0, 0.0, 3.0), 0)
    assert path(state, 6.0)[-1] == pytest.approx((0.0, 0.0, 5.0))
    state = external.go_to(FLIGHT, state, PositionSetpoint((None, None, None), 1.0), (0.0, 0.0, 4.0), 10**6)
    moved = external.hold(state, HOME, (0.0, 0.0), 10 * 10**6)
    assert (moved.yaw, moved.hold_altitude) == (1.0, pytest.approx(5.0))


def test_an_attitude_lasts_half_a_second():
    state = external.lean(None, AttitudeSetpoint((0.1, 0.0, 0.3)), 0)
    assert not external.expired(FLIGHT, state, 500_000)
    assert external.expired(FLIGHT, state, 500_001)


def test_a_stream_of_setpoints_that_cannot_be_flown_does_not_become_one_of_texts(fake):
    """Each names another height; a serial line would have had no room left for setpoints of our own."""
    flight = fake.Lockstep(fake.settings(scenario=(External(100.0),)), fake.airborne()).run_to(State.ENGAGED)
    flight.log.clear()
    for height in range(60, 560):
        flight.give(PositionSetpoint((None, None, float(height))))
    assert len(flight.texts) == 20
    assert flight.texts[0] == "setpoint not followed: altitude 60 m is outside -3 .. 50"


@pytest.mark.parametrize("after_us", [0, 5_000, 9_000])
@pytest.mark.parametrize("often", [1, 10])
def test_a_stream_of_places_that_move_is_followed_whenever_they_come(fake, after_us, often):
    """Up to a thousand a second, long after a control step: the set point crept, and jumped at the end."""
    flight = fake.Lockstep(fake.settings(scenario=(External(100.0),)), fake.airborne()).run_to(State.ENGAGED)
    heights = []
    for k in range(400):
        for part in range(often):
            asked = PositionSetpoint((None, None, 20.0 + 0.01 * k + 1e-3 * part))
            flight.service.handle(flight.time_us + after_us, asked)
        flight.tick()
        heights.append(flight.service._flight.scenario.hold_altitude)
    speeds = [(b - a) / 0.01 for a, b in pairwise(heights)]
    assert speeds[-1] == pytest.approx(FLIGHT.setpoint_climb_rate_m_s, rel=0.01)
    assert max(abs(b - a) for a, b in pairwise(speeds)) < 1.2 * 0.01 * FLIGHT.acceleration_m_s2
    assert flight.altitudes[-1] > 5.0
