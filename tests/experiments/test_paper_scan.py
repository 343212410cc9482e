"""The scan behind docs/paper.md: what it changes, and that it tells choices apart."""

from __future__ import annotations

import pytest

from kffa_offboard.experiments import scan, settings


def short() -> settings.PaperSettings:
    """The paper's numbers with flights just long enough to measure something."""
    told = settings.load()
    times = {
        "duration_s": 1.5,
        "load_on_s": 0.7,
        "load_off_s": 1.2,
        "settled_after_s": 0.6,
        "step_duration_s": 0.8,
    }
    return told.model_copy(update={"examples": told.examples.model_copy(update=times)})


def test_the_first_scaling_is_the_chosen_one() -> None:
    told = settings.load()
    assert scan.with_scaling(told, *scan.SCALINGS[0]) == told


def test_the_height_is_scaled_in_proportion() -> None:
    scaled = scan.with_scaling(settings.load(), 0.1, 30.0, 8.0).fuzzy
    assert scaled.error_scale == pytest.approx((0.1, 0.1, 0.1, 0.5))
    assert scaled.error_rate_scale == pytest.approx((30.0, 30.0, 30.0, 80.0))
    assert scaled.omega_c_range_rad_s == (8.0, 8.0, 8.0, 8.0)


def test_a_larger_intensity_is_quicker_and_calms_less() -> None:
    slow, quick = (
        scan.sensitivity(scan.with_intensity(short(), intensity), seeds=1) for intensity in (300.0, 10_000.0)
    )
    assert quick.load_peak_m < slow.load_peak_m
    assert quick.kffa_roll_step_s < slow.kffa_roll_step_s
    assert quick.effort > slow.effort
    assert quick.fa_roll_step_s == slow.fa_roll_step_s
