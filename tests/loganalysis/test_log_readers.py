"""Three formats, one flight; and files that are not what they should be."""

from __future__ import annotations

import gzip
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.DFReader import DFReader_binary

from kffa_offboard import cli
from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis import dataflash
from kffa_offboard.loganalysis.identify_command import run_identify
from kffa_offboard.loganalysis.read import read_log

KINDS = ("tlog", "dataflash", "ulog")
TURN = np.array([1.0, -1.0, -1.0])


@pytest.mark.parametrize("kind", KINDS)
def test_every_format_gives_the_same_flight_in_the_papers_axes(
    kind: str, log_files: dict[str, Path], flight: Any
) -> None:
    record = read_log(log_files[kind])
    assert record.source == kind
    assert not record.partial
    for series, ned in (
        (record.attitude, flight.euler),
        (record.body_rates, flight.rates),
        (record.position, flight.position),
        (record.velocity, flight.velocity),
        (record.rates_setpoint, flight.rates_setpoint),
    ):
        assert np.allclose(series.values, TURN * ned, atol=1e-4)
    assert np.allclose(record.thrust.values[:, 0], flight.thrust, atol=1e-6)
    assert np.allclose(record.attitude.time_s, flight.time_s, atol=1e-3)


def test_commands_in_a_companions_log_count_from_the_sample_that_it_had(
    log_files: dict[str, Path], flight: Any
) -> None:
    record = read_log(log_files["tlog"])
    assert record.commands_sent
    assert np.allclose(record.rates_setpoint.time_s, flight.time_s, atol=1e-3)
    assert record.clock_offset_s == pytest.approx(1.7e9 + 0.03, abs=1e-3)


def test_reported_set_points_are_taken_where_none_were_sent(reported_tlog: Path, flight: Any) -> None:
    record = read_log(reported_tlog)
    assert not record.commands_sent
    assert np.allclose(record.rates_setpoint.values, TURN * flight.rates_setpoint, atol=1e-6)


def test_dataflash_columns_are_those_of_pymavlink(log_files: dict[str, Path]) -> None:
    ours = dataflash.read(log_files["dataflash"], frozenset({"ATT", "RATE"})).tables
    reader = DFReader_binary(str(log_files["dataflash"]))
    messages = [reader.recv_msg() for _ in range(800)]
    for name, columns in ours.items():
        theirs = [message for message in messages if message is not None and message.get_type() == name]
        for column, values in columns.items():
            expected = [getattr(message, column) for message in theirs]
            assert np.allclose(values[: len(expected)].astype(float), expected)


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_cut_short_gives_what_came_before_and_says_so(
    kind: str, log_files: dict[str, Path], tmp_path: Path
) -> None:
    data = log_files[kind].read_bytes()
    cut = tmp_path / log_files[kind].name
    cut.write_bytes(data[: len(data) // 2 + 5])
    record = read_log(cut)
    assert 1.0 < record.duration_s < 3.0
    assert record.partial


def test_a_log_that_begins_after_arming_was_armed_until_it_says_otherwise(
    log_files: dict[str, Path], tmp_path: Path, flight: Any
) -> None:
    data = log_files["dataflash"].read_bytes()
    arm = data.index(b"\xa3\x95\x85")
    later = round((flight.time_s[0] + 2.0) * 1e6).to_bytes(8, "little")
    path = tmp_path / "disarmed.BIN"
    path.write_bytes(data[:arm] + data[arm + 12 :] + data[arm : arm + 3] + later + b"\x00")
    armed = read_log(path).armed.held(flight.time_s)[:, 0]
    assert np.array_equal(armed != 0.0, flight.time_s < flight.time_s[0] + 2.0)


@pytest.mark.parametrize("content", [b"", b"hello, world, this is a text file\n" * 9, b"\x00" * 100])
def test_a_file_of_another_kind_is_refused_in_one_line_that_names_it(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "notes.BIN"
    path.write_bytes(content)
    with pytest.raises(UserError) as refusal:
        read_log(path)
    assert str(path) in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_log_without_attitude_names_the_remedy(tmp_path: Path) -> None:
    path = tmp_path / "bare.BIN"
    path.write_bytes(
        b"\xa3\x95\x80" + bytes([200, 11]) + b"XYZ\0Q".ljust(20, b"\0") + b"TimeUS".ljust(64, b"\0")
    )
    with pytest.raises(UserError, match="LOG_BITMASK"):
        read_log(path)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_damage_crashes_or_hangs_a_reader(kind: str, log_files: dict[str, Path], data: Any) -> None:
    content = bytearray(log_files[kind].read_bytes()[:12_000])
    for position in data.draw(st.lists(st.integers(0, len(content) - 1), max_size=8)):
        content[position] = data.draw(st.integers(0, 255))
    del content[data.draw(st.integers(0, len(content))) :]
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "damaged"
        path.write_bytes(content)
        try:
            record = read_log(path)
        except UserError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error)
        else:
            assert np.all(np.diff(record.attitude.time_s) > 0.0)


@pytest.mark.parametrize(
    ("status", "what"),
    [
        ({"system_type": 1, "vehicle_type": 2}, "a MAV_TYPE_FIXED_WING"),
        ({"system_type": 21, "vehicle_type": 1}, "a MAV_TYPE_VTOL_TILTROTOR"),
        ({"system_type": 0, "vehicle_type": 2}, "a fixed-wing vehicle"),
        ({"vehicle_type": 3}, "a rover"),
        ({"vehicle_type": 9}, "a vehicle with vehicle_type 9"),
        ({"system_type": 250}, "a vehicle with system_type 250"),
    ],
)
def test_a_px4_log_of_another_vehicle_than_a_multirotor_is_called_so(
    ulog_of: Callable[..., Path], status: dict[str, int], what: str
) -> None:
    with pytest.raises(UserError, match=f"is a log of {what}; only those of multirotors can be read"):
        read_log(ulog_of(**status))


@pytest.mark.parametrize(
    "status",
    [{"system_type": 2, "vehicle_type": 1}, {"system_type": 0, "vehicle_type": 0}, {"system_type": 13}],
)
def test_a_px4_log_of_a_multirotor_or_of_a_vehicle_that_is_not_known_is_read(
    ulog_of: Callable[..., Path], status: dict[str, int]
) -> None:
    assert read_log(ulog_of(**status)).attitude.time_s.size > 100


def test_identify_never_writes_its_model_over_a_log(log_files: dict[str, Path]) -> None:
    log = log_files["tlog"]
    recorded = log.read_bytes()
    with pytest.raises(UserError, match="is what is to be read"):
        run_identify([log], log, 0.0, as_json=True)
    assert log.read_bytes() == recorded


def test_no_command_writes_its_results_over_any_flight_log(
    log_files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    packed = tmp_path / "other.tlog.gz"
    packed.write_bytes(gzip.compress(log_files["tlog"].read_bytes()))
    flown = str(log_files["tlog"])
    for other in (log_files["dataflash"], log_files["ulog"], packed):
        recorded = other.read_bytes()
        for command in ("report", "export", "identify"):
            with pytest.raises(SystemExit) as ended:
                cli.main([command, flown, "--out", str(other)])
            assert ended.value.code == 2
            assert "is a flight log, which would be lost" in capsys.readouterr().err
        assert other.read_bytes() == recorded


@pytest.mark.parametrize("command", ["report", "export", "identify"])
def test_no_command_writes_its_results_over_what_it_has_not_written(
    command: str, log_files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mine = tmp_path / "my-vehicle.toml"
    mine.write_text('[link]\nurl = "udpin:127.0.0.1:14540"\n', encoding="utf-8")
    before = mine.read_bytes()
    with pytest.raises(SystemExit) as ended:
        cli.main([command, str(log_files["tlog"]), "--out", str(mine)])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert said.startswith(f"error: --out {mine}: is there and begins with '[link]', not with ")
    assert said.endswith("it would be lost; name another file\n")
    assert mine.read_bytes() == before


def test_shadow_writes_its_table_over_an_older_one_and_over_nothing_else(
    log_files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = str(Path(__file__).parents[2] / "configs" / "demo-px4.toml")
    arguments = ["shadow", str(log_files["ulog"]), "--out", str(tmp_path), "--config", config]
    table, mine = tmp_path / "shadow.csv", "date,hours of shadow\n"
    table.write_text(mine, encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 2
    assert capsys.readouterr().err.startswith(
        f"error: --out {table}: is there and begins with 'date,ho', not "
    )
    assert table.read_text(encoding="utf-8") == mine
    table.write_text("time_s,measured_roll\n", encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        cli.main(arguments)
    assert ended.value.code == 0
    assert table.stat().st_size > 1000


def test_identify_writes_its_model_over_an_older_model_and_into_an_empty_file(
    log_files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "model.toml"
    for before in ("", "# Identified by kffa-offboard from older.tlog.\n"):
        model.write_text(before, encoding="utf-8")
        assert run_identify([log_files["tlog"]], model, 0.0, as_json=True) == 1  # nothing in it to identify


def test_a_compressed_telemetry_log_is_read_whatever_its_name(
    log_files: dict[str, Path], tmp_path: Path
) -> None:
    packed = tmp_path / "flight"
    packed.write_bytes(gzip.compress(log_files["tlog"].read_bytes()))
    assert np.array_equal(read_log(packed).attitude.values, read_log(log_files["tlog"]).attitude.values)


def test_a_pipe_is_refused_in_words(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(UserError, match="is a pipe, and a log is read more than once; give a file"):
        read_log(tmp_path / "pipe")


def test_a_record_of_a_kind_that_is_not_known_yet_is_passed_over_by_its_length(
    log_files: dict[str, Path], tmp_path: Path
) -> None:
    """ArduPilot adds format letters; "?" is none so far."""
    known = log_files["dataflash"].read_bytes()
    path = tmp_path / "newer.BIN"
    declared = bytes([201, 3 + 7]) + b"NEW\0Q?".ljust(20, b"\0") + b"TimeUS,New".ljust(64, b"\0")
    record = b"\xa3\x95\xc9" + bytes(range(7))
    path.write_bytes(known[:89] + b"\xa3\x95\x80" + declared + known[89:] + 10 * record)
    newer = read_log(path)
    assert newer.damage == ()
    assert np.array_equal(newer.attitude.values, read_log(log_files["dataflash"]).attitude.values)


def test_a_log_of_a_fixed_wing_vehicle_is_refused(log_files: dict[str, Path], tmp_path: Path) -> None:
    path = tmp_path / "plane.BIN"
    path.write_bytes(log_files["dataflash"].read_bytes().replace(b"ArduCopter V4.7.0", b"ArduPlane V4.7.0\0"))
    with pytest.raises(UserError, match=r"plane\.BIN: is a log of ArduPlane; only those of multirotors"):
        read_log(path)
