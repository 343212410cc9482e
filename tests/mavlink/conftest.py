"""A scripted autopilot: packs the messages that a vehicle would send, and reads what we answer."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.telemetry import TelemetryDecoder

PX4_OFFBOARD = 6 << 16
PX4_HOLD = 3 << 24 | 4 << 16


class ScriptedAutopilot:
    """Packs messages of one system and component; decodes frames of anybody."""

    def __init__(self, system=1, component=1):
        self._packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)

    def pack(self, *messages):
        frames = []
        for message in messages:
            frames.append(bytes(message.pack(self._packer)))
            self._packer.seq = (self._packer.seq + 1) % 256
        return b"".join(frames)

    def over_the_wire(self, message):
        """The message as a receiver sees it, with its header."""
        return read_frames(self.pack(message))[0]

    @staticmethod
    def heartbeat(
        autopilot=mavlink.MAV_AUTOPILOT_PX4,
        custom_mode=PX4_HOLD,
        armed=False,
        kind=mavlink.MAV_TYPE_QUADROTOR,
    ):
        base_mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        return mavlink.MAVLink_heartbeat_message(kind, autopilot, base_mode, custom_mode, 4, 3)

    @staticmethod
    def attitude(time_boot_ms=0, roll=0.0, pitch=0.0, yaw=0.0, p=0.0, q=0.0, r=0.0):
        return mavlink.MAVLink_attitude_message(time_boot_ms, roll, pitch, yaw, p, q, r)

    @staticmethod
    def timesync(ts1_ns, tc1_ns=0):
        return mavlink.MAVLink_timesync_message(tc1_ns, ts1_ns)


def read_frames(data):
    parser = mavlink.MAVLink(None)
    return parser.parse_buffer(data) or []


@pytest.fixture
def autopilot():
    return ScriptedAutopilot()


@pytest.fixture
def scripted():
    """The class, for tests that need other systems and components too."""
    return ScriptedAutopilot


@pytest.fixture
def read():
    return read_frames


@pytest.fixture
def route():
    return Route()


@pytest.fixture
def telemetry():
    return TelemetryDecoder()
