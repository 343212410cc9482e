"""A load is weighed and announced, and leaves without moving the vehicle when the daemon releases it.

Lock-step with 20 ms of link each way and 1 cm of noise on the height, on true states, by the configurations
that ship.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.offboard.events import Announce, PayloadReport
from kffa_offboard.offboard.segments import Gripper, Hold, Takeoff
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

PERSONALITIES = ("px4", "ardupilot")
TARGET_M, PEAK_M, HOLD_S = 3.0, 0.025, 2.0
SCENARIO = (Takeoff(TARGET_M, 2.0), Gripper("grab"), Hold(HOLD_S), Gripper("release"), Hold(2.5))


@dataclass
class Flown:
    """Times (n,), true heights (n,), true events and what the daemon said and reported."""

    time_s: np.ndarray
    height: np.ndarray
    events: dict[str, float]
    said: list[tuple[float, str]]
    reports: list[PayloadReport]

    def peak(self, event: str, seconds: float = 2.0) -> float:
        """Largest distance from the target from 0.15 s before an event on, m."""
        start = self.events[event] - 0.15
        within = (self.time_s >= start) & (self.time_s < start + seconds)
        return float(np.abs(self.height[within] - TARGET_M).max())


def fly(
    lock_step_flight: Any,
    personality: str,
    mass_kg: float = 5.0,
    seed: int = 0,
    output: str = "rates",
    **changes: Any,
) -> Flown:
    """Fly the release; `changes`: `parameters`, `schedule` of the vehicle; keys of the daemon's [payload]."""
    flight = lock_step_flight(personality, output=output)
    name = f"demo-{personality}-release"
    daemon = load(bundled(f"{name}.toml"), Overrides(output=output, arm=True, engage=True))  # type: ignore[arg-type]
    vehicle = {
        "vehicle": {"seed": seed},
        "payload": {"gripper_mass_kg": mass_kg, "schedule": changes.pop("schedule", [])},
        "parameters": changes.pop("parameters", {}),
    }
    payload = replace(daemon.service.payload, **changes)
    flight.daemon = replace(daemon, service=replace(daemon.service, scenario=SCENARIO, payload=payload))
    flight.vehicle = SimulatedVehicle(sim_config.load(bundled(f"{name}-vehicle.toml"), vehicle))
    result = flight.fly()
    assert result.finished is not None and result.finished.successful, result
    truth = flight.truth
    return Flown(
        truth.time_s,
        truth.z,
        {event.text.split()[0]: event.time_s for event in flight.vehicle.truth.events},
        [(time_us * 1e-6, item.text) for time_us, item in flight.heard if isinstance(item, Announce)],
        [item for _, item in flight.heard if isinstance(item, PayloadReport)],
    )


def loads(flown: Flown) -> list[str]:
    """What was said of loads."""
    words = ("picked", "dropped", "carrying", "load of", "release not", "gripper")
    return [text for _, text in flown.said if text.startswith(words)]


@pytest.fixture(scope="module", params=PERSONALITIES)
def personality(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_a_released_load_leaves_the_vehicle_where_it_is_and_both_are_announced(
    lock_step_flight: Any, personality: str
) -> None:
    flown = fly(lock_step_flight, personality)
    assert flown.peak("drop") <= PEAK_M
    picked, dropped = loads(flown)
    assert picked in ("picked up 4.9 kg", "picked up 5.0 kg", "picked up 5.1 kg", "picked up 5.2 kg")
    assert dropped in ("dropped 4.9 kg", "dropped 5.0 kg", "dropped 5.1 kg")
    second = [
        report for report in flown.reports if 0.9 <= report.time_us * 1e-6 - flown.events["pick-up"] <= 1.5
    ]
    assert second and all(abs(report.mass_kg - 5.0) <= 0.25 for report in second)
    assert abs(flown.reports[-1].mass_kg) <= 0.15


def test_a_drop_that_nobody_commanded_is_announced_within_0_3_seconds(
    lock_step_flight: Any, personality: str
) -> None:
    schedule = [{"time_s": 4.0, "mass_kg": 5.0}, {"time_s": 5.5, "mass_kg": 0.0}]
    flown = fly(lock_step_flight, personality, 0.0, schedule=schedule)
    said = [time for time, text in flown.said if text.startswith("dropped")]
    assert 0.0 < said[0] - flown.events["drop"] <= 0.3
    assert len(said) == 1


REFUSING = {"px4": {"PD_GRIPPER_EN": 0}, "ardupilot": {"GRIP_ENABLE": 0}}


def test_a_gripper_that_does_not_open_costs_no_more_than_a_pick_up(
    lock_step_flight: Any, personality: str
) -> None:
    schedule = [{"time_s": 4.0, "mass_kg": 5.0}]
    flown = fly(lock_step_flight, personality, 0.0, schedule=schedule, parameters=REFUSING[personality])
    asked = 2.0 + flown.events["pick-up"]
    after = flown.height[flown.time_s > asked]
    assert np.abs(after - TARGET_M).max() <= 0.1
    assert abs(after[-1] - TARGET_M) <= 0.02
    wanted = "release not seen: still" if personality == "px4" else "gripper refused"
    assert any(text.startswith(wanted) for text in loads(flown)), loads(flown)
    assert abs(flown.reports[-1].mass_kg - 5.0) <= 0.25


@pytest.mark.grid
@pytest.mark.parametrize(
    ("which", "mass_kg", "output", "seed"),
    list(product(PERSONALITIES, (2.0, 5.0, 6.73), ("rates", "attitude"), range(3))),
)
def test_no_load_and_no_seed_breaks_the_promise(
    lock_step_flight: Any, which: str, mass_kg: float, output: str, seed: int
) -> None:
    flown = fly(lock_step_flight, which, mass_kg, seed, output)
    assert flown.peak("drop") <= PEAK_M
    last = [report for report in flown.reports if report.time_us * 1e-6 < flown.events["drop"]][-1]
    assert abs(last.mass_kg - mass_kg) <= 0.05 * mass_kg + 0.05
