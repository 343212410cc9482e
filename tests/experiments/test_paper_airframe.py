"""The airframe profile, written twice: here against the simulated vehicle's motors, mixing and dynamics."""

from __future__ import annotations

import numpy as np

from kffa_offboard.experiments import airframe, plant
from sim_vehicle import airframe as simulated
from sim_vehicle import dynamics, environment, payload, rate_loop
from sim_vehicle.parameter_tables import PX4
from sim_vehicle.parameters import ParameterStore
from sim_vehicle.personality_px4_gains import rate_gains

COUNT, DRAG = 50, 0.6
THEIRS_FULL = 246.0
THEIRS = simulated.AirframeParameters(drag=DRAG, ground=None)


def random_flights() -> tuple[np.ndarray, ...]:
    """State, motor thrust, load, wind, wanted thrust and torque; far from any hover."""
    random = np.random.default_rng(1)
    torque = random.normal(0.0, 15.0, (3, COUNT)) * [[1.0], [1.0], [0.1]]
    return (
        random.normal(0.0, 0.3, (12, COUNT)),
        random.uniform(0.0, 60.0, (4, COUNT)),
        random.uniform(0.0, payload.LOAD_LIMIT, COUNT),
        random.normal(0.0, 5.0, (3, COUNT)),
        random.uniform(-0.1, 1.1, COUNT),
        torque,
    )


def test_mixing_gives_way_in_the_same_order() -> None:
    *_, thrust, torque = random_flights()
    np.testing.assert_array_equal(airframe.mix(thrust, torque), simulated.mix(THEIRS, thrust, torque))


def test_one_step_with_load_and_wind_is_the_same() -> None:
    rigid, motors, load, wind, thrust, torque = random_flights()
    commands = airframe.mix(thrust, torque)
    there = simulated.step(
        THEIRS,
        simulated.AirframeState(rigid, motors, load, 0.0, False),
        commands,
        environment.EnvironmentInputs(wind_velocity=wind),
        airframe.STEP_S,
    )
    ours = airframe.step(rigid, motors, commands, airframe.body(load, DRAG), wind)
    # Euler angles here, a quaternion there: the integration errors of 5 ms differ.
    np.testing.assert_allclose(ours[0], there.rigid, rtol=0, atol=1e-8)
    np.testing.assert_allclose(ours[1], there.motor_thrust, rtol=0, atol=1e-12)


def test_a_load_off_the_centre_turns_it_as_the_simulated_vehicle() -> None:
    rigid, _, load, wind, thrust, torque = random_flights()
    offset = np.random.default_rng(4).normal(0.0, 0.2, (3, COUNT))
    wrench = np.concatenate([THEIRS_FULL * thrust[None], torque])
    vehicle = payload.VehicleBody(plant.MASS, (plant.INERTIA,) * 3, plant.ARM)
    there = dynamics.derivatives(
        rigid,
        wrench,
        payload.mass_properties(vehicle, load, tuple(offset)),
        DRAG,
        plant.GRAVITY,
        wind_velocity=wind,
    )
    ours = airframe.derivatives(rigid, wrench, airframe.body(load, DRAG, offset), wind)
    np.testing.assert_allclose(ours, there, rtol=0, atol=1e-10)


def test_motors_may_be_weaker_and_slower_from_flight_to_flight() -> None:
    rigid, motors, load, wind, *_ = random_flights()
    full, lag = np.linspace(200.0, 300.0, COUNT), np.linspace(0.02, 0.1, COUNT)
    body = airframe.body(load, DRAG, None, full, lag)
    _, after = airframe.step(rigid, motors, np.full((4, COUNT), 0.5), body, wind)
    share = 1.0 - np.exp(-airframe.STEP_S / lag)
    np.testing.assert_allclose(after, motors + share * (full / 8.0 - motors), rtol=1e-12)


def test_one_step_of_5_ms_is_short_enough() -> None:
    rigid, motors, load, wind, thrust, torque = random_flights()
    commands, body = airframe.mix(thrust, torque), airframe.body(load, DRAG)
    fine = rigid, motors
    for _ in range(10):
        fine = airframe.step(*fine, commands, body, wind, airframe.STEP_S / 10)
    np.testing.assert_allclose(
        airframe.step(rigid, motors, commands, body, wind)[0], fine[0], rtol=0, atol=1e-3
    )


def test_the_rate_loop_is_that_of_the_simulated_px4() -> None:
    gains = rate_gains(ParameterStore(PX4, "bytewise"))
    ours = airframe.RateLoop(*3 * (np.zeros((3, 1)),))
    theirs = rate_loop.RateState()
    random = np.random.default_rng(2)
    full = firmware_torque()
    for _ in range(20):
        wanted, measured = random.normal(0.0, 0.5, (2, 3))
        ours, torque = airframe.rate_loop(ours, wanted[:, None], measured[:, None])
        theirs, share = rate_loop.step(
            gains, theirs, tuple(wanted), tuple(measured), (0.0, 0.0, 0.0), True, airframe.STEP_S
        )
        np.testing.assert_allclose(torque[:, 0], full * share, rtol=1e-9, atol=1e-12)


def firmware_torque() -> np.ndarray:
    """What a share of 1 means in the simulated firmware, N m."""
    motor = THEIRS.motor_max_thrust
    return np.array([THEIRS.arm * motor, THEIRS.arm * motor, 2.0 * THEIRS.yaw_moment_per_thrust * motor])
