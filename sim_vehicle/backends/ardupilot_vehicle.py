"""The plant behind ArduPilot's JSON interface, without clock and without sockets.

Lock-step: each servo packet is answered once. The plant goes on by the firmware's own frame period, in whole
physics steps. A packet that comes again gets the same answer again; an older one, that a network delivers
late, gets none. A frame count that begins at 0 again, or another sender, is a firmware that has been
restarted: the vehicle stays where it is, the firmware's time begins anew.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from sim_vehicle.backends.ardupilot_json import ServoPacket, encode_answer, parse_servo_packet
from sim_vehicle.backends.sensors import ImuNoise, imu, pose, with_noise
from sim_vehicle.backends.servo_outputs import (
    GripperServo,
    GripperState,
    MotorOutputs,
    follow_gripper,
    motor_commands,
)
from sim_vehicle.config import SimConfig
from sim_vehicle.errors import SimulatorError
from sim_vehicle.plant import Plant

NAME = "ardupilot-json"
MODE_NAME = "external"
"""The truth's column "mode": the firmware does not say over this interface."""

LONGEST_FRAME_S = 0.09
"""Longest step taken at once; the firmware refuses 0.1 s and more."""


UNDRIVEN_US = 5_000_000
"""ArduCopter drives its motors' outputs from 2 s after its start on."""

LEAST_RATE_HZ = 720.0
"""Gyro samples that ArduCopter wants before it arms: 1.8 times its loop rate (AP_InertialSensor.cpp)."""


class Answer(NamedTuple):
    """A datagram for the firmware, and the simulated time at which it is due [us]."""

    peer: Hashable
    data: bytes
    time_us: int


@dataclass
class Counters:
    """What came in: answered frames, packets again or late, packets that were no servo packets, restarts."""

    frames: int = 0
    repeated: int = 0
    bad: int = 0
    restarts: int = 0

    def __str__(self) -> str:
        return (
            f"{self.frames} frames, {self.repeated} repeated, {self.bad} bad packets, "
            f"{self.restarts} firmware restarts"
        )


class ArdupilotVehicle:
    """One vehicle flown by ArduPilot.

    Attributes
    ----------
    plant : the flying body
    armed : do the motors get more than their idle pulse?
    counters : what came in
    notices : lines for people since they were last taken out
    """

    def __init__(self, config: SimConfig) -> None:
        wind, sensors = np.random.SeedSequence(config.vehicle.seed).spawn(2)
        self.plant = Plant(config, np.random.default_rng(wind))
        self.armed = False
        self.counters = Counters()
        self.notices: list[str] = []
        section = config.backend.ardupilot_json
        self._generator = np.random.default_rng(sensors)
        self._noise = ImuNoise(config.backend.accel_noise_m_s2, config.backend.gyro_noise_rad_s)
        self._no_time_sync = section.pace == "physics"
        self._motors = MotorOutputs(
            section.motor_channels, section.motor_pwm_min_us, section.motor_pwm_max_us
        )
        self._servo = (
            GripperServo(section.gripper_channel, section.gripper_grab_us, section.gripper_release_us)
            if section.gripper_channel
            else None
        )
        self._gripper = GripperState()
        self._channels = max(*section.motor_channels, section.gripper_channel)
        self._peer: Hashable | None = None
        self._retired: set[Hashable] = set()
        self._frame_count = -1
        self._origin_us = 0
        self._answer: Answer | None = None
        self._complained: set[Hashable] = set()
        self._told_idle = False
        self._record()

    def receive(self, datagrams: Iterable[tuple[Hashable, bytes]]) -> Answer | None:
        """Take in everything that has come; the answer to the newest servo packet, None if there was none.

        Raises SimulatorError if the firmware has too few outputs or the plant's state has left all bounds.
        """
        newest: tuple[Hashable, ServoPacket] | None = None
        for peer, data in datagrams:
            packet = self._parse(peer, data)
            if packet is None:
                continue
            before = newest or (self._peer, ServoPacket(0, self._frame_count, ()))
            if _is_late(packet.frame_count, before[1].frame_count) and peer == before[0]:
                self.counters.repeated += 1
                continue
            newest = peer, packet
        return None if newest is None else self._reply(*newest)

    # ------------------------------------------------------------------------------- the border

    def _parse(self, peer: Hashable, data: bytes) -> ServoPacket | None:
        """The packet, or None (with a notice, once for each sender) if it is not one to answer."""
        if peer in self._retired:
            self._complain(peer, "another firmware has taken over; stop one of them")
            return None
        try:
            return parse_servo_packet(data)
        except ValueError as problem:
            self.counters.bad += 1
            self._complain(peer, f"{problem}; does something else send to this port?")
            return None

    def _complain(self, peer: Hashable, why: str) -> None:
        if peer not in self._complained:
            self._complained.add(peer)
            self.notices.append(f"{NAME}: packet from {_shown(peer)} ignored: {why}")

    def _reply(self, peer: Hashable, packet: ServoPacket) -> Answer:
        if len(packet.pwm) < self._channels:
            raise SimulatorError(
                f"{NAME}: output {self._channels} is configured and the firmware sends {len(packet.pwm)}; "
                "set its SERVO_32_ENABLE to 1 or choose other channels"
            )
        if self._answer is None:
            self._greet(peer)
        elif peer != self._peer or packet.frame_count < self._frame_count:
            self._restart(peer)
        elif packet.frame_count == self._frame_count:
            self.counters.repeated += 1
            return self._answer
        self._peer, self._frame_count = peer, packet.frame_count
        self._answer = Answer(peer, self._fly(packet), self.plant.time_us)
        self.counters.frames += 1
        return self._answer

    def _greet(self, peer: Hashable) -> None:
        rate = 1.0 / self.plant.dt
        self.notices.append(f"{NAME}: firmware at {_shown(peer)}, physics at {rate:g} Hz")
        if rate < LEAST_RATE_HZ:
            self.notices.append(
                f"{NAME}: ArduCopter with its loop at 400 Hz arms from {LEAST_RATE_HZ:g} Hz on; "
                "set vehicle.physics_dt_s = 0.00125"
            )

    def _restart(self, peer: Hashable) -> None:
        self.counters.restarts += 1
        if peer != self._peer and self._peer is not None:
            self._retired.add(self._peer)
        self._origin_us = self.plant.time_us
        self._gripper = GripperState()
        at = f"{self.plant.time_us * 1e-6:.2f} s"
        self.notices.append(f"{NAME}: firmware restarted at {at} of simulated time, now at {_shown(peer)}")
        self.plant.truth.event(self.plant.time_us, "firmware restarted")

    # ------------------------------------------------------------------------------- one frame

    def _fly(self, packet: ServoPacket) -> bytes:
        """One frame of simulated time with these outputs; the answer for the state at its end."""
        plant = self.plant
        self._look_for_pulses(packet.pwm)
        commands = motor_commands(self._motors, packet.pwm)
        self._note_motors(bool(commands.max() > 0.0))
        self._follow_gripper(packet)
        before, steps = plant.state, self._steps(packet.frame_rate)
        for _ in range(steps):
            plant.step(commands)
            if plant.truth.due(plant.time_us):
                self._record()
        sample = imu(before, plant.state, steps * plant.dt, plant.body.gravity)
        sample = with_noise(sample, self._noise, self._generator)
        timestamp = (plant.time_us - self._origin_us) * 1e-6
        try:
            return encode_answer(timestamp, sample, pose(plant.state), self._no_time_sync)
        except ValueError as problem:
            raise SimulatorError(
                f"{NAME}: the vehicle's state is not finite any more at {plant.time_us * 1e-6:.2f} s; "
                "choose a shorter vehicle.physics_dt_s"
            ) from problem

    def _steps(self, frame_rate: int) -> int:
        """Physics steps nearest to the firmware's frame period, at least one."""
        period = min(LONGEST_FRAME_S, 1.0 / frame_rate) if frame_rate > 0 else 0.0
        return max(1, round(period / self.plant.dt))

    def _look_for_pulses(self, pwm: tuple[int, ...]) -> None:
        """Say so, once, if the firmware drives other outputs than those of the motors."""
        idle = [channel for channel in self._motors.channels if not pwm[channel - 1]]
        driven = [channel for channel, width in enumerate(pwm, start=1) if width]
        if not idle or not driven or self._told_idle:
            return
        if self.plant.time_us - self._origin_us >= UNDRIVEN_US:
            self._told_idle = True
            self.notices.append(
                f"{NAME}: no pulses at output {_list(idle)} of backend.ardupilot_json.motor_channels, "
                f"the firmware drives {_list(driven)}; give the outputs of its SERVOn_FUNCTION "
                "35, 34, 36, 33 (front, left, rear, right)"
            )

    def _note_motors(self, armed: bool) -> None:
        if armed != self.armed:
            self.armed = armed
            self.plant.truth.event(self.plant.time_us, "motors on" if armed else "motors off")

    def _follow_gripper(self, packet: ServoPacket) -> None:
        if self._servo is None:
            return
        pwm = packet.pwm[self._servo.channel - 1]
        self._gripper, action = follow_gripper(self._servo, self._gripper, pwm, self.plant.time_us)
        if action is not None:
            self.plant.work_gripper(action)

    def _record(self) -> None:
        self.plant.record(self.armed, MODE_NAME)


def _is_late(count: int, newest: int) -> bool:
    """Is it older than a packet that is known? Only a firmware that has started anew counts from 0."""
    return 0 < count < newest


def _list(channels: list[int]) -> str:
    return ", ".join(str(channel) for channel in channels)


def _shown(peer: Hashable) -> str:
    """Address of a peer `(link number, (host, port))`."""
    if isinstance(peer, tuple) and len(peer) == 2 and isinstance(peer[1], tuple):
        return ":".join(str(part) for part in peer[1])
    return str(peer)
