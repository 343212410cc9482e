"""What a flight meets: drawn from its number, so that it is the same whatever is flown beside it.

Each flight has two generators of its own, seeded with the campaign's seed and its number: one for its
conditions, one for noise and gusts. New conditions go at the end, so that old campaigns stay as they were.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.campaign.settings import CampaignFile
from kffa_offboard.control import Array

_DRAWN = 16  # numbers of each flight, some of them still unused
_CONDITIONS, _NOISE = 0, 1

_MEASURED, _GUSTS = 8, 3  # rows of random numbers
_STEPS_AT_ONCE, _FLIGHTS_AT_ONCE = 64, 64  # drawn into what a processor's second-level cache holds


@dataclass(frozen=True)
class Conditions:
    """Conditions of N flights; each ``(N,)``.

    Attributes
    ----------
    load_kg : mass of the load
    offset_x_m, offset_y_m : where it hangs, forward and left of the centre
    drop_after_s : after the pick-up
    wind_x_m_s, wind_y_m_s : mean wind, towards north and west
    gust_std_m_s : of each axis
    noise_factor : times the noise of the file
    link_delay_s : each way
    hover_thrust_error : true over configured hover thrust, less one
    motor_lag_s : time constant
    """

    load_kg: Array
    offset_x_m: Array
    offset_y_m: Array
    drop_after_s: Array
    wind_x_m_s: Array
    wind_y_m_s: Array
    gust_std_m_s: Array
    noise_factor: Array
    link_delay_s: Array
    hover_thrust_error: Array
    motor_lag_s: Array


def _generator(seed: int, number: int, purpose: int) -> np.random.Generator:
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence((seed, number, purpose))))


def draw(file: CampaignFile, numbers: NDArray[np.int64]) -> Conditions:
    """The conditions of the flights `numbers` ``(N,)``."""
    seed, ranges = file.campaign.seed, file.random
    shares = np.stack(
        [_generator(seed, int(number), _CONDITIONS).random(_DRAWN) for number in numbers], axis=-1
    )

    def within(row: int, ends: tuple[float, float]) -> Array:
        return np.asarray(ends[0] + (ends[1] - ends[0]) * shares[row])

    offset, wind = within(1, ranges.load_offset_m), within(4, ranges.wind_m_s)
    side, from_side = 2.0 * np.pi * shares[2], 2.0 * np.pi * shares[5]
    return Conditions(
        load_kg=within(0, ranges.load_kg),
        offset_x_m=offset * np.cos(side),
        offset_y_m=offset * np.sin(side),
        drop_after_s=within(3, ranges.drop_after_s),
        wind_x_m_s=wind * np.cos(from_side),
        wind_y_m_s=wind * np.sin(from_side),
        gust_std_m_s=within(6, ranges.gust_std_m_s),
        noise_factor=within(7, ranges.noise_factor),
        link_delay_s=within(8, ranges.link_delay_s),
        hover_thrust_error=within(9, ranges.hover_thrust_error),
        motor_lag_s=within(10, ranges.motor_lag_s),
    )


class Surroundings:
    """Noise and gusty wind of N flights, step by step."""

    def __init__(
        self, file: CampaignFile, conditions: Conditions, numbers: NDArray[np.int64], dt: float
    ) -> None:
        """Each flight's random numbers come from a generator of its own; `dt` is the control step [s]."""
        told = file.noise
        noise = np.repeat(
            [told.attitude_rad, told.body_rate_rad_s, told.altitude_m, told.climb_rate_m_s], [3, 3, 1, 1]
        )
        self._noise = noise[:, None] * conditions.noise_factor
        self._mean = np.stack([conditions.wind_x_m_s, conditions.wind_y_m_s, np.zeros(len(numbers))])
        self._keep = float(np.exp(-dt / file.vehicle.gust_time_constant_s))
        self._spread = float(np.sqrt(1.0 - self._keep**2)) * conditions.gust_std_m_s
        self._gust = np.zeros((_GUSTS, len(numbers)))
        self._normal = _Normal(file.campaign.seed, numbers)

    def step(self) -> tuple[Array, Array]:
        """Noise ``(8, N)`` of roll, pitch, yaw, body rates, height, climb rate; wind ``(3, N)`` [m/s]."""
        normal = self._normal.step()
        self._gust = self._keep * self._gust + self._spread * normal[_MEASURED:]
        return self._noise * normal[:_MEASURED], self._mean + self._gust


class _Normal:
    """Standard normal numbers, a row for each flight drawn well ahead."""

    def __init__(self, seed: int, numbers: NDArray[np.int64]) -> None:
        self._generators = [_generator(seed, int(number), _NOISE) for number in numbers]
        self._drawn = np.empty((_FLIGHTS_AT_ONCE, _STEPS_AT_ONCE * (_MEASURED + _GUSTS)))
        self._rows = np.empty((_STEPS_AT_ONCE, _MEASURED + _GUSTS, len(numbers)))
        self._next = _STEPS_AT_ONCE

    def step(self) -> Array:
        """The next rows ``(R, N)``; valid until they are drawn anew."""
        if self._next == _STEPS_AT_ONCE:
            for first in range(0, len(self._generators), _FLIGHTS_AT_ONCE):
                self._draw(slice(first, first + _FLIGHTS_AT_ONCE))
            self._next = 0
        rows = self._rows[self._next]
        self._next += 1
        return np.asarray(rows)

    def _draw(self, flights: slice) -> None:
        some = self._generators[flights]
        for generator, row in zip(some, self._drawn, strict=False):
            generator.standard_normal(out=row)
        drawn = self._drawn[: len(some)].reshape(len(some), *self._rows.shape[:2])
        self._rows[..., flights] = drawn.transpose(1, 2, 0)
