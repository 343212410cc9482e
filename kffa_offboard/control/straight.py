"""One step of one vehicle: `composition.advance`, written out in plain floats (`tracing`).

Only what steps have in common is traced: a LADRC, without an expected step of the disturbance, whose
reference moves in one part. Everything else is left to the array code. The numbers are the same. Parameters
are arguments of the function, which is traced once for each structure: that takes some 0.05 s, and parameters
are set in flight.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import count
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from msgspec import structs

from kffa_offboard.control import Array, actuator, observer
from kffa_offboard.control.blocks import (
    ControllerInput,
    ControllerOutput,
    ControllerParameters,
    ControllerState,
    Limits,
    initial_state,
)
from kffa_offboard.control.composition import (
    Coefficients,
    Lookahead,
    advance,
    coefficients,
    discretised,
    filter_gains,
)
from kffa_offboard.control.covariance import Spread
from kffa_offboard.control.kalman import KalmanGains, KalmanState
from kffa_offboard.control.tracing import Tape, Traced, compiled
from kffa_offboard.control.tracking_differentiator import TrackingDifferentiatorState

Function: TypeAlias = Callable[..., tuple[float, ...]]

LAWS = 32
"""Sets of parameters whose functions are kept."""

REMEMBERED = 256
"""Coefficients that are kept for each of them; beyond it what was needed longest ago is forgotten."""


_ANY_STEP = 0.01  # s; the function is the same for all


class Found(NamedTuple):
    """Coefficients without the Kalman filter's, and the same as `Law.function` takes them.

    Attributes
    ----------
    numbers : flat lists, in the order of `_coefficient_arrays` and `_parameter_arrays`
    delay, span : s ``(2, channels)``, of the windows (`actuator.Window`) of what acted, and of what will
    """

    coefficients: Coefficients
    numbers: list[list[float]]
    delay: Array
    span: Array


class FoundGains(NamedTuple):
    """The Kalman filter's gains as `Law.function` takes them, and its spreads after the step."""

    numbers: list[list[float]]
    spreads: tuple[Spread, ...]


_NO_GAINS = FoundGains([], ())


_functions: dict[tuple[Any, ...], Function] = {}


class Law:
    """The step with one set of parameters, and what it has looked up.

    Attributes
    ----------
    function : of state, inputs, means, coefficients and parameters, in this order; a list for each array
    """

    def __init__(self, parameters: ControllerParameters, with_rate: bool) -> None:
        structure = _structure(parameters, with_rate)
        if structure not in _functions:
            _keep(_functions, structure, _traced(parameters, with_rate))
        self.function = _functions[structure]
        self._parameters = parameters
        self._numbers = [array.reshape(-1).tolist() for array in _parameter_arrays(parameters)]
        self._found: dict[tuple[object, ...], Found] = {}
        self._gains: dict[tuple[object, ...], FoundGains] = {}
        self._shares: dict[tuple[object, ...], tuple[Array, int, tuple[float, ...]]] = {}

    def find(self, state: ControllerState, inputs: ControllerInput, dt: float) -> Found:
        """Look up the coefficients of a step, or work them out."""
        key = (dt, inputs.fresh.tobytes(), state.observer.elapsed.tobytes())
        known = self._found.pop(key, None)
        if known is None:
            found = discretised(self._parameters, state, inputs, dt)
            known = Found(found, _flat(_coefficient_arrays(found)) + self._numbers, *_windows(found))
        _keep(self._found, key, known)  # as the latest
        return known

    def find_gains(self, state: ControllerState, inputs: ControllerInput, dt: float) -> FoundGains:
        """Look up the Kalman filter's gains, or work them out: odd times make them many."""
        noise, filtered = self._parameters.kalman, state.kalman
        if noise is None or filtered is None:
            return _NO_GAINS
        key = (dt, inputs.fresh.tobytes(), filtered.spreads)
        known = self._gains.pop(key, None)
        if known is None:
            gains, spreads = filter_gains(self._parameters, noise, filtered, inputs, dt)
            known = FoundGains(_flat(gains), spreads)
        _keep(self._gains, key, known)
        return known

    def shares(self, state: ControllerState, found: Found, dt: float) -> tuple[Array, int, tuple[float, ...]]:
        """Shares ``(K, 2, channels)`` of the commands under way in what acted and in what will act.

        Then how many act no more, and the ages of the others.
        """
        key = (dt, state.actuator.ages)
        known = self._shares.get(key)
        if known is None:
            ages = actuator.aged(state.actuator.ages, dt)
            over = actuator.count_over(self._parameters.actuator, ages)
            known = actuator.shares(ages, found.delay, found.span), over, actuator.kept(ages, over)
            _keep(self._shares, key, known)
        return known


def _flat(arrays: Iterable[Array]) -> list[list[float]]:
    return [array.reshape(-1).tolist() for array in arrays]


def _windows(found: Coefficients) -> list[Array]:
    """`Found.delay` and `Found.span`."""
    acted = found.window
    ahead = acted if found.ahead is None else found.ahead.window
    return [
        np.stack(np.broadcast_arrays(*pair, acted.held)[:2])
        for pair in ((acted.delay, ahead.delay), (acted.span, ahead.span))
    ]


def _keep(results: dict[Any, Any], key: Any, result: Any) -> None:
    if len(results) >= REMEMBERED:
        del results[next(iter(results))]
    results[key] = result


@lru_cache(maxsize=LAWS)
def law(parameters: ControllerParameters, with_rate: bool) -> Law:
    """The law of these parameters (by identity)."""
    return Law(parameters, with_rate)


def can_be_straight(parameters: ControllerParameters) -> bool:
    """Are most steps of this controller made by a function of floats?"""
    return parameters.pid is None and parameters.differentiator is not None


def is_straight(parameters: ControllerParameters, state: ControllerState, dt: float) -> bool:
    """Is this step made by a function of floats?"""
    if state.expected is not None or state.observer.estimate.ndim != 1 or not can_be_straight(parameters):
        return False
    assert parameters.differentiator is not None
    return 2.0 * dt <= parameters.differentiator.filter_time


def step(
    parameters: ControllerParameters, state: ControllerState, inputs: ControllerInput, dt: float
) -> tuple[ControllerState, ControllerOutput]:
    """`controllers.step`, for what `is_straight`."""
    known = law(parameters, inputs.measured_rate is not None)
    found, gains = known.find(state, inputs, dt), known.find_gains(state, inputs, dt)
    shares, over, ages = known.shares(state, found, dt)
    means = np.add.reduce(shares * state.actuator.commands[:, None])
    given = (*_state_arrays(state), *_input_arrays(inputs), *means)
    numbers = known.function(*[array.tolist() for array in given], *gains.numbers, *found.numbers)
    rows = list(np.array(numbers).reshape(-1, inputs.reference.size))
    queue = actuator.ActuatorState(ages, state.actuator.commands[over:], rows[6])
    queue = actuator.send(queue, rows[-3])
    return _next_state(state, found.coefficients.elapsed, gains.spreads, queue, rows), _output(rows)


def _changing_arrays(state: ControllerState) -> list[Any]:
    """What the arithmetic changes of a state."""
    tracked, seen, filtered = state.differentiator, state.observer, state.kalman
    arrays = [
        tracked.position,
        tracked.rate,
        tracked.acceleration,
        seen.estimate,
        seen.rate,
        seen.disturbance,
    ]
    arrays.append(state.actuator.lagged)
    return arrays if filtered is None else [*arrays, filtered.estimate, filtered.rate, filtered.disturbance]


def _state_arrays(state: ControllerState) -> list[Any]:
    """What it reads of it: the last command, too."""
    return [*_changing_arrays(state), state.actuator.commands[-1]]


def _input_arrays(inputs: ControllerInput) -> list[Any]:
    rate = [] if inputs.measured_rate is None else [inputs.measured_rate]
    return [inputs.reference, inputs.measurement, inputs.fresh, *rate]


def _coefficient_arrays(found: Coefficients) -> list[Array]:
    """What of the coefficients differs from step to step, but for the Kalman filter's gains."""
    arrays = [np.array(found.dt), found.window.held, found.window.decay, *found.discrete[:3]]
    if found.ahead is not None:
        arrays += [found.ahead.window.held, *found.ahead.discrete[:3]]
    for more in (found.correction, found.scales):
        arrays += [] if more is None else more
    return [np.asarray(array) for array in arrays]


def _parameter_arrays(parameters: ControllerParameters) -> list[Array]:
    """What the arithmetic reads of the parameters, and they are free to be."""
    law, differentiator = parameters.law, parameters.differentiator
    assert law is not None and differentiator is not None
    model, limits = parameters.model, parameters.limits
    arrays = [model.b0, model.damping, model.stiffness, limits.lower, limits.upper, limits.rate]
    arrays += [differentiator.acceleration, law.omega_c]
    arrays += [] if law.kp is None or law.kd is None else [law.kp, law.kd]
    return [np.asarray(array, dtype=float) for array in arrays]


def _structure(parameters: ControllerParameters, with_rate: bool) -> tuple[Any, ...]:
    """Parameters that the function is made for."""
    law, differentiator, fuzzy = parameters.law, parameters.differentiator, parameters.fuzzy
    assert law is not None and differentiator is not None
    return (
        with_rate,
        parameters.angular.tobytes(),
        differentiator.filter_time,
        parameters.kalman is None,
        parameters.kalman is not None and parameters.kalman.rate_variance is None,
        None if fuzzy is None else fuzzy.rules,
        parameters.prediction is None,
        law.acceleration_feedforward,
        *(array.shape for array in _parameter_arrays(parameters)),
    )


def _next_state(
    state: ControllerState,
    elapsed: Array,
    spreads: tuple[Spread, ...],
    queue: actuator.ActuatorState,
    rows: list[Array],
) -> ControllerState:
    """The state after the step; `rows` are those of `_results`."""
    filtered = state.kalman
    if filtered is not None:
        filtered = KalmanState(rows[7], rows[8], rows[9], spreads)
    return ControllerState(
        TrackingDifferentiatorState(rows[0], rows[1], rows[2]),
        observer.ObserverState(rows[3], rows[4], rows[5], elapsed),
        queue,
        state.pid,
        filtered,
    )


def _output(rows: list[Array]) -> ControllerOutput:
    command, omega_c, saturated = rows[-3:]
    return ControllerOutput(
        command, rows[0], rows[1], rows[3], rows[4], rows[5], omega_c, saturated.astype(bool)
    )


def _results(state: ControllerState, output: ControllerOutput) -> list[Any]:
    """What the function returns: state, command, omega_c and whether the command was limited."""
    return [*_changing_arrays(state), output.command, output.omega_c, output.saturated]


def _traced(parameters: ControllerParameters, with_rate: bool) -> Function:
    """Run the arithmetic with symbols in place of all numbers that differ from step to step."""
    channels = len(parameters.angular)
    zero, fresh = np.zeros(channels), np.ones(channels, dtype=bool)
    state = initial_state(parameters, zero, zero)
    inputs = ControllerInput(zero, zero, fresh, zero if with_rate else None)
    found = coefficients(parameters, state, inputs, _ANY_STEP)
    tape, names = Tape(), count()
    arguments: dict[str, Traced] = {}

    def symbols(arrays: Sequence[Array]) -> list[Any]:
        for array in arrays:
            name = f"a{next(names)}"
            arguments[name] = tape.inputs(f"{name}_", array.shape)
        return list(arguments.values())[-len(arrays) :]

    state = _with_state_arrays(state, symbols(_state_arrays(state)))
    inputs = ControllerInput(*symbols(_input_arrays(inputs)))
    means = symbols([zero, zero])
    gains = None if found.kalman is None else KalmanGains(*symbols(found.kalman))
    parts = found, symbols(_coefficient_arrays(found))
    parameters = _with_parameter_arrays(parameters, symbols(_parameter_arrays(parameters)))
    found = _with_coefficient_arrays(*parts, parameters.model)._replace(kalman=gains)
    advanced, output = advance(parameters, found, state, inputs, means)
    return compiled(tape, arguments, _results(advanced, output))


def _with_state_arrays(state: ControllerState, arrays: list[Any]) -> ControllerState:
    """A state with other `_state_arrays`."""
    lagged, previous, filtered = arrays[6], arrays[-1], state.kalman
    if filtered is not None:
        filtered = structs.replace(filtered, estimate=arrays[7], rate=arrays[8], disturbance=arrays[9])
    return structs.replace(
        state,
        differentiator=TrackingDifferentiatorState(*arrays[:3]),
        observer=observer.ObserverState(arrays[3], arrays[4], arrays[5], state.observer.elapsed),
        actuator=actuator.ActuatorState((np.inf,), previous[None], lagged),
        kalman=filtered,
    )


def _with_coefficient_arrays(
    found: Coefficients, arrays: list[Any], model: observer.PlantModel
) -> Coefficients:
    """Coefficients with other `_coefficient_arrays`, and those of `model`."""
    given = iter(arrays)

    def plant() -> observer.Discrete:
        return observer.Discrete(next(given), next(given), next(given), model.b0, model.stiffness)

    dt = next(given)
    window = found.window._replace(held=next(given), decay=next(given))
    discrete, ahead = plant(), found.ahead
    if ahead is not None:
        ahead = Lookahead(ahead.window._replace(held=next(given)), plant())
    return found._replace(
        dt=dt,
        window=window,
        discrete=discrete,
        ahead=ahead,
        correction=(next(given), next(given), next(given)),
        scales=None if found.scales is None else (next(given), next(given)),
    )


def _with_parameter_arrays(parameters: ControllerParameters, arrays: list[Any]) -> ControllerParameters:
    """Parameters with other `_parameter_arrays`."""
    law, differentiator = parameters.law, parameters.differentiator
    assert law is not None and differentiator is not None
    kp, kd = arrays[8:] or (law.kp, law.kd)
    return replace(
        parameters,
        model=observer.PlantModel(*arrays[:3]),
        limits=Limits(*arrays[3:6]),
        differentiator=replace(differentiator, acceleration=arrays[6]),
        law=replace(law, omega_c=arrays[7], kp=kp, kd=kd),
    )
