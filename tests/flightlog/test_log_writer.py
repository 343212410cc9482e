"""The log under stress: a full disk, a killed process, files that grow too large."""

import errno
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog import writer as writing
from kffa_offboard.flightlog.notes import End, Header, Lost, NoteReader, is_note, notes, to_messages
from kffa_offboard.flightlog.parts import following_parts, part_path, without_parts
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.offboard.events import EngageRequested, HangNoticed, ReleaseRequested

START_US = 1_700_000_000_000_000
HEADER = Header(
    version="1.2.3",
    configuration={
        "control": {"altitude": {"omega_c": 8.0}},
        "scenario": {"segment": [{"type": "hold"}] * 40},
    },
    options={"arm": True, "engage": False, "shadow": False},
    lockstep=True,
    libraries={"numpy": "2.0"},
)


def attitude(n):
    packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    return bytes(mavlink.MAVLink_attitude_message(n, 0.1, 0.2, 0.3, 0, 0, 0.5).pack(packer))


def times_in(path):
    return [m.time_boot_ms for _, m in read_tlog(path) if m.get_type() == "ATTITUDE"]


class SmallDisk:
    """A raw file on a disk with `room` bytes left."""

    def __init__(self, path, room):
        self.file = path.open("xb", buffering=0)
        self.room = room

    def write(self, data):
        if self.room == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        taken = self.file.write(data[: self.room])
        self.room -= taken
        return taken

    def truncate(self, size):
        self.room += self.file.seek(0, 2) - size
        self.file.truncate(size)

    def __getattr__(self, name):
        return getattr(self.file, name)


@pytest.fixture
def small_disk(monkeypatch):
    """Makes logs on a disk with little room; returns the disks made."""
    disks = []

    def limit(room):
        monkeypatch.setattr(writing, "_create", lambda path: disks.append(SmallDisk(path, room)) or disks[-1])
        return disks

    return limit


def make_sink(path, header=None, part_size=None):
    return writing._Sink(path, header, writing._NotePacker(245, 191), part_size)


def record(n):
    return writing.TIMESTAMP.pack(START_US + n) + attitude(n)


def test_a_full_disk_leaves_a_readable_log_that_goes_on_when_there_is_room_again(tmp_path, small_disk):
    path = tmp_path / "flight.tlog"
    disks = small_disk(10 * len(record(0)) + 7)
    sink = make_sink(path)
    for start in (0, 8, 16):
        sink.write([record(n) for n in range(start, start + 8)])
    assert times_in(path) == list(range(8)), "a batch that does not fit leaves nothing half written"
    assert not (reader := read_tlog(path)).truncated
    assert len(list(reader)) == 8
    disks[0].room = 10_000
    sink.write([record(n) for n in range(24, 32)])
    sink.close()
    assert times_in(path) == [*range(8), *range(24, 32)]
    assert sink.lost == 16
    assert [*notes(m for _, m in read_tlog(path))] == [Lost(16)], "the hole is told where it is"
    assert sink.problem == "No space left on device"


def test_a_full_disk_is_reported_at_the_end_and_does_not_stop_the_flight(tmp_path, small_disk):
    small_disk(0)
    writer = TlogWriter(tmp_path / "flight.tlog")
    for n in range(2000):
        writer.write(START_US, attitude(n))
    with pytest.raises(
        UserError, match=r"is not complete: No space left on device \(2000 records lost\); is the disk full"
    ):
        writer.close()
    writer.close()


def test_records_that_were_lost_at_the_end_are_told_if_there_is_room_for_a_note(tmp_path, small_disk):
    path = tmp_path / "flight.tlog"
    small_disk(4 * len(record(0)))
    sink = make_sink(path)
    sink.write([record(0)])
    sink.write([record(n) for n in range(1, 9)])
    sink.close()
    assert [*notes(m for _, m in read_tlog(path))] == [Lost(8)]


def test_what_comes_faster_than_in_a_flight_does_not_wait_until_the_period_is_over(tmp_path, monkeypatch):
    path, written = tmp_path / "flight.tlog", threading.Event()

    class Watched(SmallDisk):
        def write(self, data):
            taken = super().write(data)
            written.set()
            return taken

    monkeypatch.setattr(writing, "_create", lambda path: Watched(path, 1_000_000))
    monkeypatch.setattr(writing, "FLUSH_PERIOD_S", 3600.0)
    count = writing.BATCH_SIZE + 1
    with TlogWriter(path) as writer:
        for n in range(count):
            assert not written.is_set()
            writer.write(START_US + n, attitude(n))
        assert written.wait(10.0)
    assert times_in(path) == list(range(count))


WRITE_UNTIL_KILLED = """
import itertools, sys, time
from pathlib import Path
from kffa_offboard.flightlog.writer import TlogWriter
from tests_attitude import attitude
writer = TlogWriter(Path(sys.argv[1]))
started = time.monotonic()
for n in itertools.count():
    while time.monotonic() - started < n / 1000.0:
        pass
    writer.write(n, attitude(n))
    print(n, flush=True)
"""


def test_a_killed_process_loses_less_than_the_last_second(tmp_path):
    path, script = tmp_path / "flight.tlog", tmp_path / "write.py"
    script.write_text(WRITE_UNTIL_KILLED)
    (tmp_path / "tests_attitude.py").write_text(
        "from pymavlink.dialects.v20 import ardupilotmega as mavlink\n"
        "def attitude(n):\n"
        "    packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)\n"
        "    return bytes(mavlink.MAVLink_attitude_message(n, 0, 0, 0, 0, 0, 0).pack(packer))\n"
    )
    with subprocess.Popen([sys.executable, script, path], stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            if int(line) >= 1600:
                process.send_signal(signal.SIGKILL)
                break
        written = int(line)
        process.wait()
    kept = times_in(path)
    assert kept == list(range(len(kept)))
    assert len(kept) > written - 1000, "1000 records a second: at most the last second may be missing"


def test_a_long_flight_goes_on_in_further_files_that_each_begin_with_the_header(tmp_path):
    path = tmp_path / "flight.tlog"
    sink = make_sink(path, HEADER, part_size=5_000)
    for start in range(0, 600, 50):
        sink.write([record(n) for n in range(start, start + 50)])
    sink.close()
    parts = [path, part_path(path, 2), part_path(path, 3)]
    assert parts[1] == tmp_path / "flight-2.tlog"
    kept = [times_in(part) for part in parts if part.exists()]
    assert [n for part in kept for n in part] == list(range(600))[: sum(map(len, kept))]
    headers = [note for note in notes(m for _, m in read_tlog(parts[1])) if isinstance(note, Header)]
    assert [header.part for header in headers] == [2]
    assert headers[0].configuration == HEADER.configuration


def test_a_further_file_that_exists_is_left_alone_and_the_log_stays_where_it_is(tmp_path):
    path = tmp_path / "flight.tlog"
    other = part_path(path, 2)
    other.write_bytes(b"somebody else's")
    sink = make_sink(path, HEADER, part_size=1_000)
    for start in range(0, 100, 50):
        sink.write([record(n) for n in range(start, start + 50)])
    sink.close()
    assert times_in(path) == list(range(100))
    assert other.read_bytes() == b"somebody else's"


def parts_of(path, begin_us=START_US, count=600):
    """A flight in several files, 10 records in each."""
    begun = replace(HEADER, begin_us=begin_us)
    sink = make_sink(path, begun, part_size=1)
    sink.write([sink._notes.records(begin_us, begun)])
    for n in range(0, count, 10):
        sink.write([record(k) for k in range(n, n + 10)])
    sink.close()


def test_another_flight_that_is_called_like_a_further_file_is_none(tmp_path):
    parts_of(tmp_path / "flight.tlog", count=20)
    assert [*following_parts(tmp_path / "flight.tlog")] == [
        part_path(tmp_path / "flight.tlog", k) for k in (2, 3)
    ]
    other = tmp_path / "other.tlog"
    parts_of(other, START_US + 1, count=0)
    parts_of(part_path(other, 2), count=0)
    assert [*following_parts(other)] == []
    parts_of(tmp_path / "later.tlog", START_US + 2, count=20)
    part_path(tmp_path / "later.tlog", 2).rename(part_path(other, 3))
    assert [*following_parts(other)] == [], "nor is a further file of another flight"
    logs = [part_path(other, 2), other]
    assert without_parts(logs) == logs


def test_a_further_file_that_is_missing_between_others_is_named(tmp_path):
    path = tmp_path / "flight.tlog"
    parts_of(path, count=40)
    part_path(path, 3).unlink()
    with pytest.raises(UserError, match=r"flight-3\.tlog: is missing, and flight-4\.tlog is there"):
        [*following_parts(path)]


@pytest.mark.parametrize(
    "note",
    [
        HEADER,
        EngageRequested(),
        ReleaseRequested("Strg-C, “stop”"),
        HangNoticed(3.25),
        End("landed", frames_dropped=3),
    ],
    ids=lambda note: type(note).__name__,
)
def test_a_note_survives_its_way_through_frames(note):
    packer, parser = mavlink.MAVLink(None), mavlink.MAVLink(None)
    reader = NoteReader()
    frames = [bytes(message.pack(packer)) for message in to_messages(note)]
    messages = [parser.decode(bytearray(frame)) for frame in frames]
    assert all(is_note(message) for message in messages)
    assert [reader.take(message) for message in messages] == [None] * (len(messages) - 1) + [note]


def test_a_lost_piece_of_a_note_is_noticed():
    first, second, *_ = to_messages(HEADER)
    reader = NoteReader()
    reader.take(first)
    with pytest.raises(ValueError, match="piece 0 of a note where piece 1 was expected"):
        reader.take(first)
    assert second


def test_a_header_of_a_later_version_is_refused(monkeypatch):
    monkeypatch.setattr("kffa_offboard.flightlog.notes.FORMAT", 2)
    messages = to_messages(HEADER)
    monkeypatch.undo()
    with pytest.raises(ValueError, match="format 2; this version reads format 1"):
        list(notes(iter(messages)))


def test_logs_are_named_with_part_numbers_before_the_suffix():
    assert part_path(Path("a/b.tlog"), 1) == Path("a/b.tlog")
    assert part_path(Path("a/b.tlog"), 12) == Path("a/b-12.tlog")
