"""A scripted autopilot: packs the messages that a vehicle would send, and reads what we answer."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import bundled, load
from kffa_offboard.config_log import make_companion
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.telemetry import TelemetryDecoder
from kffa_offboard.offboard.events import Signals
from kffa_offboard.offboard.service import Service, State

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


# --------------------------------------------------------------------------- talking to the daemon

CONFIG = load(bundled("demo-px4.toml"))
START_US = 1_700_000_000_000_000
LATE_US = 30_000  # age of a sample when it arrives


class ListLink:
    name = "test"
    keeps_frames_whole = True
    trouble = ""

    def __init__(self):
        self.sent = []

    def send(self, data):
        self.sent.append(data)
        return True

    def lock(self, source):
        pass


class Talk:
    """A session with a scripted PX4 in the air, its telemetry, and a ground station."""

    def __init__(self, config=CONFIG, **options):
        self.autopilot, self.ground = ScriptedAutopilot(), ScriptedAutopilot(255, 190)
        self.config, self.time_us = config, START_US
        self.link, self.signals = ListLink(), []
        self.session = Session(
            Service(config.service),
            self.link,
            Route(),
            companion=make_companion(config, Route()),
            observer=lambda time_us, item: self.signals.append(item) if isinstance(item, Signals) else None,
            **options,
        )
        self.hear(self.autopilot, ScriptedAutopilot.heartbeat(armed=True))

    def hear(self, sender, message):
        self.session.handle(self.time_us, read_frames(sender.pack(message))[0])

    def telemetry(self, seconds):
        """Attitude and position at 100 Hz, sampled `LATE_US` before they arrive; a heartbeat each second."""
        for k in range(round(seconds * 100)):
            self.time_us += 10_000
            self.session.advance(self.time_us)
            boot_ms = (self.time_us - START_US + 10_000_000 - LATE_US) // 1000
            self.hear(self.autopilot, ScriptedAutopilot.attitude(boot_ms))
            position = mavlink.MAVLink_local_position_ned_message(boot_ms, 0, 0, -5.0, 0, 0, 0)
            self.hear(self.autopilot, position)
            if k % 100 == 0:
                self.hear(self.autopilot, ScriptedAutopilot.heartbeat(armed=True))

    def sent(self, kind):
        messages = [message for data in self.link.sent for message in read_frames(data)]
        return [message for message in messages if message.get_type() == kind]

    def engage(self):
        """Take control in the air."""
        self.telemetry(3.0)
        flies = mavlink.MAV_LANDED_STATE_IN_AIR
        self.hear(self.autopilot, mavlink.MAVLink_extended_sys_state_message(0, flies))
        engage = mavlink.MAV_CMD_NAV_GUIDED_ENABLE, 0, 1.0, *[0.0] * 6
        self.hear(self.ground, mavlink.MAVLink_command_long_message(245, 191, *engage))
        assert self.session.service.state is State.ENGAGING

    def set(self, name, value):
        """Set a parameter: the value that is answered, and what is said."""
        self.link.sent.clear()
        self.hear(self.ground, mavlink.MAVLink_param_set_message(245, 191, name, value, 9))
        (answered,) = self.sent("PARAM_VALUE")
        return answered.param_value, "".join(said.text for said in self.sent("STATUSTEXT"))


@pytest.fixture
def new_talk():
    """Begins a conversation; its options are `Session`'s."""
    return Talk


@pytest.fixture
def talk():
    return Talk()
