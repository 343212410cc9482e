"""The blocks of a controller, put together: first what depends on times alone, then arithmetic.

`coefficients` looks up what the step's length and the freshness of the measurements make of the parameters:
discretised models and gains. `advance` is what is left: sums, products and limits of measurements and state,
without a look-up or a branch that depends on numbers. So it can be written out as straight code for one
vehicle (`straight.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from kffa_offboard.control import Array, actuator, column, fuzzy, kalman, ladrc, observer, pid
from kffa_offboard.control import tracking_differentiator as td
from kffa_offboard.control.blocks import (
    ControllerInput,
    ControllerOutput,
    ControllerParameters,
    ControllerState,
    ExpectedStep,
    Limits,
    wrap_near,
)
from kffa_offboard.control.covariance import Spread

_SAME_MOMENT = 5e-3  # s; the step nearest to the moment takes it, with a telemetry of 100 Hz


class Lookahead(NamedTuple):
    """What the law's look ahead needs: the time until the next command acts, and the plant over it."""

    window: actuator.Window
    discrete: observer.Discrete


class Coefficients(NamedTuple):
    """What one step takes from its length, and from what is measured when.

    Attributes
    ----------
    dt : s
    parts : steps of the tracking differentiator
    window : `dt`, for the commands that acted
    discrete : the plant over `dt`
    ahead : None without a prediction
    kalman, correction : gains; None without the block
    scales : of the fuzzy rules; None without them
    elapsed, spreads : of the state after the step (see the blocks)
    """

    dt: float | Array
    parts: int
    window: actuator.Window
    discrete: observer.Discrete
    ahead: Lookahead | None
    kalman: kalman.KalmanGains | None
    correction: tuple[Array, Array, Array] | None
    scales: tuple[Array, Array] | None
    elapsed: Array
    spreads: tuple[Spread, ...]


def coefficients(
    parameters: ControllerParameters, state: ControllerState, inputs: ControllerInput, dt: float
) -> Coefficients:
    """Look them up for a step of `dt` s; measurements are not read, only which of them are there."""
    found = discretised(parameters, state, inputs, dt)
    if parameters.kalman is None or state.kalman is None:
        return found
    gains, spreads = filter_gains(parameters, parameters.kalman, state.kalman, inputs, dt)
    return found._replace(kalman=gains, spreads=spreads)


def filter_gains(
    parameters: ControllerParameters,
    noise: kalman.KalmanParameters,
    state: kalman.KalmanState,
    inputs: ControllerInput,
    dt: float,
) -> tuple[kalman.KalmanGains, tuple[Spread, ...]]:
    """The Kalman filter's part of them, which depends on when measurements came, too."""
    with_rate = inputs.measured_rate is not None
    return kalman.gains(noise, parameters.model, state, inputs.fresh, dt, with_rate=with_rate)


def discretised(
    parameters: ControllerParameters, state: ControllerState, inputs: ControllerInput, dt: float
) -> Coefficients:
    """All but the Kalman filter's: they depend on `dt` and on what is fresh alone."""
    axes = state.actuator.lagged.ndim
    elapsed = state.observer.elapsed + dt
    correction = None
    if parameters.observer is not None:
        correction = observer.gains(parameters.observer, parameters.model, elapsed)
        elapsed = np.where(inputs.fresh, 0.0, elapsed)
    ahead, horizon = None, parameters.prediction
    if horizon is not None:
        ahead = Lookahead(
            actuator.window(parameters.actuator, horizon, horizon, axes),
            observer.discretised(parameters.model, horizon, axes),
        )
    return Coefficients(
        dt,
        1 if parameters.differentiator is None else td.parts_of(parameters.differentiator, dt),
        actuator.window(parameters.actuator, actuator.NOW, dt, axes),
        observer.discretised(parameters.model, dt, axes),
        ahead,
        None,
        correction,
        None if parameters.fuzzy is None else fuzzy.scaling(parameters.fuzzy, axes),
        elapsed,
        (),
    )


def averages(found: Coefficients, ages: tuple[float, ...], commands: Array) -> list[Array]:
    """Means of the delayed commands ``(4[, N])``: those that acted, and those that will while looking ahead.

    `ages` are those at the end of the step.
    """
    windows = [found.window] if found.ahead is None else [found.window, found.ahead.window]
    acting = [actuator.acting(ages, seen.delay, seen.span) for seen in windows]
    return [actuator.average(shares, commands[piece]) for piece, shares in acting]


def with_times(
    parameters: ControllerParameters, state: ControllerState, found: Coefficients, ages: tuple[float, ...]
) -> ControllerState:
    """Ages and spreads as they are after the step; commands that act no more are forgotten."""
    queue, filtered = state.actuator, state.kalman
    over = actuator.count_over(parameters.actuator, ages)
    if filtered is not None:
        filtered = replace(filtered, spreads=found.spreads)
    return replace(
        state,
        observer=replace(state.observer, elapsed=found.elapsed),
        actuator=actuator.ActuatorState(actuator.kept(ages, over), queue.commands[over:], queue.lagged),
        kalman=filtered,
    )


def advance(
    parameters: ControllerParameters,
    found: Coefficients,
    state: ControllerState,
    inputs: ControllerInput,
    means: Sequence[Array],
) -> tuple[ControllerState, ControllerOutput]:
    """The arithmetic of a step; times and queue of `state` are left as they are (`with_times`).

    `means` are `averages`; the command's rate is limited against the last of ``state.actuator.commands``.
    """
    state = _estimate(parameters, found, state, inputs, means[0])
    tracked = _track(parameters, found, state, inputs.reference)
    baseline, previous = state.pid, state.actuator.commands[-1]
    if parameters.pid is not None:
        assert not isinstance(found.dt, np.ndarray)
        unlimited = pid.command(
            parameters.pid, baseline, tracked.position, tracked.rate, tracked.acceleration
        )
        command = _limit(parameters.limits, unlimited, previous, found.dt)
        excess = unlimited - command
        baseline = pid.integrate(parameters.pid, baseline, tracked.position, excess, found.dt)
        omega_c = np.zeros_like(command)
    else:
        unlimited, omega_c = _adrc_command(parameters, found, state, tracked, means[-1])
        command = _limit(parameters.limits, unlimited, previous, found.dt)
    state = ControllerState(tracked, state.observer, state.actuator, baseline, state.kalman, state.expected)
    return state, ControllerOutput(
        command=command,
        reference=tracked.position,
        reference_rate=tracked.rate,
        estimate=state.observer.estimate,
        estimate_rate=state.observer.rate,
        disturbance=state.observer.disturbance,
        omega_c=omega_c,
        saturated=command != unlimited,
    )


def lead(parameters: ControllerParameters) -> Array:
    """From a command to the moment when it acts in the mean, ``(4,)`` s: delay and lag."""
    return np.asarray(parameters.actuator.delay + parameters.actuator.lag)


def with_disturbance_step(
    parameters: ControllerParameters, state: ControllerState, step: Array, after: float = 0.0
) -> ControllerState:
    """The disturbance will change by `step` ``(4[, N])``, output units/s^2: a load is going to be released.

    Observer and Kalman filter change together when the step shows in the measurements, `after` s from
    now. The command that will act at that moment, sent `lead` s before it, already meets the new
    disturbance, so that its own step and the disturbance's have the same centroid. One step can be
    expected at a time; a new one takes its place, and one of zeros calls it off. The PIDs estimate no
    disturbance and take no notice.
    """
    if after > 0.0:
        return replace(state, expected=ExpectedStep(step, after) if np.any(step) else None)
    stepped = replace(state.observer, disturbance=state.observer.disturbance + step)
    filter_state = state.kalman
    if parameters.kalman is not None and filter_state is not None:
        filter_state = kalman.with_disturbance_step(parameters.kalman, filter_state, step)
    return replace(state, observer=stepped, kalman=filter_state, expected=None)


def _advance_expected(
    parameters: ControllerParameters, state: ControllerState, acted: Array, dt: float | Array
) -> tuple[ControllerState, Array]:
    """Let the expected step come nearer, or come.

    Returns the state and the command that `acted`, corrected: if the step came within these `dt` s, the part
    before it still had the old disturbance.
    """
    expected = state.expected
    if expected is None:
        return state, acted
    assert not isinstance(dt, np.ndarray)
    if expected.after > dt:
        return replace(state, expected=replace(expected, after=expected.after - dt)), acted
    early = expected.after / dt * expected.step / column(parameters.model.b0, expected.step)
    return with_disturbance_step(parameters, state, expected.step), acted - early


def _limit(limits: Limits, command: Array, previous: Array, dt: float | Array) -> Array:
    """Bound the command and its change since `previous`; bounds win over the change."""
    change = column(limits.rate, command) * dt
    slewed: Array = np.minimum(np.maximum(command, previous - change), previous + change)
    lower, upper = column(limits.lower, command), column(limits.upper, command)
    bounded: Array = np.minimum(np.maximum(slewed, lower), upper)
    return bounded


def _estimate(
    parameters: ControllerParameters,
    found: Coefficients,
    state: ControllerState,
    inputs: ControllerInput,
    average: Array,
) -> ControllerState:
    """Lag, Kalman filter and observer: everything that runs in shadow, too."""
    acted, lagged = actuator.lagging(average, found.window.held, found.window.decay, state.actuator.lagged)
    state = replace(state, actuator=replace(state.actuator, lagged=lagged))
    state, acted = _advance_expected(parameters, state, acted, found.dt)
    before = state.observer
    estimate, rate = observer.moved(found.discrete, before.estimate, before.rate, before.disturbance, acted)
    measurement = np.where(inputs.fresh, inputs.measurement, estimate)
    measurement = wrap_near(measurement, estimate, parameters)
    filtered, filter_state = measurement, state.kalman
    if parameters.kalman is not None and filter_state is not None and found.kalman is not None:
        rates = None if parameters.kalman.rate_variance is None else inputs.measured_rate
        filter_state = kalman.advance(
            found.kalman, found.discrete, filter_state, acted, measurement, inputs.fresh, rates
        )
        filtered = filter_state.estimate
    predicted = observer.ObserverState(estimate, rate, before.disturbance, before.elapsed)
    if parameters.pid is not None:
        assert not isinstance(found.dt, np.ndarray)
        baseline = pid.differentiate(parameters.pid, state.pid, measurement, found.dt)
        if inputs.measured_rate is not None:
            baseline = replace(baseline, rate=inputs.measured_rate)
        seen = observer.ObserverState(measurement, baseline.rate, -baseline.integral, before.elapsed)
        return replace(state, observer=seen, pid=baseline, kalman=filter_state)
    assert found.correction is not None
    seen = observer.corrected(found.correction, predicted, filtered, inputs.fresh)
    return replace(state, observer=seen, kalman=filter_state)


def _track(
    parameters: ControllerParameters, found: Coefficients, state: ControllerState, reference: Array
) -> td.TrackingDifferentiatorState:
    """The reference as the law sees it, in the turn of the present one."""
    near = wrap_near(reference, state.differentiator.position, parameters)
    if parameters.differentiator is None:
        return td.TrackingDifferentiatorState(near, np.zeros_like(near), np.zeros_like(near))
    return td.steps(
        parameters.differentiator, state.differentiator, near, found.dt / found.parts, found.parts
    )


def _ahead(
    parameters: ControllerParameters, found: Coefficients, state: ControllerState, average: Array
) -> observer.ObserverState:
    """The estimates at the moment when the next command will act (those under way are known).

    An expected step of the disturbance counts from its moment on in what is predicted, and in full in what
    the command will meet.
    """
    ahead, expected = state.observer, state.expected
    if found.ahead is not None and parameters.prediction is not None:
        acting = average + found.ahead.window.held * (state.actuator.lagged - average)
        if expected is not None:
            share = np.clip(1.0 - expected.after / column(parameters.prediction, acting), 0.0, 1.0)
            acting = acting + share * expected.step / column(parameters.model.b0, acting)
        estimate, rate = observer.moved(
            found.ahead.discrete, ahead.estimate, ahead.rate, ahead.disturbance, acting
        )
        ahead = observer.ObserverState(estimate, rate, ahead.disturbance, ahead.elapsed)
    if expected is None:
        return ahead
    met = expected.after <= column(lead(parameters), ahead.disturbance) + _SAME_MOMENT
    return replace(ahead, disturbance=ahead.disturbance + np.where(met, expected.step, 0.0))


def _adrc_command(
    parameters: ControllerParameters,
    found: Coefficients,
    state: ControllerState,
    tracked: td.TrackingDifferentiatorState,
    average: Array,
) -> tuple[Array, Array]:
    """Unlimited command and the momentary omega_c of the four LADRC controllers."""
    law = parameters.law
    assert law is not None
    estimates = _ahead(parameters, found, state, average)
    omega_c = column(law.omega_c, estimates.estimate)
    if parameters.fuzzy is None or found.scales is None:
        omega_c = omega_c + np.zeros_like(estimates.estimate)
    else:
        error, error_rate = estimates.estimate - tracked.position, estimates.rate - tracked.rate
        omega_c = omega_c + fuzzy.scaled_correction(parameters.fuzzy.rules, found.scales, error, error_rate)
    kp, kd = ladrc.gains(law, omega_c)
    forward = law.acceleration_feedforward * tracked.acceleration
    reference = (tracked.position, tracked.rate, forward)
    unlimited = ladrc.command(parameters.model, estimates, reference, kp, kd, law.rejection)
    return unlimited, omega_c
