"""Mass of the payload from thrust and climb rate, and the moments when it changes.

No counterpart in the paper, which takes the load for a disturbance. Thrust that carries the empty vehicle at
`hover_thrust` gives it b0 u of acceleration; the loaded one gets the share `ratio` of that:

    dv/dt = ratio b0 u cos(roll) cos(pitch) - g,    ratio = empty mass / total mass

which is linear in the ratio, so a Kalman filter with the states climb rate v and ratio (a slow random
walk: gusts, battery) estimates it. It is the altitude channel's disturbance, s3 = -g - (1 - ratio) b0 u,
read for the mass: unlike s3 the ratio does not change when the thrust does, so it can be averaged for
longer. u is the collective thrust as the motors gave it, delayed and lagged (`actuator`).

Two hypotheses, "the mass is what it was" and "it has changed", are told apart by a two-sided cumulative
sum of the normalised innovations (E. S. Page, "Continuous inspection schemes", Biometrika 41, 1954). An
alarm opens the covariance, so that the filter finds the new mass at once; only a change that is then
clearly there is reported.

Numbers are floats for one vehicle, arrays ``(N,)`` for a batch.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields
from functools import lru_cache
from math import exp, isinf
from operator import attrgetter
from typing import TypeAlias

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.control import Array, BoolArray, actuator
from kffa_offboard.control.tracing import Tape, compiled

GRAVITY = 9.80665

Numbers: TypeAlias = float | Array
"""One vehicle's, or a batch's ``(N,)``."""


@dataclass(frozen=True)
class DetectionParameters:
    """When a change of mass is one.

    Attributes
    ----------
    slack : standard deviations
        Innovation that counts for neither hypothesis; half the mean shift that a change is to be noticed by.
    alarm : standard deviations
        Cumulative sum that raises the alarm: exp(2 slack alarm) / (2 slack^2) samples, four weeks at 100 Hz,
        pass between two false ones; 5 kg on 10 kg reach it in four samples.
    opening : standard deviation of the ratio after an alarm; 5 kg on 10 kg change it by 0.33
    settle : s, from the alarm to the decision; in 0.1 s the slope of the climb rate gives the mass to 0.3 kg
    patience : s, after which an alarm without a change is forgotten
    memory : s, time constant of the load before a change; the 0.04 s until an alarm hardly blur it
    minimum : kg, least change that is reported; a gust of 0.4 kg g = 4 N is a strong one
    confidence : standard deviations by which the change must exceed zero
    """

    slack: float = 1.0
    alarm: float = 10.0
    opening: float = 0.3
    settle: float = 0.1
    patience: float = 0.5
    memory: float = 0.2
    minimum: float = 0.4
    confidence: float = 4.0


@dataclass(frozen=True, eq=False)
class PayloadParameters:
    """What is known of the vehicle.

    Attributes
    ----------
    vehicle_mass : kg, empty
    hover_thrust : normalised collective thrust that carries it
    actuator : delay and lag of thrust, each ``(1,)``
    rate_variance : (m/s)^2, of one measured climb rate
    hover_thrust_uncertainty : relative standard deviation of `hover_thrust`
    acceleration_intensity : (m/s^2)^2/s, growth of the variance of what else accelerates; gusts of 1 N on
        10 kg that last 2 s have 2 * 0.1^2 / 2
    timing_uncertainty : s, standard deviation of the actuator's delay and of a sample's age; times a change
        of the acceleration by thrust, or times the acceleration, it is the velocity that is uncertain then
    """

    vehicle_mass: float
    hover_thrust: float
    actuator: actuator.ActuatorParameters
    rate_variance: float
    hover_thrust_uncertainty: float = 0.01
    acceleration_intensity: float = 0.01
    timing_uncertainty: float = 0.005
    detection: DetectionParameters = field(default_factory=DetectionParameters)

    @property
    def b0(self) -> float:
        """Acceleration of the empty vehicle per unit of thrust, m/s^2."""
        return GRAVITY / self.hover_thrust


class PayloadState(Struct, frozen=True, gc=False):
    """Estimates, sums and commands under way.

    Attributes
    ----------
    thrust : commands under way; the arrays of a batch are ``(1, N)``
    acted : mean thrust of the last step
    rate, ratio : climb rate, m/s, and empty over total mass
    rate_variance, covariance, ratio_variance : of the two
    rising, falling : cumulative sums for more and for less mass
    settled : kg, load before the last alarm
    suspected : s since the alarm; infinite without one
    """

    thrust: actuator.ActuatorState | actuator.Line
    acted: Numbers
    rate: Numbers
    ratio: Numbers
    rate_variance: Numbers
    covariance: Numbers
    ratio_variance: Numbers
    rising: Numbers
    falling: Numbers
    settled: Numbers
    suspected: Numbers


class PayloadEstimate(Struct, frozen=True, gc=False):
    """What one step found.

    Attributes
    ----------
    mass, std : kg, of the load, and its standard deviation (noise, filter and `hover_thrust_uncertainty`)
    change : kg, change of load that has just been decided on; 0 in all other steps
    """

    mass: Numbers
    std: Numbers
    change: Numbers


def initial_state(thrust: Numbers, rate: Numbers) -> PayloadState:
    """Nothing is known of the load; `thrust` has been acting for ever; floats or ``(N,)``."""
    one = np.ndim(rate) == 0
    queue = actuator.initial_line(float(thrust)) if one else actuator.initial_state(np.asarray(thrust)[None])
    zero = np.zeros_like(rate)
    return reset(PayloadState(queue, thrust, *[zero] * 9), rate, 0.0, 0.5)


def reset(state: PayloadState, rate: Numbers, load_ratio: Numbers, std: Numbers) -> PayloadState:
    """Begin anew with a climb rate [m/s] and load / empty mass, and the standard deviation of the ratio."""
    zero = np.zeros_like(rate)
    begun = replace(
        state,
        rate=rate,
        ratio=1.0 / (1.0 + load_ratio) + zero,
        rate_variance=zero + 1.0,
        covariance=zero,
        ratio_variance=zero + std**2,
        rising=zero,
        falling=zero,
        settled=zero,
        suspected=zero + np.inf,
    )
    return _plain(begun)


def _plain(state: PayloadState) -> PayloadState:
    """The numbers of one vehicle as floats; a batch as it is."""
    if isinstance(state.thrust, actuator.ActuatorState):
        return state
    return PayloadState(state.thrust, *map(float, _numbers(state)))


def send(state: PayloadState, thrust: Numbers) -> PayloadState:
    """Collective `thrust` goes out at this moment."""
    if isinstance(state.thrust, actuator.Line):
        return replace(state, thrust=actuator.send_one(state.thrust, float(thrust)))
    return replace(state, thrust=actuator.send(state.thrust, np.asarray(thrust)[None]))


def load(parameters: PayloadParameters, state: PayloadState) -> tuple[Numbers, Numbers]:
    """Mass of the load and its standard deviation, kg."""
    total = parameters.vehicle_mass / state.ratio
    noise = total / state.ratio * np.sqrt(state.ratio_variance)
    uncertain = total * parameters.hover_thrust_uncertainty
    return total - parameters.vehicle_mass, np.sqrt(noise * noise + uncertain * uncertain)


def accept(parameters: PayloadParameters, state: PayloadState) -> PayloadState:
    """Take the present estimate for the settled load, without any suspicion."""
    zero = np.zeros_like(state.rate)
    settled = load(parameters, state)[0]
    return _plain(replace(state, settled=settled, rising=zero, falling=zero, suspected=zero + np.inf))


def advance(parameters: PayloadParameters, state: PayloadState, dt: float) -> PayloadState:
    """Move the commands under way by `dt` s; that is all while the vehicle does not fly freely."""
    if isinstance(state.thrust, actuator.Line):
        line, acted = actuator.step_one(parameters.actuator, state.thrust, dt)
        return replace(state, thrust=line, acted=acted)
    queue, together = actuator.step(parameters.actuator, state.thrust, dt)
    return replace(state, thrust=queue, acted=together[0])


def step(
    parameters: PayloadParameters,
    state: PayloadState,
    rate: Numbers,
    tilt_factor: Numbers,
    fresh: bool,
    dt: float,
) -> tuple[PayloadState, PayloadEstimate]:
    """One step of a vehicle that flies freely, `dt` s after the last one.

    Parameters
    ----------
    rate : measured climb rate, m/s; read if `fresh`
    tilt_factor : cos(roll) cos(pitch), as measured
    """
    if isinstance(state.thrust, actuator.Line):
        line, thrust = actuator.step_one(parameters.actuator, state.thrust, dt)
        if isinf(state.suspected):
            seen = thrust, float(rate), float(tilt_factor)
            return _straight_step(parameters, state, line, seen, fresh, dt)
        state = _filter(parameters, replace(state, thrust=line), thrust, rate, tilt_factor, fresh, dt)
    else:
        queue, (acted,) = actuator.step(parameters.actuator, state.thrust, dt)
        state = _filter(parameters, state, acted, rate, tilt_factor, fresh, dt)
        state = replace(state, thrust=queue)
    return _decide(parameters, state, rate, dt)


def _filter(
    parameters: PayloadParameters,
    state: PayloadState,
    acted: Numbers,
    rate: Numbers,
    tilt_factor: Numbers,
    fresh: bool,
    dt: float,
) -> PayloadState:
    state = _predict(parameters, state, acted, tilt_factor, dt)
    return _correct(parameters, state, rate, tilt_factor) if fresh else state


def _predict(
    parameters: PayloadParameters, state: PayloadState, acted: Numbers, tilt_factor: Numbers, dt: float
) -> PayloadState:
    """Kalman prediction with the transition [[1, gain], [0, 1]], the gain by the thrust that acted."""
    change = acted - state.acted
    gain = parameters.b0 * acted * tilt_factor * dt
    # A change of thrust is smeared over the lag: its steps err alike and add up.
    together = 1.0 + 2.0 * parameters.actuator.longest_lag / dt
    mistimed = parameters.b0 * change * parameters.timing_uncertainty
    drift = parameters.acceleration_intensity / GRAVITY**2 * dt
    covariance = state.covariance + gain * state.ratio_variance
    return replace(
        state,
        acted=acted,
        rate=state.rate + gain * state.ratio - GRAVITY * dt,
        rate_variance=state.rate_variance
        + gain * (state.covariance + covariance)
        + together * (mistimed * mistimed),
        covariance=covariance,
        ratio_variance=state.ratio_variance + drift,
    )


def _correct(
    parameters: PayloadParameters, state: PayloadState, rate: Numbers, tilt_factor: Numbers
) -> PayloadState:
    """Kalman correction, and the two cumulative sums of its innovation.

    A climb rate that changes is known as well as the time that it belongs to.
    """
    detection = parameters.detection
    acceleration = parameters.b0 * state.acted * tilt_factor * state.ratio - GRAVITY
    mistimed = acceleration * parameters.timing_uncertainty
    total = state.rate_variance + parameters.rate_variance + mistimed * mistimed
    innovation = rate - state.rate
    k_rate, k_ratio = state.rate_variance / total, state.covariance / total
    normal = innovation / np.sqrt(total)
    return replace(
        state,
        rate=state.rate + k_rate * innovation,
        ratio=np.minimum(np.maximum(state.ratio + k_ratio * innovation, 0.2), 3.0),
        rate_variance=(1.0 - k_rate) * state.rate_variance,
        covariance=(1.0 - k_rate) * state.covariance,
        ratio_variance=state.ratio_variance - k_ratio * state.covariance,
        rising=np.maximum(0.0, state.rising - normal - detection.slack),
        falling=np.maximum(0.0, state.falling + normal - detection.slack),
    )


def write_out(parameters: PayloadParameters) -> None:
    """Trace the step of one vehicle, which otherwise is done in the first ones."""
    for fresh in (False, True):
        _straight(parameters, fresh)


_NUMBERS = [field for field in PayloadState.__struct_fields__ if field != "thrust"]
_numbers = attrgetter(*_NUMBERS)  # of a state, beside the commands under way


def _straight_step(
    parameters: PayloadParameters,
    state: PayloadState,
    line: actuator.Line,
    seen: tuple[float, float, float],
    fresh: bool,
    dt: float,
) -> tuple[PayloadState, PayloadEstimate]:
    """The step of one vehicle of whose load nothing is suspected, in plain floats.

    `line` are the commands under way after it, `seen` the thrust that acted, climb rate and tilt factor.
    """
    detection = parameters.detection
    given = (*_numbers(state), *seen, dt, exp(-dt / detection.memory))
    *numbers, mass, std, followed = _straight(parameters, fresh)(given)
    after = PayloadState(line, *numbers)
    if max(after.rising, after.falling) > detection.alarm:
        return _decide(parameters, after, seen[1], dt)
    return replace(after, settled=followed), PayloadEstimate(mass, std, 0.0)


_Function: TypeAlias = Callable[..., tuple[float, ...]]
_functions: dict[tuple[float, ...], _Function] = {}


@lru_cache(maxsize=16)
def _straight(parameters: PayloadParameters, fresh: bool) -> _Function:
    """`_filter` and what is done while nothing is suspected, written out (`tracing`)."""
    numbers = [getattr(parameters, one.name) for one in fields(parameters)]
    numbers = [number for number in numbers if isinstance(number, float)]
    key = (fresh, parameters.actuator.longest_lag, parameters.detection.slack, *numbers)
    if key not in _functions:
        _functions[key] = _written_out(parameters, fresh)
    return _functions[key]


def _written_out(parameters: PayloadParameters, fresh: bool) -> _Function:
    tape = Tape()
    numbers = tape.inputs("x", (len(_NUMBERS) + 5,))
    state = PayloadState(actuator.initial_state(np.zeros(1)), *numbers[: len(_NUMBERS)])
    acted, rate, tilt_factor, dt, forgotten = numbers[len(_NUMBERS) :]
    state = _filter(parameters, state, acted, rate, tilt_factor, fresh, dt)
    mass, std = load(parameters, state)
    results = [*_numbers(state), mass, std, _followed(state, mass, forgotten)]
    return compiled(tape, {"numbers": numbers}, results)


def _followed(state: PayloadState, mass: Numbers, forgotten: Numbers) -> Numbers:
    """The settled load follows the estimate while nothing is suspected."""
    return state.settled + (1.0 - forgotten) * (mass - state.settled)


def _decide(
    parameters: PayloadParameters, state: PayloadState, measured: Numbers, dt: float
) -> tuple[PayloadState, PayloadEstimate]:
    """Alarm, then decision; while nothing is suspected the settled load follows the estimate."""
    detection = parameters.detection
    alarm = np.maximum(state.rising, state.falling) > detection.alarm
    suspected = state.suspected + dt
    if alarm.any():
        state = _alarmed(parameters, state, alarm, measured)
        suspected = np.where(alarm & np.isinf(suspected), 0.0, suspected)
    mass, std = load(parameters, state)
    change = mass - state.settled
    followed = _followed(state, mass, exp(-dt / detection.memory))
    calm = np.isinf(suspected)
    if calm.all():
        return _plain(replace(state, settled=followed)), PayloadEstimate(mass, std, np.zeros_like(change))
    noise = parameters.vehicle_mass / state.ratio**2 * np.sqrt(state.ratio_variance)
    clear = np.abs(change) > np.maximum(detection.minimum, detection.confidence * noise)
    decided = ~calm & (suspected >= detection.settle) & clear
    over: BoolArray = decided | (~calm & (suspected >= detection.patience))
    settled = np.where(decided, mass, np.where(calm, followed, state.settled))
    state = replace(state, settled=settled, suspected=np.where(over, np.inf, suspected))
    return _plain(state), PayloadEstimate(mass, std, np.where(decided, change, 0.0))


def _alarmed(
    parameters: PayloadParameters, state: PayloadState, alarm: BoolArray, measured: Numbers
) -> PayloadState:
    """Open the covariance where there is an alarm, so that the new mass is found at once."""
    return replace(
        state,  # The climb rate was dragged along by the wrong ratio: begin it anew, too.
        rate_variance=np.where(alarm, parameters.rate_variance, state.rate_variance),
        rate=np.where(alarm, measured, state.rate),
        covariance=np.where(alarm, 0.0, state.covariance),
        ratio_variance=np.where(alarm, parameters.detection.opening**2, state.ratio_variance),
        rising=np.where(alarm, 0.0, state.rising),
        falling=np.where(alarm, 0.0, state.falling),
    )
