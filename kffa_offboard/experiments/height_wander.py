"""``python -m kffa_offboard.experiments.height_wander``: what the estimate's wander adds to a comparison.

Prints the table of docs/comparison-px4.md as Markdown: IAE and peak of the error of a height estimate, from
its mean in the 5 s before the pick-up, in the 5 s after pick-up and drop (10 s later). A vehicle that held
the estimate exactly would move by that much. The estimate is the vertical part of PX4's EKF2 with the noises
that it assumes by default (height, climb rate, accelerometer bias; satellite fix, accelerometer, and a range
finder where there is one), of the sensors that the simulation gives it, in hover. Without the barometer, but
for its own rows: EKF2 takes 3.5 m for its noise, which leaves it next to no weight. There it is told the
noise that the row says, and the fixes' height has no offset, which EKF2 would take out within 2 s. A filter
that knows the noise is the Kalman filter whose assumptions are the sensors' true noises: none that hears the
same sensors has less variance.

``--flights`` replaces the number of flights (400).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kffa_offboard.control import Array
from kffa_offboard.trials.metrics import WINDOW_S

STEP_S = 0.01
FIX_STEPS, RANGE_STEPS, PRESSURE_STEPS = 10, 5, 6
PICKUP_S, DROP_S = 60.0, 70.0
FOLLOWING_S = (0.6, 2.0, 6.0)
"""Times in which a filter on estimated height and climb rate follows the height."""


@dataclass(frozen=True)
class Noises:
    """Standard deviations of one measurement; infinite: there is none.

    Attributes
    ----------
    acceleration : m/s^2, of the mean over `STEP_S`
    fix_velocity, fix_height : m/s, m; of a satellite fix, ten a second
    distance : m; of a range finder, twenty a second
    pressure : m; of the mean of three samples of a barometer, one every 60 ms
    bias_growth : m/s^2 per step, of the accelerometer's bias
    """

    acceleration: float
    fix_velocity: float
    fix_height: float
    distance: float = np.inf
    pressure: float = np.inf
    bias_growth: float = 0.0


SENSORS = Noises(acceleration=0.05 / np.sqrt(2.5), fix_velocity=0.05, fix_height=0.1)
"""Of `sim_vehicle.backends` (px4_sensors, accel_noise_m_s2 at 250 Hz)."""

RANGE_FINDER_M = float(np.hypot(0.02, 0.01 / np.sqrt(12.0)))
"""With its message's centimetres."""

BAROMETER_M = float(0.0873 / np.sqrt(3.0))
"""1 Pa at 488 m above the sea, of which PX4 averages three samples (SENS_BARO_RATE)."""

EKF2 = Noises(acceleration=0.35, fix_velocity=1.5 * 0.3, fix_height=1.5 * 0.5, bias_growth=0.003 * STEP_S)
"""Defaults of EKF2_ACC_NOISE, EKF2_GPS_V_NOISE, EKF2_GPS_P_NOISE (vertical: 1.5 times), EKF2_ACC_B_NOISE."""

EKF2_DISTANCE = float(np.hypot(0.1, 0.01 * 5.0))
"""EKF2_RNG_NOISE and EKF2_RNG_SFE (configs/compare-px4-range.params) at 5 m."""

EKF2_PRESSURES = (0.1, 0.2, 0.35, 0.5, 1.0)
"""What EKF2_BARO_NOISE might be, m; 0.5 in configs/compare-px4-baro.params."""


def estimates(true: Noises, assumed: Noises, flights: int, seed: int = 0) -> tuple[Array, Array]:
    """Errors of estimated height [m] and climb rate [m/s] in hover, each ``(steps, flights)``."""
    generator = np.random.default_rng(seed)
    steps = round((DROP_S + WINDOW_S) / STEP_S)
    model = np.array([[1.0, STEP_S, 0.0], [0.0, 1.0, -STEP_S], [0.0, 0.0, 1.0]])
    growth = np.diag([0.0, (assumed.acceleration * STEP_S) ** 2, assumed.bias_growth**2])
    covariance = np.diag([0.1, 0.1, 0.01])
    state = np.zeros((3, flights))
    errors = np.empty((steps, 2, flights))
    measured = (
        (1, "fix_velocity", FIX_STEPS),
        (0, "fix_height", FIX_STEPS),
        (0, "distance", RANGE_STEPS),
        (0, "pressure", PRESSURE_STEPS),
    )
    for step in range(steps):
        state = model @ state
        state[1] += STEP_S * true.acceleration * generator.standard_normal(flights)
        covariance = model @ covariance @ model.T + growth
        for index, name, period in measured:
            if step % period or np.isinf(getattr(assumed, name)):
                continue
            value = getattr(true, name) * generator.standard_normal(flights)
            gain = covariance[:, index] / (covariance[index, index] + getattr(assumed, name) ** 2)
            state = state + gain[:, None] * (value - state[index])
            covariance = covariance - np.outer(gain, covariance[index])
        errors[step] = state[:2]
    return errors[:, 0], errors[:, 1]


def followed(height: Array, climb_rate: Array, time_s: float) -> Array:
    """Height that integrates the climb rate and follows `height` in `time_s`."""
    found = np.empty_like(height)
    latest = height[0]
    for step in range(len(height)):
        latest = latest + STEP_S * (climb_rate[step] + (height[step] - latest) / time_s)
        found[step] = latest
    return found


def distances(error: Array) -> tuple[Array, Array]:
    """From the mean before the pick-up, in the windows after pick-up and drop; each ``(steps, flights)``."""
    pickup, drop, window = (round(time_s / STEP_S) for time_s in (PICKUP_S, DROP_S, WINDOW_S))
    away = np.abs(error - error[pickup - window : pickup].mean(axis=0))
    return away[pickup : pickup + window], away[drop : drop + window]


def iae(error: Array) -> tuple[float, float]:
    """Mean IAE [m s] after pick-up and drop, over the flights."""
    pickup, drop = (float(STEP_S * away.sum(axis=0).mean()) for away in distances(error))
    return pickup, drop


def peaks(error: Array) -> tuple[float, float]:
    """Mean of the largest distances [m] after pick-up and drop, over the flights."""
    pickup, drop = (float(away.max(axis=0).mean()) for away in distances(error))
    return pickup, drop


def rows(flights: int) -> list[tuple[str, Array]]:
    """Label and error of each row."""
    none = Noises(0.0, 0.0, 0.0)
    with_range = replace(SENSORS, distance=RANGE_FINDER_M)
    height, climb_rate = estimates(SENSORS, EKF2, flights)
    knowing, _ = estimates(SENSORS, SENSORS, flights)
    ranged, _ = estimates(with_range, replace(EKF2, distance=EKF2_DISTANCE), flights)
    found = [("EKF2's height", height)]
    for name, label in (
        ("acceleration", "the accelerometer's noise alone"),
        ("fix_velocity", "the fixes' velocity alone"),
        ("fix_height", "the fixes' height alone"),
    ):
        alone, _ = estimates(replace(none, **{name: getattr(SENSORS, name)}), EKF2, flights)
        found.append((label, alone))
    for time_s in FOLLOWING_S:
        label = f"its height and climb rate, height followed in {time_s:g} s"
        found.append((label, followed(height, climb_rate, time_s)))
    found.append(("a filter that knows the noise", knowing))
    found.append(("EKF2's height, range finder", ranged))
    return found + barometer_rows(flights)


def barometer_rows(flights: int) -> list[tuple[str, Array]]:
    """Label and error where EKF2 believes the barometer by what it is told of its noise."""
    with_air = replace(SENSORS, pressure=BAROMETER_M)
    found = []
    for told in EKF2_PRESSURES:
        height, _ = estimates(with_air, replace(EKF2, pressure=told), flights)
        found.append((f"EKF2's height, barometer, told {told:g} m", height))
    knowing, _ = estimates(with_air, with_air, flights)
    found.append(("a filter that knows the noise, barometer", knowing))
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m kffa_offboard.experiments.height_wander")
    parser.add_argument("--flights", type=int, default=400, help="how many flights are averaged")
    flights = parser.parse_args(arguments).flights
    print("| | IAE after pick-up, m s | after drop, m s | peak after pick-up, m | after drop, m |")
    print("|---|---|---|---|---|")
    for label, error in rows(flights):
        print(f"| {label} | {' | '.join(f'{value:.3f}' for value in (*iae(error), *peaks(error)))} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
