"""The demonstration keeps its promises with both autopilots, both outputs and ten seeds.

Six flights here, spread over the four combinations; the other thirty-four with ``pytest -m grid``, as in CI.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import pytest

from kffa_offboard.trials.metrics import FlightMetrics, measure

TARGET_M = 5.0
PEAK_M, IAE_M_S, HOVER_RMS_M, ATTITUDE_RMS_RAD = 0.08, 0.10, 0.02, 0.02
COMBINATIONS = list(product(("px4", "ardupilot"), ("rates", "attitude")))
SAMPLE = [(*COMBINATIONS[seed % len(COMBINATIONS)], seed) for seed in range(6)]
GRID = [(*combination, seed) for combination in COMBINATIONS for seed in range(10)]
OTHERS = [flight for flight in GRID if flight not in SAMPLE]


def long_after_the_drop(vehicle: Any) -> bool:
    """Enough has been seen: landing is another test's."""
    drop_s = vehicle.truth.time_of("drop")
    return drop_s is not None and vehicle.time_us * 1e-6 > drop_s + 5.1


def metrics_of(
    lock_step_flight: Any, personality: str, output: str, seed: int, **changes: Any
) -> FlightMetrics:
    flight = lock_step_flight(personality, output=output, seed=seed, **changes)
    flight.fly(long_after_the_drop)
    return measure(flight.truth, TARGET_M)


def assert_promises_kept(metrics: FlightMetrics) -> None:
    for deviation in (metrics.pickup, metrics.drop):
        assert deviation.peak_m <= PEAK_M
        assert deviation.iae_m_s <= IAE_M_S
    assert metrics.hover_rms_m <= HOVER_RMS_M
    assert metrics.attitude_rms_rad <= ATTITUDE_RMS_RAD


@pytest.mark.parametrize(("personality", "output", "seed"), SAMPLE)
def test_five_kilograms_more_or_less_hardly_move_the_vehicle(
    lock_step_flight: Any, personality: str, output: str, seed: int
) -> None:
    assert_promises_kept(metrics_of(lock_step_flight, personality, output, seed))


@pytest.mark.grid
@pytest.mark.parametrize(("personality", "output", "seed"), OTHERS)
def test_no_seed_breaks_the_promise(lock_step_flight: Any, personality: str, output: str, seed: int) -> None:
    assert_promises_kept(metrics_of(lock_step_flight, personality, output, seed))


def test_a_cascade_of_pids_is_moved_more_than_half_a_metre(lock_step_flight: Any) -> None:
    metrics = metrics_of(lock_step_flight, "px4", "rates", 0, controller="cascaded-pid")
    assert 0.5 <= metrics.pickup.peak_m <= 0.85
    assert 0.5 <= metrics.drop.peak_m <= 0.85
