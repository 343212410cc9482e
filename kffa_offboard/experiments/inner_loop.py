"""The daemon's control step for a batch of airframes: telemetry in, body rates and thrust out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kffa_offboard.control import Array, controllers
from kffa_offboard.control.rotation import Tilt, to_body_rates, to_euler_rates
from kffa_offboard.experiments.airframe import sines_and_cosines

_ALL_FRESH = np.ones((4, 1), dtype=bool)  # all flights of a batch are sampled together


@dataclass(frozen=True)
class Telemetry:
    """What the autopilot reports.

    Attitude and body rates ``(3, N)`` [rad, rad/s], height and climb rate ``(N,)`` [m, m/s].
    """

    attitude: Array
    body_rates: Array
    altitude: Array
    climb_rate: Array


@dataclass(frozen=True)
class Setpoint:
    """What goes out: body rates ``(3, N)`` [rad/s] and collective thrust ``(N,)`` of 0..1."""

    body_rates: Array
    thrust: Array


def step(
    parameters: controllers.ControllerParameters,
    state: controllers.ControllerState,
    reference: Array,
    told: Telemetry,
    tilt_compensation_max_rad: float,
    dt: float,
) -> tuple[controllers.ControllerState, controllers.ControllerOutput, Setpoint]:
    """One step with output "rates", `dt` s after the last one; `reference` is ``(4, N)`` in channel order."""
    (sin_roll, sin_pitch), (cos_roll, cos_pitch) = sines_and_cosines(told.attitude[:2])
    tilted = Tilt(sin_roll, cos_roll, sin_pitch, cos_pitch)
    euler_rates = to_euler_rates(tilted, told.body_rates)
    state, output = controllers.step(
        parameters,
        state,
        controllers.ControllerInput(
            reference,
            np.concatenate([told.attitude, told.altitude[None]]),
            _ALL_FRESH,
            np.concatenate([euler_rates, told.climb_rate[None]]),
        ),
        dt,
    )
    level = np.maximum(cos_roll * cos_pitch, np.cos(tilt_compensation_max_rad))
    rates = to_body_rates(tilted, output.command[:3])
    return state, output, Setpoint(rates, output.command[3] / level)
