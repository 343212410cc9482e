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

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from kffa_offboard.control import Array, BoolArray, actuator, column, fuzzy, kalman, ladrc, observer, pid
from kffa_offboard.control import tracking_differentiator as td

CHANNELS = ("roll", "pitch", "yaw", "altitude")
ROLL, PITCH, YAW, ALTITUDE = range(4)

_TURNS_PER_RADIAN = 0.5 / np.pi
_SAME_MOMENT = 5e-3  # s; the step nearest to the moment takes it, with a telemetry of 100 Hz

ControllerName = Literal["pid", "cascaded-pid", "wb-ladrc", "ladrc", "fa-ladrc", "kffa-ladrc"]
NAMES: tuple[ControllerName, ...] = ("pid", "cascaded-pid", "wb-ladrc", "ladrc", "fa-ladrc", "kffa-ladrc")


@dataclass(frozen=True, eq=False)
class Limits:
    """Bounds of each channel's command and of its change per second; each ``(4,)`` or ``(4, N)``."""

    lower: Array
    upper: Array
    rate: Array


@dataclass(frozen=True, eq=False)
class ControllerParameters:
    """One controller: the blocks that it has (None where it has none) and what they share.

    Attributes
    ----------
    angular : (4,) of bool
        Channels whose output is an angle and wraps at +-pi.
    prediction : (4,), s, or None
        How far ahead of the estimate the law looks (the commands under way are known).
    """

    name: ControllerName
    model: observer.PlantModel
    actuator: actuator.ActuatorParameters
    limits: Limits
    angular: BoolArray
    differentiator: td.TrackingDifferentiatorParameters | None = None
    kalman: kalman.KalmanParameters | None = None
    observer: observer.ObserverParameters | None = None
    fuzzy: fuzzy.FuzzyParameters | None = None
    law: ladrc.LawParameters | None = None
    pid: pid.PidParameters | None = None
    prediction: Array | None = None

    @cached_property
    def turn(self) -> Array:
        """2 pi for angles, 0 for what does not wrap, (4,)."""
        return np.where(self.angular, 2.0 * np.pi, 0.0)


class ExpectedStep(NamedTuple):
    """The disturbance will change by `step` ``(4[, N])``; it shows in the measurements `after` s from now."""

    step: Array
    after: float


class ControllerState(NamedTuple):
    """Everything that a controller remembers between steps; a value: copy it, compare it, save it."""

    differentiator: td.TrackingDifferentiatorState
    observer: observer.ObserverState
    actuator: actuator.ActuatorState
    pid: pid.PidState
    kalman: kalman.KalmanState | None = None
    expected: ExpectedStep | None = None


class ControllerInput(NamedTuple):
    """What one step is told; arrays ``(4[, N])`` in channel order.

    Attributes
    ----------
    reference : wanted output; angles in any turn
    measurement : measured output; entries that are not fresh are not read
    fresh : channels with a new measurement
    measured_rate : measured rate of the output; the PIDs differentiate without it, the Kalman filter fuses it
        if its `rate_variance` is given
    """

    reference: Array
    measurement: Array
    fresh: BoolArray
    measured_rate: Array | None = None


class ControllerOutput(NamedTuple):
    """What one step says; arrays ``(4[, N])`` in channel order.

    Attributes
    ----------
    command : limited command
    reference, reference_rate : what the law tracked (after the tracking differentiator)
    estimate, estimate_rate, disturbance : s1, s2, s3
    omega_c : momentary controller bandwidth, rad/s (0 for the PIDs)
    saturated : command was limited
    """

    command: Array
    reference: Array
    reference_rate: Array
    estimate: Array
    estimate_rate: Array
    disturbance: Array
    omega_c: Array
    saturated: BoolArray


def wrap_near(angle: Array, near: Array, parameters: ControllerParameters) -> Array:
    """Take that turn of `angle` ``(4[, N])`` which is nearest to `near`; channels that are no angles pass."""
    turn = column(parameters.turn, angle)
    return np.asarray(angle - turn * np.rint((angle - near) * _TURNS_PER_RADIAN))


def initial_state(parameters: ControllerParameters, measurement: Array, command: Array) -> ControllerState:
    """Start at rest at `measurement` ``(4[, N])``, where `command` ``(4[, N])`` has held the balance."""
    zero = np.zeros_like(measurement)
    balance = (
        column(parameters.model.stiffness, measurement) * measurement
        - column(parameters.model.b0, measurement) * command
    )
    return ControllerState(
        differentiator=td.TrackingDifferentiatorState(measurement, zero, zero),
        observer=observer.ObserverState(measurement, zero, balance, zero),
        actuator=actuator.initial_state(command),
        pid=pid.initial_state(measurement),
        kalman=(kalman.initial_state(parameters.kalman, measurement, balance) if parameters.kalman else None),
    )


def align_reference(parameters: ControllerParameters, state: ControllerState) -> ControllerState:
    """Let the reference start from what is estimated, so that engaging or a new segment makes no bump.

    The integral of a PID is set so that its next command equals the one that is acting.
    """
    estimate, rate = state.observer.estimate, state.observer.rate
    aligned = state._replace(
        differentiator=td.TrackingDifferentiatorState(estimate, rate, np.zeros_like(rate))
    )
    if parameters.pid is None:
        return aligned
    acting = state.actuator.commands[-1]
    at_rest = state.pid._replace(integral=np.zeros_like(acting))
    unlimited = pid.command(parameters.pid, at_rest, state.pid.measurement)
    integral = column(parameters.pid.b0, acting) * (acting - unlimited)
    needs = column(parameters.pid.ki, acting) > 0.0
    return aligned._replace(pid=state.pid._replace(integral=np.where(needs, integral, 0.0)))


def with_applied(parameters: ControllerParameters, state: ControllerState, command: Array) -> ControllerState:
    """Tell the observer which command ``(4[, N])`` really goes out from now on.

    For a guard that changed the command after `step`, and for shadow flight, where the autopilot's own
    command acts. It replaces the one that `step` noted.
    """
    return ControllerState(
        state.differentiator,
        state.observer,
        actuator.send(state.actuator, command),
        state.pid,
        state.kalman,
        state.expected,
    )


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
        return state._replace(expected=ExpectedStep(step, after) if np.any(step) else None)
    stepped = state.observer._replace(disturbance=state.observer.disturbance + step)
    filter_state = state.kalman
    if parameters.kalman is not None and filter_state is not None:
        filter_state = kalman.with_disturbance_step(parameters.kalman, filter_state, step)
    return state._replace(observer=stepped, kalman=filter_state, expected=None)


def lead(parameters: ControllerParameters) -> Array:
    """From a command to the moment when it acts in the mean, ``(4,)`` s: delay and lag."""
    return np.asarray(parameters.actuator.delay + parameters.actuator.lag)


def _advance_expected(
    parameters: ControllerParameters, state: ControllerState, acted: Array, dt: float
) -> tuple[ControllerState, Array]:
    """Let the expected step come nearer, or come.

    Returns the state and the command that `acted`, corrected: if the step came within these `dt` s, the part
    before it still had the old disturbance.
    """
    expected = state.expected
    if expected is None:
        return state, acted
    if expected.after > dt:
        return state._replace(expected=expected._replace(after=expected.after - dt)), acted
    early = expected.after / dt * expected.step / column(parameters.model.b0, expected.step)
    return with_disturbance_step(parameters, state, expected.step), acted - early


def _limit(limits: Limits, command: Array, previous: Array, dt: float) -> Array:
    """Bound the command and its change since `previous`; bounds win over the change."""
    change = column(limits.rate, command) * dt
    slewed = np.minimum(np.maximum(command, previous - change), previous + change)
    lower, upper = column(limits.lower, command), column(limits.upper, command)
    return np.asarray(np.minimum(np.maximum(slewed, lower), upper))


def _estimate(
    parameters: ControllerParameters, state: ControllerState, inputs: ControllerInput, dt: float
) -> ControllerState:
    """Command queue, Kalman filter and observer: everything that runs in shadow, too."""
    queue, acted = actuator.step(parameters.actuator, state.actuator, dt)
    state, acted = _advance_expected(parameters, state, acted, dt)
    predicted = observer.predict(parameters.model, state.observer, acted, dt)
    measurement = np.where(inputs.fresh, inputs.measurement, predicted.estimate)
    measurement = wrap_near(measurement, predicted.estimate, parameters)
    filter_state = state.kalman
    filtered = measurement
    if parameters.kalman is not None and state.kalman is not None:
        filter_state, filtered = kalman.step(
            parameters.kalman,
            parameters.model,
            state.kalman,
            acted,
            measurement,
            inputs.fresh,
            dt,
            inputs.measured_rate,
        )
    baseline = state.pid
    if parameters.pid is not None:
        baseline = pid.differentiate(parameters.pid, baseline, measurement, dt)
        if inputs.measured_rate is not None:
            baseline = baseline._replace(rate=inputs.measured_rate)
        estimates = observer.ObserverState(measurement, baseline.rate, -baseline.integral, predicted.elapsed)
    else:
        assert parameters.observer is not None
        estimates = observer.correct(parameters.observer, parameters.model, predicted, filtered, inputs.fresh)
    return ControllerState(
        state.differentiator, estimates, queue, baseline, filter_state, expected=state.expected
    )


def _track(
    parameters: ControllerParameters, state: ControllerState, reference: Array, dt: float
) -> td.TrackingDifferentiatorState:
    """The reference as the law sees it, in the turn of the present one."""
    near = wrap_near(reference, state.differentiator.position, parameters)
    if parameters.differentiator is None:
        return td.TrackingDifferentiatorState(near, np.zeros_like(near), np.zeros_like(near))
    return td.step(parameters.differentiator, state.differentiator, near, dt)


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
    state = _estimate(parameters, state, inputs, dt)
    tracked = _track(parameters, state, inputs.reference, dt)
    baseline, previous = state.pid, state.actuator.commands[-1]
    if parameters.pid is not None:
        unlimited = pid.command(parameters.pid, baseline, tracked.position)
        command = _limit(parameters.limits, unlimited, previous, dt)
        excess = unlimited - command
        baseline = pid.integrate(parameters.pid, baseline, tracked.position, excess, dt)
        omega_c = np.zeros_like(command)
    else:
        unlimited, omega_c = _adrc_command(parameters, state, tracked)
        command = _limit(parameters.limits, unlimited, previous, dt)
    queue = actuator.send(state.actuator, command)
    state = ControllerState(tracked, state.observer, queue, baseline, state.kalman, state.expected)
    return state, ControllerOutput(
        command=command,
        reference=tracked.position,
        reference_rate=tracked.rate,
        estimate=state.observer.estimate,
        estimate_rate=state.observer.rate,
        disturbance=state.observer.disturbance,
        omega_c=omega_c,
        saturated=np.asarray(command != unlimited),
    )


def prepare(
    parameters: ControllerParameters, state: ControllerState, fresh: BoolArray, dt: float, *, with_rate: bool
) -> None:
    """Work out, in time left over, what the next `step` looks up if it is like the last: `dt`, `fresh`.

    Nothing changes but the time that `step` takes: gain of the Kalman filter and weights of the queue depend
    on no measurement (`memory.remember`).
    """
    actuator.prepare(parameters.actuator, state.actuator, dt, parameters.prediction)
    if parameters.kalman is not None and state.kalman is not None:
        kalman.prepare(parameters.kalman, parameters.model, state.kalman, fresh, dt, with_rate=with_rate)


def _ahead(parameters: ControllerParameters, state: ControllerState) -> observer.ObserverState:
    """The estimates at the moment when the next command will act (those under way are known).

    An expected step of the disturbance counts from its moment on in what is predicted, and in full in what
    the command will meet.
    """
    ahead, expected = state.observer, state.expected
    if parameters.prediction is not None:
        acting = actuator.forecast(parameters.actuator, state.actuator, parameters.prediction)
        horizon = column(parameters.prediction, acting)
        if expected is not None:
            share = np.clip(1.0 - expected.after / horizon, 0.0, 1.0)
            acting = acting + share * expected.step / column(parameters.model.b0, acting)
        ahead = observer.predict(parameters.model, ahead, acting, horizon)
    if expected is None:
        return ahead
    met = expected.after <= column(lead(parameters), ahead.disturbance) + _SAME_MOMENT
    return ahead._replace(disturbance=ahead.disturbance + np.where(met, expected.step, 0.0))


def _adrc_command(
    parameters: ControllerParameters, state: ControllerState, tracked: td.TrackingDifferentiatorState
) -> tuple[Array, Array]:
    """Unlimited command and the momentary omega_c of the four LADRC controllers."""
    law = parameters.law
    assert law is not None
    estimates = _ahead(parameters, state)
    omega_c = column(law.omega_c, estimates.estimate)
    if parameters.fuzzy is None:
        omega_c = omega_c + np.zeros_like(estimates.estimate)
    else:
        omega_c = omega_c + fuzzy.bandwidth_correction(
            parameters.fuzzy, estimates.estimate - tracked.position, estimates.rate - tracked.rate
        )
    kp, kd = ladrc.gains(law, omega_c)
    forward = law.acceleration_feedforward * tracked.acceleration
    reference = (tracked.position, tracked.rate, forward)
    unlimited = ladrc.command(parameters.model, estimates, reference, kp, kd)
    return unlimited, omega_c
