"""Euler kinematics: body rates and Euler rates belong to the same rotation."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kffa_offboard.control.rotation import body_rates_to_euler_rates, euler_rates_to_body_rates, wrap_angle

angles = st.floats(-1.4, 1.4)
rates = st.floats(-5.0, 5.0)
vectors = st.tuples(angles, angles, st.floats(-3.1, 3.1))
rate_vectors = st.tuples(rates, rates, rates)


def rotation_matrix(euler):
    roll, pitch, yaw = euler
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


@given(vectors, rate_vectors)
def test_body_rates_are_those_of_the_turning_rotation_matrix(euler, euler_rates):
    euler, euler_rates = np.array(euler), np.array(euler_rates)
    step = 1e-6
    turned = rotation_matrix(euler + step * euler_rates) - rotation_matrix(euler - step * euler_rates)
    spin = rotation_matrix(euler).T @ turned / (2.0 * step)
    expected = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    np.testing.assert_allclose(euler_rates_to_body_rates(euler, euler_rates), expected, atol=1e-7)


@given(vectors, rate_vectors)
def test_there_and_back_gives_the_same_rates(euler, body_rates):
    euler, body_rates = np.array(euler), np.array(body_rates)
    back = euler_rates_to_body_rates(euler, body_rates_to_euler_rates(euler, body_rates))
    np.testing.assert_allclose(back, body_rates, atol=1e-10)


def test_a_batch_equals_its_members():
    generator = np.random.default_rng(1)
    euler, body_rates = generator.uniform(-1.2, 1.2, (2, 3, 7))
    for convert in (body_rates_to_euler_rates, euler_rates_to_body_rates):
        singles = np.stack([convert(euler[:, k], body_rates[:, k]) for k in range(7)], axis=-1)
        np.testing.assert_allclose(convert(euler, body_rates), singles, atol=1e-12)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_a_vehicle_held_nose_up_or_down_gives_finite_euler_rates(pitch):
    result = body_rates_to_euler_rates(np.array([0.3, pitch, 0.0]), np.array([0.1, 0.2, 0.3]))
    assert np.all(np.isfinite(result))


@given(st.floats(-100.0, 100.0))
def test_a_wrapped_angle_points_the_same_way_within_half_a_turn(angle):
    wrapped = float(wrap_angle(np.array(angle)))
    assert -np.pi <= wrapped < np.pi + 1e-12
    assert np.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)
