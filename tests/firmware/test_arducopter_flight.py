"""An unmodified ArduCopter flies the paper's vehicle and its load over the JSON interface."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

pytestmark = pytest.mark.timeout(400)

HEIGHT = 5.0


@pytest.fixture(scope="module")
def flight(arducopter: Callable[..., Any]) -> Any:
    """Take-off, hover, 5 kg picked up and dropped by the firmware's gripper."""
    copter = arducopter()
    copter.start()
    copter.take_off(HEIGHT)
    assert copter.ask(mavlink.MAV_CMD_DO_GRIPPER, 1, 1) == mavlink.MAV_RESULT_ACCEPTED
    copter.run(8.0)
    assert copter.ask(mavlink.MAV_CMD_DO_GRIPPER, 1, 0) == mavlink.MAV_RESULT_ACCEPTED
    copter.run(8.0)
    for message in (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_ATTITUDE):
        copter.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message, 20_000)
    copter.run(0.5)
    return copter


def rows(flight: Any, start: float, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Time [s] and state (n, 12) of the truth between two times."""
    chosen = [row for row in flight.vehicle.plant.truth.rows if start <= row.time_s < end]
    return np.array([row.time_s for row in chosen]), np.array([row.state for row in chosen])


def event(flight: Any, text: str) -> float:
    time_s = flight.vehicle.plant.truth.time_of(text)
    assert time_s is not None, [event.text for event in flight.vehicle.plant.truth.events]
    return float(time_s)


def test_it_hovers_where_it_took_off(flight):
    pick_up = event(flight, "pick-up 5 kg")
    _, states = rows(flight, pick_up - 5.0, pick_up)
    assert states[:, 2] == pytest.approx(HEIGHT, abs=0.2)
    assert np.abs(states[:, :2]).max() < 0.3
    assert np.degrees(np.abs(states[:, 6:8]).max()) < 0.5
    assert np.degrees(np.abs(states[:, 8]).max()) < 5.0


def test_what_it_reports_is_what_happens(flight):
    """Axes and signs end to end: the firmware's own estimate agrees with the truth."""
    reported = flight.heard["GLOBAL_POSITION_INT"]
    assert reported.relative_alt * 1e-3 == pytest.approx(flight.vehicle.plant.state.position[2], abs=0.3)
    attitude = flight.heard["ATTITUDE"]
    truth = flight.vehicle.plant.state.euler * [1.0, -1.0, -1.0]
    assert [attitude.roll, attitude.pitch, attitude.yaw] == pytest.approx(truth, abs=0.05)


@pytest.mark.parametrize("what", ["pick-up 5 kg", "drop 5 kg"])
def test_its_own_height_hold_moves_a_quarter_of_a_metre(flight, what):
    """0.264 m at pick-up and 0.255 m at the drop in the study that this simulator continues."""
    at = event(flight, what)
    before = rows(flight, at - 1.0, at)[1][:, 2].mean()
    _, states = rows(flight, at, at + 5.0)
    assert 0.2 < np.abs(states[:, 2] - before).max() < 0.32
    assert np.degrees(np.abs(states[:, 6:8]).max()) < 1.0


def test_every_frame_was_answered_once(flight):
    assert flight.vehicle.counters.frames == flight.vehicle.plant.time_us // 1250
    assert flight.vehicle.counters.bad == flight.vehicle.counters.restarts == 0


def test_a_firmware_that_is_started_again_boots_on_the_same_vehicle(flight):
    """Last, because it ends the flight: power fails in the air, the vehicle falls, the firmware is back."""
    flight.stop()
    flight.heard.clear()
    flight.start()
    assert flight.run(30.0, lambda: "HEARTBEAT" in flight.heard)
    assert flight.vehicle.counters.restarts == 1
    assert flight.vehicle.plant.state.rigid[2] < HEIGHT
    flight.run(3.0)
    assert flight.vehicle.plant.state.rigid[2] == 0.0
    assert not flight.vehicle.armed
    assert flight.vehicle.plant.truth.time_of("firmware restarted") is not None


def test_a_firmware_that_reboots_itself_is_answered_again(flight):
    flight.heard.clear()
    flight.ask(mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1)
    assert flight.run(10.0, lambda: flight.vehicle.counters.restarts == 2)
    flight.heard.clear()
    assert flight.run(30.0, lambda: "HEARTBEAT" in flight.heard)
