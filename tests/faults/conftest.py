"""The demonstration's vehicle, hovering, and a link with faults between it and the daemon; in lock-step.

In one process (`fly`), or over UDP through the proxy (`fly_over_udp`): then the vehicle has a thread of its
own. `settled` keeps a flight at the moment of engaging, of which any number of copies fly on.
"""

import copy
import copyreg
import struct
import threading
import time
from dataclasses import dataclass, field, replace
from functools import cache

import pytest

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.faults.barrier import BarrierFaults
from kffa_offboard.faults.check import violations
from kffa_offboard.faults.edit import decoded
from kffa_offboard.faults.line import FaultLine
from kffa_offboard.faults.link import FaultyLink
from kffa_offboard.faults.proxy import FaultProxy
from kffa_offboard.mavlink.commands import is_timesync_request
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import _LockStep
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard import events
from kffa_offboard.offboard.segments import Hold
from kffa_offboard.offboard.service import Service, State
from sim_vehicle import airframe, land_detector
from sim_vehicle import config as sim_config
from sim_vehicle.endpoints import parse_endpoint
from sim_vehicle.links import Links
from sim_vehicle.server import run_lockstep
from sim_vehicle.vehicle import SimulatedVehicle

SLOT_US = 10_000
HEIGHT = 5.0
AFTERWARDS_US = 250_000
SENDING = (State.ENGAGING, State.ENGAGED, State.RELEASING)


copyreg.pickle(struct.Struct, lambda packer: (struct.Struct, (packer.format,)))  # in pymavlink's messages


class Going:
    """Nobody asks the daemon to stop."""

    def is_set(self):
        return False


class InProcessLink:
    """The daemon's link in lock-step, with the vehicle right behind it."""

    name = "in-process"
    keeps_frames_whole = True
    trouble = ""
    descriptor = None

    def __init__(self, vehicle):
        self.vehicle = vehicle
        vehicle.add_peer("daemon")

    def take_news(self):
        return None

    def receive(self, timeout_s):
        vehicle = self.vehicle
        vehicle.advance(vehicle.time_us + SLOT_US)
        now = vehicle.time_us
        frames = [data for peer, data in vehicle.outgoing() if peer in (None, "daemon")]
        frames.append(vehicle.time_request("daemon"))
        return [Datagram(now, frame, "vehicle") for frame in frames]

    def send(self, data):
        self.vehicle.receive(data, "daemon")
        return True

    def lock(self, source):
        pass

    def close(self):
        pass


class Recorder:
    """What a flight log would hold of the frames that were sent."""

    def __init__(self):
        self.sent = []

    def write(self, time_us, frame):
        if frame[5] == 245:
            self.sent.append((time_us, frame))

    def write_signals(self, signals):
        pass

    def write_begin(self, time_us):
        pass

    def write_request(self, time_us, request):
        pass

    def write_report(self, time_us, report):
        pass

    def write_end(self, time_us, reason, frames_dropped):
        pass


def hovering(personality, changes):
    """The demonstration's vehicle at 5 m, in its own hold mode."""
    base = {
        "vehicle": {"seed": 0, "attitude_ready_s": 0.0, "position_ready_s": 0.0, "physics_dt_s": 0.005},
        "payload": {"schedule": []},
        "lockstep": {"answer_timeout_s": 60.0, "connect_timeout_s": 60.0},
    }
    for section, values in changes.items():
        base[section] = {**base.get(section, {}), **values}
    simulated = sim_config.load(bundled(f"demo-{personality}-vehicle.toml"), base)
    vehicle = SimulatedVehicle(simulated)
    rigid = vehicle.state.rigid.copy()
    rigid[2] = HEIGHT
    share = vehicle.body.hover_thrust() * vehicle.body.motor_max_thrust
    vehicle.state = replace(airframe.initial_state(rigid), motor_thrust=vehicle.state.motor_thrust + share)
    vehicle.firmware.armed = vehicle.firmware.flown = True
    vehicle.firmware.armed_at_us = -60_000_000
    vehicle.firmware._spool = 1.0  # of ArduCopter: its motors run
    vehicle.firmware.land = land_detector.LandState(False, 0.0, 0.0)
    vehicle.advance(SLOT_US)
    vehicle.firmware.set_custom_mode(4 << 16 | 5 << 24 if personality == "px4" else 9)
    vehicle.firmware.loiter()
    return vehicle


@cache
def daemon_config(personality, output):
    return load(
        bundled(f"demo-{personality}.toml"),
        Overrides(controller=None, output=output, arm=True, engage=True),
    )


@dataclass
class Flight:
    """One flight in faults: the vehicle hovers, the daemon takes over at once and holds."""

    personality: str = "px4"
    down: tuple = ()
    up: tuple = ()
    vehicle_changes: dict = field(default_factory=dict)
    settle_s: float = 1.0
    acts: dict = field(default_factory=dict)  # time [s] -> what is done to the vehicle
    seconds: float = 6.0
    changes: dict = field(default_factory=dict)  # of the service's settings
    scenario: tuple = (Hold(1000.0),)
    output: str | None = None
    heard: list = field(default_factory=list)
    states: list = field(default_factory=list)
    heights: list = field(default_factory=list)
    tilts: list = field(default_factory=list)
    in_hand_us: int = 0  # when control was last seen

    def begin(self):
        """Vehicle and settings; the session comes with the link."""
        daemon = daemon_config(self.personality, self.output)
        quick = replace(daemon.service.telemetry, settle_time_s=self.settle_s)
        self.settings = replace(daemon.service, scenario=self.scenario, telemetry=quick, **self.changes)
        self.vehicle = hovering(self.personality, self.vehicle_changes)
        self.recorder = Recorder()
        self.service = Service(self.settings)

    def connect(self, link):
        route = Route(245, 191)
        self.session = Session(
            self.service, link, route, recorder=self.recorder, observer=self.hear, compare_clocks=True
        )
        self.loop = _LockStep(self.session, Going())

    def hear(self, time_us, item):
        self.heard.append((time_us, item))

    def look(self):
        """Before each slot: what is done to the vehicle, and how it is."""
        now = self.vehicle.time_us * 1e-6
        for due in [due for due in self.acts if now >= due]:
            self.acts.pop(due)(self.vehicle)
        self.states.append((self.vehicle.time_us, self.service.state))
        rigid = self.vehicle.state.rigid
        self.heights.append(float(rigid[2]))
        self.tilts.append(float(abs(rigid[6:8]).max()))

    # ------------------------------------------------------------------- in one process

    def prepare(self):
        """Ready for the first slot."""
        self.begin()
        self.faults = BarrierFaults(FaultLine(self.down, seed=1), FaultLine(self.up, seed=2))
        self.link = FaultyLink(InProcessLink(self.vehicle), self.faults)
        self.connect(self.link)
        return self

    def go_on(self, until):
        """Slot by slot; when the daemon has ended, the vehicle flies on alone."""
        while not until():
            self.look()
            for datagram in self.link.receive(0.0):
                if not self.loop.ended:
                    for message in self.session.read(datagram):
                        self.loop.take(message)
        return self

    def fly(self):
        return self.prepare().until(self.seconds)

    def fly_on(self, seconds, down=(), up=(), acts=None):
        """A copy of this flight that goes on with other faults; times count from now."""
        began = self.vehicle.time_us * 1e-6
        for fault in (*down, *up):
            fault.start_s += began
        flight = self.copied(down, up)
        flight.acts = {began + at: act for at, act in (acts or {}).items()}
        return flight.go_on(lambda: flight.over(began + seconds))

    def copied(self, down=(), up=()):
        """A copy of this flight with other faults; times count from its beginning."""
        unchanging = (self.settings, self.vehicle.config)
        flight = copy.deepcopy(self, {id(value): value for value in unchanging})
        flight.faults.down, flight.faults.up = FaultLine(down, seed=1), FaultLine(up, seed=2)
        return flight

    def until(self, seconds):
        """This flight goes on to that time."""
        return self.go_on(lambda: self.vehicle.time_us * 1e-6 >= seconds)

    def over(self, end_s):
        """The time is over, or control was given up a while ago."""
        now_us = self.vehicle.time_us
        if self.service.state in SENDING:
            self.in_hand_us = now_us
        return now_us >= end_s * 1e6 or now_us - self.in_hand_us > AFTERWARDS_US

    # ------------------------------------------------------------------------- over UDP

    def fly_over_udp(self):
        """The same with two sockets each, a proxy with the faults between them, and the daemon's own loop."""
        self.begin()
        link = open_link("udpin:127.0.0.1:0", lambda: time.monotonic_ns() // 1000)
        port = int(link.name.rpartition(":")[2])
        proxy = FaultProxy(port, FaultLine(self.down, seed=1), FaultLine(self.up, seed=2), lockstep=True)
        self.connect(link)
        advance = self.vehicle.advance

        def observed(until_us):
            self.look()
            advance(until_us)

        self.vehicle.advance = observed
        with (
            proxy.running(),
            Links([parse_endpoint(f"udpout:127.0.0.1:{proxy.vehicle_port}", False)]) as links,
        ):
            thread = threading.Thread(
                target=run_lockstep, args=(self.vehicle, links, self.seconds), daemon=True
            )
            thread.start()
            while thread.is_alive():
                for datagram in link.receive(0.1):
                    for message in self.session.read(datagram):
                        self.take(message)
            thread.join()
        link.close()
        return self

    def take(self, message):
        if not self.loop.ended:
            self.loop.take(message)
        elif is_timesync_request(message):  # the daemon has ended, the vehicle flies on
            self.session.answer_timesync(0, message, message.ts1)

    # ---------------------------------------------------------------------- what was seen

    @property
    def violations(self):
        return violations(self.settings, self.heard, self.recorder.sent)

    @property
    def texts(self):
        return [item.text for _, item in self.heard if isinstance(item, events.Announce)]

    @property
    def targets(self):
        return [(time_us, item) for time_us, item in self.heard if isinstance(item, events.AttitudeTarget)]

    @property
    def status_texts(self):
        """STATUSTEXT on the wire, joined."""
        messages = [decoded(data) for _, data in self.recorder.sent if data[7] == 253]
        return "".join(message.text for message in messages)

    @property
    def engaged_s(self):
        return next((t * 1e-6 for t, state in self.states if state is State.ENGAGED), None)

    @property
    def released_s(self):
        """When control was given up; None if it was kept."""
        began = self.engaged_s
        if began is None:
            return None
        return next((t * 1e-6 - 0.01 for t, s in self.states if t * 1e-6 > began and s not in SENDING), None)

    @property
    def held(self):
        """Numbers of the slots in control."""
        return [k for k, (_, state) in enumerate(self.states) if state is State.ENGAGED]


@cache
def settled(personality, loaded_kg=0.0):
    """A flight that has been engaged for half a second, perhaps with a load."""
    flight = Flight(personality, settle_s=0.2).prepare()
    if loaded_kg > 0.0:
        flight.vehicle.set_load(loaded_kg)
    flight.go_on(lambda: (flight.engaged_s or 1e9) + 0.5 <= flight.vehicle.time_us * 1e-6)
    return flight


@pytest.fixture(scope="session")
def fault_flight():
    return Flight


@pytest.fixture(scope="session")
def settled_flight():
    return settled
