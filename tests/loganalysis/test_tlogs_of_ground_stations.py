"""Telemetry logs that hold more than one flight of one vehicle, as ground stations write them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.notes import Header
from kffa_offboard.flightlog.tlog import TIMESTAMP, read_tlog
from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.loganalysis.read import read_log
from kffa_offboard.report.read import read_flight

Records = list[tuple[int, Any]]


@pytest.fixture
def records(log_files: dict[str, Path]) -> Records:
    """The synthetic flight with the commands of its companion computer: time in us, message."""
    return [*read_tlog(log_files["tlog"])]


@pytest.fixture
def write(tmp_path: Path) -> Callable[[Iterable[tuple[int, Any]]], Path]:
    """Writes messages in order of time, each from its own system and component."""

    def write_records(records: Iterable[tuple[int, Any]]) -> Path:
        path = tmp_path / "ground.tlog"
        with path.open("wb") as file:
            for time_us, message in records:
                sender = mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
                file.write(TIMESTAMP.pack(time_us) + bytes(message.pack(sender)))
        return path

    return write_records


def again(records: Records, later_s: float, system: int = 1, **changes: Any) -> Records:
    """The same flight later, of a vehicle of another system, with other values in fields of that name."""
    sender = {1: system, 245: 245 + system - 1}
    found = []
    for time_us, message in records:
        values = {name: getattr(message, name) for name in message.fieldnames}
        if "target_system" in values:
            values["target_system"] = system
        other = type(message)(**values | {name: changes[name] for name in changes if name in values})
        component = message.get_srcComponent()
        other._header.srcSystem, other._header.srcComponent = sender[message.get_srcSystem()], component
        found.append((time_us + round(later_s * 1e6), other))
    return found


def in_order(*flights: Records) -> Records:
    return sorted((entry for flight in flights for entry in flight), key=lambda entry: entry[0])


def test_commands_to_another_vehicle_and_its_telemetry_are_not_mixed_in(
    records: Records, write: Callable[..., Path], log_files: dict[str, Path]
) -> None:
    alone = read_log(log_files["tlog"])
    both = write(in_order(records, again(records, 0.005, system=2, thrust=0.9, roll=1.0)))
    assert "system 1 is shown; left out: system 2" in read_flight(both).remarks
    record = read_log(both)
    assert np.array_equal(record.attitude.values, alone.attitude.values)
    assert np.array_equal(record.thrust.values, alone.thrust.values)
    assert record.remarks == ("system 1 is looked at; left out: system 2",)
    assert not record.partial


def test_of_a_vehicle_that_restarted_the_longer_flight_is_read(
    records: Records, write: Callable[..., Path], log_files: dict[str, Path]
) -> None:
    alone = read_log(log_files["tlog"])
    short = records[: len(records) // 2]
    for flights in (
        in_order(again(short, -60.0, roll=1.0), records),
        in_order(records, again(short, 60.0, roll=1.0)),
    ):
        for time_us, message in flights:
            if hasattr(message, "time_boot_ms"):  # power-up just before each flight
                began_us = next(t for t, _ in flights if time_us - t < 30_000_000)
                message.time_boot_ms = (time_us - began_us) // 1000
        record = read_log(write(flights))
        assert np.array_equal(record.attitude.values, alone.attitude.values)
        assert np.array_equal(record.rates_setpoint.values, alone.rates_setpoint.values)
        assert "the vehicle was started 2 times" in record.remarks[0]


def test_samples_that_come_again_late_by_another_link_are_no_restart(
    records: Records, write: Callable[..., Path], log_files: dict[str, Path]
) -> None:
    record = read_log(write(in_order(records, again(records, 1.5))))
    assert np.array_equal(record.attitude.values, read_log(log_files["tlog"]).attitude.values)
    assert record.remarks == ()


def test_a_thrust_that_px4_repeats_while_it_follows_body_rates_is_not_believed(
    reported_tlog: Path, write: Callable[..., Path], flight: Any
) -> None:
    reported = [*read_tlog(reported_tlog)]
    assert np.allclose(read_log(reported_tlog).thrust.values[:, 0], flight.thrust, atol=1e-6)
    throttles = []
    for time_s, thrust in zip(flight.time_s[::10], flight.thrust[::10], strict=True):
        hud = mavlink.MAVLink_vfr_hud_message(0.0, 0.0, 0, round(100.0 * thrust), 0.0, 0.0)
        hud._header.srcSystem, hud._header.srcComponent = 1, 1
        throttles.append((round((1.7e9 + 0.03 + time_s) * 1e6), hud))
    agreeing = read_log(write(in_order(reported, throttles)))
    assert len(agreeing.thrust) == len(flight.thrust)
    stale = read_log(write(in_order(again(reported, 0.0, thrust=0.0), throttles)))
    assert np.allclose(stale.thrust.values[:, 0], flight.thrust[::10], atol=0.0051)


def test_a_fixed_wing_vehicle_is_named_and_a_multirotor_beside_it_is_read(
    records: Records, write: Callable[..., Path], log_files: dict[str, Path]
) -> None:
    plane = again(records, -0.005, system=7, type=mavlink.MAV_TYPE_FIXED_WING, roll=1.0)
    record = read_log(write(in_order(plane, records)))
    assert np.array_equal(record.attitude.values, read_log(log_files["tlog"]).attitude.values)
    with pytest.raises(UserError, match=r"no multirotor .*: system 7 is a MAV_TYPE_FIXED_WING"):
        read_log(write(plane))


def test_the_further_files_of_a_flight_are_read_with_it(
    records: Records, tmp_path: Path, flight: Any
) -> None:
    path = tmp_path / "long.tlog"
    half = len(records) // 2
    for part, some in ((1, records[:half]), (2, records[half:])):
        name = path if part == 1 else tmp_path / "long-2.tlog"
        with TlogWriter(name, header=Header("1.2.3", {}, {}, part=part)) as log:
            log.write_begin(records[0][0])
            for time_us, message in some:
                sender = mavlink.MAVLink(None, message.get_srcSystem(), message.get_srcComponent())
                log.write(time_us, bytes(message.pack(sender)))
    assert len(read_log(path).attitude) == len(flight.time_s)
