"""Figures of merit of flights whose figures are known beforehand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kffa_offboard.trials.metrics import FlightFailed, Truth, distance_from_path, measure, read_truth

LIFTOFF_S, PICKUP_S, DROP_S, LANDING_S, END_S = 3.0, 15.0, 23.0, 30.0, 40.0


def known_flight() -> Truth:
    """Up at 3 s, 5 kg from 15 s to 23 s, down at 30 s; the load pulls it down by 10 cm for one second."""
    time = np.arange(0.0, END_S, 0.01)
    z = np.where((time >= LIFTOFF_S) & (time <= LANDING_S), 5.0, 0.0)
    z[(time >= PICKUP_S) & (time < PICKUP_S + 1.0)] -= 0.1
    z[(time >= DROP_S) & (time < DROP_S + 2.0)] += 0.05
    zero = np.zeros_like(time)
    load = np.where((time >= PICKUP_S) & (time < DROP_S), 5.0, 0.0)
    return Truth(time, zero, zero, z, zero + 0.003, zero - 0.004, zero, zero + 98.0, load)


def test_peak_is_the_largest_distance_and_iae_its_integral() -> None:
    metrics = measure(known_flight(), 5.0)
    assert metrics.pickup.peak_m == pytest.approx(0.1)
    assert metrics.pickup.iae_m_s == pytest.approx(0.1, rel=0.02)
    assert metrics.drop.peak_m == pytest.approx(0.05)
    assert metrics.drop.iae_m_s == pytest.approx(0.1, rel=0.02)


def test_events_are_found_in_the_true_states() -> None:
    metrics = measure(known_flight(), 5.0)
    assert metrics.liftoff_s == pytest.approx(LIFTOFF_S, abs=0.011)
    assert metrics.pickup_s == pytest.approx(PICKUP_S, abs=0.011)
    assert metrics.drop_s == pytest.approx(DROP_S, abs=0.011)
    assert metrics.landing_s == pytest.approx(LANDING_S, abs=0.011)


def test_hover_is_measured_in_the_five_seconds_before_the_pick_up() -> None:
    truth = known_flight()
    before = (truth.time_s >= 10.0) & (truth.time_s < 15.0)
    assert measure(truth, 5.0).hover_rms_m == pytest.approx(0.0, abs=1e-12)
    assert measure(replace(truth, z=truth.z + 0.02 * before), 5.0).hover_rms_m == pytest.approx(0.02)
    assert measure(replace(truth, z=truth.z + 0.02 * (truth.time_s < 10.0)), 5.0).hover_rms_m < 1e-12


def test_attitude_is_the_rms_of_roll_and_pitch_in_steady_flight() -> None:
    truth = known_flight()
    expected = np.sqrt((0.003**2 + 0.004**2) / 2.0)
    assert measure(truth, 5.0).attitude_rms_rad == pytest.approx(expected)
    tilted_on_the_ground = replace(truth, roll=np.where(truth.time_s > LANDING_S, 0.5, truth.roll))
    assert measure(tilted_on_the_ground, 5.0).attitude_rms_rad == pytest.approx(expected)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"z": np.zeros(4000)}, "did not leave the ground"),
        ({"load_mass_kg": np.zeros(4000)}, "nothing was picked up"),
        ({"load_mass_kg": np.linspace(0.0, 5.0, 4000)}, "the load was not dropped"),
        ({"load_mass_kg": np.eye(4000)[500] * 5.0}, "no steady hover before it"),
        ({"z": np.where(np.arange(4000) < 2000, 5.0, 0.0) * (np.arange(4000) > 300)}, "did not stay at"),
    ],
)
def test_a_flight_that_went_wrong_has_no_figures(change: dict[str, np.ndarray], reason: str) -> None:
    with pytest.raises(FlightFailed, match=reason):
        measure(replace(known_flight(), **change), 5.0)


def test_a_flight_that_ended_too_early_has_no_figures() -> None:
    truth = known_flight()
    short = {name: value[:2500] for name, value in vars(truth).items() if isinstance(value, np.ndarray)}
    with pytest.raises(FlightFailed, match="ended 2\\.0 s after a change of load"):
        measure(replace(truth, **short), 5.0)


HEAD = "time_s,x,y,z,vx,vy,vz,roll,pitch,yaw,p,q,r,thrust_n,load_mass_kg,armed,mode,event\n"
ROW = "{},0,0,5,0,0,0,0.1,0.2,0.3,0,0,0,98,5,1,OFFBOARD,{}\n"


def test_true_states_are_read_with_their_events(tmp_path: Path) -> None:
    file = tmp_path / "truth.csv"
    file.write_text(HEAD + ROW.format(0.01, "") + ROW.format(0.02, "pick-up 5 kg"))
    truth = read_truth(file)
    assert truth.time_s.tolist() == [0.01, 0.02]
    assert (truth.z[0], truth.roll[0], truth.pitch[0], truth.yaw[0]) == (5.0, 0.1, 0.2, 0.3)
    assert truth.events == ((0.02, "pick-up 5 kg"),)


def test_a_line_that_is_still_being_written_is_left_out(tmp_path: Path) -> None:
    file = tmp_path / "truth.csv"
    file.write_text(HEAD + ROW.format(0.01, "") + "0.02,0,0,5,0")
    assert read_truth(file).time_s.tolist() == [0.01]


def test_no_true_states_is_a_failed_flight(tmp_path: Path) -> None:
    with pytest.raises(FlightFailed, match="wrote no true states"):
        read_truth(tmp_path / "none.csv")
    (tmp_path / "empty.csv").write_text(HEAD)
    with pytest.raises(FlightFailed, match="holds no true states"):
        read_truth(tmp_path / "empty.csv")


CORNERS = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, -5.0]])


def known_moves() -> Truth:
    """3-4-5 cm off its place all the time, and from 29 s on in a corner of the way, 30 cm too far."""
    truth = known_flight()
    moved = truth.time_s >= 29.0
    return replace(truth, x=np.where(moved, 5.3, 0.03), y=np.where(moved, 0.0, -0.04))


def test_a_held_place_is_measured_from_the_take_off_and_the_way_from_its_line() -> None:
    place = measure(known_moves(), 5.0, CORNERS).place
    assert place is not None
    assert place.hover_rms_m == pytest.approx(0.05)
    assert (place.pickup_peak_m, place.drop_peak_m) == pytest.approx((0.05, 0.05))
    assert place.path_peak_m == pytest.approx(0.3)


def test_without_a_place_to_hold_none_is_measured() -> None:
    assert measure(known_moves(), 5.0).place is None


def test_the_tilt_of_moves_is_no_error_of_attitude() -> None:
    truth = known_moves()
    tilted = replace(truth, pitch=np.where(truth.time_s > DROP_S + 5.0, 0.3, truth.pitch))
    assert measure(tilted, 5.0, CORNERS).attitude_rms_rad < 0.01 < measure(tilted, 5.0).attitude_rms_rad


def test_distance_from_a_path_is_that_from_its_nearest_side() -> None:
    places = np.array([[2.0, 0.1], [5.2, -1.0], [2.5, -2.5], [-3.0, 4.0]])
    np.testing.assert_allclose(distance_from_path(places, CORNERS), [0.1, 0.2, 2.5, 5.0])
