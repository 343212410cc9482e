"""Signs between MAVLink's axes and the paper's, stated as what a vehicle does."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kffa_offboard.mavlink import frames

coordinate = st.floats(-1e4, 1e4)
vector = st.tuples(coordinate, coordinate, coordinate)
angles = st.tuples(
    st.floats(-math.pi + 1e-3, math.pi - 1e-3),
    st.floats(-math.pi / 2 + 0.01, math.pi / 2 - 0.01),
    st.floats(-math.pi + 1e-3, math.pi - 1e-3),
)


def rotation(attitude):
    roll, pitch, yaw = attitude
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def rotated(quaternion, v):
    w, u = quaternion[0], np.array(quaternion[1:])
    return v + 2 * np.cross(u, np.cross(u, v) + w * v)


def test_a_vehicle_5_m_above_the_origin_has_negative_down_and_positive_height():
    assert frames.vector_from_ned(1.0, 2.0, -5.0) == (1.0, -2.0, 5.0)


def test_east_is_negative_west():
    assert frames.vector_from_ned(0.0, 3.0, 0.0)[1] == -3.0


def test_climbing_is_a_positive_rate_of_height():
    assert frames.vector_from_ned(0.0, 0.0, -1.5)[2] == 1.5


def test_nose_up_is_positive_pitch_in_ned_and_negative_in_the_papers_axes():
    assert frames.euler_from_ned(0.0, 0.2, 0.0) == (0.0, -0.2, 0.0)
    forward_in_ned = rotation((0.0, 0.2, 0.0)) @ [1, 0, 0]
    forward = rotation(frames.euler_from_ned(0.0, 0.2, 0.0)) @ [1, 0, 0]
    assert forward_in_ned[2] < 0 < forward[2]  # the nose points up in both


def test_right_side_down_is_positive_roll_in_both():
    attitude = frames.euler_from_ned(0.3, 0.0, 0.0)
    assert attitude[0] == 0.3
    left = rotation(attitude) @ [0, 1, 0]
    assert left[2] > 0  # the left side is up


def test_turning_right_is_negative_yaw_in_the_papers_axes():
    assert frames.euler_from_ned(0.0, 0.0, 0.5)[2] == -0.5
    nose = rotation(frames.euler_from_ned(0.0, 0.0, 0.5)) @ [1, 0, 0]
    assert nose[1] < 0  # east of north is negative west


def test_pitching_up_and_turning_right_are_negative_body_rates_and_rolling_right_is_positive():
    assert frames.body_rates_from_frd(0.1, 0.2, 0.3) == (0.1, -0.2, -0.3)


@given(vector)
def test_every_conversion_is_undone_by_its_opposite(v):
    assert frames.vector_from_ned(*frames.vector_to_ned(v)) == v
    assert frames.body_rates_from_frd(*frames.body_rates_to_frd(v)) == v
    assert frames.euler_from_ned(*frames.euler_to_ned(v)) == v
    assert frames.quaternion_from_ned(frames.quaternion_to_ned((0.5, *v))) == (0.5, *v)


@given(angles, vector)
def test_turning_a_body_vector_commutes_with_changing_axes(attitude_ned, body_frd):
    world_ned = rotation(attitude_ned) @ np.array(body_frd)
    body = np.array(frames.vector_from_ned(*body_frd))
    world = rotation(frames.euler_from_ned(*attitude_ned)) @ body
    np.testing.assert_allclose(world, frames.vector_from_ned(*world_ned), atol=1e-8)


@given(angles, vector)
def test_a_quaternion_turns_vectors_as_its_euler_angles_do(attitude, v):
    quaternion = frames.quaternion_from_euler(attitude)
    assert math.hypot(*quaternion) == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(rotated(quaternion, np.array(v)), rotation(attitude) @ np.array(v), atol=1e-8)


@given(angles)
def test_euler_angles_survive_the_quaternion_on_the_wire(attitude):
    on_the_wire = frames.quaternion_to_ned(frames.quaternion_from_euler(attitude))
    back = frames.euler_from_quaternion(frames.quaternion_from_ned(on_the_wire))
    assert back == pytest.approx(attitude, abs=1e-9)


@given(angles)
def test_converting_euler_angles_and_converting_the_quaternion_agree(attitude_ned):
    direct = frames.euler_from_ned(*attitude_ned)
    by_quaternion = frames.quaternion_from_ned(frames.quaternion_from_euler(attitude_ned))
    assert frames.euler_from_quaternion(by_quaternion) == pytest.approx(direct, abs=1e-9)


def test_a_quaternion_pointing_straight_up_is_pitch_90_degrees_despite_rounding():
    half = np.float32(math.sqrt(0.5)) * np.float32(1.0000001)
    pitch = frames.euler_from_quaternion((float(half), 0.0, float(half), 0.0))[1]
    assert pitch == pytest.approx(math.pi / 2)


def test_nan_stays_nan():
    assert all(math.isnan(a) for a in frames.euler_from_quaternion((math.nan,) * 4))
