"""What `run` loads, and what it does when the clock on the wall is wrong."""

import ast
import contextlib
import errno
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

import kffa_offboard
from kffa_offboard import cli, cli_run
from kffa_offboard.cli_vehicle import RunOptions, _log_path
from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.errors import UserError
from kffa_offboard.flightlog import writer
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import RunResult, real_time_clock
from kffa_offboard.mavlink.transmission import Counters
from kffa_offboard.mavlink.udp import UdpLink
from kffa_offboard.offboard.state import Finished

PACKAGE = Path(kffa_offboard.__file__).parent
RUN_WITHOUT_VEHICLE = """
import sys
from kffa_offboard.cli import main
try:
    main(["run", "--config", sys.argv[1], "--link", "udpin:127.0.0.1:0", "--engage"])
except SystemExit as ended:
    assert ended.code == 2, ended.code
print(*sorted(sys.modules))
"""
HEAVY = ("matplotlib", "plotly", "pandas", "scipy", "control", "pyulog", "sim_vehicle")


def test_run_loads_nothing_heavy(tmp_path):
    config = tmp_path / "short.toml"
    text = bundled("px4-udp.toml").read_text().replace("[telemetry]", "[telemetry]\nconnect_timeout_s = 0.1")
    config.write_text(text.replace('directory = "logs"', ""))
    ended = subprocess.run(
        [sys.executable, "-c", RUN_WITHOUT_VEHICLE, config], capture_output=True, text=True, cwd=tmp_path
    )
    assert "no vehicle answered" in ended.stderr
    loaded = ended.stdout.split()
    assert "kffa_offboard.offboard.service" in loaded
    assert not [name for name in HEAVY if name in loaded]


SAME_FILTER = """
import sys
from kffa_offboard.lean_imports import load_kalman_filter_alone
load_kalman_filter_alone()
from filterpy.kalman import KalmanFilter
assert "scipy" not in sys.modules
kalman = KalmanFilter(dim_x=2, dim_z=1)
kalman.F[0, 1], kalman.H[0, 0] = 0.1, 1.0
for k in range(20):
    kalman.predict()
    kalman.update(0.1 * k)
print(kalman.x.ravel().tolist(), kalman.log_likelihood)
print(sys.modules[KalmanFilter.__module__].__file__)
"""


def test_the_filter_that_is_loaded_alone_is_filterpy_s_own():
    whole = SAME_FILTER.replace("load_kalman_filter_alone()\n", "").replace("not in", "in")
    said = [
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
        for code in (SAME_FILTER, whole)
    ]
    assert said[0] == said[1]
    assert said[0].strip().endswith("kalman_filter.py")


def test_the_clock_of_a_flight_does_not_follow_the_wall(monkeypatch):
    clock = real_time_clock()
    before = clock()
    for year in (1970, 2100):
        monkeypatch.setattr(time, "time_ns", lambda year=year: (year - 1970) * 31_557_600 * 10**9)
        monkeypatch.setattr(time, "time", lambda year=year: (year - 1970) * 31_557_600.0)
        after = clock()
        assert 0 <= after - before < 60_000_000
        before = after


def test_wall_time_is_read_where_a_flight_begins_and_where_the_kernel_stamps_with_it_and_nowhere_else():
    """In what flies: names of logs, the first time stamp, and how long a datagram waited (bounded)."""
    wall = {"time", "time_ns", "strftime", "localtime", "gmtime", "now", "utcnow", "today"}
    readers = set()
    for layer in ("control", "offboard", "mavlink", "flightlog", "process", "."):
        for path in (PACKAGE / layer).glob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if (
                    isinstance(node, ast.Attribute)
                    and node.attr in wall
                    and isinstance(node.value, ast.Name)
                    and node.value.id in ("time", "datetime", "date")
                ):
                    readers.add((path.name, node.attr))
    assert readers == {("shell.py", "time_ns"), ("udp.py", "time_ns"), ("cli_vehicle.py", "strftime")}


def test_a_log_of_the_same_second_gets_another_name(tmp_path, monkeypatch):
    """A computer without a clock of its own begins at the same second with each power-up."""
    monkeypatch.setattr(time, "strftime", lambda _: "1970-01-01_00-00-05")
    config = tmp_path / "vehicle.toml"
    config.write_text(bundled("px4-udp.toml").read_text().replace('"logs"', f'"{tmp_path}"'))
    paths = []
    for _ in range(3):
        paths.append(_log_path(load(config), RunOptions(), ""))
        paths[-1].touch()
    assert [path.name for path in paths] == [
        "1970-01-01_00-00-05.tlog",
        "1970-01-01_00-00-05_2.tlog",
        "1970-01-01_00-00-05_3.tlog",
    ]


def said_by(capsys, *options, config=None):
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "--config", str(config or bundled("px4-udp.toml")), *options])
    assert ended.value.code == 2
    return capsys.readouterr().err.splitlines()[-1]


def test_real_time_and_lock_step_contradict_each_other(capsys):
    assert "--realtime is for flying by the clock" in said_by(capsys, "--realtime", "--lockstep")


def test_reengaging_without_engaging_is_refused(capsys):
    assert "--reengage is what --engage does after a restart" in said_by(capsys, "--reengage")


@pytest.mark.parametrize("url", ["127.0.0.1:9870", "udpin:127.0.0.1:9870", "serial:/dev/ttyS0:57600"])
def test_a_place_for_signals_that_is_none_names_option_and_remedy(url, capsys):
    said = said_by(capsys, "--link", "udpin:127.0.0.1:0", "--plot", url)
    assert said == f"error: --plot '{url}': signals go out over UDP only; write udpout:HOST:PORT"


def test_a_log_directory_that_cannot_be_written_is_said_at_the_start(tmp_path, capsys):
    (tmp_path / "file").touch()
    log = tmp_path / "file" / "logs" / "flight.tlog"
    said = said_by(capsys, "--link", "udpin:127.0.0.1:0", "--log", str(log))
    assert said.startswith(f"error: cannot make directory {log.parent} for the flight log: ")
    assert said.endswith("; choose another --log or log.directory")


def test_real_time_that_is_required_and_not_permitted_is_said_before_flying(monkeypatch, tmp_path, capsys):
    refusal = "cannot run with SCHED_FIFO priority 50 (realtime.priority): not permitted; ask"
    monkeypatch.setattr(cli_run, "become_real_time", lambda settings: [refusal])
    log = ("--link", "udpin:127.0.0.1:0", "--log", str(tmp_path / "flight.tlog"))
    said = said_by(capsys, "--realtime", *log)
    assert said == f"error: {refusal}; or set realtime.required = false"


@pytest.mark.parametrize("error", [ZeroDivisionError("a mistake"), KeyboardInterrupt(), UserError("no")])
def test_a_run_that_breaks_off_says_its_last_words_before_the_link_is_closed(monkeypatch, tmp_path, error):
    happened = []

    def drive(vehicle, *_):
        raise error

    monkeypatch.setattr(cli_run, "_drive", drive)
    monkeypatch.setattr(Session, "fall_silent", lambda session: happened.append("last words"))
    monkeypatch.setattr(Session, "close", lambda session, reason: happened.append("end of the log"))
    monkeypatch.setattr(UdpLink, "close", lambda link: happened.append("link closed"))
    config = load(bundled("demo-px4.toml"), Overrides(link="udpin:127.0.0.1:0"))
    with contextlib.suppress(ZeroDivisionError, UserError):
        cli_run.run_one(config, RunOptions(log=tmp_path / "flight.tlog"))
    assert happened[0] == "last words" and happened[-1] == "link closed"


def test_the_log_of_a_run_without_a_vehicle_is_a_whole_one(tmp_path, capsys):
    config, log = tmp_path / "short.toml", tmp_path / "nobody.tlog"
    text = bundled("px4-udp.toml").read_text().replace("[telemetry]", "[telemetry]\nconnect_timeout_s = 0.1")
    config.write_text(text)
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "--config", str(config), "--log", str(log), "--link", "udpin:127.0.0.1:0"])
    assert ended.value.code == 2
    with pytest.raises(SystemExit) as replayed:
        cli.main(["replay", str(log)])
    assert replayed.value.code == 0
    assert "breaks off" not in capsys.readouterr().out


def test_a_log_that_is_not_complete_is_told_beside_how_the_flight_ended(monkeypatch, tmp_path, capsys):
    def full(sink, data):
        raise OSError(errno.ENOSPC, "No space left on device")

    landed = RunResult(Counters(), Finished(True, "scenario done, landed"), stopped=False, refusal=None)
    monkeypatch.setattr(writer._Sink, "_append", full)
    monkeypatch.setattr(cli_run, "_drive", lambda vehicle, *_: vehicle.session.advance(1_000_000) or landed)
    with pytest.raises(SystemExit) as ended:
        arguments = ["--link", "udpin:127.0.0.1:0", "--log", str(tmp_path / "flight.tlog"), "--json"]
        cli.main(["run", "--config", str(bundled("px4-udp.toml")), *arguments])
    assert ended.value.code == 1, "not 2: nobody used it wrongly, and there was a vehicle"
    said = capsys.readouterr()
    assert "is not complete: No space left on device" in said.err
    assert json.loads(said.out.splitlines()[-1])["reason"] == "scenario done, landed"


def test_a_log_name_that_another_process_takes_at_the_same_moment_is_left_to_it(
    tmp_path, monkeypatch, capsys
):
    """Two services that are started in the same second log to one directory."""
    create, taken = writer._create, []

    def later(path):
        if not taken:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(b"of the other one")
            taken.append(path)
        return create(path)

    monkeypatch.setattr(writer, "_create", later)
    config = tmp_path / "short.toml"
    text = bundled("px4-udp.toml").read_text().replace("[telemetry]", "[telemetry]\nconnect_timeout_s = 0.1")
    config.write_text(text.replace('directory = "logs"', f'directory = "{tmp_path / "logs"}"'))
    assert "no vehicle answered" in said_by(capsys, "--link", "udpin:127.0.0.1:0", config=config)
    first, second = sorted((tmp_path / "logs").glob("*.tlog"), key=lambda log: len(log.name))
    assert taken == [first]
    assert first.read_bytes() == b"of the other one"
    assert second.stat().st_size > 0


def test_a_log_directory_that_is_a_file_or_has_too_long_a_name_is_one_line(tmp_path, capsys):
    (tmp_path / "file").touch()
    text = bundled("px4-udp.toml").read_text()
    for name, said in (
        ("file", "cannot make directory"),
        ("x" * 300, "File name too long; name another file"),
    ):
        config = tmp_path / "odd.toml"
        config.write_text(text.replace('directory = "logs"', f'directory = "{tmp_path / name}"'))
        assert said in said_by(capsys, "--link", "udpin:127.0.0.1:0", config=config)
    for command in ("replay", "report", "export", "identify", "shadow"):
        with pytest.raises(SystemExit) as ended:
            cli.main([command, str(tmp_path / ("x" * 300 + ".tlog"))])
        assert ended.value.code == 2
        assert "ile name too long" in capsys.readouterr().err
