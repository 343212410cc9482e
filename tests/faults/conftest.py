"""The demonstration's vehicle, hovering, and a link with faults between it and the daemon; in lock-step."""

import threading
from dataclasses import dataclass, field, replace

import pytest

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.faults.edit import decoded
from kffa_offboard.faults.line import FaultLine
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import run_lock_step
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard import events
from kffa_offboard.offboard.segments import Hold
from kffa_offboard.offboard.service import Service, State
from sim_vehicle import airframe, land_detector
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

SLOT_US = 10_000
HEIGHT = 5.0
SENDING = (State.ENGAGING, State.ENGAGED, State.RELEASING)


class FaultyLink:
    """The daemon's link in lock-step; what passes goes through the faults, the barrier does not."""

    name = "in-process"
    keeps_frames_whole = True
    trouble = ""

    def __init__(self, vehicle, down, up, before_slot):
        self.vehicle = vehicle
        self.down = FaultLine(down, seed=1)
        self.up = FaultLine(up, seed=2)
        self.sent = []
        self._before_slot = before_slot
        vehicle.add_peer("daemon")

    def receive(self, timeout_s):
        vehicle = self.vehicle
        self._before_slot()
        for data in self.up.take(vehicle.time_us):
            vehicle.receive(data, "daemon")
        vehicle.advance(vehicle.time_us + SLOT_US)
        now = vehicle.time_us
        for peer, data in vehicle.outgoing():
            if peer in (None, "daemon"):
                self.down.put(now, data)
        frames = [*self.down.take(now), vehicle.time_request("daemon")]
        return [Datagram(now, frame, "vehicle") for frame in frames]

    def send(self, data):
        self.sent.append((self.vehicle.time_us, data))
        message = decoded(data)
        if message.get_type() == "TIMESYNC" and message.tc1 != 0:  # the barrier's answer
            self.vehicle.receive(data, "daemon")
        else:
            self.up.put(self.vehicle.time_us, data)
        return True

    def lock(self, source):
        pass

    def close(self):
        pass


def hovering(personality, changes):
    """The demonstration's vehicle at 5 m, in its own hold mode."""
    base = {
        "vehicle": {"seed": 0, "attitude_ready_s": 0.0, "position_ready_s": 0.0, "physics_dt_s": 0.005},
        "payload": {"schedule": []},
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
    scenario: tuple = (Hold(1000.0),)
    output: str | None = None
    heard: list = field(default_factory=list)
    states: list = field(default_factory=list)
    heights: list = field(default_factory=list)
    tilts: list = field(default_factory=list)

    def fly(self):
        daemon = load(
            bundled(f"demo-{self.personality}.toml"),
            Overrides(controller=None, output=self.output, arm=True, engage=True),
        )
        quick = replace(daemon.service.telemetry, settle_time_s=self.settle_s)
        settings = replace(daemon.service, scenario=self.scenario, telemetry=quick)
        self.settings = settings
        self.vehicle = hovering(self.personality, self.vehicle_changes)
        stop = threading.Event()
        acts = dict(self.acts)

        def before_slot():
            now = self.vehicle.time_us * 1e-6
            for due in [due for due in acts if now >= due]:
                acts.pop(due)(self.vehicle)
            self.states.append((self.vehicle.time_us, self.session.service.state))
            rigid = self.vehicle.state.rigid
            self.heights.append(float(rigid[2]))
            self.tilts.append(float(abs(rigid[6:8]).max()))
            if now >= self.seconds:
                raise Over

        self.link = FaultyLink(self.vehicle, self.down, self.up, before_slot)
        self.service = Service(settings)
        self.session = Session(
            self.service,
            self.link,
            Route(daemon.link.system_id, daemon.link.component_id),
            observer=lambda time_us, item: self.heard.append((time_us, item)),
            compare_clocks=True,
        )
        try:
            run_lock_step(self.session, lambda: self.vehicle.time_us, stop)
            while True:
                self.link.receive(0.0)  # the daemon has ended, the vehicle flies on
        except Over:
            pass
        return self

    @property
    def texts(self):
        return [item.text for _, item in self.heard if isinstance(item, events.Announce)]

    @property
    def targets(self):
        return [(time_us, item) for time_us, item in self.heard if isinstance(item, events.AttitudeTarget)]

    @property
    def status_texts(self):
        """STATUSTEXT on the wire, joined."""
        messages = [decoded(data) for _, data in self.link.sent if data[7] == 253]
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


class Over(Exception):
    """The time of the flight is over."""


@pytest.fixture(scope="session")
def fault_flight():
    return Flight
