"""Telemetry logs (.tlog) as flight records: arrival times beside the vehicle's own, commands as they were
sent.

Commands sent by a companion computer carry that computer's time. They are put on the vehicle's clock as the
computer saw it: arrival time less the median of (arrival - sample). A delay from them to the response is
therefore that of the whole loop, telemetry and command, which is what `delay_s` of a configuration means.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.loganalysis.record import FlightRecord, Note, Series, empty, series, series_with_arrival
from kffa_offboard.mavlink import frames
from kffa_offboard.mavlink.telemetry import TelemetryDecoder, landed_state
from kffa_offboard.offboard.events import (
    AttitudeReceived,
    PositionReceived,
    TargetReported,
    Vector3,
)

AUTOPILOT_COMPONENT = mavlink.MAV_COMP_ID_AUTOPILOT1
_REBOOT_S = 1.0  # a boot clock that falls back by more than this began anew
_AUTOPILOTS = {mavlink.MAV_AUTOPILOT_PX4: "px4", mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA: "ardupilot"}
_IGNORE_RATES = 7
_IGNORE_ATTITUDE = mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE


@dataclass
class _Column:
    """Rows as they come."""

    time_s: list[float] = field(default_factory=list)
    arrival_s: list[float] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)

    def add(self, time_s: float, arrival_s: float, values: tuple[float, ...]) -> None:
        self.time_s.append(time_s)
        self.arrival_s.append(arrival_s)
        self.values.append(values)

    def series(self, columns: int) -> Series:
        return series_with_arrival(self.time_s, self.values, self.arrival_s, columns)

    def sent(self, offset_s: float, columns: int) -> Series:
        """Series of what has arrival times only, on the vehicle's clock."""
        return series(np.array(self.arrival_s) - offset_s, self.values, columns)


@dataclass
class _Collector:
    """Sorts the messages of one vehicle into columns."""

    system: int | None = None
    autopilot: str = ""
    decoder: TelemetryDecoder = field(default_factory=TelemetryDecoder)
    columns: dict[str, _Column] = field(default_factory=dict)
    notes: list[tuple[float, str, str]] = field(default_factory=list)
    damage: list[str] = field(default_factory=list)
    latest_s: float = -np.inf
    mode: int | None = None
    armed: bool | None = None

    def column(self, name: str) -> _Column:
        return self.columns.setdefault(name, _Column())

    def take(self, arrival_s: float, message: Any) -> None:
        kind = message.get_type()
        if kind == "SET_ATTITUDE_TARGET":
            self._sent(arrival_s, message)
            return
        if message.get_srcComponent() != AUTOPILOT_COMPONENT:
            return
        if kind == "HEARTBEAT" and message.autopilot in _AUTOPILOTS and self.system is None:
            self.system = message.get_srcSystem()
            self.autopilot = _AUTOPILOTS[message.autopilot]
        if self.system is not None and message.get_srcSystem() != self.system:
            return
        match kind:
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
                    if time_s < self.latest_s - _REBOOT_S and not self.damage:
                        self.damage.append(
                            f"the vehicle restarted at {self.latest_s:.1f} s; what follows is left out"
                        )
                    self.latest_s = max(self.latest_s, time_s)
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

    def _sent(self, arrival_s: float, message: Any) -> None:
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


def read(path: Path) -> FlightRecord:
    """Read a telemetry log.

    Raises UserError for a file that is none, or one without a vehicle's attitude in it.
    """
    collector = _Collector()
    reader = read_tlog(path)
    try:
        for time_us, message in reader:
            collector.take(time_us * 1e-6, message)
    except UserError as error:
        if "attitude" not in collector.columns:
            raise
        collector.damage.append(str(error).partition(": ")[2])
    if reader.truncated:
        collector.damage.append("the last record is incomplete")
    if reader.damaged:
        collector.damage.append(f"{reader.damaged} frames with a wrong checksum are left out")
    if "attitude" not in collector.columns:
        raise UserError(
            f"{path}: no ATTITUDE of an autopilot in this telemetry log; record one of a flight, with "
            "ATTITUDE and LOCAL_POSITION_NED at 50 Hz or more"
        )
    return _record(path, collector)


def _record(path: Path, collector: _Collector) -> FlightRecord:
    columns = collector.columns
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

    thrust = target("thrust", 1)
    return FlightRecord(
        path=path,
        source="tlog",
        attitude=attitude,
        body_rates=own("body_rates", 3),
        position=own("position", 3),
        velocity=own("velocity", 3),
        attitude_setpoint=target("attitude", 3),
        rates_setpoint=target("rates", 3),
        thrust=thrust if thrust else arrived("throttle"),
        armed=arrived("armed"),
        landed=arrived("landed"),
        notes=tuple(Note(time - offset, kind, text) for time, kind, text in collector.notes),
        autopilot=collector.autopilot,
        commands_sent=sent,
        clock_offset_s=offset,
        damage=tuple(collector.damage),
    )
