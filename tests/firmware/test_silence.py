"""Telemetry falls silent for half a second after a drop, on unmodified firmware: level, and on it goes."""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.bridge import Bridge
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.trials.metrics import read_truth

pytestmark = pytest.mark.timeout(900)

HEIGHT_M, PICKUP_S, DROP_S, END_S = 3.0, 6.0, 8.0, 11.0
"""Times are seconds since lift-off."""

BEGIN_S, SILENCE_S = DROP_S + 0.3, 0.5
HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
POSITION = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
SAMPLES = (mavlink.MAVLINK_MSG_ID_ATTITUDE, POSITION)
OUTPUT = {"ardupilot": "attitude", "px4": "rates"}
LEVEL, RATES = 7, 128
"""Type masks of SET_ATTITUDE_TARGET."""


def number_of(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little")


class DeafBridge(Bridge):
    """Loses the firmware's samples for a while after the load has left: `silent`, s of simulated time."""

    silent: tuple[float, float] = (np.inf, np.inf)
    ground_m: float = 0.0
    armed = False

    def _hear_firmware(self) -> bool:
        answered = super()._hear_firmware()
        for _, frame in self._to_daemon:
            if number_of(frame) == HEARTBEAT:
                self.armed = bool(frame[16] & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
            if number_of(frame) == POSITION and self.silent[0] == np.inf:
                (down,) = struct.unpack_from("<f", frame, 22)
                if not self.armed:  # an estimate that is settling wanders
                    self.ground_m = -down
                if -down - self.ground_m > 0.3:
                    type(self).silent = (self.time_s + BEGIN_S, self.time_s + BEGIN_S + SILENCE_S)
        if self.silent[0] <= self.time_s < self.silent[1]:
            self._to_daemon = deque(item for item in self._to_daemon if number_of(item[1]) not in SAMPLES)
        return answered


def setpoints(log: Path) -> list[tuple[float, Any]]:
    """SET_ATTITUDE_TARGETs of the daemon and when they went out, s of simulated time."""
    parser = mavlink.MAVLink(None)
    wanted = mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET
    frames = ((t, frame) for t, frame in read_tlog(log).frames() if number_of(frame) == wanted)
    return [(t * 1e-6, parser.decode(bytearray(frame))) for t, frame in frames]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_firmware_levels_while_the_daemon_is_blind_and_follows_it_again(
    firmware_binary: Callable[[str], Path],
    fly_in_lockstep: Callable[..., str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    autopilot: str,
) -> None:
    monkeypatch.setattr(DeafBridge, "silent", DeafBridge.silent)
    changes = {
        "scenario": {
            "segment": [
                {"type": "takeoff", "altitude_m": HEIGHT_M, "climb_rate_m_s": 1.0},
                {"type": "hold", "duration_s": END_S - HEIGHT_M},
                {"type": "land", "descent_rate_m_s": 1.0},
            ]
        },
        "sequence": {"disarm_timeout_s": 2.0},
        "telemetry": {"timeout_s": 0.8, "position_timeout_s": 0.8},
    }
    word = fly_in_lockstep(
        autopilot,
        firmware_binary(autopilot),
        tmp_path,
        OUTPUT[autopilot],
        changes,
        bridge=DeafBridge,
        load_s=(PICKUP_S, DROP_S),
    )
    truth, sent = read_truth(tmp_path / "flight-truth.csv"), setpoints(tmp_path / "flight.tlog")
    begin, end = DeafBridge.silent
    blind = [message for t, message in sent if begin + 0.15 < t <= end]
    assert 1 <= len(blind) <= 4, "one in 0.1 s"
    # PX4 would not notice an attitude among body rates for half a second, nor rates after it.
    kind = RATES if autopilot == "px4" else LEVEL
    assert {message.type_mask for message in blind} == {kind}
    assert {message.type_mask for t, message in sent if end + 0.1 < t < end + 1.0} == {kind}
    during = (begin <= truth.time_s) & (truth.time_s < end + 1.0)
    tilt, height = np.hypot(truth.roll, truth.pitch)[during], truth.z[during]
    assert tilt.max() < 0.1, word
    assert np.abs(height - HEIGHT_M).max() < 0.3
    assert abs(height[-1] - HEIGHT_M) < 0.1
    assert truth.z[-1] < 0.05
