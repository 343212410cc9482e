"""What the comparison says of the autopilot's own estimate of height."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.estimate import HeightLog, measure_estimate, read_heights
from kffa_offboard.compare.measure import measure_load
from kffa_offboard.flightlog.tlog import TIMESTAMP
from kffa_offboard.trials.metrics import FlightFailed, Truth

LIFTOFF, PICKUP, DROP, END = 2.0, 20.0, 30.0, 40.0
TIME = np.arange(0.0, END, 0.01)


def truth(height: np.ndarray) -> Truth:
    columns = {name: np.zeros_like(TIME) for name in Truth.__dataclass_fields__ if name != "events"}
    load = np.where((TIME >= PICKUP) & (TIME < DROP), 5.0, 0.0)
    return Truth(**{**columns, "time_s": TIME, "z": height, "load_mass_kg": load})


def hover(wobble: np.ndarray) -> Truth:
    return truth(np.where(TIME < LIFTOFF, 0.0, 5.0 + wobble))


def test_an_estimate_that_is_always_wrong_by_the_same_costs_nothing() -> None:
    flown = hover(np.where((TIME >= PICKUP) & (TIME < DROP), -0.2, 0.0))
    log = HeightLog(TIME, flown.z + 0.7, np.zeros_like(TIME))
    figures = measure_estimate(flown, log, measure_load(flown))
    assert figures.pickup.iae_m_s == pytest.approx(0.0, abs=1e-9)
    assert figures.drop.peak_m == pytest.approx(0.0, abs=1e-9)
    assert figures.seen_pickup.peak_m == pytest.approx(0.2)
    assert figures.seen_pickup.iae_m_s == pytest.approx(1.0, rel=0.01)
    assert figures.seen_drop.peak_m == pytest.approx(0.0, abs=1e-9)


def test_whoever_holds_a_drifting_estimate_moves_by_the_drift() -> None:
    drift = np.where(TIME >= PICKUP, 0.005 * (TIME - PICKUP), 0.0)
    flown = hover(-drift)
    log = HeightLog(TIME, np.where(TIME < LIFTOFF, 0.0, 5.0), np.zeros_like(TIME))
    figures, load = measure_estimate(flown, log, measure_load(flown)), measure_load(flown)
    assert figures.pickup.iae_m_s == pytest.approx(load.pickup.iae_m_s, abs=1e-3)
    assert figures.drop.peak_m == pytest.approx(0.075, abs=1e-3)
    assert figures.seen_drop.peak_m == pytest.approx(0.0, abs=1e-9)
    assert figures.after_m_s == pytest.approx(0.005, abs=1e-4)
    assert figures.before_m_s == pytest.approx(0.0, abs=1e-9)


def test_samples_of_the_log_are_put_at_their_own_simulated_time(tmp_path: Path) -> None:
    codec = mavlink.MAVLink(file=None, srcSystem=1, srcComponent=1)
    records = b""
    for boot_ms, late_us in ((1000, 5000), (1010, 5000), (1020, 9000)):
        message = mavlink.MAVLink_local_position_ned_message(boot_ms, 0.0, 0.0, -5.0, 0.0, 0.0, 0.25)
        records += TIMESTAMP.pack(boot_ms * 1000 + 2_000_000 + late_us) + message.pack(codec)
    path = tmp_path / "flight.tlog"
    path.write_bytes(records)
    log = read_heights(path, delay_s=0.005)
    np.testing.assert_allclose(log.time_s, [3.0, 3.01, 3.02])
    np.testing.assert_allclose(log.height_m, 5.0)
    np.testing.assert_allclose(log.climb_rate_m_s, -0.25)


def test_a_log_without_positions_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flight.tlog"
    path.write_bytes(b"")
    with pytest.raises(FlightFailed, match="no LOCAL_POSITION_NED"):
        read_heights(path, 0.0)
