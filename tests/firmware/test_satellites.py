"""Unmodified firmware loses its satellites while the position ring flies it in gusty wind."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.trials.metrics import read_truth

pytestmark = pytest.mark.timeout(900)

LOSS_S, END_S = 6.0, 20.0
"""After lift-off, and after the loss."""

NO_SATELLITES = {
    "px4": (b"EKF2_GPS_CTRL", struct.unpack("<f", struct.pack("<i", 0))[0], mavlink.MAV_PARAM_TYPE_INT32),
    "ardupilot": (b"SIM_GPS1_ENABLE", 0.0, mavlink.MAV_PARAM_TYPE_INT8),
}
REPORTS = (mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS, mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT)
PLACE = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS
TAKES_AWAY = {
    "px4": "failsafe: autopilot calls its position invalid",
    "ardupilot": "control given up: mode LAND",
}


def invalid_after(log: Path, since_s: float) -> float:
    """When the firmware first called its position invalid, simulated time, s."""
    for time_us, frame in read_tlog(log).frames():
        if time_us * 1e-6 > since_s and int.from_bytes(frame[7:10], "little") in REPORTS:
            message = mavlink.MAVLink(None).decode(bytearray(frame))
            if not message.flags & PLACE:
                return time_us * 1e-6
    return np.inf


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_without_satellites_nobody_flies_after_a_position_that_is_reckoned(
    firmware_binary: Callable[[str], Path],
    fly_in_lockstep: Callable[..., str],
    acting_bridge: Any,
    tmp_path: Path,
    autopilot: str,
) -> None:
    """PX4 stays in OFFBOARD by rates: half a minute after the loss the ring flew it in swings of 10 m."""

    class Jammed(acting_bridge):  # type: ignore[misc]
        pass

    name, value, kind = NO_SATELLITES[autopilot]
    Jammed.acts = [(LOSS_S, lambda system: [mavlink.MAVLink_param_set_message(system, 1, name, value, kind)])]
    segments = [
        {"type": "takeoff", "altitude_m": 3.0, "climb_rate_m_s": 1.0},
        {"type": "hold", "duration_s": 60.0},
    ]
    changes: dict[str, Any] = {"scenario": {"segment": segments}, "position": {"enabled": True}}
    output = "attitude" if autopilot == "ardupilot" else "rates"

    def over(bridge: Any) -> bool:
        return bool(Jammed.acted_s) and bridge.time_s > Jammed.acted_s[0] + END_S

    binary = firmware_binary(autopilot)
    fly_in_lockstep(autopilot, binary, tmp_path, output, changes, wind=True, over=over, bridge=Jammed)
    assert TAKES_AWAY[autopilot] in (tmp_path / "daemon.log").read_text(encoding="utf-8")
    (lost_s,) = Jammed.acted_s
    invalid_s = invalid_after(tmp_path / "flight.tlog", lost_s)
    assert 3.0 < invalid_s - lost_s < 9.0
    truth, until_s = read_truth(tmp_path / "flight-truth.csv"), invalid_s + 1.2
    during = (lost_s - 0.5 <= truth.time_s) & (truth.time_s < until_s)
    away = np.hypot(truth.x[during] - truth.x[during][0], truth.y[during] - truth.y[during][0]).max()
    tilt = np.hypot(truth.roll, truth.pitch)
    then = tilt[truth.time_s >= until_s].max()
    print(
        f"\n{autopilot}: invalid after {invalid_s - lost_s:.1f} s, {away:.2f} m away, "
        f"tilt {tilt[during].max():.3f} rad, then {then:.3f}"
    )
    assert away < 2.0 and tilt[during].max() < 0.12
    assert then < 0.12, "level on the way down"
