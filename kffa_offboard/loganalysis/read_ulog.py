"""PX4 logs (.ulg) as flight records, through pyulog.

Topics (PX4 msg/): vehicle_attitude.q and vehicle_attitude_setpoint.q_d (FRD in NED, scalar first),
vehicle_angular_velocity.xyz and vehicle_rates_setpoint (rad/s), vehicle_local_position (NED),
vehicle_thrust_setpoint.xyz (z points down: thrust is -z), actuator_armed, vehicle_status,
vehicle_land_detected.
"""

from __future__ import annotations

import contextlib
import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from pyulog import ULog

from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis.record import Array, FlightRecord, Note, Series, empty, series
from kffa_offboard.mavlink import frames
from kffa_offboard.mavlink.vehicle import MULTIROTORS

_TOPICS = [
    "vehicle_attitude",
    "vehicle_attitude_setpoint",
    "vehicle_angular_velocity",
    "vehicle_rates_setpoint",
    "vehicle_local_position",
    "vehicle_thrust_setpoint",
    "actuator_armed",
    "vehicle_status",
    "vehicle_land_detected",
]
UNKNOWN, ROTARY_WING = 0, 1
VEHICLE_TYPES = {2: "fixed-wing vehicle", 3: "rover", 4: "airship"}
"""vehicle_status.vehicle_type."""

MAGIC = b"ULog\x01\x12\x35"
_HEADER_BYTES, _RECORD_BYTES = 16, 3


def _columns(data: dict[str, Any], names: tuple[str, ...]) -> Array | None:
    if not all(name in data for name in names):
        return None
    return np.stack([np.asarray(data[name], dtype=float) for name in names], axis=1)


def _series(
    topics: dict[str, dict[str, Any]],
    topic: str,
    names: tuple[str, ...],
    turn: Callable[[Array], Array],
    width: int,
) -> Series:
    """Columns of a topic at the time of the sample (of publication where there is no other)."""
    data = topics.get(topic)
    values = None if data is None else _columns(data, names)
    if data is None or values is None:
        return empty(width)
    stamp = "timestamp_sample" if np.any(data.get("timestamp_sample", 0)) else "timestamp"
    if stamp not in data:  # a damaged format
        return empty(width)
    return series(np.asarray(data[stamp], dtype=float) * 1e-6, turn(values), width)


def _vectors(values: Array) -> Array:
    return np.array([frames.vector_from_ned(*row) for row in values]).reshape(-1, 3)


def _attitudes(values: Array) -> Array:
    turned = [frames.euler_from_quaternion(frames.quaternion_from_ned((w, x, y, z))) for w, x, y, z in values]
    return np.array(turned).reshape(-1, 3)


def _load(path: Path) -> ULog:
    """Parse, with what pyulog prints kept to itself.

    pyulog raises whatever a damaged byte leads to (struct.error, KeyError, IndexError, UnicodeError, ...).
    """
    chatter = io.StringIO()
    try:
        with contextlib.redirect_stdout(chatter), contextlib.redirect_stderr(chatter):
            return ULog(str(path), _TOPICS)
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}; check the path") from error
    except Exception as error:
        raise UserError(
            f"{path}: the PX4 log is damaged ({type(error).__name__}: {error}); download it again, or try "
            "`ulog_info` on it"
        ) from error


def read(path: Path) -> FlightRecord:
    """Read a ULog.

    Raises UserError for a file that is none, one of another vehicle than a multirotor, or one without
    attitude in it.
    """
    log = _load(path)
    topics: dict[str, dict[str, Any]] = {}
    for item in log.data_list:
        if item.multi_id == 0:
            topics.setdefault(item.name, item.data)
    if (other := _other_vehicle(topics.get("vehicle_status", {}))) is not None:
        raise UserError(f"{path}: is a log of {other}; only those of multirotors can be read")

    def same(values: Array) -> Array:
        return values

    attitude = _series(topics, "vehicle_attitude", ("q[0]", "q[1]", "q[2]", "q[3]"), _attitudes, 3)
    if not attitude:
        raise UserError(
            f"{path}: no vehicle_attitude in this PX4 log; set SDLOG_PROFILE to log attitude and fly again"
        )
    q_d = ("q_d[0]", "q_d[1]", "q_d[2]", "q_d[3]")
    thrust = _series(topics, "vehicle_thrust_setpoint", ("xyz[2]",), np.negative, 1)
    if not thrust:
        thrust = _series(topics, "vehicle_rates_setpoint", ("thrust_body[2]",), np.negative, 1)
    armed = _series(topics, "actuator_armed", ("armed",), same, 1)
    return FlightRecord(
        path=path,
        source="ulog",
        attitude=attitude,
        body_rates=_series(topics, "vehicle_angular_velocity", ("xyz[0]", "xyz[1]", "xyz[2]"), _vectors, 3),
        position=_series(topics, "vehicle_local_position", ("x", "y", "z"), _vectors, 3),
        velocity=_series(topics, "vehicle_local_position", ("vx", "vy", "vz"), _vectors, 3),
        attitude_setpoint=_series(topics, "vehicle_attitude_setpoint", q_d, _attitudes, 3),
        rates_setpoint=_series(topics, "vehicle_rates_setpoint", ("roll", "pitch", "yaw"), _vectors, 3),
        thrust=thrust,
        armed=armed,
        landed=_series(topics, "vehicle_land_detected", ("landed",), same, 1),
        notes=_notes(log, topics, armed),
        autopilot="px4",
        damage=_damage(log, path),
    )


def _other_vehicle(status: dict[str, Any]) -> str | None:
    """What flew, if it was no multirotor: vehicle_status.system_type is a MAV_TYPE; older is vehicle_type."""
    for field, right, names in (
        ("system_type", MULTIROTORS, {n: entry.name for n, entry in mavlink.enums["MAV_TYPE"].items()}),
        ("vehicle_type", (ROTARY_WING,), VEHICLE_TYPES),
    ):
        kinds = {int(kind) for kind in status.get(field, ()) if math.isfinite(kind)} - {UNKNOWN}
        wrong = sorted(kinds.difference(right))
        if wrong:
            return f"a {names.get(wrong[0], f'vehicle with {field} {wrong[0]}')}"
        if kinds:
            return None
    return None


def _damage(log: ULog, path: Path) -> tuple[str, ...]:
    damage = []
    if log.file_corruption:
        damage.append("damaged stretches were skipped")
    elif _cut_short(path):
        damage.append("the last record is incomplete")
    if log.dropouts:
        lost_s = sum(dropout.duration for dropout in log.dropouts) * 1e-3
        damage.append(f"{len(log.dropouts)} dropouts of the logger, {lost_s:.2f} s in all")
    return tuple(damage)


def _cut_short(path: Path) -> bool:
    """The last record ends after the file, which pyulog does not tell. Records: size (uint16), type, data."""
    data = path.read_bytes()
    at = _HEADER_BYTES
    while at + _RECORD_BYTES <= len(data):
        at += _RECORD_BYTES + data[at] + (data[at + 1] << 8)
    return at != len(data)


def _notes(log: ULog, topics: dict[str, dict[str, Any]], armed: Series) -> tuple[Note, ...]:
    notes = [Note(text.timestamp * 1e-6, "text", str(text.message)) for text in log.logged_messages]
    states = _series(topics, "vehicle_status", ("nav_state",), lambda values: values, 1)
    for column, kind, name in ((armed, "armed", ("disarmed", "armed")), (states, "mode", None)):
        previous: float | None = None
        for time_s, value in zip(column.time_s, column.values[:, 0], strict=True):
            if value != previous:
                text = f"nav_state {value:.0f}" if name is None else name[int(value != 0.0)]
                notes.append(Note(float(time_s), kind, text))
                previous = value
    return tuple(sorted(notes, key=lambda note: note.time_s))
