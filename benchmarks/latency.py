"""Where the microseconds of a control step go, and UDP round trips beside bare pymavlink and MAVSDK."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
from common import AWAKE, Probe, daemon_config, free_port, percentiles, save
from replay import GOLDEN

from kffa_offboard.config_log import config_of
from kffa_offboard.control import controllers, vehicle
from kffa_offboard.control.plain import PlainInput
from kffa_offboard.mavlink.commands import attitude_target
from kffa_offboard.mavlink.component import Component, FrameParser, Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.replay import engine
from kffa_offboard.replay.recording import Recording, read_recording

RATE_HZ = 250.0
DURATION_S = 8.0


def timed(function: Callable[[], Any], times: int = 3000) -> list[float]:
    """How long each of many calls takes, s."""
    result = []
    for _ in range(times):
        began = time.perf_counter()
        function()
        result.append(time.perf_counter() - began)
    return result


def control_step(parameters: controllers.ControllerParameters, periods_s: list[float]) -> list[float]:
    """The law alone, four channels, all fresh and noisy; steps of these lengths in random order."""
    rng = np.random.default_rng(1)
    state = vehicle.initial_state(parameters, (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.4))
    fresh, wanted = (True, True, True, True), (0.1, 0.0, 0.0, 1.0)
    noise = iter(rng.normal(0.0, 0.01, (6000, 2, 4)).tolist())
    lengths = iter(rng.choice(periods_s, 6000).tolist())

    def step() -> None:
        nonlocal state
        measured, rate = map(tuple, next(noise))
        state, _ = vehicle.step(parameters, state, PlainInput(wanted, measured, fresh, rate), next(lengths))

    timed(step)  # the covariance settles
    return timed(step)


def full_path(recording: Recording) -> list[float]:
    """Decode, step, guard, pack, record: each ATTITUDE of a recorded flight that a setpoint answers."""
    paths: list[float] = []
    parser = FrameParser(keeps_frames_whole=True)

    class Timed(Session):
        def handle(self, time_us: int, message: Any) -> None:
            frame, before = bytes(message.get_msgbuf()), self.counters.commands_sent
            began = time.perf_counter()
            (decoded,) = parser.parse(Datagram(time_us, frame, "vehicle"))
            super().handle(time_us, decoded)
            took = time.perf_counter() - began
            if message.get_type() == "ATTITUDE" and self.counters.commands_sent > before:
                paths.append(took)

    with mock.patch.object(engine, "Session", Timed):
        engine.replay(recording, config_of(recording.header, recording.path))
    return paths


@contextmanager
def process(*command: str) -> Iterator[Callable[[], str]]:
    """A process under test; it is ended afterwards. Yields what tells its last word."""
    with (
        tempfile.TemporaryFile("w+") as said,
        subprocess.Popen([sys.executable, *command], stdout=subprocess.DEVNULL, stderr=said) as running,
    ):

        def last_word() -> str:
            said.seek(0)
            return (said.read().strip().splitlines() or ["nothing"])[-1].strip()

        try:
            yield last_word
        finally:
            running.terminate()
            try:
                running.wait(10.0)
            except subprocess.TimeoutExpired:
                running.kill()


def round_trips(port: int, *command: str) -> dict[str, Any]:
    """Round trips to a process that listens on `port`, after it has begun to answer."""
    probe = Probe(port)
    with process(*command) as last_word:
        for _ in range(30):  # engaging takes seconds
            if len(probe.round_trips(RATE_HZ / 2.5, 1.0)[0]) > 50:
                break
        trips, missed = probe.round_trips(RATE_HZ, DURATION_S)
        if not trips:
            raise SystemExit(f"error: {' '.join(command[:2])} did not answer; its last word: {last_word()}")
    probe.close()
    return {**percentiles(trips), "unanswered": missed}


def daemon_round_trips(tables: str) -> dict[str, Any]:
    """Round trips to a daemon of its own with a log; `tables` are added to its configuration."""
    port = free_port()
    with tempfile.TemporaryDirectory() as directory:
        config, log = daemon_config(Path(directory), port), Path(directory) / "flight.tlog"
        config.write_text(f"{config.read_text()}\n{tables}", encoding="utf-8")
        run = ("-m", "kffa_offboard", "run", "--config", str(config), "--engage", "--log", str(log))
        return round_trips(port, *run)


def main() -> None:
    """Measure everything and print it."""
    recording = read_recording(GOLDEN)
    parameters = config_of(recording.header, recording.path).service.controller
    frame = next(
        bytes(m.get_msgbuf()) for _, m in recording.incoming if getattr(m, "get_type", str)() == "ATTITUDE"
    )
    parser, component, route = FrameParser(keeps_frames_whole=True), Component(Route()), Route()
    four = np.ones(4)
    target = AttitudeTarget(0.4, body_rates=(0.01, 0.02, 0.03))
    rows: dict[str, dict[str, Any]] = {
        "numpy a + b, four numbers": percentiles(timed(lambda: four + four)),
        "control step (KFFA-LADRC), every 10 ms": percentiles(control_step(parameters, [0.01])),
        "control step, 9, 10 or 11 ms": percentiles(control_step(parameters, [0.009, 0.01, 0.011])),
        "control step, 3, 4 or 5 ms": percentiles(control_step(parameters, [0.003, 0.004, 0.005])),
        "decode ATTITUDE": percentiles(timed(lambda: parser.parse(Datagram(0, frame, "vehicle")))),
        "pack SET_ATTITUDE_TARGET": percentiles(
            timed(lambda: component.pack(attitude_target(route, target, 1000)))
        ),
        "full path in process": percentiles(full_path(recording)),
    }
    socket_port, echo_port = free_port(), free_port()
    here = Path(__file__).parent
    bare = str(here / "bare_socket.py")
    rows["UDP, bytes made before"] = round_trips(socket_port, bare, str(socket_port))
    rows["UDP, bare pymavlink echo"] = round_trips(echo_port, str(here / "echo.py"), str(echo_port))
    rows["UDP, kffa-offboard run"] = daemon_round_trips("")
    rows["UDP, kffa-offboard run, --realtime and keep_awake"] = daemon_round_trips(AWAKE)
    if find_spec("mavsdk") is None:
        print('no row for MAVSDK: pip install "kffa-offboard[clients]"', file=sys.stderr)
    else:
        mavsdk_port = free_port()
        name = f"UDP, MAVSDK-Python {version('mavsdk')}, set_attitude_rate"
        rows[name] = round_trips(mavsdk_port, str(here / "mavsdk_echo.py"), str(mavsdk_port))
    save("latency", rows)


if __name__ == "__main__":
    main()
