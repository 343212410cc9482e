"""What docs/comparison-px4.md says of the wander of an estimate of height."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kffa_offboard.experiments.height_wander import (
    BAROMETER_M,
    EKF2,
    EKF2_DISTANCE,
    RANGE_FINDER_M,
    SENSORS,
    Noises,
    estimates,
    followed,
    iae,
    main,
)

FLIGHTS = 100


def test_sensors_without_noise_leave_no_error() -> None:
    height, climb_rate = estimates(Noises(0.0, 0.0, 0.0), EKF2, 2)
    assert not height.any()
    assert not climb_rate.any()


def test_no_filter_beats_the_one_that_knows_the_noise() -> None:
    variances = [estimates(SENSORS, assumed, FLIGHTS)[0][3000:].var() for assumed in (SENSORS, EKF2)]
    assert 0.8 < variances[0] / variances[1] < 1.0


def test_a_range_finder_leaves_a_third_of_the_wander() -> None:
    plain, _ = estimates(SENSORS, EKF2, FLIGHTS)
    ranged, _ = estimates(
        replace(SENSORS, distance=RANGE_FINDER_M), replace(EKF2, distance=EKF2_DISTANCE), FLIGHTS
    )
    for with_it, without in zip(iae(ranged), iae(plain), strict=True):
        assert with_it < without / 3.0


def test_a_barometer_that_is_told_as_exaggerated_a_noise_as_the_others_is_used_as_well_as_can_be() -> None:
    with_air = replace(SENSORS, pressure=BAROMETER_M)
    plain, told, trusted, knowing = (
        iae(estimates(true, assumed, FLIGHTS)[0])
        for true, assumed in (
            (SENSORS, EKF2),
            (with_air, replace(EKF2, pressure=0.5)),
            (with_air, replace(EKF2, pressure=0.1)),
            (with_air, with_air),
        )
    )
    for without, usual, overdone, best in zip(plain, told, trusted, knowing, strict=True):
        assert usual < 0.6 * without
        assert usual < 1.1 * best
        assert overdone > 1.2 * usual


def test_whoever_follows_the_height_at_once_has_its_error() -> None:
    height, climb_rate = estimates(SENSORS, EKF2, 3)
    np.testing.assert_allclose(followed(height, climb_rate, 0.01), height, atol=1e-3)
    assert iae(followed(height, climb_rate, 0.05)) == pytest.approx(iae(height), rel=0.1)


def test_the_table_is_markdown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--flights", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("| | IAE after pick-up")
    assert all(line.count("|") == 6 for line in lines)
