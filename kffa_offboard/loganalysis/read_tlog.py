"""Telemetry logs (.tlog) as flight records: arrival times beside the vehicle's own, commands as they were
sent.

Commands sent by a companion computer carry that computer's time. They are put on the vehicle's clock as the
computer saw it: arrival time less the median of (arrival - sample). A delay from them to the response is
therefore that of the whole loop, telemetry and command, which is what `delay_s` of a configuration means.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.notes import Lost, NoteReader, is_note
from kffa_offboard.flightlog.parts import following_parts
from kffa_offboard.flightlog.tlog import clock_remarks, read_tlog
from kffa_offboard.loganalysis.record import FlightRecord, Note, Series, empty, series, series_with_arrival
from kffa_offboard.mavlink import frames
from kffa_offboard.mavlink.telemetry import TelemetryDecoder, landed_state
from kffa_offboard.mavlink.vehicle import MULTIROTORS
from kffa_offboard.offboard.events import (
    AttitudeReceived,
    PositionReceived,
    TargetReported,
    Vector3,
)

AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_REBOOT_S = 1.0  # a boot clock that falls back by more than this began anew
_BOOT_CLOCK_RANGE_MS = 2**32
_AUTOPILOTS = {mavlink.MAV_AUTOPILOT_PX4: "px4", mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot"}
_KINDS = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_ATTITUDE,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
        mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
        mavlink.MAVLINK_MSG_ID_VFR_HUD,
        mavlink.MAVLINK_MSG_ID_STATUSTEXT,
        mavlink.MAVLINK_MSG_ID_TUNNEL,
    }
)
_IGNORE_RATES = 7
_SAME_THRUST = 0.1
_IGNORE_ATTITUDE = mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE


@dataclass
class _Column:
    """Rows as they come, `values` one after the other."""

    time_s: array[float] = field(default_factory=lambda: array("d"))
    arrival_s: array[float] = field(default_factory=lambda: array("d"))
    values: array[float] = field(default_factory=lambda: array("d"))

    def add(self, time_s: float, arrival_s: float, values: tuple[float, ...]) -> None:
        self.time_s.append(time_s)
        self.arrival_s.append(arrival_s)
        self.values.extend(values)

    def series(self, columns: int) -> Series:
        times, values, arrivals = map(np.array, (self.time_s, self.values, self.arrival_s))
        return series_with_arrival(times, values, arrivals, columns)

    def sent(self, offset_s: float, columns: int) -> Series:
        """Series of what has arrival times only, on the vehicle's clock."""
        return series(np.array(self.arrival_s) - offset_s, np.array(self.values), columns)


@dataclass
class _Stretch:
    """What one vehicle said, and was told, from one start of its clock to the next.

    `samples` counts attitudes, `flown` those while armed.
    """

    decoder: TelemetryDecoder = field(default_factory=TelemetryDecoder)
    columns: dict[str, _Column] = field(default_factory=dict)
    notes: list[tuple[float, str, str]] = field(default_factory=list)
    latest_s: float = -np.inf
    mode: int | None = None
    armed: bool | None = None
    samples: int = 0
    flown: int = 0

    def column(self, name: str) -> _Column:
        return self.columns.setdefault(name, _Column())

    def take(self, arrival_s: float, message: Any) -> None:
        """One message of the vehicle's autopilot."""
        match message.get_type():
            case "HEARTBEAT":
                self._heartbeat(arrival_s, message)
            case "EXTENDED_SYS_STATE":
                for event in landed_state(message):
                    self.column("landed").add(arrival_s, arrival_s, (float(event.on_ground),))  # type: ignore[union-attr]
            case "VFR_HUD":
                self.column("throttle").add(arrival_s, arrival_s, (message.throttle / 100.0,))
            case "STATUSTEXT":
                self.notes.append((arrival_s, "text", str(message.text)))
            case "ATTITUDE" | "LOCAL_POSITION_NED" | "ATTITUDE_TARGET":
                self._sample(arrival_s, message)
            case _:
                pass

    def ends_before(self, arrival_s: float, message: Any) -> bool:
        """True for the first attitude after a restart: its clock is no older than the pause before it.

        A late sample, or one that came a second time by another link, is older.
        """
        if not self.samples:
            return False
        back_ms = (round(self.latest_s * 1e3) - message.time_boot_ms) % _BOOT_CLOCK_RANGE_MS
        if not 1e3 * _REBOOT_S < back_ms < _BOOT_CLOCK_RANGE_MS // 2:
            return False
        pause_s = arrival_s - self.columns["attitude"].arrival_s[-1]
        return pause_s < -_REBOOT_S or message.time_boot_ms * 1e-3 < pause_s + _REBOOT_S

    def _heartbeat(self, arrival_s: float, message: Any) -> None:
        armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        if armed != self.armed:
            self.armed = armed
            self.column("armed").add(arrival_s, arrival_s, (float(armed),))
            self.notes.append((arrival_s, "armed", "armed" if armed else "disarmed"))
        if message.custom_mode != self.mode:
            self.mode = message.custom_mode
            self.notes.append((arrival_s, "mode", f"custom mode {message.custom_mode}"))

    def _sample(self, arrival_s: float, message: Any) -> None:
        for event in self.decoder.decode(message):
            match event:
                case AttitudeReceived():
                    time_s = event.sample_time_us * 1e-6
                    self.latest_s = max(self.latest_s, time_s)
                    self.samples += 1
                    self.flown += bool(self.armed)
                    self.column("attitude").add(time_s, arrival_s, event.attitude)
                    self.column("body_rates").add(time_s, arrival_s, event.body_rates)
                case PositionReceived():
                    time_s = event.sample_time_us * 1e-6
                    self.column("position").add(time_s, arrival_s, event.position)
                    self.column("velocity").add(time_s, arrival_s, event.velocity)
                case TargetReported():
                    time_s = message.time_boot_ms * 1e-3
                    self._target(
                        "reported", time_s, arrival_s, event.attitude, event.body_rates, event.thrust
                    )
                case _:
                    pass

    def sent(self, arrival_s: float, message: Any) -> None:
        """A SET_ATTITUDE_TARGET to the vehicle."""
        mask = message.type_mask
        attitude: Vector3 | None = None
        if not mask & _IGNORE_ATTITUDE:
            w, x, y, z = message.q
            attitude = frames.euler_from_quaternion(frames.quaternion_from_ned((w, x, y, z)))
        rates: Vector3 | None = None
        if not mask & _IGNORE_RATES:
            rates = frames.body_rates_from_frd(
                message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate
            )
        self._target("sent", arrival_s, arrival_s, attitude, rates, message.thrust)

    def _target(
        self,
        prefix: str,
        time_s: float,
        arrival_s: float,
        attitude: Vector3 | None,
        rates: Vector3 | None,
        thrust: float | None,
    ) -> None:
        if attitude is not None:
            self.column(f"{prefix} attitude").add(time_s, arrival_s, attitude)
        if rates is not None:
            self.column(f"{prefix} rates").add(time_s, arrival_s, rates)
        if thrust is not None:
            self.column(f"{prefix} thrust").add(time_s, arrival_s, (thrust,))


@dataclass
class _Log:
    """Chooses the vehicle: the first multirotor that says anything. Others, and what is sent to them, are not
    mixed with it. `heartbeats` are those since the last attitude.
    """

    system: int | None = None
    autopilot: str = ""
    stretches: list[_Stretch] = field(default_factory=lambda: [_Stretch()])
    heartbeats: list[tuple[float, Any]] = field(default_factory=list)
    others: set[int] = field(default_factory=set)
    foreign: dict[int, int] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)
    clock: list[str] = field(default_factory=list)

    def take(self, arrival_s: float, message: Any) -> None:
        """Sort in one message of anybody."""
        kind, system = message.get_type(), message.get_srcSystem()
        if is_note(message):
            self._note(message)
            return
        if kind == "SET_ATTITUDE_TARGET":
            if message.target_system in (0, self.system):
                self.stretches[-1].sent(arrival_s, message)
            return
        if message.get_srcComponent() != AUTOPILOT_COMPONENT:
            return
        if kind == "HEARTBEAT" and message.autopilot in _AUTOPILOTS:
            self._recognise(message)
        if self.system is None and kind == "ATTITUDE" and system not in self.foreign:
            self.system = system
        if system != self.system:
            return
        if kind == "HEARTBEAT":
            self.heartbeats.append((arrival_s, message))
        elif kind == "ATTITUDE":
            if self.stretches[-1].ends_before(arrival_s, message):
                self._begin_again()
            self.heartbeats.clear()
        self.stretches[-1].take(arrival_s, message)

    def _note(self, message: Any) -> None:
        """Of the daemon's notes only lost records concern us, which fit into one piece."""
        try:
            note = NoteReader().take(message)
        except ValueError:
            return
        if isinstance(note, Lost):
            self.damage.append(f"{note.records} records are missing (full disk)")

    def _begin_again(self) -> None:
        self.stretches.append(_Stretch())
        for arrival_s, heartbeat in self.heartbeats:
            self.stretches[-1].take(arrival_s, heartbeat)

    def _recognise(self, heartbeat: Any) -> None:
        system = heartbeat.get_srcSystem()
        if heartbeat.type not in MULTIROTORS:
            self.foreign[system] = heartbeat.type
            if system == self.system:
                self.system, self.stretches = None, [_Stretch()]
        elif self.system in (None, system):
            self.system, self.autopilot = system, _AUTOPILOTS[heartbeat.autopilot]
        else:
            self.others.add(system)

    def chosen(self) -> _Stretch:
        """The stretch with most of the flight."""
        return max(self.stretches, key=lambda stretch: (stretch.flown, stretch.samples))

    def remarks(self) -> list[str]:
        """What of the log is not looked at."""
        remarks = [*self.clock]
        if len(self.stretches) > 1:
            number = self.stretches.index(self.chosen()) + 1
            remarks.append(
                f"the vehicle was started {len(self.stretches)} times; looked at is what followed "
                f"start {number} alone"
            )
        if self.others:
            names = ", ".join(map(str, sorted(self.others)))
            remarks.append(f"system {self.system} is looked at; left out: system {names}")
        return remarks

    def nothing(self) -> str:
        """Why there is no flight in the log."""
        if self.foreign:
            system, kind = min(self.foreign.items())
            name = mavlink.enums["MAV_TYPE"][kind].name if kind in mavlink.enums["MAV_TYPE"] else kind
            return f"no multirotor in this telemetry log: system {system} is a {name}"
        return (
            "no ATTITUDE of an autopilot in this telemetry log; record one of a flight, with ATTITUDE and "
            "LOCAL_POSITION_NED at 50 Hz or more"
        )


def read(path: Path) -> FlightRecord:
    """Read a telemetry log with its further parts (FLIGHT-2.tlog, ...).

    Raises UserError for a file that is none, or one without a multirotor's attitude in it.
    """
    log = _Log()
    for part in (path, *following_parts(path)):
        _read_part(part, log)
    stretch = log.chosen()
    if "attitude" not in stretch.columns:
        raise UserError(f"{path}: {log.nothing()}")
    return _record(path, log, stretch)


def _read_part(path: Path, log: _Log) -> None:
    reader = read_tlog(path, even=True, kinds=_KINDS)
    try:
        for time_us, message in reader:
            log.take(time_us * 1e-6, message)
    except UserError as error:
        if not any(stretch.samples for stretch in log.stretches):
            raise
        log.damage.append(str(error).partition(": ")[2])
    log.clock += clock_remarks(reader)
    if reader.truncated:
        log.damage.append("the last record is incomplete")
    if reader.damaged:
        log.damage.append(f"{reader.damaged} frames with a wrong checksum are left out")


def _record(path: Path, log: _Log, stretch: _Stretch) -> FlightRecord:
    columns = stretch.columns
    attitude = columns["attitude"].series(3)
    assert attitude.arrival_s is not None
    offset = float(np.median(attitude.arrival_s - attitude.time_s)) if attitude else 0.0
    sent = any(name in columns for name in ("sent attitude", "sent rates"))

    def own(name: str, width: int) -> Series:
        return columns[name].series(width) if name in columns else empty(width)

    def target(name: str, width: int) -> Series:
        if sent:
            found = columns.get(f"sent {name}")
            return found.sent(offset, width) if found else empty(width)
        return own(f"reported {name}", width)

    def arrived(name: str) -> Series:
        return columns[name].sent(offset, 1) if name in columns else empty(1)

    thrust, throttle = target("thrust", 1), arrived("throttle")
    if not sent and not _agree(thrust, throttle):
        thrust = throttle
    return FlightRecord(
        path=path,
        source="tlog",
        attitude=attitude,
        body_rates=own("body_rates", 3),
        position=own("position", 3),
        velocity=own("velocity", 3),
        attitude_setpoint=target("attitude", 3),
        rates_setpoint=target("rates", 3),
        thrust=thrust,
        armed=arrived("armed"),
        landed=arrived("landed"),
        notes=tuple(Note(time - offset, kind, text) for time, kind, text in stretch.notes),
        autopilot=log.autopilot,
        commands_sent=sent,
        clock_offset_s=offset,
        damage=tuple(log.damage),
        remarks=tuple(log.remarks()),
    )


def _agree(thrust: Series, throttle: Series) -> bool:
    """True if ATTITUDE_TARGET has the thrust that the motors got, VFR_HUD's throttle, as far as is known.

    PX4 repeats an old one there while it follows body rates.
    """
    if not thrust or not throttle:
        return bool(thrust)
    differences = np.abs(thrust.held(throttle.time_s) - throttle.values)[throttle.values > 0.0]
    return not differences.size or float(np.median(differences)) < _SAME_THRUST
