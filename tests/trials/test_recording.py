"""Signals of a flight are put on the vehicle's own clock."""

from __future__ import annotations

from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.offboard.events import Signals
from kffa_offboard.trials.metrics import FlightFailed
from kffa_offboard.trials.recording import read_recording

ZERO = (0.0, 0.0, 0.0, 0.0)
UNIX_US = 1_750_000_000_000_000


def attitude(boot_ms: int) -> bytes:
    vehicle = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return bytes(mavlink.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0).pack(vehicle))


def signals(time_us: int) -> Signals:
    return Signals(time_us, "engaged", *(ZERO,) * 9)


def test_the_least_late_telemetry_sets_the_clock(tmp_path: Path) -> None:
    with TlogWriter(tmp_path / "flight.tlog") as log:
        for boot_ms, late_us in ((1000, 4000), (1010, 0), (1020, 9000)):
            log.write(UNIX_US + boot_ms * 1000 + late_us, attitude(boot_ms))
            log.write_signals(signals(UNIX_US + boot_ms * 1000 + late_us))
    recording = read_recording(tmp_path / "flight.tlog")
    assert recording.time_s.tolist() == pytest.approx([1.004, 1.010, 1.029])
    assert recording.signals.command.shape == (3, 4)


def test_a_log_without_control_steps_is_a_failed_flight(tmp_path: Path) -> None:
    with TlogWriter(tmp_path / "flight.tlog") as log:
        log.write(UNIX_US, attitude(1000))
    with pytest.raises(FlightFailed, match="holds no control steps"):
        read_recording(tmp_path / "flight.tlog")
