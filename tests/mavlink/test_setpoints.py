"""Setpoints to the daemon, read: frames, masks, refusals."""

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.setpoints import SetpointRefused, read_setpoint
from kffa_offboard.offboard.events import AttitudeSetpoint, PositionSetpoint

ALL = 2552  # everything but position and yaw ignored


def position(mask=ALL, *, frame=1, system=245, component=191, yaw=0.5):
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, system, component, frame, mask, 1.0, 2.0, -3.0, 0, 0, 0, 0, 0, 0, yaw, 0
    )


NOSE_UP = (math.cos(0.1), 0.0, math.sin(0.1), 0.0)


def attitude(mask=71, q=NOSE_UP):
    return mavlink.MAVLink_set_attitude_target_message(0, 245, 191, mask, q, 0, 0, 0, 0.5)


@pytest.mark.parametrize(
    ("mask", "wanted"),
    [
        (ALL, PositionSetpoint((1.0, -2.0, 3.0), -0.5)),
        (ALL | 1024, PositionSetpoint((1.0, -2.0, 3.0))),
        (ALL | 3, PositionSetpoint((None, None, 3.0), -0.5)),
        (ALL | 4, PositionSetpoint((1.0, -2.0, None), -0.5)),
        (ALL | 7, PositionSetpoint((None, None, None), -0.5)),
    ],
)
def test_a_position_comes_out_in_the_controllers_axes(mask, wanted):
    assert read_setpoint(Route(), position(mask)) == wanted


@pytest.mark.parametrize("mask", [0, 2552 - 8, 2552 - 2048, ALL | 1, ALL | 2, ALL | 512, ALL | 1031, 65535])
def test_any_other_mask_is_refused_by_number(mask):
    with pytest.raises(SetpointRefused, match=f"mask {mask}, "):
        read_setpoint(Route(), position(mask))


@pytest.mark.parametrize("frame", [0, 7, 8, 9, 255])
def test_only_the_local_frame_is_taken(frame):
    with pytest.raises(SetpointRefused, match=f"frame {frame}, only LOCAL_NED"):
        read_setpoint(Route(), position(frame=frame))


def test_an_attitude_comes_out_in_the_controllers_axes():
    setpoint = read_setpoint(Route(), attitude())
    assert isinstance(setpoint, AttitudeSetpoint)
    assert setpoint.attitude == pytest.approx((0.0, -0.2, 0.0))


@pytest.mark.parametrize("mask", [0, 7, 64, 128, 199])
def test_thrust_and_rates_are_not_taken(mask):
    with pytest.raises(SetpointRefused, match=f"mask {mask}, only 71"):
        read_setpoint(Route(), attitude(mask))


@pytest.mark.parametrize("q", [(0, 0, 0, 0), (math.nan, 0, 0, 0), (2, 0, 0, 0)])
def test_a_quaternion_that_is_none_is_refused(q):
    with pytest.raises(SetpointRefused, match="unit norm"):
        read_setpoint(Route(), attitude(q=q))


@pytest.mark.parametrize(("system", "component"), [(1, 1), (245, 0), (0, 191), (245, 1)])
def test_what_is_for_others_is_left_alone(system, component):
    assert read_setpoint(Route(), position(0, system=system, component=component)) is None
    assert read_setpoint(Route(), mavlink.MAVLink_ping_message(0, 0, 245, 191)) is None
