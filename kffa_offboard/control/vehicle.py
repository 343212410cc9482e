"""A controller of one vehicle in plain numbers: `controllers` without arrays where none are needed.

A state is a `PlainState` while steps are written out (`straight`), and arrays for the rest: the PIDs, an
expected step of the disturbance, steps that are very long. Either may be handed on; the numbers are the same.
"""

from __future__ import annotations

from math import inf
from typing import TypeAlias

import numpy as np
from msgspec.structs import replace

from kffa_offboard.control import actuator, controllers, straight
from kffa_offboard.control.blocks import ControllerParameters, ControllerState
from kffa_offboard.control.plain import (
    DISTURBANCE,
    ESTIMATE,
    RATE,
    PlainInput,
    PlainOutput,
    PlainState,
    Vector,
    array_state,
    plain_output,
    plain_state,
    sent,
)

State: TypeAlias = PlainState | ControllerState
"""Of one vehicle."""


def as_arrays(state: State) -> ControllerState:
    """The state in arrays."""
    return array_state(state) if isinstance(state, PlainState) else state


def initial_state(parameters: ControllerParameters, measurement: Vector, command: Vector) -> State:
    """Start at rest at `measurement`, where `command` has held the balance."""
    return controllers.initial_state(parameters, np.array(measurement), np.array(command))


def step(
    parameters: ControllerParameters, state: State, inputs: PlainInput, dt: float
) -> tuple[State, PlainOutput]:
    """One step, `dt` s after the last one; raises as `controllers.step`."""
    if not 0.0 < dt < inf or not straight.is_straight(parameters, state, dt):
        after, output = controllers.step(parameters, as_arrays(state), inputs.arrays(), dt)
        return after, plain_output(output)
    plain = state if isinstance(state, PlainState) else plain_state(state)
    return straight.step(parameters, plain, inputs, dt)


def estimates(state: State) -> tuple[Vector, Vector, Vector]:
    """Estimate, its rate, and the disturbance of each channel."""
    if isinstance(state, PlainState):
        return state.row(ESTIMATE), state.row(RATE), state.row(DISTURBANCE)
    seen = state.observer
    return tuple(seen.estimate.tolist()), tuple(seen.rate.tolist()), tuple(seen.disturbance.tolist())


def align_reference(parameters: ControllerParameters, state: State) -> State:
    """See `controllers.align_reference`."""
    if not isinstance(state, PlainState):
        return controllers.align_reference(parameters, state)
    channels = len(state.elapsed)
    seen = state.numbers[ESTIMATE * channels : DISTURBANCE * channels]
    rest = state.numbers[ESTIMATE * channels :]
    return replace(state, numbers=(*seen, *(0.0,) * channels, *rest))


def with_applied(
    parameters: ControllerParameters, state: State, command: Vector, after: float = 0.0
) -> State:
    """See `controllers.with_applied`."""
    if not isinstance(state, PlainState):
        return controllers.with_applied(parameters, state, np.array(command), after)
    ages, commands = sent(state.ages, state.commands, command, after)
    return replace(state, ages=ages, commands=commands)


def forecast(parameters: ControllerParameters, state: State, horizon: float) -> Vector:
    """Mean command of each channel that will act during the coming `horizon` s if no other is sent."""
    queue = as_arrays(state).actuator
    ahead = np.full(len(queue.lagged), horizon)
    return tuple(actuator.forecast(parameters.actuator, queue, ahead).tolist())


def with_disturbance_step(
    parameters: ControllerParameters, state: State, step: Vector, after: float = 0.0
) -> State:
    """See `controllers.with_disturbance_step`."""
    return controllers.with_disturbance_step(parameters, as_arrays(state), np.array(step), after)


def expects_step(state: State) -> bool:
    """A step of the disturbance is expected."""
    return isinstance(state, ControllerState) and state.expected is not None


def wrap_near(angle: Vector, near: Vector, parameters: ControllerParameters) -> Vector:
    """See `controllers.wrap_near`."""
    return tuple(controllers.wrap_near(np.array(angle), np.array(near), parameters).tolist())
