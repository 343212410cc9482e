"""Telemetry is believed only while it flows, advances and is possible."""

from math import inf, nan

import pytest

from kffa_offboard.offboard import telemetry
from kffa_offboard.offboard.events import AttitudeReceived, PositionReceived, TargetReported, ThrottleReported
from kffa_offboard.offboard.settings import LimitSettings, TelemetrySettings
from kffa_offboard.offboard.telemetry import Telemetry

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


def test_rates_are_measured_over_the_last_second():
    known = Telemetry()
    for k in range(150):
        known, _ = take_attitude(known, k * 10_000, attitude(k * 10_000))
    assert telemetry.rate_hz(known.attitude_stream, 1_490_000) == 100.0
    assert telemetry.rate_hz(known.attitude_stream, 2_000_000) == 49.0


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
