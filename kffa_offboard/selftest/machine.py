"""Whether this machine is quick enough: control step, UDP round trip, punctuality, log writing."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config_log import config_of
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.mavlink.commands import attitude_target
from kffa_offboard.mavlink.component import Component, FrameParser, Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.offboard.service import Service
from kffa_offboard.replay.engine import NoLink
from kffa_offboard.replay.recording import Recording, is_message, is_report, read_recording
from kffa_offboard.selftest.result import Row, at_most

GROUP = "this machine"
HOST = "127.0.0.1"
TICK_S = 0.004
TICKS = 1000
ROUND_TRIPS = 1000
LOG_FRAMES = 50_000
SHARE = 0.5
"""Of a period that step, round trip and lateness together may take."""

_ROOM_S = 0.01


def run_machine(log: Path | None, directory: Path) -> list[Row]:
    """All of it; `log` is a flight that was just recorded, None if there is none."""
    trip, late = _percentile(_round_trips()), _percentile(_lateness())
    rows = [
        at_most(GROUP, "UDP round trip on loopback, 99 %", 1e3 * trip, 1e3 * SHARE * _ROOM_S, "ms"),
        at_most(GROUP, "lateness of a timer, 99 %", 1e3 * late, 1e3 * SHARE * _ROOM_S, "ms"),
    ]
    if log is not None:
        steps = _steps(read_recording(log))
        rows.insert(0, _median_row(steps))
        together = _percentile(steps) + trip + late
        for rate_hz, needed in ((100.0, True), (250.0, False)):
            rows.append(_verdict(rate_hz, together, needed))
    return [*rows, _log_writing(directory)]


def _percentile(seconds: Sequence[float], share: float = 0.99) -> float:
    ordered = sorted(seconds)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def _median_row(steps: Sequence[float]) -> Row:
    middle, slow = 1e3 * _percentile(steps, 0.5), 1e3 * _percentile(steps)
    limit = 1e3 * SHARE * _ROOM_S
    measured = f"{slow:.3g} ms, median {middle:.3g} ms"
    return Row(GROUP, "message in, setpoint out, 99 %", measured, f"{limit:g} ms", slow <= limit, slow * 1e-3)


def _verdict(rate_hz: float, together_s: float, needed: bool) -> Row:
    room_s = SHARE / rate_hz
    possible = together_s <= room_s
    measured = f"{'possible' if possible else 'not possible'}: {1e3 * together_s:.3g} ms"
    limit = f"{1e3 * room_s:g} ms" + ("" if needed else " (told only)")
    return Row(
        GROUP, f"{rate_hz:g} Hz", measured, limit, possible if needed or possible else None, together_s
    )


def _steps(recording: Recording) -> list[float]:
    """Decode, step, guard, pack: each message of a recorded flight that a setpoint answers, s."""
    config = config_of(recording.header, recording.path)
    ids = config.link
    route = Route(ids.system_id, ids.component_id, ids.target_system, ids.target_component)
    session, parser = (
        Session(Service(config.service), NoLink(), route),
        FrameParser(keeps_frames_whole=True),
    )
    took: list[float] = []
    for time_us, item in recording.incoming:
        if not is_message(item):
            if not is_report(item):
                session.request(time_us, item)
            continue
        frame = item if isinstance(item, bytes) else bytes(item.get_msgbuf())
        before = session.counters.commands_sent
        began = time.perf_counter()
        for message in parser.parse(Datagram(time_us, frame, "vehicle")):
            session.handle(time_us, message)
        if session.counters.commands_sent > before:
            took.append(time.perf_counter() - began)
    return took or [float("inf")]


def _round_trips() -> list[float]:
    """A setpoint's bytes to another thread and back."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far,
    ):
        for side in (near, far):
            side.bind((HOST, 0))
            side.settimeout(1.0)

        def echo() -> None:
            with contextlib.suppress(TimeoutError):
                for _ in range(ROUND_TRIPS):
                    data, source = far.recvfrom(2048)
                    far.sendto(data, source)

        thread = threading.Thread(target=echo, daemon=True)
        thread.start()
        took = []
        for _ in range(ROUND_TRIPS):
            began = time.perf_counter()
            near.sendto(bytes(60), far.getsockname())
            with contextlib.suppress(TimeoutError):
                near.recvfrom(2048)
            took.append(time.perf_counter() - began)
        thread.join()
    return took


def _lateness() -> list[float]:
    """How much later than asked a sleeping program goes on."""
    late = []
    due = time.perf_counter()
    for _ in range(TICKS):
        due = max(due, time.perf_counter()) + TICK_S
        time.sleep(max(due - time.perf_counter(), 0.0))
        late.append(time.perf_counter() - due)
    return late


def _log_writing(directory: Path) -> Row:
    """Minutes of traffic at once: nothing is lost, and it is there when the log is closed."""
    path = directory / "log-writing.tlog"
    path.unlink(missing_ok=True)
    route = Route()
    message = attitude_target(route, AttitudeTarget(0.4, (0.0, 0.0, 0.0)), 0)
    frame = Component(route).pack(message)
    began = time.perf_counter()
    with TlogWriter(path) as writer:
        for k in range(LOG_FRAMES):
            writer.write(k, frame)
    took = time.perf_counter() - began
    number = mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET
    read = sum(int.from_bytes(found[7:10], "little") == number for _, found in read_tlog(path).frames())
    megabytes = path.stat().st_size * 1e-6
    path.unlink()
    measured = f"{read} of {LOG_FRAMES} frames, {megabytes / took:.1f} MB/s"
    passed = read == LOG_FRAMES and megabytes / took > 1.0
    return Row(GROUP, "log written and read back", measured, "all, 1 MB/s", passed, megabytes / took * 1e6)
