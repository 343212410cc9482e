"""Telemetry is believed only while it flows, advances and is possible."""

from math import inf, isnan, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from kffa_offboard.offboard import telemetry
from kffa_offboard.offboard.events import (
    AttitudeReceived,
    HeartbeatReceived,
    LandedStateReported,
    LinkMeasured,
    ModeKind,
    PositionReceived,
    TargetReported,
    ThrottleReported,
)
from kffa_offboard.offboard.settings import LimitSettings, TelemetrySettings
from kffa_offboard.offboard.telemetry import Stream, Telemetry

SETTINGS = TelemetrySettings(repeated_samples_max=5)
LIMITS = LimitSettings()


def attitude(sample_us, roll=0.0, yaw=0.0):
    return AttitudeReceived(sample_us, (roll, 0.0, yaw), (0.0, 0.0, 0.0))


def position(sample_us, altitude=0.0):
    return PositionReceived(sample_us, (0.0, 0.0, altitude), (0.0, 0.0, 0.0))


def take_attitude(known, time_us, event):
    return telemetry.receive_attitude(SETTINGS, LIMITS, known, time_us, event)


def take_position(known, time_us, event):
    return telemetry.receive_position(SETTINGS, LIMITS, known, time_us, event)


def test_the_step_comes_from_the_autopilots_clock_not_from_arrival():
    known, first = take_attitude(Telemetry(), 1_000_000, attitude(500_000))
    known, second = take_attitude(known, 1_000_001, attitude(510_000))
    assert (first.dt, second.dt) == (0.0, pytest.approx(0.01))


def test_a_repeated_or_late_sample_is_dropped_and_counted():
    known, _ = take_attitude(Telemetry(), 0, attitude(500_000))
    known, same = take_attitude(known, 10_000, attitude(500_000, roll=0.1))
    known, older = take_attitude(known, 20_000, attitude(490_000, roll=0.1))
    assert not same.accepted and not older.accepted and same.fault is None
    assert known.attitude_stream.dropped == 2
    assert known.attitude.attitude[0] == 0.0
    assert known.attitude_stream.arrival_us == 0


def test_a_standing_clock_is_a_fault_after_a_few_samples():
    known, _ = take_attitude(Telemetry(), 0, attitude(500_000))
    faults = []
    for k in range(6):
        known, sample = take_attitude(known, k, attitude(500_000))
        faults.append(sample.fault)
    assert faults[:5] == [None] * 5
    assert faults[5] == "6 samples with a standing clock"


def test_a_gap_in_the_autopilots_clock_is_a_fault_even_if_arrival_is_on_time():
    known, _ = take_attitude(Telemetry(), 0, attitude(500_000))
    _, sample = take_attitude(known, 10_000, attitude(800_000))
    assert sample.fault == "0.30 s between samples, 0.25 allowed"


def test_the_longest_gap_that_is_allowed_is_none_and_each_stream_has_its_own():
    settings = TelemetrySettings(timeout_s=0.25, position_timeout_s=0.5)
    for receive, event, longest_us in (
        (telemetry.receive_attitude, attitude, 250_000),
        (telemetry.receive_position, position, 500_000),
    ):
        known, _ = receive(settings, LIMITS, Telemetry(), 0, event(0))
        _, allowed = receive(settings, LIMITS, known, 1, event(longest_us))
        assert allowed.accepted and allowed.fault is None
        _, longer = receive(settings, LIMITS, known, 1, event(longest_us + 1))
        assert not longer.accepted and "s between samples" in longer.fault


@pytest.mark.parametrize(
    ("take", "first", "bad"),
    [
        (take_attitude, attitude(0), attitude(300_000)),
        (take_attitude, attitude(0), attitude(10_000, roll=0.5)),
        (take_position, position(0), position(300_000)),
        (take_position, position(0), position(10_000, altitude=5.0)),
    ],
)
def test_a_sample_that_is_a_fault_does_not_count_as_arrived(take, first, bad):
    """Else the next one would be compared with it, and a stream of faults would be no silence."""
    before, _ = take(Telemetry(), 0, first)
    after, sample = take(before, 10_000, bad)
    assert sample.fault is not None and not sample.accepted
    assert (after.attitude, after.position) == (before.attitude, before.position)
    assert (after.attitude_stream, after.position_stream) == (before.attitude_stream, before.position_stream)


def test_good_samples_in_between_begin_the_count_of_a_standing_clock_anew():
    known, _ = take_attitude(Telemetry(), 0, attitude(0))
    for k in range(1, 20):
        known, sample = take_attitude(known, k * 10_000, attitude(k // 4 * 10_000))
        assert sample.fault is None
    assert known.attitude_stream.dropped == 15


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("turn", "possible"), [(0.29, True), (0.31, False), (-0.29, True), (-0.31, False)])
def test_no_axis_turns_farther_than_its_rate_and_a_jump_allow(axis, turn, possible):
    """0.2 rad, and 10 rad/s for 10 ms."""
    known, _ = take_attitude(Telemetry(), 0, attitude(0))
    angles = tuple(turn if k == axis else 0.0 for k in range(3))
    _, sample = take_attitude(known, 10_000, AttitudeReceived(10_000, angles, (0.0, 0.0, 0.0)))
    assert sample.accepted == possible


def test_an_impossible_turn_is_a_fault_and_a_turn_across_pi_is_none():
    known, _ = take_attitude(Telemetry(), 0, attitude(0, yaw=3.14))
    _, crossing = take_attitude(known, 10_000, attitude(10_000, yaw=-3.14))
    assert crossing.accepted and crossing.fault is None
    _, jump = take_attitude(known, 10_000, attitude(10_000, roll=0.31, yaw=3.14))
    assert jump.fault == "attitude jumped 0.31 rad, 0.30 possible"


def test_an_impossible_change_of_altitude_is_a_fault():
    known, _ = take_position(Telemetry(), 0, position(0))
    _, possible = take_position(known, 10_000, position(10_000, 0.55))
    _, jump = take_position(known, 10_000, position(10_000, 0.65))
    assert possible.accepted
    assert jump.fault == "altitude jumped 0.65 m, 0.60 possible"


@pytest.mark.parametrize("bad", [-0.1, 1.1, 40.0])
def test_a_thrust_beyond_0_to_1_is_none(bad):
    known = telemetry.receive_target(Telemetry(), 0, TargetReported(0, bad, None, None))
    known = telemetry.receive_throttle(known, 0, ThrottleReported(bad))
    assert (known.target.thrust, known.throttle, known.invalid) == (None, None, 2)


@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_numbers_that_are_not_finite_are_faults_and_never_kept(bad):
    known, sample = take_attitude(Telemetry(), 0, AttitudeReceived(0, (0.0, 0.0, 0.0), (0.0, bad, 0.0)))
    assert sample.fault == "attitude is not finite" and known.attitude is None
    known, sample = take_position(known, 0, PositionReceived(0, (bad, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert sample.fault == "position is not finite" and known.position is None
    known = telemetry.receive_target(known, 0, TargetReported(0, bad, (0.0, bad, 0.0), (0.1, 0.0, 0.0)))
    assert (known.target.thrust, known.target.body_rates) == (None, None)
    assert known.target.attitude == (0.1, 0.0, 0.0)
    known = telemetry.receive_throttle(known, 0, ThrottleReported(bad))
    assert known.throttle is None
    assert known.invalid == 4


@pytest.mark.parametrize("place", range(6))
def test_each_number_of_a_sample_must_be_finite(place):
    """One that is not is counted, whichever it is."""
    numbers = [0.0] * 6
    numbers[place] = nan
    vectors = tuple(numbers[:3]), tuple(numbers[3:])
    for take, kind in ((take_attitude, AttitudeReceived), (take_position, PositionReceived)):
        known, sample = take(Telemetry(), 0, kind(0, *vectors))
        assert sample.fault.endswith("is not finite") and known == Telemetry(invalid=1)


def test_a_target_whose_attitude_is_not_finite_has_none():
    known = telemetry.receive_target(Telemetry(), 0, TargetReported(0, 0.4, None, (0.0, nan, 0.0)))
    assert (known.target.attitude, known.target.thrust, known.invalid) == (None, 0.4, 1)


@pytest.mark.parametrize("thrust", [0.0, 1.0])
def test_no_thrust_and_full_thrust_are_thrust(thrust):
    known = telemetry.receive_target(Telemetry(), 0, TargetReported(0, thrust, None, None))
    known = telemetry.receive_throttle(known, 0, ThrottleReported(thrust))
    assert (known.target.thrust, known.throttle, known.invalid) == (thrust, thrust, 0)


def test_rates_are_measured_over_the_last_second():
    known = Telemetry()
    for k in range(150):
        known, _ = take_attitude(known, k * 10_000, attitude(k * 10_000))
    assert telemetry.rate_hz(known.attitude_stream, 1_490_000) == 100.0
    assert telemetry.rate_hz(known.attitude_stream, 2_000_000) == 49.0
    assert len(known.attitude_stream.arrivals) == 100, "and no longer remembered"


@given(
    arrivals=st.lists(st.integers(0, 8), max_size=12).map(sorted),
    now=st.integers(8, 16),
    samples=st.integers(1, 14),
)
def test_whether_a_stream_is_slower_is_told_without_counting(arrivals, now, samples):
    """Times in quarters of a second: a sample just one second ago is the boundary."""
    stream = Stream(arrivals=tuple(250_000 * time for time in arrivals))
    now_us = 250_000 * now
    assert telemetry.slower(stream, samples, now_us) == (telemetry.rate_hz(stream, now_us) < samples)


@pytest.mark.parametrize(
    ("age_us", "carried"), [(0, 0.0), (12_000, 0.024), (-4_000, -0.008), (150_000, 0.3), (150_001, 0.0)]
)
def test_the_altitude_is_that_of_the_attitudes_time_unless_the_position_is_too_old(age_us, carried):
    """It climbs at 2 m/s; a position counts as late from 0.15 s on."""
    place = PositionReceived(1_000_000, (0.0, 0.0, 5.0), (0.0, 0.0, 2.0))
    known = Telemetry(attitude=attitude(1_000_000 + age_us), position=place)
    assert telemetry.altitude_now(SETTINGS, known) == pytest.approx(5.0 + carried, abs=1e-9)


def test_an_old_report_of_the_autopilots_thrust_counts_no_more():
    known = telemetry.receive_throttle(Telemetry(), 0, ThrottleReported(0.3))
    known = telemetry.receive_target(known, 0, TargetReported(0, 0.4, None, None))
    assert telemetry.reported_thrust(SETTINGS, known, 500_000) == 0.4
    assert telemetry.reported_thrust(SETTINGS, known, 500_001) is None
    known = telemetry.receive_throttle(known, 600_000, ThrottleReported(0.3))
    assert telemetry.reported_thrust(SETTINGS, known, 600_000) == 0.3


def test_tilt_and_altitude_out_of_limits_are_named():
    known, _ = take_attitude(Telemetry(), 0, attitude(0, roll=1.1))
    assert telemetry.outside_limits(LIMITS, known, 0.0) == "tilt beyond 1.05 rad"
    known, _ = take_position(Telemetry(), 0, position(0, 52.0))
    assert telemetry.outside_limits(LIMITS, known, 0.0) == "altitude 52.0 m outside -3.0 .. 50.0"
    assert telemetry.outside_limits(LIMITS, known, 10.0) is None


def test_upside_down_is_beyond_every_tilt_limit():
    known, _ = take_attitude(Telemetry(), 0, AttitudeReceived(0, (3.1, 3.1, 0.0), (0.0, 0.0, 0.0)))
    assert telemetry.outside_limits(LIMITS, known, 0.0) is not None


@pytest.mark.parametrize(
    ("roll", "pitch", "within"),
    [(1.04, 0.0, True), (0.0, -1.06, False), (-1.06, 0.0, False), (0.8, 0.8, False)],
)
def test_tilt_is_that_of_the_thrust_axis_whichever_way_it_leans(roll, pitch, within):
    """cos(tilt) = cos(roll) cos(pitch); 60 degrees are the limit."""
    known, _ = take_attitude(Telemetry(), 0, AttitudeReceived(0, (roll, pitch, 0.0), (0.0, 0.0, 0.0)))
    assert (telemetry.outside_limits(LIMITS, known, 0.0) is None) == within


@pytest.mark.parametrize(
    ("altitude", "ground", "within"),
    [(50.0, 0.0, True), (-3.0, 0.0, True), (-3.1, 0.0, False), (50.1, 0.0, False), (105.0, 100.0, True)],
)
def test_altitude_counts_from_the_ground_and_its_limits_are_within_it(altitude, ground, within):
    known, _ = take_position(Telemetry(), 0, position(0, altitude))
    assert (telemetry.outside_limits(LIMITS, known, ground) is None) == within


# -------------------------------------------------------------------------------- how old is it


def test_a_report_counts_for_half_a_second_and_the_target_counts_before_the_throttle():
    known = telemetry.receive_throttle(Telemetry(), 1_000_000, ThrottleReported(0.3))
    known = telemetry.receive_target(known, 1_000_000, TargetReported(0, None, (0.1, 0.0, 0.0), None))
    assert telemetry.reported_thrust(SETTINGS, known, 1_500_000) == 0.3, "that target has no thrust"
    assert telemetry.reported_target(SETTINGS, known, 1_500_000).body_rates == (0.1, 0.0, 0.0)
    assert telemetry.reported_target(SETTINGS, known, 1_500_001) is None
    assert telemetry.reported_thrust(SETTINGS, known, 1_500_001) is None
    known = telemetry.receive_target(known, 1_000_000, TargetReported(0, 0.4, None, None))
    assert telemetry.reported_thrust(SETTINGS, known, 1_500_000) == 0.4


@pytest.mark.parametrize("on_ground", [True, False])
def test_a_landed_state_counts_as_long_as_a_heartbeat_may_stay_away(on_ground):
    known = telemetry.receive_landed(Telemetry(), 1_000_000, LandedStateReported(on_ground))
    assert telemetry.reported_landed(SETTINGS, known, 4_000_000) is on_ground
    assert telemetry.reported_landed(SETTINGS, known, 4_000_001) is None


def linked(age_us, round_trip_s, offset_us=70_000_000):
    """Latency at 5 s of a sample of this age; the autopilot's clock is ahead by `offset_us`."""
    now_us = 5_000_000
    known, _ = take_attitude(Telemetry(), now_us, attitude(now_us - age_us + offset_us))
    return telemetry.latency_s(known, LinkMeasured(offset_us, round_trip_s), now_us)


def test_latency_is_the_age_of_the_sample_and_half_a_round_trip():
    assert linked(20_000, 0.06) == pytest.approx(0.05)
    assert linked(20_000, 0.06, offset_us=-3_000_000) == pytest.approx(0.05)


@pytest.mark.parametrize(
    ("age_us", "known"), [(10_000_000, True), (10_000_001, False), (0, True), (-1, False)]
)
def test_a_latency_that_makes_no_sense_is_none(age_us, known):
    """A sample from the future, or one that is older than 10 s: the autopilot's clock is another one."""
    assert isnan(linked(age_us, 0.0)) != known


def test_on_arrival_latency_does_not_count_the_silence_since():
    known, _ = take_attitude(Telemetry(), 1_020_000, attitude(1_000_000))
    link = LinkMeasured(0, 0.0)
    assert telemetry.latency_on_arrival_s(known, link, 1_200_000) == pytest.approx(0.02)
    assert telemetry.latency_s(known, link, 1_200_000) == pytest.approx(0.2)


# ------------------------------------------------------------------------- flowing without a break


def flowing(*entries, settings=SETTINGS):
    """Samples at these times, us, of one kind each: since when telemetry is steady."""
    known = Telemetry()
    for time_us, receive, event in entries:
        known, _ = receive(settings, LIMITS, known, time_us, event(time_us))
    return known.steady_since_us


A, P = (telemetry.receive_attitude, attitude), (telemetry.receive_position, position)


def test_telemetry_is_steady_since_the_first_sample_that_finds_both():
    assert flowing((0, *A), (10, *A), (20, *P)) is None
    assert flowing((0, *A), (10, *P), (20, *A), (30, *P), (40, *A)) == 20


@pytest.mark.parametrize(("late", "steady"), [(A, P), (P, A)])
@pytest.mark.parametrize("longest_us", [400_000, 200_000])
def test_a_silence_of_either_stream_begins_the_steady_time_anew(late, steady, longest_us):
    """As long as its own timeout, whichever stream notices first."""
    own_s, other_s = longest_us * 1e-6, 10.0
    settings = TelemetrySettings(
        timeout_s=own_s if late is A else other_s, position_timeout_s=own_s if late is P else other_s
    )
    begun = (0, *late), (10, *steady), (20, *late)
    for silence_us, since_us in ((longest_us - 1, 20), (longest_us, 20 + longest_us)):
        for first in (late, steady):
            assert flowing(*begun, (20 + silence_us, *first), settings=settings) == since_us


def test_what_is_forgotten_after_a_fault_are_the_samples_and_not_the_counts():
    known = Telemetry()
    for time_us in (0, 0, 10_000):
        known, _ = take_attitude(known, time_us, attitude(time_us))
        known, _ = take_position(known, time_us, position(time_us))
    heard = HeartbeatReceived("px4", ModeKind.OTHER, "POSCTL", 0, True)
    known = telemetry.receive_heartbeat(known, 10_000, heard)
    assert known.steady_since_us is not None
    after = telemetry.forget_samples(known)
    assert (after.attitude, after.position, after.steady_since_us) == (None, None, None)
    assert after.attitude_stream == after.position_stream == Stream(dropped=1)
    assert (after.heartbeat, after.armed_since_us) == (heard, 10_000)


def test_the_vehicle_is_armed_since_the_first_heartbeat_that_shows_it():
    known = Telemetry()
    since = []
    for time_us, armed in ((0, False), (10, True), (20, True), (30, False), (40, True)):
        heard = HeartbeatReceived("px4", ModeKind.OTHER, "POSCTL", 0, armed)
        known = telemetry.receive_heartbeat(known, time_us, heard)
        since.append(known.armed_since_us)
    assert since == [None, 10, 10, None, 40]
    lost = telemetry.forget_heartbeat(known)
    assert (lost.heartbeat, lost.armed_since_us) == (None, None)


@pytest.mark.parametrize(
    ("age_us", "silence_s", "old"),
    [(150_001, 0.16, True), (150_000, 0.16, False), (150_001, 0.15, False), (10_000, 0.5, False)],
)
def test_a_position_is_from_before_a_silence_if_attitude_was_late_and_it_is_older_than_that(
    age_us, silence_s, old
):
    known, _ = take_attitude(Telemetry(), 0, attitude(1_000_000))
    assert not telemetry.before_silence(SETTINGS, known, silence_s)
    known, _ = take_position(known, 0, position(1_000_000 - age_us))
    assert telemetry.before_silence(SETTINGS, known, silence_s) == old


# ------------------------------------------------------------------------------------- ready


def arrived(attitude_hz, position_hz, steady_since_us=0):
    """Heard of at these rates in the second that ends at 1 s."""
    streams = (
        Stream(arrivals=tuple(1_000_000 - 1000 * k for k in reversed(range(hz))))
        for hz in (attitude_hz, position_hz)
    )
    heard = HeartbeatReceived("px4", ModeKind.OTHER, "POSCTL", 0, False)
    attitudes, positions = streams
    return Telemetry(
        attitude_stream=attitudes,
        position_stream=positions,
        heartbeat=heard,
        steady_since_us=steady_since_us,
    )


@pytest.mark.parametrize(
    ("known", "reason"),
    [
        (arrived(40, 20), None),
        (arrived(39, 20), "attitude telemetry 39 Hz, 40 needed"),
        (arrived(40, 19), "position telemetry 19 Hz, 20 needed"),
        (arrived(40, 20, steady_since_us=1), "estimates are settling"),
        (arrived(40, 20, steady_since_us=None), "estimates are settling"),
        (replace(arrived(40, 20), heartbeat=None), "no heartbeat"),
    ],
)
def test_it_is_ready_with_a_heartbeat_enough_samples_and_a_second_of_them(known, reason):
    """0.8 of 50 Hz and of 25 Hz."""
    assert telemetry.not_ready(SETTINGS, known, 1_000_000) == reason


@pytest.mark.parametrize(
    ("known", "text"),
    [
        (arrived(80, 80), None),
        (arrived(79, 100), "attitude stays at about 80 Hz, 100 asked for"),
        (arrived(85, 70), "position stays at about 70 Hz, 100 asked for"),
        (arrived(100, 51), "position stays at about 50 Hz, 100 asked for"),
        (arrived(100, 0), "no position comes; has the autopilot an estimate, and the link room?"),
    ],
)
def test_telemetry_is_slow_below_0_8_of_what_was_asked_for(known, text):
    assert telemetry.too_slow(SETTINGS, known, 1_000_000) == (text is not None)
    if text is not None:
        assert telemetry.too_slow_text(SETTINGS, known, 1_000_000) == text
