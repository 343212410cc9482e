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

from sim_vehicle import airframe, environment
from sim_vehicle.config import SimConfig
from sim_vehicle.firmware import Firmware, Readiness
from sim_vehicle.guidance import Estimate
from sim_vehicle.mavlink_server import MavlinkServer
from sim_vehicle.personality_ardupilot import ArduCopterFirmware
from sim_vehicle.personality_px4 import Px4Firmware
from sim_vehicle.proximity import Proximity
from sim_vehicle.truth import TruthRecorder

AIRBORNE_HEIGHT = 0.1
"""The airborne clock of the payload schedule starts when the vehicle is first this high [m]."""


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
    """One vehicle.

    Attributes
    ----------
    time_us : simulated time since power-up [us]
    state : true state of the airframe; may be replaced before the first `advance`
    firmware, server : the autopilot and its MAVLink side
    truth : recorder of true states and events
    """

    def __init__(self, config: SimConfig) -> None:
        self.config = config
        self.time_us = 0
        self.body = airframe.AirframeParameters(
            profile=config.vehicle.profile,
            drag=config.vehicle.drag_n_s_m,
            load_offset=config.payload.offset_m,
            proximity=_proximity(config),
        )
        self.state = airframe.initial_state()
        self.truth = TruthRecorder()
        self.firmware = _firmware(config, self.body)
        self._step_us = round(config.vehicle.physics_dt_s * 1e6)
        self._dt = self._step_us * 1e-6
        self.server = MavlinkServer(self.firmware, config.vehicle.system_id, 1.0 / self._dt)
        seeds = np.random.SeedSequence(config.vehicle.seed).spawn(4)
        self._sensor_generator, self._wind_generator, up, down = (np.random.default_rng(s) for s in seeds)
        link = config.link
        self._uplink = _DelayLine(link.command_delay_s, link.jitter_s, up)
        self._downlink = _DelayLine(link.telemetry_delay_s, link.jitter_s, down)
        self._noise = _noise(config)
        self._wind = _wind(config)
        self._gust = np.zeros(3)
        self._changes = deque((c.time_s, c.mass_kg) for c in config.payload.schedule)
        self._airborne_at_us: int | None = None
        self._climb_rate = 0.0
        self._estimate = self._sense()
        self._record()

    # ------------------------------------------------------------------------------ the border

    def add_peer(self, key: Hashable) -> None:
        """Send telemetry to `key` from now on, although nothing came from it yet."""
        self.server.add_peer(key)

    def remove_peer(self, key: Hashable) -> None:
        """Forget a peer that has gone."""
        self.server.remove_peer(key)

    def time_request(self, peer: Hashable) -> bytes:
        """The lock-step barrier's TIMESYNC request to a peer, with simulated time in ns; not delayed."""
        return self.server.add_peer(peer).pack(mavlink.MAVLink_timesync_message(0, self.time_us * 1000))

    def receive(self, data: bytes, source: Hashable) -> None:
        """A datagram from a peer. It takes effect link.command_delay_s of simulated time from now."""
        self._uplink.put(self.time_us, source, data)

    def outgoing(self) -> list[tuple[Hashable | None, bytes]]:
        """Datagrams that have arrived at their peers by now; None stands for everybody."""
        return [(datagram.peer, datagram.data) for datagram in self._downlink.take(self.time_us)]

    def advance(self, until_us: int) -> None:
        """Let simulated time go on, in whole physics steps, to `until_us` at most."""
        while self.time_us + self._step_us <= until_us:
            self._step()

    # -------------------------------------------------------------------------------- one step

    def _step(self) -> None:
        """Commands and firmware at the present time, physics to the next, telemetry from there."""
        for datagram in self._uplink.take(self.time_us):
            self.server.time_us = self.time_us
            self.server.receive(datagram.peer, datagram.data)
        self.server.run_due(self.time_us)
        commands = self.firmware.step(self._estimate, self._dt)
        self._update_load()
        self._gust, surroundings = environment.advance(
            self._wind, self._gust, self.time_us * 1e-6, self._wind_generator, self._dt
        )
        self.state = airframe.step(self.body, self.state, np.array(commands), surroundings, self._dt)
        self.time_us += self._step_us
        self._estimate = self._sense()
        for peer, data in self.server.emit(self._estimate):
            self._downlink.put(self.time_us, peer, data)
        for text in self.firmware.events:
            self.truth.event(self.time_us, text)
        self.firmware.events.clear()
        if self.truth.due(self.time_us):
            self._record()

    def _sense(self) -> Estimate:
        measured = airframe.measure(self._noise, self.state, self._sensor_generator)
        climb_rate = float(self.state.rigid[5])
        acceleration = (climb_rate - self._climb_rate) / self._dt
        self._climb_rate = climb_rate
        x, y, z = measured.position.tolist()
        vx, vy, vz = measured.velocity.tolist()
        roll, pitch, yaw = measured.euler.tolist()
        p, q, r = measured.body_rates.tolist()
        return Estimate(self.time_us, (x, y, z), (vx, vy, vz), (roll, pitch, yaw), (p, q, r), acceleration)

    def _record(self) -> None:
        self.truth.record(
            self.time_us,
            self.state.rigid.tolist(),
            float(self.state.motor_thrust.sum()),
            float(np.asarray(self.state.load_mass)),
            self.firmware.armed,
            self.firmware.mode_name,
        )

    # ------------------------------------------------------------------------------------ load

    def set_load(self, mass_kg: float) -> None:
        """Carry a load of `mass_kg` from now on; 0 drops it. ValueError if there can be no such load."""
        before = float(np.asarray(self.state.load_mass))
        if mass_kg == before:
            return
        self.state = airframe.with_load(self.state, mass_kg)
        word = "pick-up" if mass_kg > before else "drop"
        self.truth.event(self.time_us, f"{word} {abs(mass_kg - before):.6g} kg")

    def _update_load(self) -> None:
        for action in self.firmware.gripper_requests:
            self.set_load(self.config.payload.gripper_mass_kg if action == "grab" else 0.0)
        self.firmware.gripper_requests.clear()
        if self._airborne_at_us is None and self.state.rigid[2] > AIRBORNE_HEIGHT:
            self._airborne_at_us = self.time_us
        if not self._changes:
            return
        start = 0 if self.config.payload.clock == "boot" else self._airborne_at_us
        while start is not None and self._changes and self.time_us - start >= self._changes[0][0] * 1e6:
            self.set_load(self._changes.popleft()[1])


def _firmware(config: SimConfig, body: airframe.AirframeParameters) -> Firmware:
    readiness = Readiness(
        round(config.vehicle.attitude_ready_s * 1e6), round(config.vehicle.position_ready_s * 1e6)
    )
    kind = Px4Firmware if config.vehicle.personality == "px4" else ArduCopterFirmware
    return kind(config.make_parameters(), body, readiness)


def _proximity(config: SimConfig) -> Proximity | None:
    e = config.environment
    return e.proximity() if e.ground_effect or e.ceiling_height_m is not None else None


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


def _wind(config: SimConfig) -> environment.Wind:
    w = config.wind
    force = w.sine_amplitude_n != 0.0
    return environment.Wind(
        mean=w.mean_m_s,
        gust_std=w.gust_std_m_s,
        gust_time_constant=w.gust_time_constant_s,
        sine_amplitude=w.sine_amplitude_n if force else w.sine_amplitude_m_s2,
        sine_period=w.sine_period_s,
        sine_direction=w.sine_direction,
        sine_kind="force" if force else "acceleration",
    )
