"""Setpoints from a ground station, flown in lock-step."""

from __future__ import annotations

from dataclasses import replace
from math import cos, degrees, radians, sin
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import bundled
from kffa_offboard.offboard.events import Announce

EXTERNAL = (
    '[[scenario.segment]]\ntype = "takeoff"\naltitude_m = 3.0\n'
    '[[scenario.segment]]\ntype = "external"\nduration_s = {}\n'
    '[[scenario.segment]]\ntype = "hold"\nduration_s = 5.0\n'
)
GROUND = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)


def configured(tmp_path: Any, name: str, seconds: float = 60.0) -> Any:
    """A demonstration's configuration that follows setpoints after take-off."""
    text = bundled(name).read_text()
    file = tmp_path / "external.toml"
    file.write_text(text[: text.index("[[scenario.segment]]")] + EXTERNAL.format(seconds))
    return file


def position(x: float, y: float, z: float, yaw: float = 0.0, mask: int = 2552) -> bytes:
    message = mavlink.MAVLink_set_position_target_local_ned_message(
        0, 245, 191, 1, mask, x, y, z, 0, 0, 0, 0, 0, 0, yaw, 0
    )
    return bytes(message.pack(GROUND))


def attitude(roll: float) -> bytes:
    q = (cos(roll / 2), sin(roll / 2), 0.0, 0.0)
    return bytes(mavlink.MAVLink_set_attitude_target_message(0, 245, 191, 71, q, 0, 0, 0, 0).pack(GROUND))


class Pilot:
    """Sends frames at times after the external segment began; the flight ends at `until`."""

    def __init__(self, flight: Any, plan: list[tuple[float, bytes]], until: float) -> None:
        self._flight, self._plan, self._until = flight, list(plan), until
        self.begun_us: int | None = None

    def __call__(self, vehicle: Any) -> bool:
        state = self._flight.session.service._flight
        if self.begun_us is None and (state is None or state.scenario.segment_index < 1):
            return False
        self.begun_us = vehicle.time_us if self.begun_us is None else self.begun_us
        elapsed = (vehicle.time_us - self.begun_us) * 1e-6
        while self._plan and elapsed >= self._plan[0][0]:
            self._flight.link.from_ground.append(self._plan.pop(0)[1])
        return elapsed >= self._until


def texts(flight: Any) -> list[str]:
    return [item.text for _, item in flight.heard if isinstance(item, Announce)]


def test_a_jump_of_five_metres_is_flown_as_a_move(lock_step_flight, tmp_path):
    flight = lock_step_flight("px4", daemon_file=configured(tmp_path, "demo-px4-position.toml"))
    pilot = Pilot(flight, [(1.0, position(5.0, -2.0, -4.0, 0.5))], 9.0)
    flight.fly(pilot)
    rows = flight.vehicle.truth.rows
    final = np.array(rows[-1].state)
    # NED (5, -2, -4), heading 0.5, in the paper's axes.
    assert final[:3] == pytest.approx([5.0, 2.0, 4.0], abs=0.15)
    assert final[8] == pytest.approx(-0.5, abs=0.05)
    states = np.array([row.state for row in rows])
    assert np.hypot(states[:, 3], states[:, 4]).max() < 2.3
    assert degrees(np.abs(states[:, 6:8]).max()) < 15.0


def test_without_the_ring_a_place_is_refused_once_and_a_height_is_flown(lock_step_flight, tmp_path):
    flight = lock_step_flight("px4", daemon_file=configured(tmp_path, "demo-px4.toml"))
    refused = [(0.1 * k, position(5.0, 0.0, -3.0)) for k in range(5)]
    masks = [(1.0 + 0.1 * k, position(0.0, 0.0, -3.0, mask=0)) for k in range(5)]
    frames = [*refused, *masks, (2.0, position(0.0, 0.0, -4.0, mask=2552 | 3 | 1024))]
    flight.fly(Pilot(flight, [*frames, (2.1, position(0, 0, -500.0, mask=2552 | 3))], 6.0))
    assert flight.truth.z[-1] == pytest.approx(4.0, abs=0.05)
    said = [text for text in texts(flight) if "setpoint" in text]
    assert said == [
        "setpoint not followed: x and y need [position] enabled",
        "position setpoint: mask 0, only position and yaw (2552)",
        "setpoint not followed: altitude 500 m is outside -3 .. 50",
    ]


def test_an_attitude_is_flown_while_it_comes_and_level_after_it(lock_step_flight, tmp_path):
    flight = lock_step_flight("px4", daemon_file=configured(tmp_path, "demo-px4.toml"))
    pilot = Pilot(flight, [(0.05 * k, attitude(radians(8.0))) for k in range(21)], 3.5)
    flight.fly(pilot)
    assert pilot.begun_us is not None
    end_s = pilot.begun_us * 1e-6 + 3.4  # then it is released, and the autopilot brakes
    rows = [row for row in flight.vehicle.truth.rows if row.time_s < end_s]
    roll, z = np.array([row.state[6] for row in rows]), np.array([row.state[2] for row in rows])
    assert degrees(roll[-1]) == pytest.approx(0.0, abs=0.5)
    assert degrees(roll.max()) == pytest.approx(8.0, abs=1.0)
    assert np.abs(z[-300:] - 3.0).max() < 0.1
    assert texts(flight).count("no attitude setpoints: level") == 1


def test_setpoints_beyond_the_limit_of_tilt_are_limited(lock_step_flight, tmp_path):
    flight = lock_step_flight("px4", daemon_file=configured(tmp_path, "demo-px4.toml"))
    limits = replace(flight.daemon.service.limits, tilt_max_rad=radians(10.0))
    flight.daemon = replace(flight.daemon, service=replace(flight.daemon.service, limits=limits))
    flight.fly(Pilot(flight, [(0.05 * k, attitude(radians(40.0))) for k in range(21)], 1.5))
    assert degrees(max(row.state[6] for row in flight.vehicle.truth.rows)) < 11.5


def test_only_the_external_segment_follows_setpoints(lock_step_flight, tmp_path):
    file = configured(tmp_path, "demo-px4.toml", seconds=1.0)
    flight = lock_step_flight("px4", daemon_file=file)
    flight.fly(Pilot(flight, [(1.5, position(0.0, 0.0, -6.0, mask=2552 | 3))], 4.0))
    assert flight.truth.z[-1] == pytest.approx(3.0, abs=0.05)
    assert "setpoint not followed: the scenario is flown" in texts(flight)
