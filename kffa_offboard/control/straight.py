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
from typing import Any, TypeAlias

import numpy as np
from msgspec import Struct, structs

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
from kffa_offboard.control.kalman import KalmanGains
from kffa_offboard.control.plain import (
    DISTURBANCE,
    ESTIMATE,
    LAGGED,
    RATE,
    PlainInput,
    PlainOutput,
    PlainState,
    Vector,
    array_state,
    sent,
)
from kffa_offboard.control.tracing import Tape, Traced, compiled
from kffa_offboard.control.tracking_differentiator import TrackingDifferentiatorState

Function: TypeAlias = Callable[..., tuple[float, ...]]

LAWS = 32
"""Sets of parameters whose functions are kept."""

REMEMBERED = 256
"""Coefficients that are kept for each of them; beyond it the oldest ones are forgotten."""


_ANY_STEP = 0.01  # s; the function is the same for all


class Found(Struct, frozen=True, gc=False):
    """Coefficients without the Kalman filter's, as `Law.function` takes them.

    Attributes
    ----------
    elapsed : of the state after the step
    numbers : flat, in the order of `_coefficient_arrays` and `_parameter_arrays`
    windows : delay and span, s, of the windows (`actuator.Window`) of each channel: what acted, what will act
    """

    elapsed: Vector
    numbers: Vector
    windows: list[tuple[float, float]]


class FoundGains(Struct, frozen=True, gc=False):
    """The Kalman filter's gains as `Law.function` takes them, and its spreads after the step."""

    numbers: Vector
    spreads: tuple[Spread, ...]


class Shares(Struct, frozen=True, gc=False):
    """How commands under way act in a step.

    Attributes
    ----------
    means : channel, and place and share of each command that acts: for all in what acted, then in what will
    over : how many act no more
    ages : of the others, s
    """

    means: list[tuple[int, list[tuple[int, float]]]]
    over: int
    ages: tuple[float, ...]


_NO_GAINS = FoundGains((), ())


_functions: dict[tuple[Any, ...], Function] = {}


class Law:
    """The step with one set of parameters, and what it has looked up.

    Attributes
    ----------
    function : of the numbers of the state, the last command, reference, measurement, what is fresh, the
        measured rate (none: empty), means, gains of the Kalman filter (none: empty), and `Found.numbers`
    """

    def __init__(self, parameters: ControllerParameters, with_rate: bool) -> None:
        structure = _structure(parameters, with_rate)
        if structure not in _functions:
            _keep(_functions, structure, _traced(parameters, with_rate))
        self.function = _functions[structure]
        self._parameters = parameters
        self._numbers = _flat(_parameter_arrays(parameters))
        self._found: dict[tuple[object, ...], Found] = {}
        self._gains: dict[tuple[object, ...], FoundGains] = {}
        self._shares: dict[tuple[object, ...], Shares] = {}

    def find(self, state: PlainState, inputs: PlainInput, dt: float) -> Found:
        """Look up the coefficients of a step, or work them out."""
        key = (dt, inputs.fresh, state.elapsed)
        known = self._found.get(key)
        if known is None:
            found = discretised(self._parameters, array_state(state), inputs.arrays(), dt)
            numbers = _flat(_coefficient_arrays(found)) + self._numbers
            known = Found(tuple(found.elapsed.tolist()), numbers, _windows(found))
            _keep(self._found, key, known)
        return known

    def find_gains(self, state: PlainState, inputs: PlainInput, dt: float) -> FoundGains:
        """Look up the Kalman filter's gains, or work them out: odd times make them many."""
        if self._parameters.kalman is None:
            return _NO_GAINS
        key = (dt, inputs.fresh, state.spreads)
        known = self._gains.get(key)
        if known is None:
            filtered = array_state(state).kalman
            assert filtered is not None
            gains, spreads = filter_gains(
                self._parameters, self._parameters.kalman, filtered, inputs.arrays(), dt
            )
            known = FoundGains(_flat(gains), spreads)
            _keep(self._gains, key, known)
        return known

    def shares(self, state: PlainState, found: Found, dt: float) -> Shares:
        """Look up how the commands under way act, or work it out."""
        key = (dt, state.ages)
        known = self._shares.get(key)
        if known is None:
            ages = actuator.aged(state.ages, dt)
            over = actuator.count_over(self._parameters.actuator, ages)
            acting = {seen: actuator.shares_of_one(ages, *seen) for seen in set(found.windows)}
            means = [(number % len(found.elapsed), acting[seen]) for number, seen in enumerate(found.windows)]
            known = Shares(means, over, actuator.kept(ages, over))
            _keep(self._shares, key, known)
        return known


def _flat(arrays: Iterable[Array]) -> Vector:
    return tuple(number for array in arrays for number in array.reshape(-1).tolist())


def _windows(found: Coefficients) -> list[tuple[float, float]]:
    acted = found.window
    seen = [acted, acted if found.ahead is None else found.ahead.window]
    delay, span = (
        np.concatenate([np.broadcast_to(one, acted.held.shape) for one in ones]).tolist()
        for ones in ([window.delay for window in seen], [window.span for window in seen])
    )
    return list(zip(delay, span, strict=True))


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


def is_straight(parameters: ControllerParameters, state: ControllerState | PlainState, dt: float) -> bool:
    """Is this step made by a function of floats?"""
    if not isinstance(state, PlainState) and (
        state.expected is not None or state.observer.estimate.ndim != 1 or not can_be_straight(parameters)
    ):
        return False
    assert parameters.differentiator is not None
    return 2.0 * dt <= parameters.differentiator.filter_time


def step(
    parameters: ControllerParameters, state: PlainState, inputs: PlainInput, dt: float
) -> tuple[PlainState, PlainOutput]:
    """`controllers.step`, for what `is_straight`."""
    rate = inputs.measured_rate
    known = law(parameters, rate is not None)
    found, gains = known.find(state, inputs, dt), known.find_gains(state, inputs, dt)
    shares, commands, size = known.shares(state, found, dt), state.commands, len(found.elapsed)
    means = []
    for channel, acting in shares.means:
        mean = 0.0
        for place, share in acting:
            mean += share * commands[place][channel]
        means.append(mean)
    numbers = known.function(
        state.numbers,
        commands[-1],
        inputs.reference,
        inputs.measurement,
        inputs.fresh,
        () if rate is None else rate,
        means,
        gains.numbers,
        found.numbers,
    )
    end = len(state.numbers)
    command = numbers[end : end + size]
    under_way = sent(shares.ages, commands[shares.over :], command)
    after = PlainState(numbers[:end], *under_way, found.elapsed, gains.spreads, state.pid)
    return after, PlainOutput(
        command,
        numbers[:size],
        numbers[size : 2 * size],
        numbers[ESTIMATE * size : RATE * size],
        numbers[RATE * size : DISTURBANCE * size],
        numbers[DISTURBANCE * size : LAGGED * size],
        numbers[end + size : end + 2 * size],
        numbers[end + 2 * size :],  # type: ignore[arg-type]  # truth values
    )


def _changing_arrays(state: ControllerState) -> list[Any]:
    """What the arithmetic changes of a state: the rows of `PlainState.numbers`."""
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
        None if law.rejection is None else law.rejection.tobytes(),
        *(array.shape for array in _parameter_arrays(parameters)),
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
    tape = Tape()
    arguments: dict[str, Traced] = {}

    def symbols(arrays: Sequence[Array]) -> list[Any]:
        """One argument, flat, for arrays like these; it may be empty."""
        name, sizes = f"a{len(arguments)}", [array.size for array in arrays]
        flat, ends = tape.inputs(f"{name}_", (sum(sizes),)), np.cumsum(sizes, dtype=int).tolist()
        arguments[name] = flat
        return [
            flat[end - array.size : end].reshape(array.shape) for array, end in zip(arrays, ends, strict=True)
        ]

    state = _with_state_arrays(state, symbols(_changing_arrays(state)), *symbols([zero]))
    given_inputs = [*symbols([zero]), *symbols([zero]), *symbols([zero])]
    inputs = ControllerInput(*given_inputs, *symbols([zero] if with_rate else []))
    means = symbols([zero, zero])
    kalman = symbols([] if found.kalman is None else found.kalman)
    gains = KalmanGains(*kalman) if kalman else None
    given, free = _coefficient_arrays(found), _parameter_arrays(parameters)
    numbers = symbols([*given, *free])
    changed = _with_parameter_arrays(parameters, numbers[len(given) :])
    found = _with_coefficient_arrays(found, numbers[: len(given)], changed.model)._replace(kalman=gains)
    advanced, output = advance(changed, found, state, inputs, means)
    return compiled(tape, arguments, _results(advanced, output))


def _with_state_arrays(state: ControllerState, arrays: list[Any], previous: Any) -> ControllerState:
    """A state with other `_changing_arrays` and another last command."""
    lagged, filtered = arrays[6], state.kalman
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
