"""The linear loop of one channel, in discrete time, as it is implemented.

The controller's matrices are read off `control.controllers.step` itself, one call with a unit vector in each
column of the batch: observer, Kalman filter, queue of delayed commands and forecast are what flies, not a
copy. The
fuzzy rules and the limits are left out (they are not linear). The plant is exact for a held command,

    y'' = b0 lag(u(t - delay)) - damping y' - stiffness y + disturbance,

and the loop is broken at the command, where autopilot and motors are uncertain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from msgspec import structs
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from kffa_offboard.control import actuator, controllers, kalman, observer
from kffa_offboard.control import tracking_differentiator as td
from kffa_offboard.control.covariance import Spread, at_rest
from kffa_offboard.loganalysis.record import Array

_SETTLING_STEPS = 400
"""Until the Kalman filter's covariance is at rest."""


@dataclass(frozen=True)
class LinearSystem:
    """x+ = a x + b u, y = c x + d u, every `period_s`."""

    a: Array
    b: Array
    c: Array
    d: Array
    period_s: float


@dataclass(frozen=True)
class PlantNumbers:
    """One channel's plant: b0 (acceleration per command), damping 1/s, stiffness 1/s^2, delay and lag s."""

    b0: float
    damping: float
    stiffness: float
    delay_s: float
    lag_s: float


def plant(numbers: PlantNumbers, period_s: float) -> LinearSystem:
    """Command and disturbance [output units/s^2] -> output and its rate; the command is held for a period."""
    lag = max(numbers.lag_s, 1e-4)
    a = np.array(
        [
            [0.0, 1.0, 0.0, 0.0, 0.0],
            [-numbers.stiffness, -numbers.damping, numbers.b0, 0.0, 1.0],
            [0.0, 0.0, -1.0 / lag, 1.0 / lag, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0],
        ]
    )
    whole = int(numbers.delay_s / period_s + 1e-9)
    part = max(numbers.delay_s - whole * period_s, 0.0)
    first, second = expm(a * part), expm(a * (period_s - part))
    moved = second[:3, :3] @ first[:3, :3]
    older, newer = second[:3, :3] @ first[:3, 3], second[:3, 3]
    disturbed = second[:3, :3] @ first[:3, 4] + second[:3, 4]
    # States: y, y', lagged command, then u[k-1], u[k-2], ... u[k-whole-1].
    size = 3 + whole + 1
    state = np.zeros((size, size))
    state[:3, :3] = moved
    state[:3, 3 + whole] = older
    inputs = np.zeros((size, 2))
    if whole == 0:
        inputs[:3, 0] = newer
    else:
        state[:3, 3 + whole - 1] += newer
    state[np.arange(4, size), np.arange(3, size - 1)] = 1.0
    inputs[3, 0] = 1.0
    inputs[:3, 1] = disturbed
    return LinearSystem(state, inputs, np.eye(2, size), np.zeros((2, 2)), period_s)


def _unlimited(parameters: controllers.ControllerParameters) -> controllers.ControllerParameters:
    never = np.full(4, np.inf)
    return replace(
        parameters,
        fuzzy=None,
        angular=np.zeros(4, dtype=bool),
        limits=controllers.Limits(-never, never, never),
    )


@dataclass(frozen=True)
class LinearController:
    """Makes the linear form of a controller; the Kalman filter settles once for all bandwidths.

    Attributes
    ----------
    parameters : without limits and fuzzy rules
    settled : state at rest, with the queue of commands full
    """

    parameters: controllers.ControllerParameters
    settled: controllers.ControllerState
    period_s: float

    @classmethod
    def of(cls, parameters: controllers.ControllerParameters, period_s: float) -> LinearController:
        """Settle the filter of `parameters`, a LADRC, at one step each `period_s`."""
        linear = _unlimited(parameters)
        zero, every = np.zeros(4), np.ones(4, dtype=bool)
        state = controllers.initial_state(linear, zero, zero)
        inputs = controllers.ControllerInput(zero, zero, every, zero)
        for _ in range(_SETTLING_STEPS if linear.kalman is not None else 60):
            state, _ = controllers.step(linear, state, inputs, period_s)
        return cls(linear, state, period_s)

    def with_bandwidths(self, omega_c: Array, omega_o: Array) -> LinearController:
        """The same with other bandwidths, (4,) each."""
        assert self.parameters.law is not None
        parameters = replace(
            self.parameters,
            observer=observer.ObserverParameters.from_bandwidth(omega_o),
            law=replace(self.parameters.law, omega_c=omega_c),
        )
        return replace(self, parameters=parameters)

    def with_prediction(self, channel: int, prediction_s: float) -> LinearController:
        """The same, looking further or less far ahead on one channel."""
        assert self.parameters.prediction is not None
        prediction = np.array(self.parameters.prediction, dtype=float)
        prediction[channel] = prediction_s
        return replace(self, parameters=replace(self.parameters, prediction=prediction))

    def with_filter(self, channel: int, measurement_variance: float, intensity: float) -> LinearController:
        """The same with another Kalman filter on one channel, at rest (algebraic Riccati equation)."""
        before, state = self.parameters.kalman, self.settled.kalman
        assert before is not None and before.model == "extended" and state is not None
        variances = np.array(before.measurement_variance, dtype=float)
        intensities = np.array(before.disturbance_intensity, dtype=float)
        variances[channel], intensities[channel] = measurement_variance, intensity
        filtering = replace(before, measurement_variance=variances, disturbance_intensity=intensities)
        fused, spreads = before.rate_variance is not None, list(state.spreads)
        (rest,) = at_rest(filtering, self.parameters.model, channel, fused, self.period_s)
        spreads[channel] = Spread(rest, 0.0, self.period_s)
        return replace(
            self,
            parameters=replace(self.parameters, kalman=filtering),
            settled=structs.replace(self.settled, kalman=structs.replace(state, spreads=tuple(spreads))),
        )

    def system(self, channel: int) -> LinearSystem:
        """Measured output and rate -> command, of one channel."""
        before = self.settled
        queue = len(before.actuator.commands)
        filters = self.parameters.kalman.states if self.parameters.kalman is not None else 0
        size = 4 + queue + filters
        unit = np.zeros((size + 2, 4, size + 2))
        unit[np.arange(size + 2), channel, np.arange(size + 2)] = 1.0
        zero = np.zeros((4, size + 2))
        mean = [unit[4 + queue + k] if k < filters else zero for k in range(3)]
        state = controllers.ControllerState(
            differentiator=td.TrackingDifferentiatorState(zero, zero, zero),
            observer=observer.ObserverState(unit[0], unit[1], unit[2], zero),
            actuator=actuator.ActuatorState(before.actuator.ages, unit[4 : 4 + queue], unit[3]),
            pid=structs.replace(before.pid, measurement=zero, rate=zero, integral=zero),
            kalman=None
            if before.kalman is None
            else kalman.KalmanState(mean[0], mean[1], mean[2], before.kalman.spreads),
        )
        fresh = np.ones((4, size + 2), dtype=bool)
        inputs = controllers.ControllerInput(zero, unit[size], fresh, unit[size + 1])
        after, output = controllers.step(self.parameters, state, inputs, self.period_s)
        rows = [after.observer.estimate, after.observer.rate, after.observer.disturbance]
        rows += [after.actuator.lagged, *after.actuator.commands]
        if after.kalman is not None:
            rows += [after.kalman.estimate, after.kalman.rate, after.kalman.disturbance][:filters]
        table = np.stack([row[channel] for row in rows])
        command = output.command[channel][None]
        return LinearSystem(
            table[:, :size], table[:, size:], command[:, :size], command[:, size:], self.period_s
        )


def open_loop(controller: LinearSystem, vehicle: LinearSystem) -> LinearSystem:
    """Command acting on the vehicle -> what the controller would command, sign of negative feedback."""
    b, c = vehicle.b[:, :1], vehicle.c
    a = block_diag(vehicle.a, controller.a)
    n = len(vehicle.a)
    a[n:, :n] = controller.b @ c
    inputs = np.concatenate([b, np.zeros((len(controller.a), 1))])
    outputs = -np.concatenate([controller.d @ c, controller.c], axis=1)
    return LinearSystem(a, inputs, outputs, np.zeros((1, 1)), vehicle.period_s)


def closed_loop(controller: LinearSystem, vehicle: LinearSystem) -> LinearSystem:
    """Disturbance -> output, with the loop closed."""
    loop = open_loop(controller, vehicle)
    a = loop.a - loop.b @ loop.c
    disturbance = np.concatenate([vehicle.b[:, 1:], np.zeros((len(controller.a), 1))])
    output = np.zeros((1, len(a)))
    output[0, 0] = 1.0
    return LinearSystem(a, disturbance, output, np.zeros((1, 1)), vehicle.period_s)


def is_stable(system: LinearSystem) -> bool:
    """All poles inside the unit circle."""
    return bool(np.max(np.abs(np.linalg.eigvals(system.a))) < 1.0 - 1e-9)


def frequency_response(system: LinearSystem, omega: Array) -> NDArray[np.complex128]:
    """Response ``(n,)`` of a system with one input and one output at `omega` [rad/s]."""
    z = np.exp(1j * omega * system.period_s)
    eye = np.eye(len(system.a))
    states = np.linalg.solve(z[:, None, None] * eye - system.a, system.b[None].astype(complex))
    return np.asarray((system.c @ states)[:, 0, 0] + system.d[0, 0])


def step_response(system: LinearSystem, duration_s: float) -> Array:
    """Output ``(n,)`` after a unit step of the input."""
    state, outputs = np.zeros(len(system.a)), []
    for _ in range(round(duration_s / system.period_s)):
        outputs.append(float(system.c[0] @ state))
        state = system.a @ state + system.b[:, 0]
    return np.array(outputs)
