"""How far the numbers of a controller may go at once in flight: in steps one sees where they lead.

Measured with the simulated vehicles, one PARAM_SET from the demonstration's numbers:

- with 2.5 times the right natural frequency the vehicle tilts by 0.7 rad (the law needs its model);
- a position ring with three times the bandwidth swings by 0.2 rad without end, and so it does with an
  observer of 1000 rad/s or four times the lag (`admission` judges the bandwidths of the other channels);
- with output = "attitude" a quarter of omega_c, or 2.7 times as much, swings up to 0.46 and 0.36 rad beside
  a natural frequency that is 1.5 times too high or too low;
- with three times omega_c the height swings by 0.7 m beside a delay that is told a third too short, roll by
  rates by 0.38 rad beside an observer as quick as the telemetry bears;
- a Kalman filter that trusts nothing but noise, or that takes a load for impossible, swings in height by 0.1
  to 0.9 m;
- a cascade of PIDs with four times the gain on roll swings by 0.4 rad, without that on the climb rate by 2 m.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from kffa_offboard.control import Array, BoolArray
from kffa_offboard.control.controllers import CHANNELS, YAW, ControllerParameters
from kffa_offboard.offboard.settings import PositionSettings, ServiceSettings

PLANT_STEP, PLANT_STEP_DAMPING_PER_S, PLANT_STEP_S = 1.5, 1.0, 0.02
"""What a number of the plant may change by at once: times; 1/s of damping, s of delay or lag."""

BANDWIDTH_STEP = 2.0
"""Upwards of omega_c, and of omega_o of the position ring; they may fall at once.

Both ways of omega_c that works against the stiffness of the autopilot's own attitude loop: slower is no
calmer there. Yaw by rates may go anywhere: it turns about an axis along which nobody tilts.
"""

NOISE_STEP, DISTURBANCE_STEP = 3.0, 10.0
"""Of the Kalman filter's standard deviations, and of its disturbance intensity, which is a variance."""

GAIN_STEP, LEAST_GAIN_STEP = 2.0, 0.2
"""Of a PID's gain in 1/s; others by the power that they have of it."""


class Numbers(NamedTuple):
    """One number of all channels, and how far it may go at once.

    Attributes
    ----------
    name : as people are told
    values : (channels,)
    step : times
    least : this much may be added in any case
    falls : it may fall as far as it likes, (channels,) or all
    said : the step that is named, of the parameter from which the number follows
    """

    name: str
    values: Array
    step: float | Array
    least: float = 0.0
    falls: bool | BoolArray = False
    said: float = PLANT_STEP


def too_far(before: ServiceSettings, after: ServiceSettings, original: ServiceSettings) -> str | None:
    """Why numbers must not go from `before` to `after` at once in flight; to those of `original` they may."""
    flown = (before, after, original)
    found = _too_far(CHANNELS, *(list(_of_channels(each.controller)) for each in flown))
    rings = [list(_of_ring(each.position)) for each in flown if each.position is not None]
    return found or (_too_far(("position", "position"), *rings) if rings else None)


def _too_far(
    channels: tuple[str, ...], before: list[Numbers], after: list[Numbers], original: list[Numbers]
) -> str | None:
    for old, new, first in zip(before, after, original, strict=True):
        a, b = old.values, new.values
        large, small = np.where(old.falls, b, np.maximum(a, b)), np.where(old.falls, a, np.minimum(a, b))
        far = large > np.maximum(old.step * small, small + old.least) * (1.0 + 1e-9)
        for k in np.flatnonzero(far & (b != first.values)):
            change = f"{channels[k]}: {old.name} from {a[k]:.3g} to {b[k]:.3g}"
            return f"{change}; go in steps of {old.said:g} times at most"
    return None


def _of_channels(controller: ControllerParameters) -> Iterator[Numbers]:
    yield from _of_controller(controller)
    if controller.law is not None:
        stiff = controller.model.stiffness > 0.0
        step = np.full(len(CHANNELS), BANDWIDTH_STEP)
        step[YAW] = BANDWIDTH_STEP if stiff[YAW] else np.inf
        yield Numbers("omega_c", controller.law.omega_c, step, falls=~stiff, said=BANDWIDTH_STEP)


def _of_ring(position: PositionSettings) -> Iterator[Numbers]:
    controller = position.ring.controller
    yield from _of_controller(controller)
    if controller.law is not None and controller.observer is not None:
        bandwidths = {"omega_c": controller.law.omega_c, "omega_o": controller.observer.fastest}
        for name, values in bandwidths.items():
            yield Numbers(name, values, BANDWIDTH_STEP, falls=True, said=BANDWIDTH_STEP)


def _of_controller(parameters: ControllerParameters) -> Iterator[Numbers]:
    model, acting = parameters.model, parameters.actuator
    # A natural frequency is squared in b0 (`control.design`).
    yield Numbers("b0", model.b0, np.where(model.stiffness > 0.0, PLANT_STEP**2, PLANT_STEP))
    yield Numbers("damping", model.damping, PLANT_STEP, PLANT_STEP_DAMPING_PER_S)
    yield Numbers("delay", acting.delay, PLANT_STEP, PLANT_STEP_S)
    yield Numbers("lag", acting.lag, PLANT_STEP, PLANT_STEP_S)
    yield from _of_filter(parameters)
    yield from _of_pid(parameters)


def _of_filter(parameters: ControllerParameters) -> Iterator[Numbers]:
    filtering = parameters.kalman
    if filtering is None:
        return
    yield Numbers("noise", np.sqrt(filtering.measurement_variance), NOISE_STEP, said=NOISE_STEP)
    if filtering.rate_variance is not None:
        yield Numbers("rate noise", np.sqrt(filtering.rate_variance), NOISE_STEP, said=NOISE_STEP)
    intensity = filtering.disturbance_intensity
    yield Numbers("disturbance_intensity", intensity, DISTURBANCE_STEP, said=DISTURBANCE_STEP)


def _of_pid(parameters: ControllerParameters) -> Iterator[Numbers]:
    pid = parameters.pid
    if pid is None:
        return
    power = np.where(pid.cascade | pid.rate_command | pid.pass_reference, 1, 2)
    for name, values, exponent in (("p", pid.kp, power), ("i", pid.ki, power + 1), ("d", pid.kd, 1)):
        step = GAIN_STEP**exponent
        yield Numbers(f"PID {name}", values, step, LEAST_GAIN_STEP, said=float(np.min(step)))
