"""Plant and sensors under an unmodified PX4, over the HIL interface of its simulator_mavlink. Sans-I/O.

Source: PX4 src/modules/simulation/simulator_mavlink/SimulatorMavlink.cpp. HIL_SENSOR number 0 sets PX4's
clock; PX4 in lock-step answers each with one HIL_ACTUATOR_CONTROLS of the same time_usec. Its outputs 1 to 4
are the motors front, left, rear, right (configs/px4-hil/px4-rc.params), 0..1; one more is the gripper, -1
open, 1 closed. `px4_backend` owns the clock and `px4_port` the socket.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle import airframe
from sim_vehicle.backends import px4_sensors, sensors
from sim_vehicle.config import SimConfig
from sim_vehicle.errors import SimulatorError
from sim_vehicle.frames import Array, body_to_frd
from sim_vehicle.plant import Plant

SENSOR_PERIOD_US = 4_000
"""HIL_SENSOR at 250 Hz, PX4's IMU_INTEG_RATE in simulation."""

SLOW_PERIOD_US = 20_000
"""Magnetometer and barometer at 50 Hz."""

TRUTH_PERIOD_US = 8_000
"""HIL_STATE_QUATERNION at 125 Hz; PX4 asks for 5 ms."""

FIX_PERIOD_US = 100_000
"""HIL_GPS at 10 Hz."""

RANGE_PERIOD_US = 48_000
"""DISTANCE_SENSOR at 20 Hz."""

ARMED = mavlink.MAV_MODE_FLAG_SAFETY_ARMED
LOCK_STEP = 1
"""Bit of HIL_ACTUATOR_CONTROLS.flags: PX4's time stands still until the next HIL_SENSOR."""

INERTIAL, MAGNETIC, AIR = 0x3F, 0x1C0, 0x1A00
"""Bits of HIL_SENSOR.fields_updated."""

GRIPPER_THRESHOLD = 0.5
"""The gripper's output beyond which it counts as closed, or below minus which as open."""

FARTHEST = 1e6
"""Largest number in a state [m, m/s, rad, rad/s] that the frames can hold; no flight gets there."""

MODE_NAME = "external"
"""The truth's column "mode": PX4 does not say over this interface."""


def physics_step_us(wanted_us: int) -> int:
    """Largest fraction of the sensor period, in whole microseconds, that is not longer than `wanted_us`."""
    parts = math.ceil(SENSOR_PERIOD_US / wanted_us)
    while SENSOR_PERIOD_US % parts:
        parts += 1
    return SENSOR_PERIOD_US // parts


class Px4Vehicle:
    """The plant as PX4's simulator sees it: frames out and in, and one sensor period of physics at a time.

    Attributes
    ----------
    plant : the flying body
    armed : PX4 says so
    answered : the motor outputs for the latest HIL_SENSOR are there
    heard_us : latest time_usec of this session's motor outputs that is not ahead of ours; -1 before [us]
    lock_step : whether PX4 waits for our time; None before the first outputs
    bad_bytes : how much came in this session that was no MAVLink frame
    """

    def __init__(self, config: SimConfig) -> None:
        step_s = physics_step_us(round(config.vehicle.physics_dt_s * 1e6)) * 1e-6
        vehicle = config.vehicle.model_copy(update={"physics_dt_s": step_s})
        wind, noise = np.random.SeedSequence(config.vehicle.seed).spawn(2)
        self.plant = Plant(config.model_copy(update={"vehicle": vehicle}), np.random.default_rng(wind))
        self._generator = np.random.default_rng(noise)
        self.place = px4_sensors.Place()
        self._noise = px4_sensors.Px4SensorNoise()
        backend = config.backend
        self._imu_noise = sensors.ImuNoise(backend.accel_noise_m_s2, backend.gyro_noise_rad_s)
        self._motors = [output - 1 for output in backend.px4_hil.motor_outputs]
        self._gripper = backend.px4_hil.gripper_output - 1
        self._range_finder = backend.px4_hil.range_finder
        self._new_session()
        self._record()

    def _new_session(self) -> None:
        self._codec: Any = mavlink.MAVLink(file=None, srcSystem=1, srcComponent=200)
        self._codec.robust_parsing = True
        self._receiver = px4_sensors.SatelliteReceiver(self.place, self._noise, self._generator)
        self._before = self.plant.state
        self._commands: Array = np.zeros(4)
        self._gripper_closed: bool | None = None
        self.armed = False
        self.answered = False
        self.heard_us = -1
        self.lock_step: bool | None = None
        self.bad_bytes = 0

    @property
    def time_us(self) -> int:
        """Simulated time [us], the time_usec of the latest HIL_SENSOR."""
        return self.plant.time_us

    def restart(self) -> None:
        """PX4 has started anew: the vehicle stays where it is, motors off, and its time goes on."""
        self._new_session()
        self.plant.truth.event(self.time_us, "firmware restarted")

    # ---------------------------------------------------------------------------------- physics

    def advance(self) -> bytes:
        """One sensor period of physics with the latest motor outputs, and the frames of its end.

        Raises SimulatorError if the plant's state has left all bounds.
        """
        self._before = self.plant.state
        for _ in range(SENSOR_PERIOD_US // self.plant.step_us):
            self.plant.step(self._commands)
            if self.plant.truth.due(self.time_us):
                self._record()
        self._check_state()
        self.answered = False
        return self._frames()

    def _check_state(self) -> None:
        rigid = self.plant.state.rigid
        if not (np.abs(rigid) <= FARTHEST).all():  # nor is NaN
            x, y, z = rigid[:3].tolist()
            raise SimulatorError(
                f"px4-hil: the vehicle's state has left all bounds ({FARTHEST:g}) at "
                f"{self.time_us * 1e-6:.2f} s: x {x:g}, y {y:g}, z {z:g} m; stop PX4, look at "
                "what it flew, or choose a shorter vehicle.physics_dt_s"
            )

    def _record(self) -> None:
        self.plant.record(self.armed, MODE_NAME)

    # -------------------------------------------------------------------------------- from PX4

    def receive(self, data: bytes) -> None:
        """Bytes from PX4; what is no frame is skipped and counted."""
        for message in self._codec.parse_buffer(data) or []:
            kind = message.get_type()
            if kind == "HIL_ACTUATOR_CONTROLS":
                self._take_outputs(message)
            elif kind == "BAD_DATA":
                self.bad_bytes += len(message.data)

    def _take_outputs(self, message: Any) -> None:
        outputs = [value if math.isfinite(value) else 0.0 for value in message.controls]  # NaN: PX4's "off"
        self.lock_step = bool(message.flags & LOCK_STEP)
        self.answered = self.answered or message.time_usec == self.time_us
        if message.time_usec <= self.time_us:
            self.heard_us = max(self.heard_us, message.time_usec)
        armed = bool(message.mode & ARMED)
        if armed != self.armed:
            self.armed = armed
            self.plant.truth.event(self.time_us, "armed" if armed else "disarmed")
        self._commands = np.array([outputs[index] for index in self._motors]) if armed else np.zeros(4)
        if armed and self._gripper >= 0:
            self._work_gripper(outputs[self._gripper])

    def _work_gripper(self, output: float) -> None:
        """Follow changes of the gripper's output; where it stands at first changes nothing."""
        if abs(output) < GRIPPER_THRESHOLD:
            return
        closed = output > 0.0
        if self._gripper_closed is not None and closed != self._gripper_closed:
            self.plant.work_gripper("grab" if closed else "release")
        self._gripper_closed = closed

    # ---------------------------------------------------------------------------------- to PX4

    def _frames(self) -> bytes:
        """Everything due now; HIL_SENSOR last, because it moves PX4's clock."""
        now, state = self.time_us, self.plant.state
        dt, gravity = SENSOR_PERIOD_US * 1e-6, self.plant.body.gravity
        true = sensors.imu(self._before, state, dt, gravity)
        messages = []
        if now % FIX_PERIOD_US == 0:
            self._receiver.sample(now, state)
        fix = self._receiver.take(now)
        if fix is not None:
            messages.append(_hil_gps(now, fix))
        if self._range_finder and now % RANGE_PERIOD_US == 0:
            messages.append(self._distance_sensor(now, state))
        if now % TRUTH_PERIOD_US == 0:
            messages.append(_hil_state(now, self.place, state, true))
        messages.append(self._hil_sensor(now, state, true))
        return b"".join(self._pack(message) for message in messages)

    def _distance_sensor(self, now: int, state: airframe.AirframeState) -> Any:
        """What points to nothing reports one centimetre more than it can measure, as lasers do."""
        least, most = (round(100.0 * limit) for limit in px4_sensors.RANGE_M)
        distance = px4_sensors.range_finder(self._noise, state, self._generator)
        return mavlink.MAVLink_distance_sensor_message(
            (now // 1000) % 2**32,
            least,
            most,
            most + 1 if distance is None else round(100.0 * distance),
            mavlink.MAV_DISTANCE_SENSOR_LASER,
            0,
            mavlink.MAV_SENSOR_ROTATION_PITCH_270,
            0,
        )

    def _pack(self, message: Any) -> bytes:
        frame = bytes(message.pack(self._codec))
        self._codec.seq = (self._codec.seq + 1) % 256
        return frame

    def _hil_sensor(self, now: int, state: airframe.AirframeState, true: sensors.ImuSample) -> Any:
        sample = sensors.with_noise(true, self._imu_noise, self._generator)
        field, air, updated = [0.0, 0.0, 0.0], px4_sensors.Air(0.0, 0.0, 0.0), INERTIAL
        if now % SLOW_PERIOD_US == 0:
            updated |= MAGNETIC | AIR
            field = px4_sensors.magnetometer(self.place, self._noise, state.euler, self._generator).tolist()
            air = px4_sensors.barometer(self.place, self._noise, state.position, self._generator)
        return mavlink.MAVLink_hil_sensor_message(
            now,
            *sample.specific_force.tolist(),
            *sample.body_rates.tolist(),
            *field,
            air.pressure * 0.01,
            0.0,
            air.pressure_altitude,
            air.temperature,
            updated,
            0,
        )


def _hil_gps(now: int, fix: px4_sensors.Fix) -> Any:
    north, east, down = (_short(100.0 * value) for value in fix.velocity_ned.tolist())
    course = math.degrees(math.atan2(east, north)) % 360.0
    return mavlink.MAVLink_hil_gps_message(
        now,
        mavlink.GPS_FIX_TYPE_3D_FIX,
        round(math.degrees(fix.latitude) * 1e7),
        round(math.degrees(fix.longitude) * 1e7),
        round(fix.altitude * 1e3),
        30,  # cm, horizontal accuracy
        40,  # cm, vertical accuracy
        min(65534, round(math.hypot(north, east))),
        north,
        east,
        down,
        round(course * 100.0) % 36000,
        12,
        0,
        0,
    )


def _hil_state(
    now: int, place: px4_sensors.Place, state: airframe.AirframeState, true: sensors.ImuSample
) -> Any:
    pose = sensors.pose(state)
    latitude, longitude, altitude = place.geodetic(state.position)
    return mavlink.MAVLink_hil_state_quaternion_message(
        now,
        pose.quaternion.tolist(),
        *body_to_frd(state.body_rates).tolist(),
        round(math.degrees(latitude) * 1e7),
        round(math.degrees(longitude) * 1e7),
        round(altitude * 1e3),
        *(_short(100.0 * value) for value in pose.velocity.tolist()),
        0,
        0,
        *(_short(value / 9.80665e-3) for value in true.specific_force.tolist()),
    )


def _short(value: float) -> int:
    """Nearest number that fits 16 bits."""
    return max(-32768, min(32767, round(value)))
