"""Flight logs: written without delay, readable by everybody, forgiving about a power cut."""

import struct

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.signals import BLOCKS
from kffa_offboard.flightlog.tlog import read_signals, read_tlog
from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.offboard.events import Signals

START_US = 1_700_000_000_000_000
RECORD = struct.Struct(">Q")


@pytest.fixture
def packer():
    return mavlink.MAVLink(None, srcSystem=1, srcComponent=1)


def attitude(packer, time_boot_ms):
    return bytes(mavlink.MAVLink_attitude_message(time_boot_ms, 0.1, 0.2, 0.3, 0, 0, 0.5).pack(packer))


@pytest.fixture
def log(tmp_path, packer):
    """A log with five attitudes, 10 ms apart."""
    path = tmp_path / "flight.tlog"
    with TlogWriter(path) as writer:
        for n in range(5):
            writer.write(START_US + 10_000 * n, attitude(packer, n))
    return path


def read(path):
    reader = read_tlog(path)
    return [(time_us, message.time_boot_ms) for time_us, message in reader], reader


def test_what_was_written_is_read_back_with_its_time(log):
    records, reader = read(log)
    assert records == [(START_US + 10_000 * n, n) for n in range(5)]
    assert (reader.truncated, reader.damaged) == (False, 0)


def test_frames_are_stored_byte_for_byte(log, packer):
    data = log.read_bytes()
    packer.seq = 0
    frame = attitude(packer, 0)
    assert data[:8] == RECORD.pack(START_US)
    assert data[8 : 8 + len(frame)] == frame


def test_pymavlinks_own_tools_can_read_the_log(log):
    connection = mavutil.mavlink_connection(str(log), dialect="ardupilotmega")
    times = []
    while (message := connection.recv_match(type="ATTITUDE")) is not None:
        times.append(round(message._timestamp * 1e6))
    connection.close()
    assert times == pytest.approx([START_US + 10_000 * n for n in range(5)], abs=1)


@pytest.mark.parametrize("cut", range(1, 40, 3))
def test_a_log_cut_short_gives_everything_before_the_cut(log, cut):
    log.write_bytes(log.read_bytes()[:-cut])
    records, reader = read(log)
    assert len(records) == 4
    assert reader.truncated


def test_zeros_at_the_end_are_a_cut_too(log):
    log.write_bytes(log.read_bytes() + bytes(4096))
    records, reader = read(log)
    assert len(records) == 5
    assert reader.truncated


def test_a_damaged_frame_is_left_out_and_counted(log):
    data = bytearray(log.read_bytes())
    data[8 + 12] ^= 0xFF
    log.write_bytes(data)
    records, reader = read(log)
    assert [time_boot_ms for _, time_boot_ms in records] == [1, 2, 3, 4]
    assert reader.damaged == 1


def test_mavlink_1_and_signed_frames_are_read_too(tmp_path, packer):
    old = bytes(mavlink.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0).pack(packer, force_mavlink1=True))
    packer.signing.secret_key = bytes(32)
    packer.signing.sign_outgoing = True
    signed = attitude(packer, 2)
    path = tmp_path / "mixed.tlog"
    with TlogWriter(path) as writer:
        for frame in (old, signed, old):
            writer.write(START_US, frame)
    assert [time_boot_ms for _, time_boot_ms in read(path)[0]] == [1, 2, 1]


def test_a_file_that_is_no_log_is_explained(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("these are my notes of the flight")
    with pytest.raises(UserError, match=r"no MAVLink frame at byte 0; the file is damaged or not a \.tlog"):
        read(path)


def test_a_missing_log_is_explained(tmp_path):
    with pytest.raises(UserError, match=r"cannot read flight log .*No such file"):
        read(tmp_path / "missing.tlog")


def test_an_existing_log_is_never_overwritten(log):
    before = log.read_bytes()
    with pytest.raises(UserError, match="exists already; choose another name"):
        TlogWriter(log)
    assert log.read_bytes() == before


def test_missing_directories_are_made(tmp_path):
    path = tmp_path / "a" / "b" / "flight.tlog"
    TlogWriter(path).close()
    assert path.read_bytes() == b""


def test_a_directory_that_cannot_be_made_is_explained(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(
        UserError, match=r"cannot make directory .*file for the flight log: .*; choose another"
    ):
        TlogWriter(tmp_path / "file" / "flight.tlog")


def test_writing_to_a_closed_log_is_a_mistake(log, tmp_path, packer):
    writer = TlogWriter(tmp_path / "other.tlog")
    writer.close()
    with pytest.raises(ValueError, match="is closed"):
        writer.write(START_US, attitude(packer, 0))


def test_signals_in_the_log_become_arrays_in_the_order_of_their_steps(tmp_path, packer):
    path = tmp_path / "flight.tlog"
    with TlogWriter(path, system_id=99) as writer:
        for n in range(3):
            writer.write(START_US + n, attitude(packer, n))
            blocks = {
                name: tuple(100.0 * n + 10.0 * b + c for c in range(4)) for b, name in enumerate(BLOCKS)
            }
            writer.write_signals(Signals(START_US + n, "engaged", dt=0.01, **blocks))
    signals = read_signals(path)
    assert signals.time_us.tolist() == [START_US, START_US + 1, START_US + 2]
    assert signals.omega_c[:, 3].tolist() == [63.0, 163.0, 263.0]
    senders = {
        (m.get_srcSystem(), m.get_srcComponent())
        for _, m in read_tlog(path)
        if m.get_type() == "DEBUG_FLOAT_ARRAY"
    }
    assert senders == {(99, 191)}
