"""Scenario references have the shape and the timing that the scenario asks for."""

from math import inf, nan, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kffa_offboard.offboard.reference import (
    Altitude,
    Gripper,
    Hold,
    Land,
    ScenarioState,
    Sine,
    Step,
    Takeoff,
    Triangle,
    check_scenario,
    plan_profile,
    profile_altitude,
    starts_on_ground,
    step_scenario,
    wave,
)
from kffa_offboard.offboard.settings import FlightSettings

SETTINGS = FlightSettings()


def play(segments, duration, dt=0.01, follow=True, start=3.0, grounded=False):
    """References, gripper actions with their times, and the time at which the scenario was done."""
    state = ScenarioState(hold_altitude=start, yaw=0.4, ground=0.0)
    altitude, references, actions, done = start, [], [], None
    for k in range(round(duration / dt)):
        state, out = step_scenario(SETTINGS, segments, state, k * dt, altitude, grounded)
        altitude = out.reference[3] if follow else altitude
        references.append(out.reference)
        actions += [(k * dt, action) for action in out.gripper]
        if out.done and done is None:
            done = k * dt
    return np.array(references), actions, done


def test_a_hold_is_level_at_the_present_heading_and_altitude():
    references, _, done = play((Hold(1.0),), 1.5)
    np.testing.assert_array_equal(references, np.tile([0.0, 0.0, 0.4, 3.0], (150, 1)))
    assert done == pytest.approx(1.0)


@pytest.mark.parametrize(("channel", "row"), [("roll", 0), ("pitch", 1), ("yaw", 2), ("altitude", 3)])
def test_a_step_changes_one_channel_and_steps_back(channel, row):
    references, _, _ = play((Step(channel, 0.3, 1.0), Hold(1.0)), 2.0)
    deviation = references - [0.0, 0.0, 0.4, 3.0]
    np.testing.assert_allclose(deviation[:100, row], 0.3)
    np.testing.assert_allclose(deviation[100:], 0.0)
    np.testing.assert_allclose(np.delete(deviation, row, axis=1), 0.0)


def test_triangle_and_sine_go_up_first_and_come_back():
    for shape in (Triangle("altitude", 0.5, 4.0), Sine("altitude", 0.5, 4.0)):
        values = [wave(shape, t) for t in (0.0, 1.0, 2.0, 3.0, 4.0)]
        np.testing.assert_allclose(values, [0.0, 0.5, 0.0, -0.5, 0.0], atol=1e-12)
    assert wave(Triangle("roll", 1.0, 4.0), 0.5) == pytest.approx(0.5)
    assert wave(Sine("roll", 1.0, 4.0), 0.5) == pytest.approx(np.sin(pi / 4))


def test_segments_keep_their_nominal_times_however_coarse_the_samples():
    segments = (Hold(0.33), Step("roll", 0.1, 0.33), Gripper("grab"), Hold(0.34))
    state = ScenarioState(hold_altitude=1.0, yaw=0.0, ground=0.0)
    for now in (0.0, 0.2, 0.4, 0.6):
        state, out = step_scenario(SETTINGS, segments, state, now, 1.0)
    assert (state.segment_index, out.reference[0]) == (1, 0.1)
    state, out = step_scenario(SETTINGS, segments, state, 0.8, 1.0)
    assert out.gripper == ("grab",)
    assert state.started_s == pytest.approx(0.66)
    _, out = step_scenario(SETTINGS, segments, state, 1.0, 1.0)
    assert out.done


def test_the_gripper_works_once_and_takes_no_time():
    _, actions, done = play((Hold(0.5), Gripper("grab"), Hold(0.5), Gripper("release")), 1.5)
    assert actions == [(pytest.approx(0.5), "grab"), (pytest.approx(1.0), "release")]
    assert done == pytest.approx(1.0)


def test_an_empty_scenario_holds_and_is_never_done():
    references, _, done = play((), 1.0)
    assert done is None
    np.testing.assert_array_equal(references[-1], [0.0, 0.0, 0.4, 3.0])


@given(
    start=st.floats(-5.0, 5.0),
    target=st.floats(-5.0, 20.0),
    speed=st.floats(0.1, 3.0),
    acceleration=st.floats(0.2, 3.0),
    climb=st.floats(-2.0, 2.0),
)
def test_a_profile_goes_from_start_to_target_within_speed_and_acceleration(
    start, target, speed, acceleration, climb
):
    profile = plan_profile(start, target, speed, acceleration, climb)
    times = np.linspace(0.0, profile.duration + 0.1, 400)
    heights = np.array([profile_altitude(profile, t) for t in times])
    velocity = np.diff(heights) / np.diff(times)
    assert heights[0] == pytest.approx(start)
    assert heights[-1] == target
    assert np.all(heights <= max(start, target) + 1e-9) and np.all(heights >= min(start, target) - 1e-9)
    assert np.max(np.abs(velocity)) <= speed + 1e-6
    assert np.max(np.abs(np.diff(velocity))) <= acceleration * np.diff(times)[0] * 1.01 + 1e-6


def test_a_profile_begins_with_the_present_climb_rate():
    profile = plan_profile(0.1, 5.0, 1.0, 1.0, 0.4)
    assert (profile_altitude(profile, 0.01) - 0.1) / 0.01 == pytest.approx(0.4, abs=0.01)


def test_a_takeoff_in_the_air_ends_half_a_second_after_arriving():
    references, _, done = play((Takeoff(5.0, 1.0), Hold(1.0)), 6.0)
    arrival = 2.0 / 1.0 + 1.0  # distance / speed + speed / acceleration
    assert references[round(arrival / 0.01) + 1, 3] == pytest.approx(5.0)
    assert done == pytest.approx(arrival + SETTINGS.arrival_time_s + 1.0, abs=0.03)


def test_another_altitude_is_gone_to_with_its_speed_and_kept():
    references, _, done = play((Takeoff(5.0, 1.0), Altitude(2.0, 0.5), Hold(1.0)), 12.0)
    begins = 3.0 + SETTINGS.arrival_time_s
    steepest = np.diff(references[round(begins / 0.01) :, 3]).min() / 0.01
    assert steepest == pytest.approx(-0.5, abs=1e-3)
    needed = 3.0 / 0.5 + 0.5  # distance / speed + speed / acceleration
    assert references[round((begins + needed) / 0.01) + 2, 3] == pytest.approx(2.0)
    assert done == pytest.approx(begins + needed + SETTINGS.arrival_time_s + 1.0, abs=0.05)


@pytest.mark.parametrize(
    ("segment", "words"), [(Takeoff(2.0), "take-off stuck at 0.5"), (Altitude(2.0), "altitude stuck at 0.5")]
)
def test_a_vehicle_that_does_not_follow_is_a_fault(segment, words):
    state = ScenarioState(hold_altitude=0.0, yaw=0.0, ground=0.0)
    for k in range(2000):
        state, out = step_scenario(SETTINGS, (segment,), state, k * 0.01, 0.5)
        if out.fault:
            break
    assert f"{words} of 2.0 m" in out.fault
    assert k * 0.01 == pytest.approx(3.0 + SETTINGS.arrival_timeout_s, abs=0.03)


def test_on_the_ground_the_scenario_waits_before_the_takeoff():
    references, actions, done = play(
        (Hold(0.2), Gripper("grab"), Takeoff(2.0)), 3.0, start=0.0, grounded=True
    )
    assert (done, len(actions)) == (None, 1)
    np.testing.assert_array_equal(references[:, 3], 0.0)


def test_a_landing_speeds_up_gently_and_is_slow_in_the_last_metre():
    references, _, done = play((Land(1.0),), 10.0, start=5.0)
    height, speed = references[:, 3], -np.diff(references[:, 3]) / 0.01
    assert done is None
    assert np.max(speed) == pytest.approx(1.0, abs=1e-6)
    assert np.max(np.abs(np.diff(speed))) <= SETTINGS.acceleration_m_s2 * 0.01 * 1.5
    near = (height[:-1] < 0.99) & (height[:-1] > -0.5)
    np.testing.assert_allclose(speed[near], SETTINGS.slow_descent_rate_m_s, atol=0.02)


def test_a_landing_reference_does_not_run_away_from_a_vehicle_that_stands():
    references, _, _ = play((Land(1.0),), 30.0, start=5.0, follow=False)
    assert references[-1, 3] == pytest.approx(5.0 - SETTINGS.landing_lead_m)
    assert np.all(np.diff(references[:, 3]) <= 1e-12)


@pytest.mark.parametrize(
    ("segments", "words"),
    [
        ((Hold(-1.0),), "segment 1 (hold): duration_s = -1.0"),
        ((Hold(1.0), Takeoff(nan)), "segment 2 (takeoff): altitude_m = nan"),
        ((Takeoff(2.0, 0.0),), "climb_rate_m_s = 0.0"),
        ((Sine("roll", 0.1, 0.0),), "period_s"),
        ((Triangle("roll", 0.1, 1.0, inf),), "cycles = inf"),
        ((Step("roll", nan, 1.0),), "amplitude"),
        ((Land(0.5), Hold(1.0)), "segment 1 (land): must be the last"),
        ((Land(0.0),), "descent_rate_m_s"),
    ],
)
def test_a_scenario_that_cannot_be_flown_is_refused_by_name(segments, words):
    with pytest.raises(ValueError) as error:
        check_scenario(segments)
    assert words in str(error.value)


def test_only_holds_and_the_gripper_may_come_before_a_takeoff_on_the_ground():
    assert starts_on_ground((Hold(1.0), Gripper("grab"), Takeoff(2.0), Land()))
    assert not starts_on_ground((Step("roll", 0.1, 1.0), Takeoff(2.0)))
    assert not starts_on_ground((Altitude(2.0), Takeoff(2.0)))
    assert not starts_on_ground((Hold(1.0),))
    assert not starts_on_ground(())
