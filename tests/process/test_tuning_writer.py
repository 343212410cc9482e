"""Parameters that are stored in flight: no disk delays control."""

import threading

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.cli_run import shared_parts
from kffa_offboard.cli_vehicle import RunOptions, open_vehicle
from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.config_tuning_file import TuningFile
from kffa_offboard.offboard.tuning import TuningProblem
from kffa_offboard.process.realtime import RealtimeSettings
from kffa_offboard.process.tuning_writer import TuningWriter


class SlowDisk(TuningFile):
    """Takes as long as it is told to; then it may be full."""

    def __init__(self, path, full=False):
        super().__init__(path)
        self.ready = threading.Event()
        self.full = full

    def write(self, text):
        assert self.ready.wait(30.0)
        if self.full:
            raise TuningProblem(f"cannot write {self.path}: No space left on device")
        super().write(text)


@pytest.fixture
def path(tmp_path):
    return tmp_path / "mine.tuned.toml"


def test_storing_does_not_wait_for_the_disk_and_is_read_at_once(path):
    disk = SlowDisk(path)
    writer = TuningWriter(disk)
    writer.write("a = 1\n")
    writer.write("a = 2\n")
    assert writer.read() == "a = 2\n"
    assert not path.exists()
    disk.ready.set()
    writer.close()
    assert path.read_text() == "a = 2\n"
    path.write_text("a = 3\n")
    assert writer.read() == "a = 3\n", "what somebody has written since"


def test_a_full_disk_is_said_once_and_what_was_stored_before_is_read(path):
    path.write_text("a = 0\n")
    disk = SlowDisk(path, full=True)
    writer = TuningWriter(disk)
    writer.write("a = 1\n")
    disk.ready.set()
    writer.close()
    assert writer.take_trouble() == f"parameters not stored: cannot write {path}: No space left on device"
    assert writer.take_trouble() is None
    assert writer.read() == "a = 0\n"


def test_a_directory_that_is_not_there_is_a_reason_at_once(path):
    writer = TuningWriter(TuningFile(path.parent / "no" / "mine.toml"))
    with pytest.raises(TuningProblem, match="cannot write"):
        writer.write("a = 1\n")
    writer.close()


def test_a_running_daemon_stores_without_waiting(tmp_path, monkeypatch):
    disk = threading.Event()
    monkeypatch.setattr(
        TuningFile, "write", lambda self, text: disk.wait(30.0) and self.path.write_text(text)
    )
    text = bundled("demo-px4.toml").read_text() + '\n[parameters]\nfile = "mine.tuned.toml"\n'
    (tmp_path / "mine.toml").write_text(text)
    config = load(tmp_path / "mine.toml", Overrides(link="udpin:127.0.0.1:0"))
    packer = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    store = mavlink.MAVLink_command_long_message(245, 191, mavlink.MAV_CMD_PREFLIGHT_STORAGE, 0, *[1.0] * 7)
    (asked,) = mavlink.MAVLink(None).parse_buffer(store.pack(packer))
    with shared_parts(RealtimeSettings()) as shared:
        with open_vehicle(config, RunOptions(), shared) as vehicle:
            vehicle.session.handle(shared.clock(), asked)
            assert not (tmp_path / "mine.tuned.toml").exists()
            disk.set()
        assert (tmp_path / "mine.tuned.toml").exists(), "the run's end waits for it"
