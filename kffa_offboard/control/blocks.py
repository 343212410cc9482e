"""What the controllers are made of: their parameters, state, inputs and outputs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from msgspec import Struct

from kffa_offboard.control import Array, BoolArray, actuator, column, fuzzy, kalman, ladrc, observer, pid
from kffa_offboard.control import tracking_differentiator as td

CHANNELS = ("roll", "pitch", "yaw", "altitude")
_TURNS_PER_RADIAN = 0.5 / np.pi

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


class ExpectedStep(Struct, frozen=True, gc=False):
    """The disturbance will change by `step` ``(4[, N])``; it shows in the measurements `after` s from now."""

    step: Array
    after: float


class ControllerState(Struct, frozen=True, gc=False):
    """Everything that a controller remembers between steps; a value: copy it, compare it, save it."""

    differentiator: td.TrackingDifferentiatorState
    observer: observer.ObserverState
    actuator: actuator.ActuatorState
    pid: pid.PidState
    kalman: kalman.KalmanState | None = None
    expected: ExpectedStep | None = None


class ControllerInput(Struct, frozen=True, gc=False):
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


class ControllerOutput(Struct, frozen=True, gc=False):
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
    nearest: Array = angle - turn * np.rint((angle - near) * _TURNS_PER_RADIAN)
    return nearest


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
