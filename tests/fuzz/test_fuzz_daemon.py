"""Well-formed frames with anything in them, of anybody, to the daemon and to the simulated autopilot."""

import gc
import math

from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.config_log import make_companion
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.component import FrameParser, Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.offboard.service import Service
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

CONFIG = load(bundled("demo-px4.toml"), Overrides(arm=True, engage=True, trust_parameters=True))
START_US = 1_700_000_000_000_000
HEARTBEAT = mavlink.MAVLink_heartbeat_message(2, 12, 128 + 1, 6 << 16, 4, 3)


def budget(few, many):
    """How many examples: in CI, in the long mode."""

    def mark(function):
        function.budget = (few, many)
        return function

    return mark


class ListLink:
    name, trouble, keeps_frames_whole = "test", "", True

    def __init__(self):
        self.sent = []

    def send(self, data):
        self.sent.append(data)
        return True

    def lock(self, source):
        pass


class Daemon:
    """The daemon with its real service, and what it put out."""

    def __init__(self):
        self.link, self.targets, self.time_us = ListLink(), [], START_US
        self.vehicle = mavlink.MAVLink(None, 1, 1)
        self.session = Session(
            Service(CONFIG.service),
            self.link,
            Route(),
            companion=make_companion(CONFIG, Route()),
            observer=self._observe,
            compare_clocks=True,
        )

    def _observe(self, time_us, item):
        if isinstance(item, AttitudeTarget):
            self.targets.append(item)

    def hear(self, data, source="vehicle", stranger=False):
        """As the real-time loop."""
        for message in self.session.read(Datagram(self.time_us, data, source, stranger)):
            self.session.handle(self.time_us, message)
            self.session.answer_timesync(self.time_us, message, self.time_us * 1000)
        self.session.report_notices(self.time_us)

    def fly(self, seconds):
        """Good telemetry for a while; setpoints may follow from it."""
        for k in range(round(seconds * 100)):
            self.time_us += 10_000
            boot_ms = (self.time_us - START_US) // 1000 + 10_000
            wobble = 1e-4 * math.sin(self.time_us * 1e-5)
            messages = [
                mavlink.MAVLink_attitude_message(boot_ms, wobble, 0, 0, 0, 0, 0),
                mavlink.MAVLink_local_position_ned_message(boot_ms, 0, 0, -5.0 + wobble, 0, 0, 0),
            ]
            if k % 50 == 0:
                messages.append(HEARTBEAT)
            self.hear(b"".join(bytes(message.pack(self.vehicle)) for message in messages))

    def assert_sane(self):
        for target in self.targets:
            numbers = (target.thrust, *(target.body_rates or ()), *(target.attitude or ()))
            assert all(math.isfinite(number) for number in numbers)
            assert 0.0 <= target.thrust <= 1.0
        assert self.session.refusal is None


@budget(25, 1_500)
def test_whatever_well_formed_frames_say_the_daemon_neither_fails_nor_sends_nonsense(hostile, examples):
    def check(data):
        daemon = Daemon()
        try:
            daemon.hear(bytes(HEARTBEAT.pack(daemon.vehicle)))
            daemon.fly(data.draw(st.sampled_from([0.0, 0.1, 1.3])))
            for _ in range(data.draw(st.integers(1, 5))):
                stranger = data.draw(st.integers(0, 9)) == 0
                daemon.hear(data.draw(hostile.streams()), stranger=stranger)
                daemon.time_us += data.draw(st.sampled_from([0, 1, 10_000, 300_000]))
                daemon.session.advance(daemon.time_us)
                daemon.fly(0.03)
        except UserError as error:
            assert "not supported" in str(error)  # it says that it is another kind of vehicle
            assert "\n" not in str(error)
        daemon.assert_sane()

    hostile.run(check, examples)


@budget(25, 1_500)
def test_the_simulated_autopilot_takes_any_well_formed_frames(hostile, examples):
    def check(data):
        personality = data.draw(st.sampled_from(["px4", "ardupilot"]))
        vehicle = SimulatedVehicle(sim_config.build({"vehicle": {"personality": personality}}, "test"))
        for _ in range(data.draw(st.integers(1, 5))):
            vehicle.receive(data.draw(hostile.streams()), data.draw(st.sampled_from("ab")))
            vehicle.advance(vehicle.time_us + 25_000)
            assert all(datagram for _, datagram in vehicle.outgoing())
        assert math.isfinite(float(vehicle.state.rigid.sum()))

    hostile.run(check, examples)


def objects_after(daemon, frames):
    for frame in frames:
        daemon.time_us += 500
        daemon.hear(frame)
    daemon.session.advance(daemon.time_us)
    daemon.link.sent.clear()
    daemon.targets.clear()
    gc.collect()
    return len(gc.get_objects())


def test_nothing_grows_with_the_number_of_hostile_messages(hostile):
    """Invented senders, names, reasons and commands, each another one."""
    daemon = Daemon()
    daemon.hear(bytes(HEARTBEAT.pack(daemon.vehicle)))
    daemon.fly(0.2)
    seven = bytes(28)

    def flood(first):
        for k in range(first, first + 600):
            ids = (k % 254 + 2, k % 250 + 1)
            ours = bytes((245, 191))
            yield hostile.frame(76, seven + k.to_bytes(2, "little") + ours + bytes(1), ids)
            yield hostile.frame(23, bytes(4) + ours + f"NAME_{k}".encode().ljust(16, b"\0") + b"\x09", ids)
            yield hostile.frame(84, bytes(48) + k.to_bytes(2, "little") + ours + b"\x01", ids)
            yield hostile.frame(82, bytes(36) + b"\x01\x01\x80", ids)
            yield hostile.frame(0, k.to_bytes(4, "little") + b"\x02\x03\x51\x04\x03", (1, 1))
            yield hostile.frame(253, b"\x04" + f"text {k}".encode().ljust(50, b"\0") + bytes((k % 256, 0, 7)))
            yield hostile.frame(22, bytes(8) + f"P{k}".encode().ljust(16, b"\0") + b"\x09")

    objects_after(daemon, flood(0))
    before = objects_after(daemon, flood(1000))
    after = objects_after(daemon, flood(3000))
    assert after - before < 300


def test_frames_of_the_parser_are_what_was_built(hostile):
    """The builder of these tests is right: pymavlink takes its frames."""
    parser = FrameParser(True)
    for number, name in ((0, "HEARTBEAT"), (76, "COMMAND_LONG"), (253, "STATUSTEXT")):
        (message,) = parser.parse(Datagram(0, hostile.frame(number, b"\x01"), None))
        assert message.get_type() == name
