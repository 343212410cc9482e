"""The load: where it hangs, what it does to mass, centre, inertia and arm, and when it comes and goes.

Sources: eq 13 (common centre of mass), last line of eq 15 (longer arm), Table 1 (largest load).
The parallel-axis inertia is not in the paper, which leaves Table 1's moments as they are.
Body axes: x forward, y left, z up, from the airframe's centre, so a hanging load has z < 0.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Literal, TypeAlias

import numpy as np

from sim_vehicle.dynamics import MassProperties
from sim_vehicle.frames import Array, Row, array_of

Profile: TypeAlias = Literal["paper", "airframe"]
Vector3: TypeAlias = tuple[float, float, float]

LOAD_LIMIT = 6.73
"""Largest load m_max [kg], Table 1."""

DEFAULT_OFFSET: Vector3 = (0.0, 0.0, -0.3)
"""Where the load is held [m]: rigidly, 0.3 m below the airframe's centre."""


@dataclass(frozen=True, slots=True)
class VehicleBody:
    """The vehicle without load: mass [kg], moments about its own centre (3) [kg m^2], arm l0 [m]."""

    mass: float
    inertia: Vector3
    arm_length: float


def check_load_mass(mass: Row) -> None:
    """Raise ValueError unless every load mass [kg] (float or (N,)) is within 0..`LOAD_LIMIT`."""
    heaviest = mass if isinstance(mass, float | int) else float(np.max(mass))
    lightest = mass if isinstance(mass, float | int) else float(np.min(mass))
    if not (math.isfinite(heaviest) and math.isfinite(lightest)):
        raise ValueError(f"load of {heaviest} kg is not a number; give a mass of 0 to {LOAD_LIMIT} kg")
    if heaviest > LOAD_LIMIT:
        raise ValueError(
            f"load of {heaviest:.10g} kg is above the limit of {LOAD_LIMIT} kg; choose a lighter load"
        )
    if lightest < 0.0:
        raise ValueError(f"load of {lightest:.10g} kg is below zero; give a mass of 0 to {LOAD_LIMIT} kg")


def mass_properties(
    vehicle: VehicleBody,
    load_mass: Row,
    load_offset: Vector3 = DEFAULT_OFFSET,
    load_size: Vector3 = (0.0, 0.0, 0.0),
    profile: Profile = "airframe",
) -> MassProperties:
    """Vehicle and load as one body.

    Parameters
    ----------
    vehicle : the vehicle without load
    load_mass : float or (N,) kg
    load_offset : (3,) m; the load's centre in body axes from the airframe's centre
    load_size : (3,) m; edges of a box, zeros for a point mass
    profile : both have the mass M + m and the centre of mass of eq 13. "airframe": inertia of both
        bodies about the common centre (parallel axes), and the arm l0, because the lever of a
        thrust along body z is its horizontal distance, whatever the height of the centre of mass.
        "paper": inertia as in Table 1 and the arm sqrt(l0^2 + z_a^2) of eq 15, as published.

    Raises
    ------
    ValueError
        if a load is negative, not finite or above `LOAD_LIMIT`
    """
    if isinstance(load_mass, float):
        return _one_body(vehicle, load_mass, load_offset, load_size, profile)
    return _joint_body(vehicle, load_mass, load_offset, load_size, profile)


def _joint_body(
    vehicle: VehicleBody, load_mass: Row, load_offset: Vector3, load_size: Vector3, profile: Profile
) -> MassProperties:
    check_load_mass(load_mass)
    mass = vehicle.mass + load_mass
    share = load_mass / mass
    x, y, z = load_offset
    center = array_of((share * x, share * y, share * z))
    if profile == "paper":
        arm = (vehicle.arm_length**2 + (share * z) ** 2) ** 0.5
        return MassProperties(mass, np.array(vehicle.inertia), arm, center)
    reduced = vehicle.mass * share  # M m / (M + m): both parallel-axis terms in one
    inertia = _joint_inertia(vehicle.inertia, reduced, load_mass, load_offset, load_size)
    products = array_of((-reduced * x * y, -reduced * x * z, -reduced * y * z))
    return MassProperties(mass, inertia, vehicle.arm_length, center, products)


@lru_cache(maxsize=64)
def _one_body(
    vehicle: VehicleBody, load_mass: float, load_offset: Vector3, load_size: Vector3, profile: Profile
) -> MassProperties:
    """The same for one vehicle: its load changes a few times in a flight, not in every step."""
    properties = _joint_body(vehicle, load_mass, load_offset, load_size, profile)
    for shared in (properties.inertia, properties.center_of_mass, properties.products_of_inertia):
        shared.flags.writeable = False
    return properties


def _joint_inertia(inertia: Vector3, reduced: Row, load_mass: Row, offset: Vector3, size: Vector3) -> Array:
    """Moments (3[, N]) of the vehicle, of the offset (reduced mass) and of the load's own box."""
    (ix, iy, iz), (x, y, z), (ex, ey, ez) = inertia, offset, size
    box = load_mass / 12.0
    return array_of(
        (
            ix + reduced * (y * y + z * z) + box * (ey * ey + ez * ez),
            iy + reduced * (x * x + z * z) + box * (ex * ex + ez * ez),
            iz + reduced * (x * x + y * y) + box * (ex * ex + ey * ey),
        )
    )


@dataclass(frozen=True, slots=True)
class PayloadSchedule:
    """Load mass against time: `changes` are (time_s, mass_kg), each valid until the next.

    Before the first change there is no load. Raises ValueError if times are not finite and
    strictly rising or a mass is refused by `check_load_mass`.
    """

    changes: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        for time_s, mass_kg in self.changes:
            check_load_mass(mass_kg)
            if not math.isfinite(time_s):
                raise ValueError(f"load change at {time_s} s is not a time; give seconds")
        for (earlier, _), (later, _) in pairwise(self.changes):
            if later <= earlier:
                raise ValueError(
                    f"load change at {later:.10g} s comes after the one at {earlier:.10g} s; "
                    "list the changes in order of time"
                )

    @property
    def times(self) -> tuple[float, ...]:
        """Times of the changes [s], rising."""
        return tuple(time_s for time_s, _ in self.changes)

    def mass_at(self, time_s: float) -> float:
        """Load mass [kg] at `time_s`; a change counts from its own instant on."""
        index = bisect_right(self.times, time_s)
        return self.changes[index - 1][1] if index else 0.0
