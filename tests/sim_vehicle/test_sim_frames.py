"""Axes of the simulator against MAVLink's, and attitude representations against scipy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sim_vehicle import frames

angle = st.floats(-3.1, 3.1)
pitch_angle = st.floats(-1.5, 1.5)
TO_NED = np.diag([1.0, -1.0, -1.0])


def scipy_rotation(euler: np.ndarray) -> Rotation:
    return Rotation.from_euler("ZYX", euler[::-1])


def test_north_stays_and_up_becomes_negative_down() -> None:
    np.testing.assert_array_equal(frames.vector_to_ned(np.array([1.0, 2.0, 5.0])), [1.0, -2.0, -5.0])


def test_nose_up_in_mavlink_is_negative_pitch_here() -> None:
    """About the left-pointing y axis a positive pitch lowers the nose; MAVLink's raises it."""
    euler = frames.euler_from_ned(np.array([0.0, 0.3, 0.0]))
    nose = frames.rotation_matrix(euler)[:, 0]
    assert nose[2] > 0.0
    np.testing.assert_array_equal(euler, [0.0, -0.3, 0.0])


@given(st.lists(st.floats(-1e3, 1e3), min_size=3, max_size=3), angle, pitch_angle, angle)
def test_there_and_back_changes_nothing(vector: list[float], roll: float, pitch: float, yaw: float) -> None:
    values, euler = np.array(vector), np.array([roll, pitch, yaw])
    quaternion = frames.quaternion_from_euler(euler)
    np.testing.assert_array_equal(frames.vector_from_ned(frames.vector_to_ned(values)), values)
    np.testing.assert_array_equal(frames.body_from_frd(frames.body_to_frd(values)), values)
    np.testing.assert_array_equal(frames.euler_from_ned(frames.euler_to_ned(euler)), euler)
    np.testing.assert_array_equal(
        frames.quaternion_from_ned(frames.quaternion_to_ned(quaternion)), quaternion
    )


@given(angle, pitch_angle, angle)
def test_all_representations_describe_the_same_attitude_on_both_sides(
    roll: float, pitch: float, yaw: float
) -> None:
    """Matrix, Euler angles and quaternion, converted each in its own way, agree in NED/FRD."""
    euler = np.array([roll, pitch, yaw])
    matrix_ned = TO_NED @ frames.rotation_matrix(euler) @ TO_NED
    quaternion_ned = frames.quaternion_to_ned(frames.quaternion_from_euler(euler))
    np.testing.assert_allclose(scipy_rotation(frames.euler_to_ned(euler)).as_matrix(), matrix_ned, atol=1e-12)
    np.testing.assert_allclose(
        Rotation.from_quat(np.roll(quaternion_ned, -1)).as_matrix(), matrix_ned, atol=1e-12
    )


@given(angle, pitch_angle, angle)
def test_euler_quaternion_and_matrix_agree_with_scipy(roll: float, pitch: float, yaw: float) -> None:
    euler = np.array([roll, pitch, yaw])
    reference = scipy_rotation(euler)
    quaternion = frames.quaternion_from_euler(euler)
    np.testing.assert_allclose(frames.rotation_matrix(euler), reference.as_matrix(), atol=1e-14)
    assert abs(quaternion @ np.roll(reference.as_quat(), 1)) == pytest.approx(1.0, abs=1e-14)
    np.testing.assert_allclose(frames.euler_from_quaternion(quaternion), euler, atol=1e-11)


def test_quaternion_rows_give_the_same_matrix_as_euler_rows() -> None:
    euler = np.array([0.3, -0.8, 2.0])
    quaternion = frames.quaternion_from_euler(euler)
    from_quaternion = frames.rotation_rows_from_quaternion(frames.rows_of(quaternion))
    np.testing.assert_allclose(np.reshape(from_quaternion, (3, 3)), frames.rotation_matrix(euler), atol=1e-15)


def test_straight_up_is_a_finite_attitude() -> None:
    quaternion = frames.quaternion_from_euler(np.array([0.0, -np.pi / 2, 0.0]))
    euler = frames.euler_from_quaternion(quaternion * (1.0 + 1e-15))
    assert np.all(np.isfinite(euler))
    assert euler[1] == pytest.approx(-np.pi / 2, abs=1e-7)


def test_a_batch_is_converted_like_its_members() -> None:
    euler = np.random.default_rng(1).uniform(-1.4, 1.4, (3, 6))
    quaternion = frames.quaternion_from_euler(euler)
    matrix = frames.rotation_matrix(euler)
    assert quaternion.shape == (4, 6)
    assert matrix.shape == (3, 3, 6)
    for index in range(6):
        single = frames.quaternion_from_euler(euler[:, index])
        np.testing.assert_allclose(quaternion[:, index], single, atol=1e-15)
        np.testing.assert_allclose(matrix[:, :, index], frames.rotation_matrix(euler[:, index]), atol=1e-15)
        np.testing.assert_array_equal(
            frames.euler_to_ned(euler)[:, index], frames.euler_to_ned(euler[:, index])
        )


@pytest.mark.parametrize(
    ("angle_in", "angle_out"),
    [(0.0, 0.0), (np.pi + 0.1, 0.1 - np.pi), (-7.0, 2 * np.pi - 7.0), (np.pi, -np.pi)],
)
def test_angles_are_wrapped_to_half_a_turn(angle_in: float, angle_out: float) -> None:
    assert float(frames.wrap_angle(np.array(angle_in))) == pytest.approx(angle_out)


def test_conversions_leave_their_argument_alone() -> None:
    vector = np.array([1.0, 2.0, 3.0])
    frames.vector_to_ned(vector)
    np.testing.assert_array_equal(vector, [1.0, 2.0, 3.0])
