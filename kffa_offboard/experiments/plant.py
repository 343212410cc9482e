"""The paper's plant: eq 7, 12, 13 and 15 for a batch of flights, with ideal actuators.

A second, independent writing of eq 15 (the simulated vehicle has its own; the two packages know each
other by MAVLink only, and a test holds them together). Signs are those of eq 12, Euler rates are body
rates, K_f damps yaw without the arm. Differs from the paper in one thing that can be chosen: with
`load_inertia` the load's moments about the common centre of mass are added by the parallel axis
theorem (Table 1 leaves the moments as they are).

State ``(12, N)``: position, velocity (world, z up), roll, pitch, yaw, their rates.
Command ``(4, N)`` in channel order: U2, U3 [N], U4 [N m], U1 [N].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kffa_offboard.control import Array, BoolArray
from kffa_offboard.control.controllers import ALTITUDE, PITCH, ROLL, YAW

MASS = 10.0  # kg, Table 1: M
LOAD_LIMIT = 6.73  # kg, Table 1: m_max
GRAVITY = 9.8  # m/s^2
ARM = 0.44  # m, l0
INERTIA = 0.2906  # kg m^2, all three axes
DRAG = 0.15  # K_f: N s/m, and N m s about yaw
LOAD_OFFSET = -0.3  # m, z2 of eq 13; the paper gives none

#: Rows of the state that the four channels measure.
OUTPUTS = (6, 7, 8, 2)
HOVER = np.array([0.0, 0.0, 0.0, MASS * GRAVITY])


@dataclass(frozen=True)
class PlantParameters:
    """Vehicle and load as one body (eq 13); each entry ``(N,)``, inertia ``(3, N)``."""

    mass: Array
    arm: Array
    inertia: Array


def loaded(load_mass: Array, load_inertia: BoolArray) -> PlantParameters:
    """The body that a load of `load_mass` ``(N,)`` [kg] makes.

    Parameters
    ----------
    load_inertia : (N,) of bool
        True adds the moments of a point load `LOAD_OFFSET` below the vehicle; False is Table 1.
    """
    mass = MASS + load_mass
    center = load_mass * LOAD_OFFSET / mass
    added = np.where(load_inertia, MASS * load_mass / mass * LOAD_OFFSET**2, 0.0)
    unchanged = np.full_like(mass, INERTIA)
    return PlantParameters(
        mass, np.sqrt(ARM**2 + center**2), np.stack([INERTIA + added, INERTIA + added, unchanged])
    )


def derivatives(state: Array, command: Array, plant: PlantParameters, vertical: Array | float) -> Array:
    """Time derivative ``(12, N)`` of the state per second (eq 15).

    Parameters
    ----------
    vertical : (N,), m/s^2
        The disturbance d_z of Example 4, added to the vertical acceleration.
    """
    velocity, (p, q, r) = state[3:6], state[9:12]
    sine_roll, sine_pitch, sine_yaw = np.sin(state[6:9])
    cosine_roll, cosine_pitch, cosine_yaw = np.cos(state[6:9])
    ix, iy, iz = plant.inertia
    thrust = command[ALTITUDE] / plant.mass
    drag = DRAG / plant.mass
    rates = np.empty_like(state)
    rates[0:3] = velocity
    rates[3] = thrust * (cosine_roll * sine_pitch * cosine_yaw + sine_roll * sine_yaw) - drag * velocity[0]
    rates[4] = thrust * (cosine_roll * sine_pitch * sine_yaw - sine_roll * cosine_yaw) - drag * velocity[1]
    rates[5] = thrust * cosine_roll * cosine_pitch - drag * velocity[2] - GRAVITY + vertical
    rates[6:9] = state[9:12]
    rates[9] = (plant.arm * command[ROLL] - (iz - iy) * q * r - plant.arm * DRAG * p) / ix
    rates[10] = (plant.arm * command[PITCH] - (ix - iz) * p * r - plant.arm * DRAG * q) / iy
    rates[11] = (command[YAW] - (iy - ix) * p * q - DRAG * r) / iz
    return rates


def integrate(
    state: Array, command: Array, plant: PlantParameters, vertical: Array | float, dt: float
) -> Array:
    """State ``(12, N)`` after `dt` s: one Runge-Kutta step with command, load and disturbance held."""
    first = derivatives(state, command, plant, vertical)
    second = derivatives(state + 0.5 * dt * first, command, plant, vertical)
    third = derivatives(state + 0.5 * dt * second, command, plant, vertical)
    fourth = derivatives(state + dt * third, command, plant, vertical)
    return np.asarray(state + dt / 6.0 * (first + 2.0 * (second + third) + fourth))
