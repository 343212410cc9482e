"""ArduPilot DataFlash logs (.BIN) as flight records.

ATT (degrees; Des* is the attitude that is steered to), RATE (deg/s, *Des set points), XKF1 (EKF3 core 0:
NED position,
velocity), CTUN.ThO or RATE.AOut (thrust to the motors, 0..1), ARM, MODE, MSG, EV. Column meanings and
units: ArduPilot libraries/AP_Logger/LogStructure.h and libraries/AC_AttitudeControl/LogStructure.h.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis import dataflash
from kffa_offboard.loganalysis.record import Array, FlightRecord, Note, Series, empty, series
from kffa_offboard.mavlink import frames
from kffa_offboard.mavlink.ardupilot import mode_name

_NAMES = frozenset({"ATT", "RATE", "XKF1", "NKF1", "CTUN", "ARM", "MODE", "MSG", "EV"})
_OTHER_FIRMWARES = ("ArduPlane", "ArduRover", "ArduSub", "Rover", "Blimp", "AntennaTracker")
_LANDED, _NOT_LANDED = 18, 28  # LogEvent: LAND_COMPLETE, NOT_LANDED (AP_Logger.h)

_Table: TypeAlias = dict[str, NDArray[np.generic]]


def _numbers(table: _Table, *columns: str) -> Array | None:
    """Columns ``(n, k)``; None if one is missing."""
    if not all(column in table and table[column].dtype.kind == "f" for column in columns):
        return None
    return np.stack([table[column].astype(float) for column in columns], axis=1)


def _series(
    table: _Table | None, columns: tuple[str, ...], factor: float = 1.0, angles: bool = False
) -> Series:
    """Columns over TimeUS, turned to the paper's axes if there are three."""
    times = None if table is None else _numbers(table, "TimeUS")
    values = None if table is None else _numbers(table, *columns)
    if times is None or values is None:
        return empty(len(columns))
    values = values * factor
    if angles:
        values = (values + np.pi) % (2.0 * np.pi) - np.pi  # yaw is 0..360 degrees here
    if len(columns) == 3:
        values = np.array([frames.vector_from_ned(*row) for row in values]).reshape(-1, 3)
    return series(times[:, 0] * 1e-6, values, len(columns))


def _first_core(table: _Table | None) -> _Table | None:
    """Rows of the estimator's first core."""
    if table is None or "C" not in table:
        return table
    return {name: column[table["C"] == 0] for name, column in table.items()}


def read(path: Path) -> FlightRecord:
    """Read a DataFlash log.

    Raises UserError for a file that is none, or one without attitude in it.
    """
    log = dataflash.read(path, _NAMES)
    tables = log.tables
    notes = _notes(tables)
    if (other := _other_firmware(notes)) is not None:
        raise UserError(f"{path}: is a log of {other}; only those of multirotors (ArduCopter) can be read")
    degrees = np.pi / 180.0
    attitude = _series(tables.get("ATT"), ("Roll", "Pitch", "Yaw"), degrees, angles=True)
    if not attitude:
        raise UserError(
            f"{path}: no ATT messages in this DataFlash log; set LOG_BITMASK to log attitude (bit 0, fast) "
            "and fly again"
        )
    estimate = _first_core(tables.get("XKF1", tables.get("NKF1")))
    throttle = _series(tables.get("CTUN"), ("ThO",)), _series(tables.get("RATE"), ("AOut",))
    damage = []
    if log.skipped_bytes:
        damage.append(f"{log.skipped_bytes} damaged bytes were skipped")
    if log.end_cut:
        damage.append("the last record is incomplete")
    return FlightRecord(
        path=path,
        source="dataflash",
        attitude=attitude,
        body_rates=_series(tables.get("RATE"), ("R", "P", "Y"), degrees),
        position=_series(estimate, ("PN", "PE", "PD")),
        velocity=_series(estimate, ("VN", "VE", "VD")),
        attitude_setpoint=_series(tables.get("ATT"), ("DesRoll", "DesPitch", "DesYaw"), degrees, angles=True),
        rates_setpoint=_series(tables.get("RATE"), ("RDes", "PDes", "YDes"), degrees),
        thrust=max(throttle, key=len),
        armed=_before(_series(tables.get("ARM"), ("ArmState",)), attitude.time_s[0]),
        landed=_before(_landed(tables.get("EV")), attitude.time_s[0]),
        notes=notes,
        autopilot="ardupilot",
        damage=tuple(damage),
    )


def _other_firmware(notes: tuple[Note, ...]) -> str | None:
    """The firmware that named itself first, if it flies no multirotors."""
    names = (note.text.split(" ")[0] for note in notes if note.kind == "text")
    first = next((name for name in names if name in (*_OTHER_FIRMWARES, "ArduCopter")), None)
    return first if first in _OTHER_FIRMWARES else None


def _before(changes: Series, start_s: float) -> Series:
    """Changes of a state, with the state before the first: the log begins with arming, after ARM was due."""
    if not changes or changes.time_s[0] <= start_s:
        return changes
    return Series(
        np.concatenate([[start_s], changes.time_s]),
        np.concatenate([1.0 - changes.values[:1], changes.values]),
    )


def _landed(table: _Table | None) -> Series:
    events = _series(table, ("Id",))
    chosen = np.isin(events.values[:, 0], [_LANDED, _NOT_LANDED])
    return Series(events.time_s[chosen], (events.values[chosen] == _LANDED).astype(float))


def _notes(tables: dict[str, _Table]) -> tuple[Note, ...]:
    notes = []
    mode = _series(tables.get("MODE"), ("Mode",))
    notes += [
        Note(float(t), "mode", mode_name(int(row[0])))
        for t, row in zip(mode.time_s, mode.values, strict=True)
    ]
    armed = _series(tables.get("ARM"), ("ArmState",))
    notes += [
        Note(float(t), "armed", "armed" if row[0] else "disarmed")
        for t, row in zip(armed.time_s, armed.values, strict=True)
    ]
    texts = tables.get("MSG", {})
    if "Message" in texts and "TimeUS" in texts:
        notes += [
            Note(float(t) * 1e-6, "text", bytes(text).decode("utf-8", "replace"))
            for t, text in zip(texts["TimeUS"].astype(float), texts["Message"].tolist(), strict=True)
            if isinstance(text, bytes)
        ]
    return tuple(sorted(notes, key=lambda note: note.time_s))
