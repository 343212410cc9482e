"""What real firmware is told about the plant: inertial sensors and the true pose, in MAVLink's axes.

Pure functions on one vehicle (no batch); noise comes from a generator handed in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim_vehicle.airframe import AirframeState
from sim_vehicle.frames import (
    Array,
    body_to_frd,
    quaternion_from_euler,
    quaternion_to_ned,
    rotation_rows_from_quaternion,
    vector_to_ned,
)


@dataclass(frozen=True, slots=True)
class ImuNoise:
    """Standard deviations of white noise on every sample: m/s^2 and rad/s."""

    specific_force: float = 0.0
    body_rate: float = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class ImuSample:
    """One sample in body axes forward-right-down.

    Attributes
    ----------
    specific_force : (3,) m/s^2; what accelerometers read: (0, 0, -g) at rest
    body_rates : (3,) rad/s; what gyroscopes read
    """

    specific_force: Array
    body_rates: Array


@dataclass(frozen=True, eq=False, slots=True)
class Pose:
    """True pose: north-east-down position (3,) [m] and velocity (3,) [m/s], quaternion (4,) FRD to NED."""

    position: Array
    velocity: Array
    quaternion: Array


def imu(before: AirframeState, after: AirframeState, dt: float, gravity: float) -> ImuSample:
    """Inertial sensors over one step of `dt` s that led from `before` to `after`.

    The sensors sit at the airframe's centre. Specific force is the change of velocity less gravity [m/s^2],
    so thrust, drag, gusts and the ground's push are all in it, averaged over the step; it is turned into
    body axes by the attitude in the middle of the step. Body rates are those at its end.
    """
    ax, ay, az = ((after.velocity - before.velocity) / dt).tolist()
    az += gravity
    r00, r01, r02, r10, r11, r12, r20, r21, r22 = rotation_rows_from_quaternion(_middle(before, after))
    force = (
        r00 * ax + r10 * ay + r20 * az,
        r01 * ax + r11 * ay + r21 * az,
        r02 * ax + r12 * ay + r22 * az,
    )
    return ImuSample(body_to_frd(np.array(force)), body_to_frd(after.body_rates))


def _middle(before: AirframeState, after: AirframeState) -> list[float]:
    """Unit quaternion half way between two near attitudes, w first."""
    old: list[float] = quaternion_from_euler(before.euler).tolist()
    new: list[float] = quaternion_from_euler(after.euler).tolist()
    sign = math.copysign(1.0, sum(a * b for a, b in zip(old, new, strict=True)))
    total = [a + sign * b for a, b in zip(old, new, strict=True)]
    size = math.hypot(*total)
    return [part / size for part in total]


def with_noise(sample: ImuSample, noise: ImuNoise, generator: np.random.Generator) -> ImuSample:
    """Sample with white noise. Draws six numbers from `generator`, none if there is no noise."""
    if noise.specific_force == 0.0 and noise.body_rate == 0.0:
        return sample
    draws = generator.standard_normal(6)
    return ImuSample(
        sample.specific_force + noise.specific_force * draws[:3],
        sample.body_rates + noise.body_rate * draws[3:],
    )


def pose(state: AirframeState) -> Pose:
    """Where the vehicle truly is; the origin of NED is the origin of the world."""
    return Pose(
        vector_to_ned(state.position),
        vector_to_ned(state.velocity),
        quaternion_to_ned(quaternion_from_euler(state.euler)),
    )
