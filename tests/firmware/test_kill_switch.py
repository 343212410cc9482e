"""A pilot stops the motors of unmodified firmware in flight, and lets them go again when it has fallen."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.trials.metrics import read_truth

pytestmark = pytest.mark.timeout(900)

KILLED_S, LET_S, END_S = 6.0, 7.0, 9.5
"""After lift-off; 3 m take 0.8 s."""

MOTOR_ESTOP, LOW, HIGH = 31, 0, 2
"""AUX_FUNC and switch positions (RC_Channel.h)."""


def estop(position: int) -> Callable[[int], list[Any]]:
    """ArduCopter's emergency stop."""
    aux = mavlink.MAV_CMD_DO_AUX_FUNCTION
    return lambda system: [
        mavlink.MAVLink_command_long_message(system, 1, aux, 0, MOTOR_ESTOP, position, 0, 0, 0, 0, 0)
    ]


def test_arducopter_that_was_stopped_and_has_fallen_does_not_jump_when_it_is_let_again(
    firmware_binary: Callable[[str], Path],
    fly_in_lockstep: Callable[..., str],
    acting_bridge: Any,
    tmp_path: Path,
) -> None:
    """With the law's own thrust in the last setpoint, followed for half a second, it rose by 0.7 m."""

    class Stopped(acting_bridge):  # type: ignore[misc]
        pass

    Stopped.acts = [(KILLED_S, estop(HIGH)), (LET_S, estop(LOW))]
    segments = [
        {"type": "takeoff", "altitude_m": 3.0, "climb_rate_m_s": 1.0},
        {"type": "hold", "duration_s": 60.0},
    ]

    def over(bridge: Any) -> bool:
        return bridge.time_s > Stopped.lifted_s + END_S

    binary = firmware_binary("ardupilot")
    changes = {"scenario": {"segment": segments}}
    fly_in_lockstep("ardupilot", binary, tmp_path, "attitude", changes, over=over, bridge=Stopped)
    said = (tmp_path / "daemon.log").read_text(encoding="utf-8")
    assert "failsafe:" in said
    truth = read_truth(tmp_path / "flight-truth.csv")
    killed_s, let_s = Stopped.acted_s
    fallen, after = truth.time_s > killed_s + 0.9, truth.time_s > let_s
    print(f"\nheight after the fall {truth.z[fallen].max():.2f} m, let again {truth.z[after].max():.2f} m")
    assert truth.z[fallen].max() < 0.3
