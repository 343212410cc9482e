"""No setpoint outside the limits leaves, whatever the controller says."""

from dataclasses import replace
from math import cos, hypot, inf, nan, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.offboard.guard import check_target, tilt_factor
from kffa_offboard.offboard.settings import LimitSettings

LIMITS = LimitSettings(thrust_rate_max_per_s=5.0, body_rate_change_max_rad_s2=50.0)
LEVEL = (0.0, 0.0, 0.0)
anything = st.floats(-1e6, 1e6)
small = st.floats(-1.2, 1.2)
vectors = st.tuples(anything, anything, anything)
attitudes = st.tuples(small, small, st.floats(-pi, pi))


def within(values, bounds):
    return all(abs(value) <= bound + 1e-9 for value, bound in zip(values, bounds, strict=True))


@given(anything, vectors, attitudes, st.booleans())
def test_any_first_rate_setpoint_comes_out_within_limits(thrust, rates, attitude, airborne):
    checked = check_target(LIMITS, AttitudeTarget(thrust, body_rates=rates), None, attitude, 0.01, airborne)
    assert (LIMITS.thrust_min if airborne else 0.0) <= checked.target.thrust <= LIMITS.thrust_max
    assert within(checked.target.body_rates, LIMITS.body_rate_max_rad_s)
    assert checked.changed == (checked.target != AttitudeTarget(thrust, body_rates=rates))


@given(anything, vectors)
def test_any_first_attitude_setpoint_comes_out_within_the_tilt_limit(thrust, attitude):
    checked = check_target(LIMITS, AttitudeTarget(thrust, attitude=attitude), None, LEVEL, 0.01, True)
    roll, pitch, _ = checked.target.attitude
    assert cos(roll) * cos(pitch) >= cos(LIMITS.tilt_max_rad) - 1e-9


@given(st.floats(0.1, 0.9), st.floats(-1.0, 2.0), vectors, vectors, st.floats(0.0, 0.2))
def test_setpoints_change_no_faster_than_allowed(before, thrust, rates_before, rates, dt):
    previous = check_target(LIMITS, AttitudeTarget(before, body_rates=rates_before), None, LEVEL, 0.01, True)
    checked = check_target(LIMITS, AttitudeTarget(thrust, body_rates=rates), previous.target, LEVEL, dt, True)
    assert abs(checked.target.thrust - before) <= LIMITS.thrust_rate_max_per_s * dt + 1e-9
    for new, old in zip(checked.target.body_rates, previous.target.body_rates, strict=True):
        assert abs(new - old) <= LIMITS.body_rate_change_max_rad_s2 * dt + 1e-9


def test_a_setpoint_within_limits_passes_as_it_is():
    target = AttitudeTarget(0.4, body_rates=(0.1, -0.2, 0.05))
    checked = check_target(LIMITS, target, target, (0.1, 0.1, 1.0), 0.01, True)
    assert checked.target is not None and checked.target == target and not checked.changed


@pytest.mark.parametrize("bad", [nan, inf, -inf])
@pytest.mark.parametrize("place", ["thrust", "rate", "attitude"])
def test_a_number_that_is_not_finite_is_never_repaired(bad, place):
    target = {
        "thrust": AttitudeTarget(bad, body_rates=LEVEL),
        "rate": AttitudeTarget(0.4, body_rates=(0.0, bad, 0.0)),
        "attitude": AttitudeTarget(0.4, attitude=(0.0, 0.0, bad)),
    }[place]
    checked = check_target(LIMITS, target, None, LEVEL, 0.01, True)
    assert checked.target is None and checked.fault == "setpoint is not a finite number"


@pytest.mark.parametrize("target", [AttitudeTarget(0.4), AttitudeTarget(0.4, LEVEL, LEVEL)])
def test_a_setpoint_of_no_kind_or_of_both_is_a_fault(target):
    assert check_target(LIMITS, target, None, LEVEL, 0.01, True).target is None


@pytest.mark.parametrize("bad", [nan, inf, -inf])
@pytest.mark.parametrize("kind", ["body_rates", "attitude"])
def test_with_a_measured_attitude_or_a_time_that_is_not_finite_nothing_may_be_sent(bad, kind):
    target = AttitudeTarget(0.4, **{kind: LEVEL})
    assert check_target(LIMITS, target, target, (0.0, bad, 0.0), 0.01, True).target is None
    assert check_target(LIMITS, target, target, LEVEL, bad, True).target is None


def test_a_time_that_goes_back_changes_nothing_that_is_sent():
    for kind in ("body_rates", "attitude"):
        before = AttitudeTarget(0.4, **{kind: LEVEL})
        wanted = AttitudeTarget(0.6, **{kind: (0.1, -0.1, 0.2)})
        assert check_target(LIMITS, wanted, before, LEVEL, -0.5, True).target == before


def test_a_tilt_limit_that_was_lowered_in_flight_holds_for_the_next_setpoint():
    before, wanted = AttitudeTarget(0.4, attitude=(0.5, 0.0, 0.0)), AttitudeTarget(0.4, attitude=LEVEL)
    checked = check_target(replace(LIMITS, tilt_max_rad=0.2), wanted, before, LEVEL, 0.001, True)
    assert hypot(*checked.target.attitude[:2]) <= 0.2 + 1e-9


def test_the_lower_thrust_limit_holds_only_in_the_air():
    zero = AttitudeTarget(0.0, body_rates=LEVEL)
    assert check_target(LIMITS, zero, None, LEVEL, 0.01, True).target.thrust == LIMITS.thrust_min
    assert check_target(LIMITS, zero, None, LEVEL, 0.01, False).target.thrust == 0.0


@given(attitudes, vectors)
def test_beyond_the_tilt_limit_a_rate_setpoint_tilts_no_further(attitude, rates):
    checked = check_target(LIMITS, AttitudeTarget(0.4, body_rates=rates), None, attitude, 0.01, True)
    angle = hypot(attitude[0], attitude[1])
    if angle > LIMITS.tilt_max_rad and max(map(abs, rates)) < 1.0:
        outward = checked.target.body_rates[0] * attitude[0] + checked.target.body_rates[1] * attitude[1]
        assert outward <= 1e-9


def test_beyond_the_tilt_limit_levelling_and_turning_are_allowed():
    target = AttitudeTarget(0.4, body_rates=(-1.0, 0.0, 0.3))
    assert not check_target(LIMITS, target, None, (0.8, 0.0, 0.0), 0.01, True).changed


def test_a_heading_setpoint_crosses_half_a_turn_the_short_way():
    previous = AttitudeTarget(0.4, attitude=(0.0, 0.0, pi - 0.01))
    close = AttitudeTarget(0.4, attitude=(0.0, 0.0, -pi + 0.001))
    assert check_target(LIMITS, close, previous, LEVEL, 0.01, True).target == close
    far = AttitudeTarget(0.4, attitude=(0.0, 0.0, -pi + 0.5))
    yaw = check_target(LIMITS, far, previous, LEVEL, 0.01, True).target.attitude[2]
    assert yaw == pytest.approx(-pi + 0.005, abs=1e-9)


def test_tilt_compensation_is_bounded():
    assert tilt_factor(LIMITS, (0.3, 0.4, 1.0)) == pytest.approx(cos(0.3) * cos(0.4))
    assert tilt_factor(LIMITS, (1.5, 0.0, 0.0)) == pytest.approx(cos(LIMITS.tilt_compensation_max_rad))


@given(st.lists(st.tuples(vectors, st.floats(0.0, 0.05)), min_size=2, max_size=20))
def test_attitude_setpoints_change_no_faster_than_allowed_also_along_the_tilt_limit(wanted):
    previous, bounds = None, LIMITS.body_rate_max_rad_s
    for attitude, dt in wanted:
        target = AttitudeTarget(0.4, attitude=attitude)
        passed = check_target(LIMITS, target, previous, LEVEL, dt, True).target
        assert hypot(*passed.attitude[:2]) <= LIMITS.tilt_max_rad + 1e-9
        if previous is not None:
            for new, old, bound in zip(passed.attitude, previous.attitude, bounds, strict=True):
                assert abs((new - old + pi) % (2.0 * pi) - pi) <= bound * dt + 1e-9
        previous = passed
