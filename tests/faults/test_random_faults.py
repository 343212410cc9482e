"""Any mixture of faults: no command that is not fit, none after release, and control that ends in time."""

from math import inf, isfinite, nan

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kffa_offboard.faults.edit import decoded
from kffa_offboard.faults.faults import (
    Corrupt,
    Delay,
    Duplicate,
    Freeze,
    Lose,
    Offset,
    Overwrite,
    ShiftClock,
    Thin,
)
from kffa_offboard.offboard import events
from kffa_offboard.offboard.service import State

SENDING = (State.ENGAGING, State.ENGAGED, State.RELEASING)
SAMPLES = ("ATTITUDE", "LOCAL_POSITION_NED")

kinds = st.sampled_from(
    [(), ("ATTITUDE",), ("LOCAL_POSITION_NED",), SAMPLES, ("HEARTBEAT",), ("COMMAND_ACK",)]
)
shares = st.sampled_from([0.02, 0.1, 0.3, 0.7, 1.0])
bad = st.sampled_from([nan, inf, -inf, 1e30, -1e30, 3.0, -0.4, 100.0])
fields = st.one_of(
    st.tuples(st.just("ATTITUDE"), st.sampled_from(["roll", "pitch", "yaw", "rollspeed", "yawspeed"])),
    st.tuples(st.just("LOCAL_POSITION_NED"), st.sampled_from(["x", "z", "vx", "vz"])),
    st.tuples(st.just("ATTITUDE_TARGET"), st.sampled_from(["thrust", "body_roll_rate"])),
)


def window(draw):
    return draw(st.sampled_from([0.0, 0.9, 1.4, 1.6, 1.8])), draw(st.sampled_from([0.02, 0.1, 0.3, 0.6, inf]))


@st.composite
def faults(draw):
    start, duration = window(draw)
    common = {"start_s": start, "duration_s": duration, "share": draw(shares)}
    match draw(
        st.sampled_from(["lose", "delay", "copy", "flip", "thin", "freeze", "clock", "write", "jump"])
    ):
        case "lose":
            return Lose(**common, messages=draw(kinds))
        case "delay":
            late, jitter = draw(st.sampled_from([0.02, 0.1, 0.3])), draw(st.sampled_from([0.0, 0.1]))
            return Delay(**common, messages=draw(kinds), delay_s=late, jitter_s=jitter)
        case "copy":
            return Duplicate(**common, copies=3)
        case "flip":
            return Corrupt(**common, bits=draw(st.integers(1, 20)))
        case "thin":
            return Thin(start, duration, SAMPLES, keep_every=draw(st.integers(2, 20)))
        case "freeze":
            return Freeze(**common, messages=draw(kinds))
        case "clock":
            return ShiftClock(**common, offset_s=draw(st.sampled_from([-3.0, -0.1, 0.1, 0.3, 3.0])))
        case "write":
            message, name = draw(fields)
            return Overwrite(**common, messages=(message,), values={name: draw(bad)})
        case _:
            message, name = draw(fields)
            return Offset(**common, messages=(message,), values={name: draw(st.floats(-2.0, 2.0))})


acts = st.sampled_from(
    [
        {},
        {1.6: lambda vehicle: vehicle.firmware.set_custom_mode(5)},
        {1.7: lambda vehicle: vehicle.firmware.disarm(True)},
        {1.65: lambda vehicle: vehicle.set_load(6.73)},
    ]
)


def assert_fit(flight):
    """Every setpoint that left: a number, within limits, no faster than allowed."""
    limits = flight.settings.limits
    for _, data in flight.link.sent:
        message = decoded(data)
        if message.get_type() == "SET_ATTITUDE_TARGET":
            rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
            assert all(isfinite(number) for number in (message.thrust, *rates, *message.q))
            assert limits.thrust_min - 1e-6 <= message.thrust <= limits.thrust_max + 1e-6
            for rate, most in zip(rates, limits.body_rate_max_rad_s, strict=True):
                assert abs(rate) <= most + 1e-6
            assert message.type_mask in (7, 128)


def assert_silent_when_released(flight):
    """Setpoints leave only in the states that send; a slot's events are seen at the state after it."""
    changes = dict(flight.states)
    times = sorted(changes)
    for time_us, _ in flight.targets:
        before = [changes[at] for at in times if time_us - 10_000 <= at <= time_us + 10_000]
        assert any(state in SENDING for state in before)


def assert_ends_in_time(flight):
    """In control, an attitude has come within the last 0.25 s and a heartbeat within the last 3 s."""
    last = {events.AttitudeReceived: None, events.PositionReceived: None, events.HeartbeatReceived: None}
    limits_us = dict(zip(last, (250_000, 250_000, 3_000_000), strict=True))
    for time_us, item in flight.heard:
        if isinstance(item, events.AttitudeTarget):
            for kind, limit_us in limits_us.items():
                assert last[kind] is not None and time_us - last[kind] <= limit_us + 10_000
        if type(item) in last:
            last[type(item)] = time_us


def fly_and_check(fault_flight, down, up, act):
    flight = fault_flight(
        "ardupilot", down=tuple(down), up=tuple(up), acts=act, seconds=2.6, settle_s=0.2
    ).fly()
    assert_fit(flight)
    assert_silent_when_released(flight)
    assert_ends_in_time(flight)
    held = [k for k, (_, state) in enumerate(flight.states) if state is State.ENGAGED]
    assert all(flight.tilts[k] < 1.1 and abs(flight.heights[k] - 5.0) < 4.0 for k in held)
    if flight.released_s is not None:
        reasons = ("failsafe: ", "control given up: ", "released: ")
        assert any(text.startswith(reasons) for text in flight.texts)
        assert any(reason in flight.status_texts for reason in reasons)
    assert len(flight.service._known.attitude_stream.arrivals) <= 1000


def budget(examples):
    return settings(
        max_examples=examples,
        deadline=None,
        derandomize=examples < 1000,
        suppress_health_check=list(HealthCheck),
    )


mixtures = given(st.lists(faults(), min_size=1, max_size=3), st.lists(faults(), max_size=1), acts)


@budget(30)
@mixtures
def test_any_mixture_of_faults(fault_flight, down, up, act):
    fly_and_check(fault_flight, down, up, act)


@pytest.mark.long_faults
@pytest.mark.timeout(0)
@budget(3000)
@mixtures
def test_any_mixture_of_faults_for_long(fault_flight, down, up, act):
    fly_and_check(fault_flight, down, up, act)
