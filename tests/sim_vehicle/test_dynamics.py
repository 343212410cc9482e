"""Equations of motion: eq 15 by hand, Newton-Euler against an independent reference, conservation laws."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from sim_vehicle import dynamics, frames, payload
from sim_vehicle.dynamics import MassProperties

GRAVITY = 9.8
DRAG = 0.15
BODY = payload.VehicleBody(10.0, (0.25, 0.29, 0.4), 0.44)
NO_THRUST = np.zeros(4)


def fly(
    state: np.ndarray,
    wrench: np.ndarray,
    properties: MassProperties,
    seconds: float,
    dt: float = 0.0025,
    **inputs,
) -> np.ndarray:
    for _ in range(round(seconds / dt)):
        state = dynamics.integrate(
            state, wrench, properties, dt=dt, **{"drag": DRAG, "gravity": GRAVITY} | inputs
        )
    return state


@pytest.mark.parametrize("kinematics", ["paper", "rigid-body"])
@pytest.mark.parametrize("load_mass", [0.0, 5.0])
def test_a_vehicle_without_thrust_falls_freely(kinematics: str, load_mass: float) -> None:
    properties = payload.mass_properties(BODY, load_mass)
    state = fly(np.zeros(12), NO_THRUST, properties, 1.0, drag=0.0, kinematics=kinematics)
    np.testing.assert_allclose(state[[2, 5]], [-4.9, -9.8], atol=1e-12)
    np.testing.assert_array_equal(np.delete(state, [2, 5]), 0.0)


@pytest.mark.parametrize("kinematics", ["paper", "rigid-body"])
@pytest.mark.parametrize("load_mass", [0.0, 5.0, 6.73])
def test_thrust_equal_to_weight_hovers(kinematics: str, load_mass: float) -> None:
    properties = payload.mass_properties(BODY, load_mass)
    wrench = np.array([(10.0 + load_mass) * GRAVITY, 0.0, 0.0, 0.0])
    state = fly(np.zeros(12), wrench, properties, 2.0, kinematics=kinematics)
    np.testing.assert_allclose(state, 0.0, atol=1e-12)


def test_drag_lets_a_falling_vehicle_reach_its_terminal_speed() -> None:
    properties = payload.mass_properties(BODY, 0.0)
    state = fly(np.zeros(12), NO_THRUST, properties, 10.0, drag=5.0, dt=0.01)
    assert state[5] == pytest.approx(-98.0 / 5.0 * (1.0 - np.exp(-5.0)), rel=1e-9)


def test_wind_carries_the_vehicle_to_its_own_speed() -> None:
    properties = payload.mass_properties(BODY, 0.0)
    hover = np.array([98.0, 0.0, 0.0, 0.0])
    wind = np.array([2.0, -1.0, 0.5])
    state = fly(np.zeros(12), hover, properties, 30.0, drag=5.0, dt=0.01, wind_velocity=wind)
    np.testing.assert_allclose(state[3:6], wind, rtol=1e-5)


# ---------------------------------------------------------------------- eq 15 by hand ("paper")


def test_paper_translation_is_the_first_half_of_equation_15() -> None:
    state = np.array([0, 0, 0, 1.0, -2.0, 3.0, 0.2, -0.3, 0.5, 0, 0, 0])
    rates = dynamics.derivatives(
        state,
        np.array([150.0, 0, 0, 0]),
        payload.mass_properties(BODY, 5.0),
        DRAG,
        GRAVITY,
        kinematics="paper",
    )
    roll, pitch, yaw = 0.2, -0.3, 0.5
    along_x = np.cos(roll) * np.sin(pitch) * np.cos(yaw) + np.sin(roll) * np.sin(yaw)
    along_y = np.cos(roll) * np.sin(pitch) * np.sin(yaw) - np.sin(roll) * np.cos(yaw)
    along_z = np.cos(roll) * np.cos(pitch)
    np.testing.assert_allclose(rates[0:3], [1.0, -2.0, 3.0])
    np.testing.assert_allclose(
        rates[3:6],
        [
            (150.0 * along_x - 0.15 * 1.0) / 15.0,
            (150.0 * along_y + 0.15 * 2.0) / 15.0,
            (150.0 * along_z - 0.15 * 3.0) / 15.0 - 9.8,
        ],
    )


def test_paper_rotation_has_the_gyroscopic_signs_of_equation_12_and_undivided_yaw_drag() -> None:
    p, q, r = 0.7, -0.4, 0.9
    state = np.array([0, 0, 0, 0, 0, 0, 0, 0, 0, p, q, r])
    arm = float(np.hypot(0.44, 0.1))
    properties = payload.mass_properties(BODY, 5.0, profile="paper")
    rates = dynamics.derivatives(
        state, np.array([0.0, 2.0, -3.0, 0.5]), properties, DRAG, GRAVITY, kinematics="paper"
    )
    np.testing.assert_array_equal(rates[6:9], [p, q, r])
    np.testing.assert_allclose(
        rates[9:12],
        [
            (arm * 2.0 - (0.4 - 0.29) * q * r - arm * 0.15 * p) / 0.25,
            (arm * -3.0 - (0.25 - 0.4) * p * r - arm * 0.15 * q) / 0.29,
            (0.5 - (0.29 - 0.25) * p * q - 0.15 * r) / 0.4,
        ],
    )


def test_both_readings_agree_for_small_angles_of_a_load_free_vehicle() -> None:
    state = np.array([0, 0, 5.0, 0.2, 0.1, 0, 1e-4, -2e-4, 0.0, 1e-4, 1e-4, 1e-4])
    properties = payload.mass_properties(BODY, 0.0)
    wrench = np.array([98.0, 0.001, -0.002, 0.001])
    paper = dynamics.derivatives(state, wrench, properties, DRAG, GRAVITY, kinematics="paper")
    rigid = dynamics.derivatives(state, wrench, properties, DRAG, GRAVITY, kinematics="rigid-body")
    np.testing.assert_allclose(paper, rigid, atol=1e-7)


@pytest.mark.parametrize("kinematics", ["paper", "rigid-body"])
def test_integration_follows_the_derivatives(kinematics: str) -> None:
    """One step equals scipy's integration of `derivatives`, although it may go another way."""
    rng = np.random.default_rng(3)
    state = rng.uniform(-0.8, 0.8, 12)
    properties = payload.mass_properties(BODY, 5.0, (0.1, -0.05, -0.3))
    inputs = {"disturbance_force": rng.normal(size=3), "disturbance_torque": rng.normal(size=3)}
    arguments = (np.array([140.0, 1.0, -2.0, 0.3]), properties, DRAG, GRAVITY)
    reference = solve_ivp(
        lambda _, y: dynamics.derivatives(y, *arguments, **inputs, kinematics=kinematics),
        (0.0, 0.0025),
        state,
        rtol=1e-12,
        atol=1e-13,
    )
    result = dynamics.integrate(state, *arguments, **inputs, kinematics=kinematics, dt=0.0025)
    np.testing.assert_allclose(result, reference.y[:, -1], atol=1e-10)


# --------------------------------------------- Newton-Euler, written a second time and differently


@dataclass(frozen=True)
class TwoBodies:
    """Vehicle and point load for the reference: rotation matrix, motion of the centre of mass."""

    load_mass: float
    offset: np.ndarray

    @property
    def mass(self) -> float:
        return BODY.mass + self.load_mass

    @property
    def center(self) -> np.ndarray:
        return self.load_mass * self.offset / self.mass

    @property
    def inertia(self) -> np.ndarray:
        def point(mass: float, at: np.ndarray) -> np.ndarray:
            return mass * (at @ at * np.eye(3) - np.outer(at, at))

        return (
            np.diag(BODY.inertia)
            + point(BODY.mass, -self.center)
            + point(self.load_mass, self.offset - self.center)
        )

    def rates(
        self, y: np.ndarray, wrench: np.ndarray, wind: np.ndarray, force: np.ndarray, torque: np.ndarray
    ):
        velocity, rotation, omega = y[3:6], y[6:15].reshape(3, 3), y[15:18]
        airframe_velocity = velocity - rotation @ np.cross(omega, self.center)
        at_airframe = wrench[0] * rotation[:, 2] + DRAG * (wind - airframe_velocity)
        acceleration = (at_airframe + force) / self.mass - [0.0, 0.0, GRAVITY]
        arm = BODY.arm_length
        moment = np.array([arm * wrench[1], arm * wrench[2], wrench[3]]) + torque
        moment += np.cross(-self.center, rotation.T @ at_airframe) - DRAG * omega * [arm, arm, 1.0]
        spin = np.linalg.solve(self.inertia, moment - np.cross(omega, self.inertia @ omega))
        skew = np.cross(np.eye(3), omega)
        return np.concatenate([velocity, acceleration, (rotation @ skew).ravel(), spin])

    def fly(self, state: np.ndarray, seconds: float, *inputs: np.ndarray) -> tuple[np.ndarray, ...]:
        """Position and velocity of the airframe's centre, rotation and body rates at the end."""
        rotation = Rotation.from_euler("ZYX", state[6:9][::-1]).as_matrix()
        omega = state[9:12]
        start = np.concatenate(
            [
                state[0:3] + rotation @ self.center,
                state[3:6] + rotation @ np.cross(omega, self.center),
                rotation.ravel(),
                omega,
            ]
        )
        solution = solve_ivp(
            lambda _, y: self.rates(y, *inputs), (0.0, seconds), start, rtol=1e-10, atol=1e-11
        )
        y = solution.y[:, -1]
        rotation, omega = y[6:15].reshape(3, 3), y[15:18]
        position = y[0:3] - rotation @ self.center
        return position, y[3:6] - rotation @ np.cross(omega, self.center), rotation, omega


@pytest.mark.parametrize("load_mass", [0.0, 5.0])
@pytest.mark.parametrize("offset", [(0.0, 0.0, -0.3), (0.12, -0.07, -0.3)])
@pytest.mark.parametrize("seed", [1, 2])
def test_rigid_body_motion_matches_an_independent_newton_euler_model(
    load_mass: float, offset: tuple[float, float, float], seed: int
) -> None:
    """One second of tumbling flight with wind, force and torque, through every attitude."""
    rng = np.random.default_rng(seed)
    state = np.concatenate([rng.normal(size=6), rng.uniform(-1.0, 1.0, 3), rng.normal(scale=2.0, size=3)])
    wrench = np.array([(10.0 + load_mass) * 9.0, 1.0, -2.0, 0.4])
    wind, force, torque = rng.normal(size=(3, 3))
    position, velocity, rotation, omega = TwoBodies(load_mass, np.array(offset)).fly(
        state, 1.0, wrench, wind, force, torque
    )
    result = fly(
        state,
        wrench,
        payload.mass_properties(BODY, load_mass, offset),
        1.0,
        disturbance_force=force,
        disturbance_torque=torque,
        wind_velocity=wind,
    )
    np.testing.assert_allclose(result[0:3], position, atol=1e-6)
    np.testing.assert_allclose(result[3:6], velocity, atol=1e-6)
    np.testing.assert_allclose(frames.rotation_matrix(result[6:9]), rotation, atol=1e-6)
    np.testing.assert_allclose(result[9:12], omega, atol=1e-6)


@pytest.mark.parametrize("load_mass", [0.0, 6.0])
def test_angular_momentum_and_energy_are_conserved_without_torque(load_mass: float) -> None:
    properties = payload.mass_properties(BODY, load_mass, (0.1, 0.05, -0.3))
    xy, xz, yz = properties.products_of_inertia
    tensor = np.diag(properties.inertia) + np.array([[0, xy, xz], [xy, 0, yz], [xz, yz, 0]])
    state = np.array([0, 0, 0, 0, 0, 0, 0.3, -0.2, 1.0, 2.0, 3.0, -1.0], dtype=float)

    def momentum(y: np.ndarray) -> np.ndarray:
        return frames.rotation_matrix(y[6:9]) @ tensor @ y[9:12]

    end = fly(state, NO_THRUST, properties, 2.0, drag=0.0, gravity=0.0)
    assert np.linalg.norm(end[9:12] - state[9:12]) > 0.5  # it does tumble
    np.testing.assert_allclose(momentum(end), momentum(state), rtol=1e-6, atol=1e-6)
    assert end[9:12] @ tensor @ end[9:12] == pytest.approx(state[9:12] @ tensor @ state[9:12], rel=1e-7)


def test_the_centre_of_mass_of_a_tumbling_vehicle_falls_on_a_parabola() -> None:
    properties = payload.mass_properties(BODY, 5.0)
    state = np.array([0, 0, 0, 1.0, 0, 2.0, 0, 0, 0, 3.0, -2.0, 1.0])

    def center(y: np.ndarray) -> np.ndarray:
        return y[0:3] + frames.rotation_matrix(y[6:9]) @ properties.center_of_mass

    velocity = state[3:6] + np.cross(state[9:12], properties.center_of_mass)
    end = fly(state, NO_THRUST, properties, 1.0, drag=0.0)
    np.testing.assert_allclose(center(end), center(state) + velocity - [0.0, 0.0, 4.9], atol=1e-7)


def test_thrust_turns_a_vehicle_whose_load_hangs_ahead_nose_down() -> None:
    properties = payload.mass_properties(BODY, 5.0, (0.3, 0.0, -0.3))
    rates = dynamics.derivatives(np.zeros(12), np.array([147.0, 0, 0, 0]), properties, DRAG, GRAVITY)
    reduced_mass = 10.0 * 5.0 / 15.0
    about_y = 0.29 + reduced_mass * (0.3**2 + 0.3**2)
    assert rates[10] == pytest.approx(147.0 * 0.1 / about_y)
    np.testing.assert_allclose(rates[[9, 11]], 0.0, atol=1e-15)


def test_a_pitch_through_the_vertical_stays_finite_and_continuous() -> None:
    properties = payload.mass_properties(BODY, 0.0)
    state = np.array([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2 * np.pi, 0])
    end = fly(state, NO_THRUST, properties, 1.0, drag=0.0, gravity=0.0)
    np.testing.assert_allclose(frames.rotation_matrix(end[6:9]), np.eye(3), atol=1e-6)


# ------------------------------------------------------------------------------------- batches


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    size=st.integers(1, 5),
    kinematics=st.sampled_from(["paper", "rigid-body"]),
)
def test_a_batch_flies_like_its_members_alone(seed: int, size: int, kinematics: str) -> None:
    rng = np.random.default_rng(seed)
    state = rng.uniform(-1.0, 1.0, (12, size))
    wrench = rng.uniform(-2.0, 2.0, (4, size)) + np.array([[120.0], [0], [0], [0]])
    load = rng.uniform(0.0, 6.7, size)
    force, torque, wind = rng.normal(size=(3, 3, size))

    def run(pick: slice | int) -> np.ndarray:
        single = isinstance(pick, int)
        mass = float(load[pick]) if single else load
        properties = payload.mass_properties(BODY, mass, (0.1, 0.0, -0.3))
        picked = state[:, pick]
        for _ in range(4):
            picked = dynamics.integrate(
                picked,
                wrench[:, pick],
                properties,
                DRAG,
                GRAVITY,
                force[:, pick],
                torque[:, pick],
                kinematics,
                0.005,
                wind[:, pick],
            )
        return picked

    together = run(slice(None))
    assert together.shape == (12, size)
    for index in range(size):
        np.testing.assert_allclose(run(index), together[:, index], rtol=0.0, atol=1e-12)


def test_inputs_without_a_batch_serve_every_flight() -> None:
    state = np.random.default_rng(0).uniform(-0.5, 0.5, (12, 3))
    properties = payload.mass_properties(BODY, 2.0)
    wrench = np.array([120.0, 0.1, 0.2, 0.0])
    together = dynamics.integrate(state, wrench, properties, DRAG, GRAVITY)
    for index in range(3):
        alone = dynamics.integrate(state[:, index], wrench, properties, DRAG, GRAVITY)
        np.testing.assert_allclose(alone, together[:, index], atol=1e-13)
