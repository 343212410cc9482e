"""The paper's plant, written twice: here against the simulated vehicle's dynamics and mass properties."""

from __future__ import annotations

import numpy as np
import pytest

from kffa_offboard.experiments import plant
from sim_vehicle import dynamics, payload

BODY = payload.VehicleBody(plant.MASS, (plant.INERTIA,) * 3, plant.ARM)
COUNT = 50


def flights() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(1)
    state = random.normal(0.0, 1.0, (12, COUNT))
    command = random.normal(0.0, 100.0, (4, COUNT))
    load = random.uniform(0.0, plant.LOAD_LIMIT, COUNT)
    return state, command, load, random.normal(0.0, 2.0, COUNT)


@pytest.mark.parametrize("inertia", [False, True])
def test_the_two_writings_of_equation_15_agree(inertia: bool) -> None:
    state, command, load, vertical = flights()
    ours = plant.loaded(load, np.full(COUNT, inertia))
    theirs = payload.mass_properties(BODY, load, (0.0, 0.0, plant.LOAD_OFFSET), profile="paper")
    if inertia:
        moments = payload.mass_properties(
            BODY, load, (0.0, 0.0, plant.LOAD_OFFSET), profile="airframe"
        ).inertia
        theirs = dynamics.MassProperties(theirs.mass, moments, theirs.arm_length, theirs.center_of_mass)
    wrench = command[[3, 0, 1, 2]]
    force = np.stack([0.0 * vertical, 0.0 * vertical, vertical * ours.mass])
    expected = dynamics.derivatives(
        state, wrench, theirs, plant.DRAG, plant.GRAVITY, force, kinematics="paper"
    )
    np.testing.assert_allclose(
        plant.derivatives(state, command, ours, vertical), expected, rtol=1e-12, atol=1e-12
    )


def test_constants_are_those_of_table_1() -> None:
    assert payload.LOAD_LIMIT == plant.LOAD_LIMIT
    assert payload.DEFAULT_OFFSET[2] == plant.LOAD_OFFSET


def test_one_step_of_5_ms_is_short_enough() -> None:
    state, command, load, vertical = flights()
    body = plant.loaded(load, np.ones(COUNT, dtype=bool))
    fine = state
    for _ in range(20):
        fine = plant.integrate(fine, command, body, vertical, 0.005 / 20)
    np.testing.assert_allclose(
        plant.integrate(state, command, body, vertical, 0.005), fine, rtol=0, atol=1e-6
    )


def test_a_vehicle_in_a_hover_stays_there() -> None:
    body = plant.loaded(np.zeros(1), np.zeros(1, dtype=bool))
    state = plant.integrate(np.zeros((12, 1)), plant.HOVER[:, None], body, 0.0, 0.005)
    np.testing.assert_array_equal(state, np.zeros((12, 1)))
