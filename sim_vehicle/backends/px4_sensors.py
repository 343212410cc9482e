"""What PX4's simulated magnetometer, barometer, satellite receiver and range finder measure on earth.

The inertial unit is in `sensors`. Every draw comes from a seeded generator and every value has noise, because
PX4 declares a sensor dead whose value repeats 100 times (lib/validation/DataValidator).
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sim_vehicle.airframe import AirframeState
from sim_vehicle.frames import Array, body_to_frd, rotation_matrix, vector_from_ned, vector_to_ned

EARTH_RADIUS = 6_371_000.0
"""m; the sphere of PX4's own map projection (lib/geo)."""


RANGE_FINDER_CLEARANCE_M = 0.2
"""Height of the range finder while the vehicle stands."""

RANGE_M = (0.1, 40.0)
"""Between what distances a range finder measures; a small laser's."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where the origin of the world is: by default in Zurich, with its magnetic field of WMM-2020 in 2024.

    latitude, longitude : rad
    altitude : m above mean sea level
    declination, inclination : rad; of the earth's magnetic field, east and down positive
    magnetic_field : gauss
    """

    latitude: float = math.radians(47.397742)
    longitude: float = math.radians(8.545594)
    altitude: float = 488.0
    declination: float = math.radians(3.4)
    inclination: float = math.radians(63.2)
    magnetic_field: float = 0.4824

    def field_ned(self) -> Array:
        """Magnetic field (3,) [gauss], north-east-down."""
        flat = self.magnetic_field * math.cos(self.inclination)
        down = self.magnetic_field * math.sin(self.inclination)
        return np.array([flat * math.cos(self.declination), flat * math.sin(self.declination), down])

    def geodetic(self, position: Array) -> tuple[float, float, float]:
        """Latitude [rad], longitude [rad], altitude [m] of a position (3,) [m] in the world."""
        north, east, down = vector_to_ned(position).tolist()
        longitude = self.longitude + east / (EARTH_RADIUS * math.cos(self.latitude))
        return self.latitude + north / EARTH_RADIUS, longitude, self.altitude - down


@dataclass(frozen=True, slots=True)
class Px4SensorNoise:
    """Standard deviations of white noise on each sample, and how late a satellite fix is."""

    magnetometer: float = 0.002  # gauss
    pressure: float = 1.0  # Pa, 0.08 m of height
    temperature: float = 0.02  # K
    fix_horizontal: float = 0.1  # m
    fix_vertical: float = 0.1  # m
    fix_velocity: float = 0.05  # m/s
    fix_delay_us: int = 100_000  # EKF2_GPS_DELAY tells PX4
    distance: float = 0.02  # m


class Air(NamedTuple):
    """A barometer's sample: pressure [Pa], temperature [degrees Celsius], pressure altitude [m]."""

    pressure: float
    temperature: float
    pressure_altitude: float


class Fix(NamedTuple):
    """A satellite fix: latitude [rad], longitude [rad], altitude [m], velocity (3,) [m/s] north-east-down."""

    latitude: float
    longitude: float
    altitude: float
    velocity_ned: Array


TROPOPAUSE_M = 11_000.0
"""Altitude to which the standard atmosphere's lapse rate holds."""


def standard_pressure(altitude: float) -> float:
    """Pressure [Pa] of the International Standard Atmosphere at an altitude [m]; that of 11 km above them."""
    return float(101_325.0 * (1.0 - 0.0065 * min(altitude, TROPOPAUSE_M) / 288.15) ** 5.25588)


def pressure_altitude(pressure: float) -> float:
    """Altitude [m] at which the standard atmosphere has `pressure` [Pa]."""
    return float(288.15 / 0.0065 * (1.0 - (pressure / 101_325.0) ** (1.0 / 5.25588)))


def magnetometer(place: Place, noise: Px4SensorNoise, euler: Array, generator: np.random.Generator) -> Array:
    """Field (3,) [gauss] in the sensor's forward-right-down axes, for roll, pitch, yaw (3,) [rad]."""
    field = rotation_matrix(euler).T @ vector_from_ned(place.field_ned())
    return body_to_frd(field) + noise.magnetometer * generator.standard_normal(3)


def barometer(place: Place, noise: Px4SensorNoise, position: Array, generator: np.random.Generator) -> Air:
    """Air at a position (3,) [m]: the standard atmosphere, without weather or the rotors' wash."""
    altitude = place.geodetic(position)[2]
    first, second = generator.standard_normal(2).tolist()
    pressure = standard_pressure(altitude) + noise.pressure * first
    return Air(pressure, 15.0 - 0.0065 * altitude + noise.temperature * second, pressure_altitude(pressure))


def range_finder(noise: Px4SensorNoise, state: AirframeState, generator: np.random.Generator) -> float | None:
    """Distance [m] along the vehicle's own down axis to flat ground, looking past the load.

    None where it measures nothing: beyond `RANGE_M`, or tilted so far that it looks beside the ground.
    """
    roll, pitch = state.euler[:2].tolist()
    upright = math.cos(roll) * math.cos(pitch)
    height = float(state.position[2]) + RANGE_FINDER_CLEARANCE_M
    distance = math.inf if upright <= 0.0 else height / upright
    distance += noise.distance * float(generator.standard_normal())
    return distance if RANGE_M[0] <= distance <= RANGE_M[1] else None


class SatelliteReceiver:
    """Fixes of the true state, late."""

    def __init__(self, place: Place, noise: Px4SensorNoise, generator: np.random.Generator) -> None:
        self._place = place
        self._noise = noise
        self._generator = generator
        self._waiting: deque[tuple[int, Fix]] = deque()

    def sample(self, time_us: int, state: AirframeState) -> None:
        """Take a fix; it comes out `fix_delay_us` later."""
        n, draw = self._noise, self._generator.standard_normal(6)
        sigma = np.array([n.fix_horizontal, n.fix_horizontal, n.fix_vertical])
        where = self._place.geodetic(state.position + sigma * draw[:3])
        velocity = vector_to_ned(state.velocity + n.fix_velocity * draw[3:])
        self._waiting.append((time_us + n.fix_delay_us, Fix(*where, velocity)))

    def take(self, time_us: int) -> Fix | None:
        """The fix that is due by `time_us`, if there is one."""
        if self._waiting and self._waiting[0][0] <= time_us:
            return self._waiting.popleft()[1]
        return None
