"""The comparison's figures, on flights whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from kffa_offboard.compare.course import flown_steps
from kffa_offboard.compare.measure import FlownStep, measure_load, measure_place, measure_steps
from kffa_offboard.flightlog.signals import SignalTable
from kffa_offboard.trials.metrics import FlightFailed, Truth

LIFTOFF, PICKUP, DROP, END = 2.0, 20.0, 30.0, 40.0
TIME = np.arange(0.0, END, 0.01)


def truth(height: np.ndarray, **angles: np.ndarray) -> Truth:
    zero = np.zeros_like(TIME)
    columns = {name: zero for name in Truth.__dataclass_fields__ if name not in ("time_s", "z", "events")}
    load = np.where((TIME >= PICKUP) & (TIME < DROP), 5.0, 0.0)
    return Truth(**{**columns, "time_s": TIME, "z": height, "load_mass_kg": load, **angles})


def hover(height_m: float) -> np.ndarray:
    return np.where(TIME < LIFTOFF, 0.0, height_m)


def test_a_height_that_the_estimator_has_wrong_is_no_deviation() -> None:
    figures = measure_load(truth(hover(4.7)))
    assert figures.reference_m == pytest.approx(4.7)
    assert figures.pickup.peak_m == pytest.approx(0.0, abs=1e-9)
    assert figures.pickup_recovery_s == 0.0


def test_a_sag_has_its_depth_its_area_and_its_end() -> None:
    sag = np.where((TIME >= PICKUP) & (TIME < PICKUP + 2.0), -0.2, 0.0)
    figures = measure_load(truth(hover(5.0) + sag))
    assert figures.pickup.peak_m == pytest.approx(0.2)
    assert figures.pickup.iae_m_s == pytest.approx(0.4, rel=0.01)
    assert figures.pickup_recovery_s == pytest.approx(2.0, abs=0.02)
    assert figures.drop.peak_m == pytest.approx(0.0, abs=1e-9)


def test_a_vehicle_that_stays_low_has_not_recovered() -> None:
    sag = np.where((TIME >= PICKUP) & (TIME < DROP), -0.2, 0.0)
    assert measure_load(truth(hover(5.0) + sag)).pickup_recovery_s is None


def test_tilt_after_the_pick_up_is_seen_and_tilt_before_is_level_rms() -> None:
    roll = np.where((TIME >= PICKUP + 1.0) & (TIME < PICKUP + 1.1), math.radians(4.0), math.radians(0.1))
    figures = measure_load(truth(hover(5.0), roll=roll))
    assert figures.tilt_peak_deg == pytest.approx(4.0)
    assert figures.level_rms_deg == pytest.approx(0.1 / math.sqrt(2.0), rel=0.01)


def test_a_place_is_measured_from_where_the_vehicle_stood_before_the_pick_up() -> None:
    sway = 0.1 * np.sin(2.0 * math.pi * TIME)
    north = 1.0 + np.where((TIME >= PICKUP) & (TIME < PICKUP + 1.0), 0.3, sway * (TIME < PICKUP))
    west = -2.0 + np.where((TIME >= DROP + 1.0) & (TIME < DROP + 2.0), 0.4, 0.0)
    flight = truth(hover(5.0), x=north, y=west)
    place = measure_place(flight, measure_load(flight))
    assert place.hover_rms_m == pytest.approx(0.1 / math.sqrt(2.0), rel=0.01)
    assert place.pickup_peak_m == pytest.approx(0.3)
    assert place.drop_peak_m == pytest.approx(0.4)


def log(reference: np.ndarray) -> SignalTable:
    zero = np.zeros((TIME.size, 4))
    columns = {name: zero for name in SignalTable.__dataclass_fields__}
    columns["time_us"] = (TIME * 1e6).astype(np.int64)
    columns["reference"] = np.column_stack([reference, *[np.zeros(TIME.size)] * 3])
    return SignalTable(**columns)


def step_response(response: np.ndarray) -> Truth:
    return truth(hover(5.0), roll=response)


STEP = FlownStep("roll", 0.2, 0.0)
AT = 10.0
REFERENCE = np.where((TIME >= AT) & (TIME < AT + 1.5), 0.2, 0.0)


def test_an_exact_response_settles_when_it_enters_five_percent() -> None:
    lag = np.where(TIME < AT, 0.0, 0.2 * (1.0 - np.exp(-(TIME - AT) / 0.2)))
    (figures,) = measure_steps(step_response(lag), log(REFERENCE), [STEP])
    assert figures.settling_s == pytest.approx(0.2 * math.log(20.0), abs=0.03)
    assert figures.overshoot_percent == 0.0
    assert figures.swings == 0


def test_a_ringing_response_overshoots_turns_and_does_not_settle() -> None:
    since = TIME - AT
    ringing = np.where(TIME < AT, 0.0, 0.2 * (1.0 - np.exp(-0.1 * since) * np.cos(10.0 * since)))
    (figures,) = measure_steps(step_response(ringing), log(REFERENCE), [STEP])
    assert figures.settling_s is None
    assert figures.overshoot_percent > 90.0
    assert figures.swings == 4


def test_the_first_step_is_found_where_the_reference_moves() -> None:
    late = np.where(TIME < AT + 0.5, 0.0, 0.2)
    (figures,) = measure_steps(step_response(late), log(REFERENCE), [STEP])
    assert figures.settling_s == pytest.approx(0.5, abs=0.02)


def test_a_log_without_steps_is_no_attitude_flight() -> None:
    with pytest.raises(FlightFailed, match="no steps"):
        measure_steps(step_response(np.zeros(TIME.size)), log(np.zeros(TIME.size)), flown_steps())
