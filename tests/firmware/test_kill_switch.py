"""A pilot stops the motors of unmodified firmware in flight, and lets them go again when it has fallen."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.trials.metrics import read_truth

pytestmark = pytest.mark.timeout(900)

KILLED_S, LET_S, END_S = 6.0, 7.0, 9.5
"""After lift-off; 3 m take 0.8 s."""

MOTOR_ESTOP, LOW, HIGH = 31, 0, 2
"""AUX_FUNC and switch positions (RC_Channel.h)."""
SCENARIO = {
    "scenario": {
        "segment": [
            {"type": "takeoff", "altitude_m": 3.0, "climb_rate_m_s": 1.0},
            {"type": "hold", "duration_s": 60.0},
        ]
    }
}
LEVEL = 7
"""Type mask of SET_ATTITUDE_TARGET."""


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

    def over(bridge: Any) -> bool:
        return bridge.time_s > Stopped.lifted_s + END_S

    binary = firmware_binary("ardupilot")
    fly_in_lockstep("ardupilot", binary, tmp_path, "attitude", SCENARIO, over=over, bridge=Stopped)
    said = (tmp_path / "daemon.log").read_text(encoding="utf-8")
    assert "failsafe:" in said
    truth = read_truth(tmp_path / "flight-truth.csv")
    killed_s, let_s = Stopped.acted_s
    fallen, after = truth.time_s > killed_s + 0.9, truth.time_s > let_s
    print(f"\nheight after the fall {truth.z[fallen].max():.2f} m, let again {truth.z[after].max():.2f} m")
    assert truth.z[fallen].max() < 0.3


def integer(value: int) -> float:
    """As PX4 wants it in PARAM_SET: its bytes."""
    return float(struct.unpack("<f", struct.pack("<i", value))[0])


def joystick(pitch: int, roll: int, throttle: int, yaw: int) -> Callable[[int], list[Any]]:
    """MANUAL_CONTROL, thousandths."""
    return lambda system: [mavlink.MAVLink_manual_control_message(system, pitch, roll, throttle, yaw, 0)]


def gesture_may_kill(system: int) -> list[Any]:
    """Both sticks down and inwards for 0.2 s, of a joystick."""
    return [
        mavlink.MAVLink_param_set_message(system, 1, b"MAN_KILL_GEST_T", 0.2, mavlink.MAV_PARAM_TYPE_REAL32),
        mavlink.MAVLink_param_set_message(
            system, 1, b"COM_RC_IN_MODE", integer(1), mavlink.MAV_PARAM_TYPE_INT32
        ),
    ]


def test_px4_that_is_killed_gets_no_more_than_what_carried_it(
    firmware_binary: Callable[[str], Path],
    fly_in_lockstep: Callable[..., str],
    acting_bridge: Any,
    tmp_path: Path,
) -> None:
    """Its estimate does not notice the impact and falls on: the law asked for 0.95 for 0.7 s more."""

    class Killed(acting_bridge):  # type: ignore[misc]
        pass

    neutral = [(3.5 + 0.05 * k, joystick(0, 0, 500, 0)) for k in range(50)]
    kill = [(KILLED_S + 0.05 * k, joystick(-1000, 1000, 0, -1000)) for k in range(40)]
    Killed.acts = [(3.0, gesture_may_kill), *neutral, *kill]

    def over(bridge: Any) -> bool:
        return bridge.time_s > Killed.lifted_s + END_S

    binary = firmware_binary("px4")
    fly_in_lockstep("px4", binary, tmp_path, "rates", SCENARIO, over=over, bridge=Killed)
    said = (tmp_path / "daemon.log").read_text(encoding="utf-8")
    assert "kill switch: the motors are stopped" in said and "failsafe: fell to the ground" in said
    sent = [
        (time_us * 1e-6 - Killed.lifted_s, mavlink.MAVLink(None).decode(bytearray(frame)))
        for time_us, frame in read_tlog(tmp_path / "flight.tlog").frames()
        if int.from_bytes(frame[7:10], "little") == mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET
    ]
    ended_s, last = sent[-1]
    print(f"\nended {ended_s - KILLED_S:.2f} s after the gesture began, thrust {last.thrust:.3f}")
    assert ended_s < KILLED_S + 1.5
    assert last.type_mask == LEVEL and 0.35 < last.thrust < 0.45
