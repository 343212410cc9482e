"""The position ring keeps its promises in a gusty wind of 5 m/s, through a drop, with both autopilots.

By the configurations that ship, a little shortened: take off, hover, pick up and drop 5 kg, 5 m to the north;
with PX4 also the rest of a square (with both in the flights of ``-m grid``). Measured on true states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.offboard.segments import Hold, Takeoff
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

ALTITUDE_M, MOVE_M, MOVE_S, HOLD_S = 3.0, 5.0, 5.4, 8.0
PICKUP_S, DROP_S = 5.0, 8.0  # after lift-off
HOVER_RMS_M, EXCURSION_M, OVERSHOOT = 0.15, 0.30, 0.05
FLIGHTS = [("px4", "rates", 0.6, 0.0, 4), ("ardupilot", "attitude", 0.6, 2.0, 1)]


@dataclass
class Flown:
    """One flight: times (n,), true places (n, 3), and when things happened."""

    time_s: np.ndarray
    place: np.ndarray
    pickup_s: float
    drop_s: float
    moves_s: float

    def within(self, start_s: float, end_s: float) -> np.ndarray:
        return self.place[(self.time_s >= start_s) & (self.time_s < end_s)]


def fly(lock_step_flight: Any, personality: str, output: str, drag: float, yaw: float, moves: int) -> Flown:
    """Fly the configuration that ships, with another drag and heading, until `moves` moves are done."""
    flight = lock_step_flight(personality, output=output)
    name = f"demo-{personality}-position"
    overrides = Overrides(output=output, arm=True, engage=True)  # type: ignore[arg-type]
    daemon = load(bundled(f"{name}.toml"), overrides)
    square = tuple(replace(part, duration_s=MOVE_S) for part in daemon.service.scenario[2:6])
    scenario = (Takeoff(ALTITUDE_M, 2.0), Hold(HOLD_S), *square[:moves])
    flight.daemon = replace(daemon, service=replace(daemon.service, scenario=scenario))
    schedule = [{"time_s": PICKUP_S, "mass_kg": 5.0}, {"time_s": DROP_S, "mass_kg": 0.0}]
    changes = {"vehicle": {"drag_n_s_m": drag, "seed": 3}, "payload": {"schedule": schedule}}
    flight.vehicle = SimulatedVehicle(sim_config.load(bundled(f"{name}-vehicle.toml"), changes))
    flight.vehicle.state.rigid[8] = yaw
    result = flight.fly()
    truth = flight.vehicle.truth
    rows = truth.rows
    drop_s = truth.time_of("drop")
    assert drop_s is not None and result.finished is not None and result.finished.successful, result
    time_s, place = np.array([row.time_s for row in rows]), np.array([row.state[:3] for row in rows])
    moving = (time_s > drop_s) & (place[:, 0] > 0.3)
    return Flown(
        time_s,
        place,
        truth.time_of("pick-up"),
        drop_s,
        float(time_s[moving][0]),
    )


def assert_hover_stays_where_it_took_off(flown: Flown) -> None:
    hover = flown.within(flown.pickup_s - 1.5, flown.pickup_s)
    assert np.sqrt(np.mean(np.sum(hover[:, :2] ** 2, axis=1))) <= HOVER_RMS_M


def assert_drop_hardly_moves_the_vehicle(flown: Flown) -> None:
    after = flown.within(flown.drop_s, flown.moves_s - 1.0) - [0.0, 0.0, ALTITUDE_M]
    assert len(after) > 100
    assert np.hypot(after[:, 0], after[:, 1]).max() <= EXCURSION_M
    assert np.abs(after[:, 2]).max() <= EXCURSION_M


def assert_step_does_not_overshoot(flown: Flown) -> None:
    step = flown.within(flown.moves_s, flown.moves_s + 4.5)
    assert MOVE_M * 0.97 <= step[:, 0].max() <= MOVE_M * (1.0 + OVERSHOOT)
    assert np.abs(step[:, 1]).max() <= EXCURSION_M


def assert_square_is_flown(flown: Flown) -> None:
    # y is west: five metres to the east are -5.
    corners = [(MOVE_M, 0.0), (MOVE_M, -MOVE_M), (0.0, -MOVE_M), (0.0, 0.0)]
    for k, corner in enumerate(corners):
        end_s = flown.moves_s + k * MOVE_S + 4.3
        there = flown.within(end_s - 0.1, end_s)[:, :2].mean(axis=0)
        assert there == pytest.approx(corner, abs=EXCURSION_M / 2.0), (k, there)
    assert flown.place[:, 0].max() <= MOVE_M * (1.0 + OVERSHOOT)
    assert flown.place[:, 1].min() >= -MOVE_M * (1.0 + OVERSHOOT)


def assert_promises_kept(flown: Flown, moves: int) -> None:
    assert_hover_stays_where_it_took_off(flown)
    assert_drop_hardly_moves_the_vehicle(flown)
    assert_step_does_not_overshoot(flown)
    if moves == 4:
        assert_square_is_flown(flown)


@pytest.mark.parametrize(("personality", "output", "drag", "yaw", "moves"), FLIGHTS)
def test_the_place_is_held_through_a_drop_and_a_square_is_flown(
    lock_step_flight: Any, personality: str, output: str, drag: float, yaw: float, moves: int
) -> None:
    """Rates and attitude, nose to the north and elsewhere."""
    assert_promises_kept(fly(lock_step_flight, personality, output, drag, yaw, moves), moves)


@pytest.mark.grid
@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
@pytest.mark.parametrize("output", ["rates", "attitude"])
@pytest.mark.parametrize(("drag", "yaw"), [(0.6, -2.5), (0.15, 1.0)])
def test_all_combinations_fly_the_square(
    lock_step_flight: Any, personality: str, output: str, drag: float, yaw: float
) -> None:
    assert_promises_kept(fly(lock_step_flight, personality, output, drag, yaw, 4), 4)


def test_without_the_ring_the_same_wind_carries_the_vehicle_away(lock_step_flight: Any) -> None:
    flight = lock_step_flight("px4")
    changes = {"vehicle": {"seed": 3}}
    vehicle_file: Path = bundled("demo-px4-position-vehicle.toml")
    flight.vehicle = SimulatedVehicle(sim_config.load(vehicle_file, changes))
    flight.fly(lambda vehicle: vehicle.truth.time_of("pick-up") is not None)
    assert np.hypot(*flight.vehicle.state.rigid[:2]) > 1.0
