"""Guard and encoder, fed with what no controller should ever want."""

from math import isfinite

from hypothesis import given
from hypothesis import strategies as st

from kffa_offboard.frame_codec import decode
from kffa_offboard.mavlink.commands import EncodingError, attitude_target
from kffa_offboard.mavlink.component import Component, Route
from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.offboard.guard import check_target, tilt
from kffa_offboard.offboard.settings import LimitSettings

LIMITS = LimitSettings()
wild = st.one_of(st.floats(), st.floats(-4.0, 4.0))
vectors = st.tuples(wild, wild, wild)
targets = st.builds(AttitudeTarget, wild, st.none() | vectors, st.none() | vectors)
steps = st.tuples(targets, st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.floats(0.0, 0.3), st.booleans())


@given(targets)
def test_nothing_bad_passes_the_last_door(target):
    try:
        message = attitude_target(Route(), target, 0)
    except EncodingError:
        return
    sent = decode(Component(Route()).pack(message))
    numbers = (sent.thrust, sent.body_roll_rate, sent.body_pitch_rate, sent.body_yaw_rate, *sent.q)
    assert all(map(isfinite, (*message.values, *numbers)))
    assert 0.0 <= sent.thrust <= 1.0 and sent.type_mask in (7, 128)


@given(st.lists(steps, max_size=8))
def test_whatever_is_wanted_one_after_the_other_what_passes_the_guard_can_be_sent(wanted):
    previous = None
    for target, attitude, dt, airborne in wanted:
        checked = check_target(LIMITS, target, previous, attitude, dt, airborne)
        if checked.target is None:
            assert checked.fault
            continue
        passed = checked.target
        attitude_target(Route(), passed, 0)
        assert (LIMITS.thrust_min if airborne else 0.0) <= passed.thrust <= LIMITS.thrust_max
        if passed.attitude is not None:
            assert tilt(passed.attitude) <= LIMITS.tilt_max_rad + 1e-9
        for rate, most in zip(passed.body_rates or (), LIMITS.body_rate_max_rad_s, strict=False):
            assert abs(rate) <= most
        previous = passed
