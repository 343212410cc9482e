"""Flights of one controller on the paper's plant: a loop over time, a batch over flights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from kffa_offboard.control import Array, BoolArray, controllers
from kffa_offboard.experiments import plant

STEP_S = 0.005  # the paper's h


@dataclass(frozen=True)
class Flights:
    """What N flights are asked to do and what happens to them, T steps of `STEP_S`.

    Attributes
    ----------
    reference : (T, 4, N)
        Channel order roll, pitch, yaw [rad], altitude [m].
    load_mass : (T, N), kg
    load_inertia : (N,) of bool
        See `plant.loaded`.
    vertical : (T, N), m/s^2
        Disturbance d_z.
    noise : (T, 4, N)
        Added to the measurements.
    """

    reference: Array
    load_mass: Array
    load_inertia: BoolArray
    vertical: Array
    noise: Array

    @property
    def time(self) -> Array:
        """Time of each step ``(T,)``, s."""
        return np.asarray(STEP_S * np.arange(len(self.reference)), dtype=np.float64)


@dataclass(frozen=True)
class Record:
    """What happened; each ``(T, 4, N)`` in channel order, outputs and rates true."""

    time: Array
    reference: Array
    output: Array
    command: Array
    omega_c: Array
    estimate: Array

    @property
    def error(self) -> Array:
        """Reference minus true output."""
        return self.reference - self.output


def calm(reference: Array) -> Flights:
    """Flights that follow `reference` ``(T, 4, N)`` without load, noise or disturbance."""
    steps, _, count = reference.shape
    nothing = np.zeros((steps, count))
    return Flights(reference, nothing, np.zeros(count, dtype=bool), nothing, np.zeros_like(reference))


def fly(
    parameters: controllers.ControllerParameters,
    flights: Flights,
    tick: Callable[[int], None] = lambda steps: None,
) -> Record:
    """Fly all flights of the batch at once, from a hover at the origin.

    Parameters
    ----------
    tick : called with the number of steps done since its last call
    """
    steps, channels, count = flights.reference.shape
    state = np.zeros((12, count))
    fresh = np.ones((channels, count), dtype=bool)
    hover = np.repeat(plant.HOVER[:, None], count, axis=1)
    control = controllers.initial_state(parameters, np.zeros((channels, count)), hover)
    recorded = np.empty((4, steps, channels, count))
    loads = _load_changes(flights)
    body = plant.loaded(flights.load_mass[0], flights.load_inertia)
    for k in range(steps):
        if k in loads:
            body = plant.loaded(flights.load_mass[k], flights.load_inertia)
        output = state[list(plant.OUTPUTS)]
        told = controllers.ControllerInput(flights.reference[k], output + flights.noise[k], fresh)
        control, said = controllers.step(parameters, control, told, STEP_S)
        recorded[:, k] = output, said.command, said.omega_c, said.estimate
        state = plant.integrate(state, said.command, body, flights.vertical[k], STEP_S)
        if k % 100 == 99:
            tick(100)
    tick(steps % 100)
    return Record(flights.time, flights.reference, *recorded)


def _load_changes(flights: Flights) -> frozenset[int]:
    """Steps at which the load of some flight differs from that of the step before."""
    return frozenset((np.flatnonzero(np.any(np.diff(flights.load_mass, axis=0), axis=1)) + 1).tolist())
