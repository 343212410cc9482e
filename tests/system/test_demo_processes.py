"""The commands as people run them: processes, sockets, signals, exit status."""

from __future__ import annotations

import contextlib
import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from kffa_offboard.flightlog.tlog import read_signals, read_tlog
from kffa_offboard.trials.processes import free_port

DAEMON = [sys.executable, "-m", "kffa_offboard"]
VEHICLE = [sys.executable, "-m", "sim_vehicle"]
HOP = """
[link]
url = "udpin:127.0.0.1:14540"
[control.altitude]
hover_thrust = 0.398
[[scenario.segment]]
type = "takeoff"
altitude_m = 0.6
[[scenario.segment]]
type = "land"
"""


@contextlib.contextmanager
def started(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def hop(tmp_path: Path) -> Path:
    """A configuration that flies a few seconds."""
    file = tmp_path / "hop.toml"
    file.write_text(HOP)
    return file


def commands(log: Path) -> list[tuple[int, bytes]]:
    """Time and payload of every setpoint in a log."""
    return [
        (time_us, bytes(message.get_payload()))
        for time_us, message in read_tlog(log)
        if message.get_type() == "SET_ATTITUDE_TARGET"
    ]


def test_a_flight_in_lock_step_over_udp_repeats_bit_for_bit(hop: Path, tmp_path: Path) -> None:
    flown = []
    for name in ("first", "second"):
        port = free_port()
        truth, log = tmp_path / f"{name}.csv", tmp_path / f"{name}.tlog"
        vehicle = [*VEHICLE, "run", "--link", f"udpout:127.0.0.1:{port}", "--seed", "3", "--lockstep"]
        daemon = [*DAEMON, "run", "--config", str(hop), "--link", f"udpin:127.0.0.1:{port}", "--lockstep"]
        with (
            started([*vehicle, "--truth", str(truth)]) as simulated,
            started([*daemon, "--arm", "--engage", "--log", str(log), "--json"]) as flying,
        ):
            said, complaints = flying.communicate(timeout=60)
            simulated.terminate()
            simulated.communicate(timeout=20)
        assert flying.returncode == 0, complaints
        assert json.loads(said.splitlines()[-1])["reason"] == "scenario done, landed"
        flown.append((commands(log), truth.read_bytes()))
    assert len(flown[0][0]) > 300
    assert flown[0] == flown[1]


@contextlib.contextmanager
def plotting_program() -> Iterator[tuple[int, list[bytes]]]:
    """A port, and the datagrams that arrive there."""
    heard: list[bytes] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        port = end.getsockname()[1]

        def listen() -> None:
            while data := end.recv(65535):
                heard.append(data)

        thread = threading.Thread(target=listen)
        thread.start()
        try:
            yield port, heard
        finally:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
                other.sendto(b"", ("127.0.0.1", port))
            thread.join(20)


def test_a_plotting_program_gets_the_signals_that_the_log_has(hop: Path, tmp_path: Path) -> None:
    port, log = free_port(), tmp_path / "flight.tlog"
    vehicle = [*VEHICLE, "run", "--link", f"udpout:127.0.0.1:{port}", "--lockstep"]
    daemon = [*DAEMON, "run", "--config", str(hop), "--link", f"udpin:127.0.0.1:{port}", "--lockstep"]
    with plotting_program() as (place, heard), started(vehicle):
        plot = ["--plot", f"udpout:127.0.0.1:{place}"]
        with started([*daemon, "--arm", "--engage", "--log", str(log), *plot]) as flying:
            _, complaints = flying.communicate(timeout=60)
        assert flying.returncode == 0, complaints
    steps = [values for data in heard if "dt" in (values := json.loads(data))]
    assert len(steps) > 300
    table = read_signals(log)
    row = {time_us / 1e6: k for k, time_us in enumerate(table.time_us.tolist())}
    for step in steps:
        logged = table.estimate[row[step["timestamp"]], 3]
        assert step["altitude/estimate"] == pytest.approx(logged, rel=1e-6)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_signal_gives_control_back_and_closes_the_log(
    hop: Path, tmp_path: Path, number: signal.Signals
) -> None:
    port, log = free_port(), tmp_path / "flight.tlog"
    daemon = [*DAEMON, "run", "--config", str(hop), "--link", f"udpin:127.0.0.1:{port}", "--log", str(log)]
    with (
        started([*VEHICLE, "run", "--link", f"udpout:127.0.0.1:{port}"]),
        started([*daemon, "--shadow"]) as flying,
    ):
        assert flying.stderr is not None
        heard = ""
        while "ready" not in heard:
            line = flying.stderr.readline()
            assert line, heard
            heard += line
        flying.send_signal(number)
        _, rest = flying.communicate(timeout=20)
    assert flying.returncode == 130, heard + rest
    assert "released: stop requested" in rest
    assert read_signals(log).time_us.size > 50


def test_nobody_answering_is_one_line_and_status_2(hop: Path) -> None:
    hop.write_text(HOP + "[telemetry]\nconnect_timeout_s = 0.3")
    port = free_port()
    ended = subprocess.run(
        [*DAEMON, "run", "--config", str(hop), "--link", f"udpin:127.0.0.1:{port}"],
        capture_output=True,
        text=True,
        timeout=30,
    )
    assert ended.returncode == 2
    assert ended.stderr.splitlines()[-1] == (
        f"error: no vehicle answered on udpin:127.0.0.1:{port} for 0.3 s; "
        "is it running, and does it send there?"
    )
    assert "Traceback" not in ended.stderr


def test_a_busy_port_is_one_line_and_status_2(hop: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as busy:
        busy.bind(("127.0.0.1", 0))
        port = busy.getsockname()[1]
        ended = subprocess.run(
            [*DAEMON, "run", "--config", str(hop), "--link", f"udpin:127.0.0.1:{port}"],
            capture_output=True,
            text=True,
            timeout=30,
        )
    assert ended.returncode == 2
    assert len(ended.stderr.splitlines()) == 1
    assert ended.stderr.startswith("error: ")
    assert str(port) in ended.stderr


def test_the_demonstration_prints_its_figures_as_json_and_draws_them(tmp_path: Path) -> None:
    ended = subprocess.run(
        [*DAEMON, "demo", "--lockstep", "--no-baseline", "--json", "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=100,
    )
    assert ended.returncode == 0, ended.stderr
    figures = json.loads(ended.stdout.splitlines()[-1])
    assert figures["pickup"].keys() == figures["drop"].keys() == {"peak_m", "iae_m_s"}
    assert 0.0 < figures["hover"]["rms_m"] < 0.02
    assert 0.0 < figures["attitude"]["rms_rad"] < 0.02
    assert figures["telemetry_received"] > 5000
    assert figures["commands_sent"] > 3000
    for name in ("flight.png", "drop.png"):
        assert (tmp_path / "out" / name).read_bytes().startswith(b"\x89PNG")


def test_stopping_the_demonstration_leaves_no_process_behind(tmp_path: Path) -> None:
    with started([*DAEMON, "demo", "--out", str(tmp_path)]) as demo:
        log = tmp_path / "kffa-ladrc-daemon.log"
        deadline = time.monotonic() + 30
        while not (log.exists() and "ready" in log.read_text()):
            assert time.monotonic() < deadline
            assert demo.poll() is None
            with contextlib.suppress(subprocess.TimeoutExpired):
                demo.wait(0.05)
        children = Path(f"/proc/{demo.pid}/task/{demo.pid}/children").read_text().split()
        assert len(children) == 2
        demo.send_signal(signal.SIGINT)
        demo.communicate(timeout=20)
    assert demo.returncode == 130
    assert not any(Path(f"/proc/{child}").exists() for child in children)
