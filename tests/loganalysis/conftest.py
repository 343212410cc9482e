"""Synthetic flights, and writers of small files of each kind that hold them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.flightlog.tlog import TIMESTAMP

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Flight:
    """Samples in NED and FRD, as the vehicle logs them; set points follow the same axes."""

    time_s: Array
    euler: Array
    rates: Array
    position: Array
    velocity: Array
    rates_setpoint: Array
    thrust: Array


def make_flight(samples: int = 200) -> Flight:
    time_s = 10.0 + 0.02 * np.arange(samples)
    waves = [np.sin(0.7 * time_s + k) for k in range(12)]
    return Flight(
        time_s=time_s,
        euler=np.stack([0.1 * waves[0], 0.2 * waves[1], 0.3 + 0.5 * waves[2]], axis=1),
        rates=np.stack(waves[3:6], axis=1),
        position=np.stack([waves[6], 2.0 * waves[7], -5.0 + waves[8]], axis=1),
        velocity=np.stack(waves[9:12], axis=1),
        rates_setpoint=0.5 * np.stack(waves[3:6], axis=1),
        thrust=0.4 + 0.1 * waves[0],
    )


def quaternion(euler: Array) -> Array:
    """ZYX Euler angles (n, 3) -> (n, 4), scalar first."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(euler.T / 2.0), np.sin(euler.T / 2.0)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ],
        axis=1,
    )


def write_tlog(path: Path, flight: Flight, *, delay_s: float = 0.03, sent: bool = True) -> None:
    vehicle, companion = mavlink.MAVLink(None, srcSystem=1, srcComponent=1), mavlink.MAVLink(None, 245, 191)
    clock_s = 1.7e9  # of the computer that logs
    with path.open("wb") as file:

        def put(time_s: float, message: mavlink.MAVLink_message, sender: mavlink.MAVLink) -> None:
            file.write(TIMESTAMP.pack(round((clock_s + time_s) * 1e6)) + message.pack(sender))

        put(
            flight.time_s[0],
            mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 128 + 64, 6 << 16, 4, 3),
            vehicle,
        )
        for k, time_s in enumerate(flight.time_s):
            boot_ms = round(time_s * 1e3)
            arrival = time_s + delay_s
            attitude = mavlink.MAVLink_attitude_message(boot_ms, *flight.euler[k], *flight.rates[k])
            put(arrival, attitude, vehicle)
            place = mavlink.MAVLink_local_position_ned_message(
                boot_ms, *flight.position[k], *flight.velocity[k]
            )
            put(arrival, place, vehicle)
            target = (128, [1.0, 0.0, 0.0, 0.0], *flight.rates_setpoint[k], flight.thrust[k])
            if sent:
                order = mavlink.MAVLink_set_attitude_target_message(boot_ms, 1, 1, *target)
                put(arrival, order, companion)
            else:
                put(arrival, mavlink.MAVLink_attitude_target_message(boot_ms, *target), vehicle)


LETTERS = {"Q": "Q", "f": "f", "B": "B", "c": "h", "C": "H", "Z": "64s"}


class DataFlashWriter:
    """The few record types that a test needs."""

    def __init__(self) -> None:
        self.data = bytearray()
        self._types: dict[str, tuple[int, str]] = {}
        self.declare("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 0x80)

    def declare(self, name: str, letters: str, columns: str, kind: int) -> None:
        self._types[name] = (kind, letters)
        size = 86 if kind == 0x80 else struct.calcsize("<" + "".join(LETTERS[x] for x in letters))
        texts = name.encode(), letters.encode(), columns.encode()
        self.data += b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size + 3, *texts)

    def add(self, name: str, *values: object) -> None:
        kind, letters = self._types[name]
        layout = "<" + "".join(LETTERS[letter] for letter in letters)
        self.data += b"\xa3\x95" + bytes([kind]) + struct.pack(layout, *values)


def write_dataflash(path: Path, flight: Flight) -> None:
    log = DataFlashWriter()
    log.declare("ATT", "Qcccccc", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw", 130)
    log.declare("RATE", "Qfffffff", "TimeUS,RDes,R,PDes,P,YDes,Y,AOut", 131)
    log.declare("XKF1", "QBffffff", "TimeUS,C,VN,VE,VD,PN,PE,PD", 132)
    log.declare("ARM", "QB", "TimeUS,ArmState", 133)
    log.declare("MSG", "QZ", "TimeUS,Message", 134)
    log.add("ARM", round(flight.time_s[0] * 1e6) - 1, 1)
    log.add("MSG", round(flight.time_s[0] * 1e6) - 1, b"ArduCopter V4.7.0")
    degrees = np.degrees(flight.euler)
    for k, time_s in enumerate(flight.time_s):
        stamp = round(time_s * 1e6)
        roll, pitch, yaw = (round(value * 100.0) for value in degrees[k])
        log.add("ATT", stamp, roll, roll, pitch, pitch, yaw, yaw)
        wanted, got = np.degrees(flight.rates_setpoint[k]), np.degrees(flight.rates[k])
        pairs = [value for pair in zip(wanted, got, strict=True) for value in pair]
        log.add("RATE", stamp, *pairs, flight.thrust[k])
        log.add("XKF1", stamp, 0, *flight.velocity[k], *flight.position[k])
        log.add("XKF1", stamp, 1, *np.zeros(6))
    path.write_bytes(log.data)


def write_ulog(path: Path, flight: Flight, status: dict[str, int] | None = None) -> None:
    """`status`: fields of vehicle_status that stay as they are; without it there is no such topic."""
    topics = {
        "vehicle_attitude": ("float[4] q", quaternion(flight.euler)),
        "vehicle_angular_velocity": ("float[3] xyz", flight.rates),
        "vehicle_local_position": (
            "float x;float y;float z;float vx;float vy;float vz",
            np.concatenate([flight.position, flight.velocity], axis=1),
        ),
        "vehicle_rates_setpoint": ("float roll;float pitch;float yaw", flight.rates_setpoint),
        "vehicle_thrust_setpoint": (
            "float[3] xyz",
            np.stack([0.0 * flight.thrust, 0.0 * flight.thrust, -flight.thrust], axis=1),
        ),
    }
    if status:
        fixed = np.tile(np.array([*status.values()], dtype=float), (len(flight.time_s), 1))
        topics["vehicle_status"] = (";".join(f"float {name}" for name in status), fixed)
    data = bytearray(b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0))

    def put(kind: str, body: bytes) -> None:
        data.extend(struct.pack("<HB", len(body), ord(kind)) + body)

    put("B", bytes(40))
    for name, (fields, _) in topics.items():
        put("F", f"{name}:uint64_t timestamp;{fields};".encode())
    for number, name in enumerate(topics):
        put("A", struct.pack("<BH", 0, number) + name.encode())
    for k, time_s in enumerate(flight.time_s):
        for number, (_, values) in enumerate(topics.values()):
            put("D", struct.pack("<HQ", number, round(time_s * 1e6)) + values[k].astype("<f4").tobytes())
    path.write_bytes(data)


Writer = Callable[[Path, Flight], None]


@pytest.fixture(scope="session")
def flight() -> Flight:
    """Four seconds of a smooth flight."""
    return make_flight()


@pytest.fixture(scope="session")
def log_files(tmp_path_factory: pytest.TempPathFactory, flight: Flight) -> dict[str, Path]:
    """The same flight in each of the three formats."""
    directory = tmp_path_factory.mktemp("logs")
    writers: dict[str, Writer] = {"tlog": write_tlog, "dataflash": write_dataflash, "ulog": write_ulog}
    suffixes = {"tlog": "tlog", "dataflash": "BIN", "ulog": "ulg"}
    files = {kind: directory / f"flight.{suffixes[kind]}" for kind in writers}
    for kind, write in writers.items():
        write(files[kind], flight)
    return files


@pytest.fixture(scope="session")
def reported_tlog(tmp_path_factory: pytest.TempPathFactory, flight: Flight) -> Path:
    """A ground station's log: set points as the autopilot reports them, none sent."""
    path = tmp_path_factory.mktemp("logs") / "station.tlog"
    write_tlog(path, flight, sent=False)
    return path


@pytest.fixture
def ulog_of(tmp_path: Path, flight: Flight) -> Callable[..., Path]:
    """The same flight as a PX4 log whose vehicle_status has these fields."""

    def write(**status: int) -> Path:
        path = tmp_path / "flight.ulg"
        write_ulog(path, flight, status)
        return path

    return write
