"""An unmodified PX4 flies the simulated vehicle."""

from __future__ import annotations

import math
import os
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.plan import AutopilotName
from sim_vehicle.backends import px4_backend
from sim_vehicle.backends.px4_backend import Px4HilBackend
from sim_vehicle.backends.px4_port import Px4Port
from sim_vehicle.config import build
from sim_vehicle.truth import TruthRow

PARAMETERS = Path(__file__).parents[2] / "configs" / "px4-hil"
AUTO_LOITER, OFFBOARD = (4, 3), (6, 0)
pytestmark = pytest.mark.timeout(400)


class Px4Process:
    """One PX4, in a directory of its own, known by its instance number."""

    def __init__(self, binary: Path, directory: Path, instance: int) -> None:
        self.directory = directory
        environment = {
            **os.environ,
            "PATH": f"{PARAMETERS}:{os.environ['PATH']}",
            "PX4_SYS_AUTOSTART": "10016",
            "PX4_SIM_HOST_ADDR": "127.0.0.1",
        }
        with (directory / "px4.log").open("a", encoding="utf-8") as log:
            self._process = subprocess.Popen(
                [
                    binary,
                    "-d",
                    "-i",
                    str(instance),
                    "-w",
                    directory,
                    binary.parent.parent / "etc",
                ],
                cwd=directory,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def signal(self, number: signal.Signals) -> None:
        self._process.send_signal(number)

    def end(self) -> None:
        """PX4 does not heed SIGTERM while its time stands still."""
        self._process.kill()
        self._process.wait()


def _free(kind: socket.SocketKind, port: int) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe:
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True


def _free_instance() -> int:
    """An instance number whose ports and lock nobody has; it starts at a place of this process's own."""
    for step in range(200):
        instance = 20 + (os.getpid() + 37 * step) % 200
        tcp, udp = socket.SOCK_STREAM, socket.SOCK_DGRAM
        ports = ((tcp, 4560), *((udp, base) for base in (13030, 14280, 14580, 18570)))
        if not Path(f"/tmp/px4_lock-{instance}").exists() and all(_free(k, p + instance) for k, p in ports):
            return instance
    raise RuntimeError("no PX4 instance number is free")


class Flight:
    """Backend, PX4 and a ground station on PX4's own link, all in simulated time.

    Attributes
    ----------
    lines : what the backend said
    mode : PX4's main and sub mode of its last heartbeat
    armed : the same heartbeat's
    """

    def __init__(self, binary: Path, directory: Path) -> None:
        self.binary = binary
        self.instance = _free_instance()
        self.directory = directory
        self.lines: list[str] = []
        self.mode = (0, 0)
        self.armed = False
        self.acks: list[tuple[int, int]] = []
        self.port = Px4Port("127.0.0.1", 4560 + self.instance)
        config = build({"backend": {"kind": "px4-hil", "real_time_factor": 0.0}}, "test")
        self.backend = Px4HilBackend(config, self.port, self.lines.append)
        self._codec: Any = mavlink.MAVLink(file=None, srcSystem=254, srcComponent=190)
        self._codec.robust_parsing = True
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._link.bind(("127.0.0.1", 0))
        self._link.setblocking(False)
        self._next_heartbeat = 0.0
        self._wanted: Callable[[], bool] = lambda: False
        self.px4 = Px4Process(binary, directory, self.instance)

    def close(self) -> None:
        self.px4.end()
        self._link.close()
        self.port.__exit__()

    @property
    def time(self) -> float:
        return self.backend.plant.time_us * 1e-6

    @property
    def height(self) -> float:
        return float(self.backend.plant.state.position[2])

    def send(self, message: Any) -> None:
        self._link.sendto(message.pack(self._codec), ("127.0.0.1", 18570 + self.instance))
        self._codec.seq = (self._codec.seq + 1) % 256

    def command(self, number: int, *parameters: float) -> None:
        values = [*parameters, *[0.0] * (7 - len(parameters))]
        self.send(mavlink.MAVLink_command_long_message(self.instance + 1, 1, number, 0, *values))

    def set_mode(self, main: int, sub: int = 0) -> None:
        self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, main, sub)

    def fly(self, seconds: float, until: Callable[[], bool] | None = None) -> bool:
        """Let simulated time go on; True as soon as `until` holds, False if it never did."""
        self._wanted = until or (lambda: False)
        try:
            self.backend.run(self.time + seconds, self._listen)
        except _Reached:
            return True
        return False

    def arm_and_take_off(self, height: float) -> None:
        """PX4's own take-off; it is asked again until its estimator is ready."""
        altitude = 488.0 + height

        def asked_again() -> bool:
            if self.armed:
                return True
            if self.time >= self._next_try:
                self._next_try = self.time + 1.0
                nan = math.nan
                self.command(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, altitude)
                self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            return False

        self._next_try = self.time + 2.0
        assert self.fly(30.0, asked_again), self.lines
        assert self.fly(30.0, lambda: self.mode == AUTO_LOITER and self.height > 0.9 * height), self.lines

    def rows(self, start: float, end: float) -> list[TruthRow]:
        return [row for row in self.backend.plant.truth.rows if start <= row.time_s < end]

    def column(self, index: int, start: float, end: float) -> np.ndarray[Any, np.dtype[np.float64]]:
        return np.array([row.state[index] for row in self.rows(start, end)])

    def _listen(self) -> None:
        if self.time >= self._next_heartbeat:
            self._next_heartbeat = self.time + 0.5
            self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        while True:
            try:
                data = self._link.recv(65536)
            except BlockingIOError:
                break
            for message in self._codec.parse_buffer(data) or []:
                self._take(message)
        if self._wanted():
            raise _Reached

    def _take(self, message: Any) -> None:
        if message.get_srcComponent() != 1:
            return
        if message.get_type() == "HEARTBEAT":
            self.mode = (message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24)
            self.armed = bool(message.base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED)
        elif message.get_type() == "COMMAND_ACK":
            self.acks.append((message.command, message.result))


class _Reached(Exception):
    """What was waited for is there."""


@pytest.fixture
def flight(
    firmware_binary: Callable[[AutopilotName], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Flight]:
    binary = firmware_binary("px4")
    monkeypatch.setattr(px4_backend, "PROGRESS_S", 0.0)  # the ground station listens after every frame
    flown = Flight(binary, tmp_path)
    try:
        yield flown
    finally:
        flown.close()


def excursion(flight: Flight, event: str) -> tuple[float, float]:
    """Largest departure from the height before [m] and its integral over 12 s [m s], at a change of load."""
    start = flight.backend.plant.truth.time_of(event)
    assert start is not None
    before = float(flight.column(2, start - 2.0, start).mean())
    gap = np.abs(flight.column(2, start, start + 12.0) - before)
    return float(gap.max()), float(gap.sum() * 0.01)


def test_px4_takes_off_hovers_and_picks_up_and_drops_the_load_in_its_own_modes(flight: Flight) -> None:
    flight.arm_and_take_off(5.0)
    flight.fly(6.0)
    start = flight.time
    flight.fly(8.0)
    x, y, z = (flight.column(axis, start, start + 8.0) for axis in range(3))
    assert np.abs(z - 5.0).max() < 0.2
    assert math.hypot(np.abs(x).max(), np.abs(y).max()) < 0.3
    tilt = np.array([flight.column(axis, start, start + 8.0) for axis in (6, 7)])
    assert math.degrees(np.sqrt((tilt**2).mean())) < 1.0
    for action, wait in ((0, 4.0), (1, 14.0), (0, 14.0)):  # PX4 starts with its gripper closed
        flight.command(mavlink.MAV_CMD_DO_GRIPPER, 1, action)
        flight.fly(wait)
    picked_up, dropped = excursion(flight, "pick-up"), excursion(flight, "drop")
    print(f"height {z.mean():.3f} +- {z.std():.3f} m, pick-up {picked_up}, drop {dropped}, {flight.lines}")
    assert 0.4 < picked_up[0] < 1.2 and 0.3 < dropped[0] < 1.0
    flight.command(mavlink.MAV_CMD_NAV_LAND, 0, 0, 0, math.nan)
    assert flight.fly(40.0, lambda: not flight.armed)
    assert not any("no motor output" in line for line in flight.lines)


def test_offboard_before_the_first_setpoint_does_not_stop_time(flight: Flight) -> None:
    flight.fly(6.0)
    flight.set_mode(*OFFBOARD)
    assert flight.fly(0.1, lambda: any("going on slowly" in line for line in flight.lines))
    flight.fly(0.02)
    flight.set_mode(*AUTO_LOITER)
    assert flight.fly(0.2, lambda: any("in lock-step with PX4 again" in line for line in flight.lines))
    flight.arm_and_take_off(3.0)


def test_a_px4_that_was_stopped_goes_on_when_it_is_continued(flight: Flight) -> None:
    flight.arm_and_take_off(5.0)
    flight.fly(5.0)
    flight.px4.signal(signal.SIGSTOP)
    stopped = flight.time
    try:
        assert flight.fly(1.0, lambda: any("no motor outputs for 1 s" in line for line in flight.lines))
        flight.fly(0.012)
    finally:
        flight.px4.signal(signal.SIGCONT)
    flight.fly(8.0)
    assert any("in lock-step with PX4 again" in line for line in flight.lines)
    assert np.abs(flight.column(2, stopped, flight.time) - 5.0).max() < 0.5
    assert flight.mode == AUTO_LOITER


def test_a_restarted_px4_flies_the_vehicle_again(flight: Flight) -> None:
    flight.arm_and_take_off(3.0)
    flight.px4.end()
    flight.px4 = Px4Process(flight.binary, flight.directory, flight.instance)
    flight.armed = False
    flight.fly(10.0)
    assert any("PX4 is back" in line for line in flight.lines)
    assert flight.height < 0.1
    flight.arm_and_take_off(3.0)
    assert flight.backend.plant.truth.time_of("firmware restarted") is not None
