"""What leaves for the vehicle, byte for byte where it matters."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.commands import EncodingError, attitude_target
from kffa_offboard.mavlink.component import Component, Route
from kffa_offboard.mavlink.frames import euler_from_quaternion
from kffa_offboard.mavlink.vehicle import Vehicle
from kffa_offboard.offboard.events import (
    Announce,
    AttitudeTarget,
    OwnHeartbeat,
    PayloadReport,
    SetArmed,
    SetGripper,
    Severity,
    Signals,
)

SET_ATTITUDE_TARGET_ID = 82
MASK_OFFSET = 10 + 38  # header, then time, quaternion, three rates, thrust, two target ids
ROUTE = Route()


@pytest.fixture
def vehicle(route, autopilot):
    connected = Vehicle(route)
    connected.decode(autopilot.over_the_wire(autopilot.heartbeat()))
    return connected


def frame(target, time_us=0):
    return Component(ROUTE).pack(attitude_target(ROUTE, target, time_us))


def test_rates_are_sent_with_mask_128_and_attitudes_with_mask_7():
    rates = frame(AttitudeTarget(0.5, body_rates=(0.1, 0.2, 0.3)))
    angles = frame(AttitudeTarget(0.5, attitude=(0.1, 0.2, 0.3)))
    assert rates[0] == angles[0] == 0xFD
    assert rates[7] == angles[7] == SET_ATTITUDE_TARGET_ID
    assert rates[MASK_OFFSET] == 128
    assert angles[MASK_OFFSET] == 7


def test_a_command_to_pitch_up_and_turn_right_has_positive_rates_in_frd(read):
    # nose up and to the right are negative in the paper's axes
    (message,) = read(frame(AttitudeTarget(0.5, body_rates=(0.1, -0.2, -0.3))))
    sent = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
    assert sent == pytest.approx((0.1, 0.2, 0.3))
    assert message.q == [1.0, 0.0, 0.0, 0.0]
    assert message.thrust == 0.5


def test_an_attitude_nose_up_is_sent_as_positive_pitch_in_ned(read):
    (message,) = read(frame(AttitudeTarget(0.5, attitude=(0.1, -0.2, -0.3))))
    assert euler_from_quaternion(tuple(message.q)) == pytest.approx((0.1, 0.2, 0.3), abs=1e-6)
    assert (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate) == (0, 0, 0)


@given(
    st.floats(-math.pi, math.pi), st.floats(-math.pi / 2, math.pi / 2), st.floats(-10, 10), st.floats(0, 1)
)
def test_every_attitude_is_sent_as_a_unit_quaternion(roll, pitch, yaw, thrust):
    message = attitude_target(ROUTE, AttitudeTarget(thrust, attitude=(roll, pitch, yaw)), 0)
    time_ms, w, x, y, z, *_ = message.values
    assert time_ms == 0
    assert math.hypot(w, x, y, z) == pytest.approx(1.0, abs=1e-9)


def test_setpoints_go_to_the_configured_vehicle_with_a_time_that_fits_32_bits(read):
    route = Route(target_system=7, target_component=3)
    packed = Component(route).pack(
        attitude_target(route, AttitudeTarget(0.5, body_rates=(0, 0, 0)), 2**60 + 12_345_000)
    )
    (message,) = read(packed)
    assert (message.target_system, message.target_component) == (7, 3)
    assert message.time_boot_ms == (2**60 + 12_345_000) // 1000 % 2**32


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, -0.001, 1.001])
def test_a_thrust_outside_0_to_1_is_refused(bad):
    with pytest.raises(EncodingError, match=r"thrust .* outside 0\.\.1"):
        attitude_target(ROUTE, AttitudeTarget(bad, body_rates=(0, 0, 0)), 0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 40.0, -40.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_an_impossible_body_rate_is_refused_on_every_axis(axis, bad):
    rates = [0.0, 0.0, 0.0]
    rates[axis] = bad
    with pytest.raises(EncodingError, match=f"body rate {'pqr'[axis]}"):
        attitude_target(ROUTE, AttitudeTarget(0.5, body_rates=tuple(rates)), 0)


@pytest.mark.parametrize("attitude", [(math.nan, 0, 0), (0, math.nan, 0), (0, 0, math.inf), (0, 2.0, 0)])
def test_an_impossible_attitude_is_refused(attitude):
    with pytest.raises(EncodingError):
        attitude_target(ROUTE, AttitudeTarget(0.5, attitude=attitude), 0)


@pytest.mark.parametrize(
    "target", [AttitudeTarget(0.5), AttitudeTarget(0.5, body_rates=(0, 0, 0), attitude=(0, 0, 0))]
)
def test_a_setpoint_with_both_or_neither_is_refused(target):
    with pytest.raises(EncodingError, match="either body rates or an attitude"):
        attitude_target(ROUTE, target, 0)


@pytest.mark.parametrize("armed", [True, False])
def test_arming_and_disarming_are_never_forced(vehicle, armed):
    (command,) = vehicle.encode(SetArmed(armed), 0)
    assert command.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM
    assert (command.param1, command.param2) == (float(armed), 0.0)


@pytest.mark.parametrize(("action", "value"), [("release", 0), ("grab", 1)])
def test_the_gripper_is_told_0_to_release_and_1_to_grab(vehicle, action, value):
    (command,) = vehicle.encode(SetGripper(action), 0)
    assert (command.command, command.param2) == (211, value)


def test_our_heartbeat_is_that_of_an_onboard_controller_and_no_autopilot(vehicle):
    for state, status in (("standby", 3), ("active", 4), ("critical", 5)):
        (message,) = vehicle.encode(OwnHeartbeat(state), 0)
        assert (message.type, message.autopilot, message.system_status) == (18, 8, status)


def test_a_short_announcement_is_one_text(vehicle):
    (message,) = vehicle.encode(Announce(Severity.WARNING, "x" * 50), 0)
    assert (message.severity, message.text, message.id) == (4, "x" * 50, 0)


@pytest.mark.parametrize("length", [51, 99, 100, 101, 250])
def test_a_long_announcement_arrives_whole_in_chunks(vehicle, autopilot, telemetry, length):
    text = "".join(chr(ord("a") + i % 26) for i in range(length))
    messages = vehicle.encode(Announce(Severity.CRITICAL, text), 0)
    events = [event for m in messages for event in telemetry.decode(autopilot.over_the_wire(m))]
    assert [(event.severity, event.text) for event in events] == [(2, text)]


def test_two_long_announcements_are_not_mixed_up(vehicle):
    first = vehicle.encode(Announce(Severity.INFO, "a" * 60), 0)
    second = vehicle.encode(Announce(Severity.INFO, "b" * 60), 0)
    assert 0 not in {first[0].id, second[0].id}
    assert first[0].id != second[0].id


def test_signals_are_not_sent_to_the_vehicle(vehicle):
    zeros = (0.0,) * 4
    assert vehicle.encode(Signals(0, "ready", *[zeros] * 9), 0) == []


def test_frames_carry_our_identity_and_consecutive_numbers_that_wrap(read):
    component = Component(Route(own_system=99, own_component=191))
    sent = [read(component.pack(mavlink.MAVLink_system_time_message(0, 0)))[0] for _ in range(258)]
    assert [m.get_seq() for m in sent] == [*range(256), 0, 1]
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in sent} == {(99, 191)}


def test_the_mass_of_the_load_goes_out_as_two_named_values(vehicle):
    mass, deviation = vehicle.encode(PayloadReport(2_000_000, 5.0, 0.15), 0)
    assert mass.get_type() == deviation.get_type() == "NAMED_VALUE_FLOAT"
    assert (mass.name, mass.value, mass.time_boot_ms) == ("payload_kg", 5.0, 2000)
    assert (deviation.name, deviation.value) == ("payload_sd", 0.15)
