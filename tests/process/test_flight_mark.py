"""The file that tells a restart in flight from a start."""

import pytest

from kffa_offboard.offboard.events import AttitudeTarget, HeartbeatReceived, ModeKind
from kffa_offboard.process.flight_mark import FlightMark

SETPOINT = AttitudeTarget(0.4, body_rates=(0.0, 0.0, 0.0))


def heartbeat(armed):
    return HeartbeatReceived("px4", ModeKind.OFFBOARD, "OFFBOARD", 0, armed)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "logs" / "in-flight-1.json"


def after(path, *items):
    """What a run leaves that saw these."""
    mark = FlightMark(path)
    for item in items:
        mark(0, item)
    mark.close()
    return FlightMark(path).found


def test_control_of_an_armed_vehicle_leaves_the_mark(path):
    assert not after(path, heartbeat(True))
    assert not after(path, heartbeat(False), SETPOINT), "set points before arming"
    assert after(path, heartbeat(False), SETPOINT, heartbeat(True), SETPOINT)


def test_the_mark_stays_until_the_vehicle_is_seen_disarmed(path):
    assert after(path, heartbeat(True), SETPOINT)
    assert after(path, heartbeat(True))
    assert not after(path, heartbeat(False))


def test_a_disk_that_takes_no_mark_is_said_once_and_harms_nothing(tmp_path):
    (tmp_path / "file").touch()
    mark = FlightMark(tmp_path / "file" / "in-flight-1.json")
    assert "cannot write in" in mark.obstacle()
    mark(0, heartbeat(True))
    mark(0, SETPOINT)
    mark.close()
    assert "restart mark: " in mark.take_trouble()
    assert mark.take_trouble() is None
