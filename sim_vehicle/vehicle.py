"""The simulated vehicle: physics, firmware and MAVLink put together, without clock and without sockets.

Bytes go in with `receive`, simulated time goes on with `advance`, bytes come out with `outgoing`. All
randomness comes from generators seeded by the configuration, so the same bytes at the same simulated
times give the same answers, bit for bit.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable
from typing import NamedTuple

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle import airframe, faults
from sim_vehicle.config import SimConfig
from sim_vehicle.firmware import Firmware, Readiness
from sim_vehicle.frames import wrapped
from sim_vehicle.guidance import Estimate
from sim_vehicle.mavlink_server import MavlinkServer
from sim_vehicle.personality_ardupilot import ArduCopterFirmware
from sim_vehicle.personality_px4 import Px4Firmware
from sim_vehicle.plant import Plant
from sim_vehicle.signing import Signing
from sim_vehicle.truth import TruthRecorder


class _Datagram(NamedTuple):
    due_us: int
    peer: Hashable | None
    data: bytes


class _DelayLine:
    """Datagrams on their way: late by a delay and some jitter, never overtaking each other."""

    def __init__(self, delay_s: float, jitter_s: float, generator: np.random.Generator) -> None:
        self._delay_us = delay_s * 1e6
        self._jitter_us = jitter_s * 1e6
        self._generator = generator
        self._queue: deque[_Datagram] = deque()
        self._last_us = 0

    def put(self, now_us: int, peer: Hashable | None, data: bytes) -> None:
        extra = self._jitter_us * self._generator.random() if self._jitter_us > 0.0 else 0.0
        self._last_us = max(self._last_us, now_us + round(self._delay_us + extra))
        self._queue.append(_Datagram(self._last_us, peer, data))

    def take(self, now_us: int) -> list[_Datagram]:
        due = []
        while self._queue and self._queue[0].due_us <= now_us:
            due.append(self._queue.popleft())
        return due


class SimulatedVehicle:
    """One vehicle; with `signing`, its MAVLink is signed (the only thing that knows another clock).

    Attributes
    ----------
    plant : the flying body
    firmware, server : the autopilot and its MAVLink side
    """

    def __init__(self, config: SimConfig, signing: Signing | None = None) -> None:
        self.config = config
        seeds = np.random.SeedSequence(config.vehicle.seed).spawn(4)
        self._sensor_generator, wind, up, down = (np.random.default_rng(s) for s in seeds)
        self.plant = Plant(config, wind)
        self.firmware = _firmware(config, self.plant.body)
        self.server = MavlinkServer(self.firmware, config.vehicle.system_id, 1.0 / self.plant.dt, signing)
        link = config.link
        self._uplink = _DelayLine(link.command_delay_s, link.jitter_s, up)
        self._downlink = _DelayLine(link.telemetry_delay_s, link.jitter_s, down)
        self._deviations = airframe.deviations(_noise(config))
        self._climb_rate = 0.0
        self._estimate = self._sense()
        self._record()

    @property
    def time_us(self) -> int:
        """Simulated time since power-up [us]."""
        return self.plant.time_us

    @property
    def body(self) -> airframe.AirframeParameters:
        """What flies."""
        return self.plant.body

    @property
    def state(self) -> airframe.AirframeState:
        """True state of the airframe; may be replaced before the first `advance`."""
        return self.plant.state

    @state.setter
    def state(self, state: airframe.AirframeState) -> None:
        self.plant.state = state

    @property
    def truth(self) -> TruthRecorder:
        """Recorder of true states and events."""
        return self.plant.truth

    def set_load(self, mass_kg: float) -> None:
        """Carry a load of `mass_kg` from now on; 0 drops it. ValueError if there can be no such load."""
        self.plant.set_load(mass_kg)

    # ------------------------------------------------------------------------------ the border

    def add_peer(self, key: Hashable) -> None:
        """Send telemetry to `key` from now on, although nothing came from it yet."""
        self.server.add_peer(key)

    def remove_peer(self, key: Hashable) -> None:
        """Forget a peer that has gone."""
        self.server.remove_peer(key)

    def time_request(self, peer: Hashable) -> bytes:
        """The lock-step barrier's TIMESYNC request to a peer, with simulated time in ns; not delayed."""
        return self.server.add_peer(peer).pack_ahead(mavlink.MAVLink_timesync_message(0, self.time_us * 1000))

    def receive(self, data: bytes, source: Hashable) -> None:
        """A datagram from a peer. It takes effect link.command_delay_s of simulated time from now."""
        self._uplink.put(self.time_us, source, data)

    def outgoing(self) -> list[tuple[Hashable | None, bytes]]:
        """Datagrams that have arrived at their peers by now; None stands for everybody."""
        return [(datagram.peer, datagram.data) for datagram in self._downlink.take(self.time_us)]

    def advance(self, until_us: int) -> None:
        """Let simulated time go on, in whole physics steps, to `until_us` at most."""
        while self.time_us + self.plant.step_us <= until_us:
            self._step()

    # -------------------------------------------------------------------------------- one step

    def _step(self) -> None:
        """Commands and firmware at the present time, physics to the next, telemetry from there."""
        for datagram in self._uplink.take(self.time_us):
            self.server.time_us = self.time_us
            self.server.receive(datagram.peer, datagram.data)
        self.server.run_due(self.time_us)
        commands = self.firmware.step(self._estimate, self.plant.dt)
        for action in self.firmware.gripper_requests:
            self.plant.work_gripper(action)
        self.firmware.gripper_requests.clear()
        self.plant.step(np.array(commands))
        self._estimate = self._sense()
        for peer, data in self.server.emit(self._estimate):
            self._downlink.put(self.time_us, peer, data)
        for text in self.firmware.events:
            self.truth.event(self.time_us, text)
        self.firmware.events.clear()
        if self.truth.due(self.time_us):
            self._record()

    def _sense(self) -> Estimate:
        """As `airframe.measure`, in floats."""
        rigid = self.plant.state.rigid
        climb_rate = float(rigid[5])
        acceleration = (climb_rate - self._climb_rate) / self.plant.dt
        self._climb_rate = climb_rate
        noisy = airframe.with_noise(self._deviations, rigid, self._sensor_generator)
        lost = faults.without_satellites(self.config.faults, self.time_us * 1e-6)
        if lost is not None:
            noisy[[0, 1, 3, 4]] += lost
        x, y, z, vx, vy, vz, roll, pitch, yaw, p, q, r = noisy.tolist()
        euler = (wrapped(roll), wrapped(pitch), wrapped(yaw))
        return Estimate(
            self.time_us, (x, y, z), (vx, vy, vz), euler, (p, q, r), acceleration, satellites=lost is None
        )

    def _record(self) -> None:
        self.plant.record(self.firmware.armed, self.firmware.mode_name)


def _firmware(config: SimConfig, body: airframe.AirframeParameters) -> Firmware:
    readiness = Readiness(
        round(config.vehicle.attitude_ready_s * 1e6), round(config.vehicle.position_ready_s * 1e6)
    )
    kind = Px4Firmware if config.vehicle.personality == "px4" else ArduCopterFirmware
    return kind(config.make_parameters(), body, readiness)


def _noise(config: SimConfig) -> airframe.SensorNoise:
    s = config.sensors
    return airframe.SensorNoise(
        attitude=s.attitude_noise_rad,
        body_rate=s.body_rate_noise_rad_s,
        altitude=s.altitude_noise_m,
        climb_rate=s.climb_rate_noise_m_s,
        horizontal_position=s.horizontal_position_noise_m,
        horizontal_velocity=s.horizontal_velocity_noise_m_s,
    )
