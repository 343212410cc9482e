"""Inertial sensors and pose as real firmware is told them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim_vehicle import airframe
from sim_vehicle.backends.sensors import ImuNoise, imu, pose, with_noise
from sim_vehicle.config import build
from sim_vehicle.plant import Plant

G = 9.8


def plant(**sections) -> Plant:
    return Plant(build(sections, "test"), np.random.default_rng(0))


def sample_after(flying: Plant, commands, steps: int = 1):
    for _ in range(steps):
        before = flying.state
        flying.step(np.array(commands, dtype=np.float64))
    return imu(before, flying.state, flying.dt, G)


def at(rigid) -> airframe.AirframeState:
    return airframe.initial_state(np.array(rigid, dtype=np.float64))


def test_at_rest_on_the_ground_the_accelerometer_reads_minus_g_down():
    sample = sample_after(plant(), [0.0] * 4, steps=5)
    np.testing.assert_allclose(sample.specific_force, [0.0, 0.0, -G], atol=1e-12)
    np.testing.assert_array_equal(sample.body_rates, np.zeros(3))


def test_in_free_fall_it_reads_nothing():
    flying = plant(vehicle={"drag_n_s_m": 0.0})
    flying.state = at([0, 0, 50, 0, 0, 0, 0.3, -0.2, 1.0, 0, 0, 0])
    np.testing.assert_allclose(sample_after(flying, [0.0] * 4).specific_force, np.zeros(3), atol=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 2.0, -3.0])
def test_thrust_is_felt_along_body_up_whatever_the_attitude(yaw):
    flying = plant(vehicle={"drag_n_s_m": 0.0})
    thrust = np.full(4, 0.5 * flying.body.motor_max_thrust)
    flying.state = replace(at([0, 0, 50, 0, 0, 0, 0.4, -0.3, yaw, 0, 0, 0]), motor_thrust=thrust)
    sample = sample_after(flying, [0.5] * 4)
    np.testing.assert_allclose(sample.specific_force, [0.0, 0.0, -12.3], atol=1e-9)


def test_gyro_is_forward_right_down():
    """Nose left and nose down are positive here and negative in FRD."""
    flying = plant()
    flying.state = at([0, 0, 50, 0, 0, 0, 0, 0, 0, 0.1, 0.2, 0.3])
    sample = sample_after(flying, [0.4] * 4)
    np.testing.assert_allclose(sample.body_rates, [0.1, -0.2, -0.3], atol=1e-3)


def test_integrating_the_sensors_gives_the_true_velocity_back():
    """Specific force and attitude are consistent: what a strapdown navigation computes is what happened."""
    flying = plant(vehicle={"drag_n_s_m": 0.6}, wind={"mean_m_s": (4.0, -3.0, 0.0)})
    flying.state = at([0, 0, 50, 1, 2, 3, 0.2, 0.1, 3.1, 0.5, -0.4, 1.5])
    velocity = pose(flying.state).velocity
    for _ in range(400):
        before = flying.state
        flying.step(np.array([0.42, 0.40, 0.41, 0.40]))
        sample = imu(before, flying.state, flying.dt, G)
        half = airframe.initial_state(
            0.5 * (_unwrapped(before.rigid, flying.state.rigid) + flying.state.rigid)
        )
        turn = _matrix(pose(half).quaternion)
        velocity = velocity + (turn @ sample.specific_force + [0.0, 0.0, G]) * flying.dt
    np.testing.assert_allclose(velocity, pose(flying.state).velocity, atol=2e-3)


def _unwrapped(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    result = before.copy()
    result[8] += 2.0 * np.pi * round((after[8] - before[8]) / (2.0 * np.pi))
    return result


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_pose_is_north_east_down():
    there = pose(at([1, 2, 5, 0.1, 0.2, 0.3, 0, 0, np.pi / 2, 0, 0, 0]))
    np.testing.assert_allclose(there.position, [1, -2, -5])
    np.testing.assert_allclose(there.velocity, [0.1, -0.2, -0.3])
    half = np.sqrt(0.5)
    np.testing.assert_allclose(there.quaternion, [half, 0, 0, -half])  # nose to the left: west


def test_noise_has_its_deviation_and_its_seed():
    still = imu(plant().state, plant().state, 0.0025, G)
    noise = ImuNoise(specific_force=0.3, body_rate=0.01)
    generator = np.random.default_rng(1)
    samples = [with_noise(still, noise, generator) for _ in range(2000)]
    assert np.std([s.specific_force for s in samples], axis=0) == pytest.approx([0.3] * 3, rel=0.1)
    assert np.std([s.body_rates for s in samples], axis=0) == pytest.approx([0.01] * 3, rel=0.1)
    again = with_noise(still, noise, np.random.default_rng(1))
    np.testing.assert_array_equal(again.specific_force, samples[0].specific_force)


def test_without_noise_nothing_is_drawn():
    still = imu(plant().state, plant().state, 0.0025, G)
    generator = np.random.default_rng(1)
    assert with_noise(still, ImuNoise(), generator) is still
    assert generator.random() == np.random.default_rng(1).random()
