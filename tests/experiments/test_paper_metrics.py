"""Settling, overshoot, lag and recovery on curves whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from kffa_offboard.experiments import metrics

TIME = np.arange(0.0, 4.0, 0.005)


@pytest.mark.parametrize("step", [5.0, -0.5])
@pytest.mark.parametrize("band", [0.02, 0.001])
def test_an_exponential_settles_when_it_enters_the_band(step: float, band: float) -> None:
    output = step * (1.0 - np.exp(-TIME / 0.2))
    settled = metrics.settling_time(TIME, output[:, None], np.array([step]), band)
    assert settled[0] == pytest.approx(-0.2 * np.log(band), abs=1e-4)  # fifty times finer than the samples


def test_settling_is_the_last_entry_into_the_band() -> None:
    output = np.where(TIME < 0.1, 0.0, 1.0)
    output[(TIME > 2.0) & (TIME < 2.5)] = 1.03
    assert metrics.settling_time(TIME, output[:, None], np.ones(1), 0.02)[0] == pytest.approx(2.5, abs=0.005)


def test_what_ends_outside_the_band_never_settles() -> None:
    output = np.where(TIME < 3.9, 1.0, 1.1)
    assert metrics.settling_time(TIME, output[:, None], np.ones(1), 0.02)[0] == np.inf


def test_what_never_leaves_the_band_is_settled_from_the_start() -> None:
    assert metrics.settling_time(TIME, np.ones((len(TIME), 1)), np.ones(1), 0.02)[0] == 0.0


def test_overshoot_is_counted_beyond_the_step_in_its_own_direction() -> None:
    output = np.array([[0.0, 0.0], [-0.55, 0.4], [-0.5, 0.5]])
    np.testing.assert_allclose(metrics.overshoot_percent(output, np.array([-0.5, 0.5])), [10.0, 0.0])


def test_a_delayed_triangle_is_late_by_its_delay() -> None:
    reference = np.abs(np.mod(TIME, 2.0) - 1.0)
    output = np.abs(np.mod(TIME - 0.083, 2.0) - 1.0)
    assert metrics.lag(TIME, reference[:, None], output[:, None])[0] == pytest.approx(0.083, abs=1e-9)


def test_recovery_ends_with_the_last_excursion() -> None:
    error = np.where(TIME < 0.3, 0.005, 0.0)
    assert metrics.recovery_time(TIME, error, 0.001) == pytest.approx(0.3, abs=0.005)
    assert metrics.recovery_time(TIME, 0.0 * error, 0.001) == 0.0
    assert metrics.recovery_time(TIME, 0.0 * error - 0.1, 0.001) == np.inf
