"""A whole delivery by rope, by the configurations that ship: lifted, carried, set down, left, and home.

In gusty wind of 5 m/s, in lock-step, on true states.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kffa_offboard.config import Overrides, bundled, load
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle


@pytest.mark.parametrize(("personality", "output"), [("px4", "rates"), ("ardupilot", "attitude")])
def test_a_load_is_delivered_where_it_is_to_be(lock_step_flight: Any, personality: str, output: str) -> None:
    """10 m to the north of where it lay, within half a metre; the swing and the vehicle's way are calm."""
    flight = lock_step_flight(personality, output=output)
    flight.daemon = load(
        bundled(f"demo-{personality}-rope.toml"), Overrides(output=output, arm=True, engage=True)
    )
    flight.vehicle = SimulatedVehicle(sim_config.load(bundled(f"demo-{personality}-rope-vehicle.toml")))
    rope, places = flight.vehicle.plant._rope, []
    flight.before_slot = lambda: places.append(rope.place.copy())
    result = flight.fly()
    assert result.finished is not None and result.finished.successful, result
    events = [(event.text, event.time_s) for event in flight.vehicle.truth.events]
    happened = [text for text, _ in events if text.split()[0] in ("pick-up", "load", "drop")]
    assert happened == ["pick-up 5 kg", "load lifted", "load set down", "drop 5 kg"]
    lifted, down = (flight.vehicle.truth.time_of(text) for text in ("load lifted", "load set down"))
    way = places[round(100 * down) + 20] - places[round(100 * lifted) - 20]
    assert way == pytest.approx([10.0, 0.0, 0.0], abs=0.5)
    said = [text.rsplit(" ", 2) for text in flight.texts if text.endswith(" kg")]
    assert [word for word, _, _ in said] == ["picked up", "dropped"]
    assert [float(mass) for _, mass, _ in said] == pytest.approx([5.0, 5.0], abs=0.3)
    truth = flight.truth
    swing = np.degrees([row.load_swing for row in flight.vehicle.truth.rows])
    assert swing.max() < 15.0
    assert np.abs(truth.roll).max() < 0.2 and np.abs(truth.pitch).max() < 0.25
    assert np.hypot(truth.x[-1] - places[0][0], truth.y[-1] - places[0][1]) < 0.5
