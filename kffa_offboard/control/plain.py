"""One vehicle in plain numbers: what `blocks` has as arrays, as tuples of floats.

numpy takes as long for four numbers as for a thousand. Between steps that are written out (`straight`) the
numbers of one vehicle need no arrays, and nobody has to make them.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from msgspec import Struct
from msgspec.structs import astuple

from kffa_offboard.control import actuator, observer
from kffa_offboard.control.blocks import ControllerInput, ControllerOutput, ControllerState
from kffa_offboard.control.covariance import Spread
from kffa_offboard.control.kalman import KalmanState
from kffa_offboard.control.pid import PidState
from kffa_offboard.control.tracking_differentiator import TrackingDifferentiatorState

Vector: TypeAlias = tuple[float, ...]
"""A number for each channel."""

ESTIMATE, RATE, DISTURBANCE, LAGGED, FILTERED = 3, 4, 5, 6, 7
"""Rows of `PlainState.numbers`; before them are those of the tracking differentiator."""


class PlainState(Struct, frozen=True, gc=False):
    """`ControllerState` of one vehicle. No expected step of the disturbance: those steps are made by arrays.

    Attributes
    ----------
    numbers : row by row position, rate, acceleration; estimate, rate, disturbance; lagged command; and the
        Kalman filter's estimate, rate, disturbance if there is one
    ages : s, of the commands under way
    commands : one `Vector` for each age
    elapsed : s since the last measurement of each channel
    spreads : of the Kalman filter
    pid : rests
    """

    numbers: Vector
    ages: tuple[float, ...]
    commands: tuple[Vector, ...]
    elapsed: Vector
    spreads: tuple[Spread, ...]
    pid: PidState

    def row(self, number: int) -> Vector:
        """One row of the numbers."""
        channels = len(self.elapsed)
        return self.numbers[number * channels : (number + 1) * channels]


class PlainInput(Struct, frozen=True, gc=False):
    """`ControllerInput` of one vehicle."""

    reference: Vector
    measurement: Vector
    fresh: tuple[bool, ...]
    measured_rate: Vector | None = None

    def arrays(self) -> ControllerInput:
        """The same as arrays."""
        rate = None if self.measured_rate is None else np.array(self.measured_rate)
        return ControllerInput(
            np.array(self.reference), np.array(self.measurement), np.array(self.fresh), rate
        )


class PlainOutput(Struct, frozen=True, gc=False):
    """`ControllerOutput` of one vehicle."""

    command: Vector
    reference: Vector
    reference_rate: Vector
    estimate: Vector
    estimate_rate: Vector
    disturbance: Vector
    omega_c: Vector
    saturated: tuple[bool, ...]

    def arrays(self) -> ControllerOutput:
        """The same as arrays."""
        return ControllerOutput(*map(np.array, astuple(self)))


def plain_state(state: ControllerState) -> PlainState:
    """A state of one vehicle in plain numbers."""
    tracked, seen, queue, filtered = state.differentiator, state.observer, state.actuator, state.kalman
    arrays = [tracked.position, tracked.rate, tracked.acceleration]
    arrays += [seen.estimate, seen.rate, seen.disturbance, queue.lagged]
    arrays += [] if filtered is None else [filtered.estimate, filtered.rate, filtered.disturbance]
    return PlainState(
        tuple(np.concatenate(arrays).tolist()),
        queue.ages,
        tuple(map(tuple, queue.commands.tolist())),
        tuple(seen.elapsed.tolist()),
        () if filtered is None else filtered.spreads,
        state.pid,
    )


def array_state(state: PlainState) -> ControllerState:
    """The same as arrays."""
    elapsed = np.array(state.elapsed)
    rows = list(np.array(state.numbers).reshape(-1, elapsed.size))
    return ControllerState(
        TrackingDifferentiatorState(*rows[:ESTIMATE]),
        observer.ObserverState(rows[ESTIMATE], rows[RATE], rows[DISTURBANCE], elapsed),
        actuator.ActuatorState(state.ages, np.array(state.commands), rows[LAGGED]),
        state.pid,
        KalmanState(rows[7], rows[8], rows[9], state.spreads) if len(rows) > FILTERED else None,
    )


def sent(
    ages: tuple[float, ...], commands: tuple[Vector, ...], command: Vector, after: float = 0.0
) -> tuple[tuple[float, ...], tuple[Vector, ...]]:
    """Ages and commands under way with one more, as `actuator.send`."""
    while ages[-1] <= -after:
        ages, commands = ages[:-1], commands[:-1]
    return (*ages, -after), (*commands, command)


def plain_input(inputs: ControllerInput) -> PlainInput:
    """What one vehicle's step is told, in plain numbers."""
    return PlainInput(
        tuple(inputs.reference.tolist()),
        tuple(inputs.measurement.tolist()),
        tuple(inputs.fresh.tolist()),
        None if inputs.measured_rate is None else tuple(inputs.measured_rate.tolist()),
    )


def plain_output(output: ControllerOutput) -> PlainOutput:
    """What one vehicle's step says, in plain numbers."""
    fields = ControllerOutput.__struct_fields__
    return PlainOutput(*(tuple(getattr(output, name).tolist()) for name in fields))
