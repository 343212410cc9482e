"""The named controllers of the paper, composed of the same blocks, behind one `step`.

============== == ======== ============== ===== ======
name           TD Kalman   observer poles fuzzy law
============== == ======== ============== ===== ======
pid            x                                PID
cascaded-pid                                    P on the output, PI on its rate (as PX4 flies height)
wb-ladrc       x           one by one           kp, kd one by one ("without bandwidth")
ladrc          x           omega_o              omega_c
fa-ladrc       x           omega_o        x     omega_c + correction
kffa-ladrc     x  x        omega_o        x     omega_c + correction
============== == ======== ============== ===== ======

Added to the paper: the command is limited here and the observer is told the limited one (no
wind-up), delayed and lagged as the vehicle feels it; angles are unwrapped at the entrance, so that
a yaw reference across +-pi takes the short way and everything behind is linear.
"""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from kffa_offboard.control import Array, actuator, column, pid, straight
from kffa_offboard.control import tracking_differentiator as td
from kffa_offboard.control.blocks import (
    CHANNELS,
    NAMES,
    ControllerInput,
    ControllerName,
    ControllerOutput,
    ControllerParameters,
    ControllerState,
    ExpectedStep,
    Limits,
    initial_state,
    wrap_near,
)
from kffa_offboard.control.composition import (
    advance,
    averages,
    coefficients,
    lead,
    with_disturbance_step,
    with_times,
)
from kffa_offboard.control.plain import array_state, plain_input, plain_state

__all__ = [
    "ALTITUDE",
    "CHANNELS",
    "NAMES",
    "PITCH",
    "ROLL",
    "YAW",
    "ControllerInput",
    "ControllerName",
    "ControllerOutput",
    "ControllerParameters",
    "ControllerState",
    "ExpectedStep",
    "Limits",
    "align_reference",
    "initial_state",
    "lead",
    "step",
    "with_applied",
    "with_disturbance_step",
    "wrap_near",
    "write_out",
]

ROLL, PITCH, YAW, ALTITUDE = range(4)


def align_reference(parameters: ControllerParameters, state: ControllerState) -> ControllerState:
    """Let the reference start from what is estimated, so that engaging or a new segment makes no bump.

    The integral of a PID is set so that its next command equals the one that is acting.
    """
    estimate, rate = state.observer.estimate, state.observer.rate
    aligned = replace(
        state, differentiator=td.TrackingDifferentiatorState(estimate, rate, np.zeros_like(rate))
    )
    if parameters.pid is None:
        return aligned
    acting = state.actuator.commands[-1]
    at_rest = replace(state.pid, integral=np.zeros_like(acting))
    unlimited = pid.command(parameters.pid, at_rest, state.pid.measurement, rate, np.zeros_like(rate))
    integral = column(parameters.pid.b0, acting) * (acting - unlimited)
    needs = column(parameters.pid.ki, acting) > 0.0
    return replace(aligned, pid=replace(state.pid, integral=np.where(needs, integral, 0.0)))


def with_applied(
    parameters: ControllerParameters, state: ControllerState, command: Array, after: float = 0.0
) -> ControllerState:
    """Tell the observer which command ``(4[, N])`` really goes out from now on, or from `after` s on.

    For a guard that changed the command after `step`, and for shadow flight, where the autopilot's own
    command acts: it replaces the one that `step` noted. With `after`, s since the step, that one acted until
    then.
    """
    return ControllerState(
        state.differentiator,
        state.observer,
        actuator.send(state.actuator, command, after),
        state.pid,
        state.kalman,
        state.expected,
    )


def step(
    parameters: ControllerParameters, state: ControllerState, inputs: ControllerInput, dt: float
) -> tuple[ControllerState, ControllerOutput]:
    """One step of the named controller, `dt` s after the last one.

    Raises
    ------
    ValueError
        If `dt` is not positive and finite.
    """
    if not 0.0 < dt < np.inf:
        raise ValueError(f"control step of {dt} s: dt must be positive; give each sample once, in order")
    if straight.is_straight(parameters, state, dt):
        after, said = straight.step(parameters, plain_state(state), plain_input(inputs), dt)
        return array_state(after), said.arrays()
    found = coefficients(parameters, state, inputs, dt)
    ages = actuator.aged(state.actuator.ages, dt)
    means = averages(found, ages, state.actuator.commands)
    advanced, output = advance(parameters, found, state, inputs, means)
    state = with_times(parameters, advanced, found, ages)
    return replace(state, actuator=actuator.send(state.actuator, output.command)), output


def write_out(parameters: ControllerParameters, *, with_rate: bool) -> None:
    """Trace the step of one vehicle (`straight`), which otherwise is done in the first one: some 0.05 s."""
    if straight.can_be_straight(parameters):
        straight.law(parameters, with_rate)
