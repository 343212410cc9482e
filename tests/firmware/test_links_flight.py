"""An unmodified ArduCopter flown in real time over the links that people have: a router, a serial line."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import os
import pty
import select
import subprocess
import sys
import threading
import time
import tomllib
import tty
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from kffa_offboard.compare.firmware import arducopter
from kffa_offboard.compare.plan import Trial
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config import bundled
from kffa_offboard.trials.metrics import read_truth
from kffa_offboard.trials.processes import free_port, process

pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.skipif(sys.platform != "linux", reason="needs Linux"),
]
TRIAL = Trial("flight", "", "kffa-ladrc", "rates")
HEIGHT_M = 3.0
SEGMENTS = [
    {"type": "takeoff", "altitude_m": HEIGHT_M, "climb_rate_m_s": 1.0},
    {"type": "hold", "duration_s": 6.0},
    {"type": "land", "descent_rate_m_s": 1.0},
]


def fly(directory: Path, link: dict[str, Any], **changes: Any) -> tuple[dict[str, Any], str]:
    """Take-off, hover, landing; the daemon's summary, and all that it said."""
    gains = tomllib.loads(bundled("compare-ardupilot.toml").read_text(encoding="utf-8"))
    config = directory / "flight.toml"
    document = merged(gains, {"link": link, "scenario": {"segment": SEGMENTS}, **changes})
    config.write_text(toml_text(document), encoding="utf-8")
    command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config), "--json"]
    command += ["--arm", "--engage", "--fix-params"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120.0, cwd=directory)
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1]), done.stdout + done.stderr


def assert_flown(truth: Path) -> None:
    heights = read_truth(truth).z
    assert heights.max() == pytest.approx(HEIGHT_M, abs=0.15) and heights[-1] < 0.1


@pytest.mark.skipif(importlib.util.find_spec("MAVProxy") is None, reason="MAVProxy is not installed")
def test_behind_mavproxy_that_asks_for_four_messages_a_second(
    firmware_binary: Callable[[str], Path], flying_firmware: Any, tmp_path: Path
) -> None:
    """It does when it has read the parameters, in flight: that ended control."""
    port = free_port()
    proxy = [str(Path(sys.executable).with_name("mavproxy.py")), "--non-interactive", "--daemon"]
    binary = firmware_binary("ardupilot")
    with flying_firmware("ardupilot", binary, tmp_path, TRIAL) as (url, system, truth):
        proxy += ["--master", url, "--out", f"udpout:127.0.0.1:{port}"]
        with (
            (tmp_path / "mavproxy.log").open("w", encoding="utf-8") as said_there,
            process(proxy, cwd=tmp_path, stdout=said_there, stderr=subprocess.STDOUT),
        ):
            time.sleep(3.0)
            link = {"url": f"udpin:127.0.0.1:{port}", "target_system": system}
            summary, said = fly(tmp_path, link)
    assert summary["successful"]
    assert "telemetry slows down: asked for it again" in said
    assert_flown(truth)


@contextlib.contextmanager
def serial_line(baud: int) -> Iterator[tuple[str, str]]:
    """Two devices with a line between them that carries so many bits a second, ten for a byte."""
    ends = [pty.openpty() for _ in range(2)]
    for end in ends:
        for descriptor in end:
            tty.setraw(descriptor)
    over = threading.Event()
    (first, first_end), (second, second_end) = ends

    def carry(source: int, sink: int) -> None:
        waiting, since, credit = b"", time.monotonic(), 0.0
        while not over.is_set():
            ready, _, _ = select.select([source], [], [], 0.002)
            if ready and len(waiting) < 4096:
                waiting += os.read(source, 4096)
            now = time.monotonic()
            credit, since = min(credit + (now - since) * baud / 10.0, 64.0 + baud / 500.0), now
            count = min(len(waiting), int(credit))
            if count:
                os.write(sink, waiting[:count])
                waiting, credit = waiting[count:], credit - count

    threads = [threading.Thread(target=carry, args=pair) for pair in ((first, second), (second, first))]
    for thread in threads:
        thread.start()
    try:
        yield os.ttyname(first_end), os.ttyname(second_end)
    finally:
        over.set()
        for thread in threads:
            thread.join()
        for descriptor in (first, first_end, second, second_end):
            os.close(descriptor)


@pytest.mark.parametrize(("baud", "signals_hz"), [(115200, 2.0), (921600, 10.0)])
def test_over_a_serial_line_that_is_quick_enough(
    firmware_binary: Callable[[str], Path],
    flying_firmware: Any,
    tmp_path: Path,
    baud: int,
    signals_hz: float,
) -> None:
    """`mavlink/line_rate.py` finds nothing wrong with it, and nothing is."""
    with serial_line(baud) as (there, here):

        def start(binary: Path, directory: Path, *others: Any) -> Any:
            made = arducopter(binary, directory, *others)
            command = list(made.command)
            command[command.index("--serial1") + 1] = f"uart:{there}:{baud}"
            return replace(made, command=tuple(command))

        binary = firmware_binary("ardupilot")
        with flying_firmware("ardupilot", binary, tmp_path, TRIAL, start) as (_, system, truth):
            link = {"url": f"serial:{here}:{baud}", "target_system": system}
            summary, said = fly(tmp_path, link, signals={"rate_hz": signals_hz})
    assert summary["successful"] and "warning" not in said
    assert_flown(truth)
