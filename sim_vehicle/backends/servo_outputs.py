"""What a firmware's servo outputs mean to the plant: motor commands and the gripper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from sim_vehicle.frames import Array

GripperAction: TypeAlias = Literal["grab", "release"]

SETTLING_US = 500_000
"""A servo that has not moved for this long after power-up stands where the firmware parks it."""

END_OF_TRAVEL = 0.25
"""Share of a servo's travel at either end that counts as that end."""


@dataclass(frozen=True, slots=True)
class MotorOutputs:
    """Which outputs drive the front, left, rear and right motor, and their range [us]."""

    channels: tuple[int, int, int, int]
    pwm_min: int
    pwm_max: int


def motor_commands(outputs: MotorOutputs, pwm: Sequence[int]) -> Array:
    """Commands (4,), 0..1, of the front, left, rear and right motor; no pulses are no thrust.

    ArduCopter's plus quadrotor (AP_MotorsMatrix.cpp, FRAME_CLASS 1 and FRAME_TYPE 0) has its motors 1 to 4
    at the right, left, front and rear, where the front and rear propellers turn clockwise seen from above.
    Their reaction turns the nose to the left, as motors 1 and 3 of eq 14 do: only the order differs.
    """
    travel = outputs.pwm_max - outputs.pwm_min
    commands = [(pwm[channel - 1] - outputs.pwm_min) / travel for channel in outputs.channels]
    return np.array([min(1.0, max(0.0, command)) for command in commands])


@dataclass(frozen=True, slots=True)
class GripperServo:
    """Output of the gripper and its two ends [us]."""

    channel: int
    grab_pwm: int
    release_pwm: int


@dataclass(frozen=True, slots=True)
class GripperState:
    """Where the servo stands.

    Attributes
    ----------
    pwm : last pulse width [us]
    since_us : simulated time since when it stands there
    place : the end at which it is, "between" them, or None until it has settled after power-up
    """

    pwm: int = 0
    since_us: int = 0
    place: GripperAction | Literal["between"] | None = None


def follow_gripper(
    servo: GripperServo, state: GripperState, pwm: int, time_us: int
) -> tuple[GripperState, GripperAction | None]:
    """State with the present pulse width, and what the gripper does now.

    Where the firmware parks the servo at power-up is taken as it is; only a later move to an end acts.
    """
    if pwm != state.pwm:
        state = replace(state, pwm=pwm, since_us=time_us)
    if pwm == 0:
        return state, None
    place = _place(servo, pwm)
    if state.place is None:
        settled = time_us - state.since_us >= SETTLING_US
        return (replace(state, place=place) if settled else state), None
    if place == state.place:
        return state, None
    return replace(state, place=place), None if place == "between" else place


def _place(servo: GripperServo, pwm: int) -> GripperAction | Literal["between"]:
    share = (pwm - servo.release_pwm) / (servo.grab_pwm - servo.release_pwm)
    if share >= 1.0 - END_OF_TRAVEL:
        return "grab"
    return "release" if share <= END_OF_TRAVEL else "between"
