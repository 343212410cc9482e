"""Daemon and vehicle joined in one process: real MAVLink bytes and the daemon's own loop, without sockets.

The lock-step barrier is what the simulator's UDP loop does, too: telemetry of one slot, then a TIMESYNC
request, then everything that the daemon sent up to its answer.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kffa_offboard.config import DaemonConfig, Overrides, bundled, load
from kffa_offboard.config_log import flight_header, make_companion
from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.parameter_check import CheckSettings
from kffa_offboard.mavlink.parameter_file import ParameterFile
from kffa_offboard.mavlink.parameter_keeper import KeeperSettings, ParameterKeeper
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import RunResult, run_lock_step
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import Announce, Signals
from kffa_offboard.offboard.service import Service
from kffa_offboard.trials.metrics import Truth
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

SLOT_US = 10_000
LONGEST_FLIGHT_S = 90.0
DAEMON = "daemon"


class LockStepLink:
    """The daemon's link, with the vehicle right behind it; the vehicle passes on what is `from_ground`."""

    name = "in-process"
    keeps_frames_whole = True
    trouble = ""

    def __init__(self, vehicle: SimulatedVehicle, before_slot: Callable[[], None]) -> None:
        self.vehicle = vehicle
        self.sent: list[bytes] = []
        self.from_ground: list[bytes] = []
        self._before_slot = before_slot
        vehicle.add_peer(DAEMON)

    def receive(self, timeout_s: float) -> list[Datagram]:
        """One slot of simulated time, and the barrier after it."""
        if self.vehicle.time_us > LONGEST_FLIGHT_S * 1e6:
            raise AssertionError(f"still flying after {LONGEST_FLIGHT_S:g} s")
        self._before_slot()
        self.vehicle.advance(self.vehicle.time_us + SLOT_US)
        frames = [data for peer, data in self.vehicle.outgoing() if peer in (None, DAEMON)]
        frames += self.from_ground
        self.from_ground.clear()
        frames.append(self.vehicle.time_request(DAEMON))
        return [Datagram(self.vehicle.time_us, frame, "vehicle") for frame in frames]

    def send(self, data: bytes) -> bool:
        """Frames reach the vehicle's end of the link at once; its own delay follows."""
        self.sent.append(data)
        self.vehicle.receive(data, DAEMON)
        return True

    def lock(self, source: Hashable) -> None:
        """There is only one source."""

    def close(self) -> None:
        """Nothing to close."""


@dataclass
class LockStepFlight:
    """One flight: daemon, vehicle and what happened.

    Change `daemon` or `vehicle` before `fly`; `before_slot` runs every 10 ms of simulated time. `log` is
    where to record it.
    """

    daemon: DaemonConfig
    vehicle: SimulatedVehicle
    before_slot: Callable[[], None] = lambda: None
    link_to: Callable[[SimulatedVehicle, Callable[[], None]], LockStepLink] = LockStepLink
    heard: list[tuple[int, Any]] = field(default_factory=list)
    stop: threading.Event = field(default_factory=threading.Event)
    log: Path | None = None
    parameters: ParameterKeeper | None = None
    record: ParameterFile | None = None
    session: Session = field(init=False)
    link: LockStepLink = field(init=False)

    def fly(self, enough: Callable[[SimulatedVehicle], bool] | None = None) -> RunResult:
        """Fly until the service has finished; it is asked to stop when `enough` says so."""

        def before_slot() -> None:
            self.before_slot()
            if enough is not None and enough(self.vehicle):
                self.stop.set()

        ids = self.daemon.link
        route = Route(ids.system_id, ids.component_id, ids.target_system, ids.target_component)
        self.link = self.link_to(self.vehicle, before_slot)
        service = Service(self.daemon.service)
        header = flight_header(self.daemon, lockstep=True, changed=self.record)
        with contextlib.nullcontext() if self.log is None else TlogWriter(self.log, header=header) as writer:
            self.session = Session(
                service,
                self.link,
                route,
                recorder=writer,
                observer=lambda time_us, item: self.heard.append((time_us, item)),
                parameters=self.parameters,
                companion=make_companion(self.daemon, route),
                guided_mode=self.daemon.autopilot.ardupilot_mode,
            )
            result = run_lock_step(self.session, lambda: self.vehicle.time_us, self.stop)
            self.session.close("flown")
        return result

    def check_parameters(self, record: ParameterFile, fix: bool = False) -> None:
        """Let the daemon read the vehicle's parameters, and set them if so asked."""
        ids = self.daemon.link
        route = Route(ids.system_id, ids.component_id, ids.target_system, ids.target_component)
        settings = KeeperSettings(CheckSettings.of(self.daemon.service), fix, self.daemon.service.shadow)
        self.parameters, self.record = ParameterKeeper(route, settings, record), record

    @property
    def texts(self) -> list[str]:
        """What the daemon announced."""
        return [item.text for _, item in self.heard if isinstance(item, Announce)]

    @property
    def signals(self) -> list[Signals]:
        """The controller's inner signals, one for each step."""
        return [item for _, item in self.heard if isinstance(item, Signals)]

    @property
    def truth(self) -> Truth:
        """True states, as the demonstration measures them."""
        rows = self.vehicle.truth.rows
        states = np.array([row.state for row in rows])
        return Truth(
            time_s=np.array([row.time_s for row in rows]),
            x=states[:, 0],
            y=states[:, 1],
            z=states[:, 2],
            roll=states[:, 6],
            pitch=states[:, 7],
            yaw=states[:, 8],
            thrust_n=np.array([row.thrust_n for row in rows]),
            load_mass_kg=np.array([row.load_mass_kg for row in rows]),
            events=tuple((event.time_s, event.text) for event in self.vehicle.truth.events),
        )


FlightMaker = Callable[..., LockStepFlight]


@pytest.fixture
def lock_step_flight() -> FlightMaker:
    """Makes flights of the demonstration's two configurations, with changes."""

    def make(
        personality: str = "px4",
        *,
        seed: int = 0,
        output: str | None = None,
        controller: str | None = None,
        daemon_file: Path | None = None,
    ) -> LockStepFlight:
        overrides = Overrides(controller=controller, output=output, arm=True, engage=True)  # type: ignore[arg-type]
        daemon = load(daemon_file or bundled(f"demo-{personality}.toml"), overrides)
        simulated = sim_config.load(bundled(f"demo-{personality}-vehicle.toml"), {"vehicle": {"seed": seed}})
        return LockStepFlight(daemon, SimulatedVehicle(simulated))

    return make


@contextlib.contextmanager
def waiting_vehicle(personality: str, transport: str, truth: Path) -> Iterator[str]:
    """A simulated vehicle in a process of its own that waits for callers on "udp" or "tcp"; ends cleanly.

    Yields HOST:PORT. The vehicle chooses the port and says it.
    """
    command = [
        sys.executable,
        "-m",
        "sim_vehicle",
        "run",
        "--config",
        str(bundled(f"sim-{personality}.toml")),
    ]
    command += ["--link", f"{transport}in:127.0.0.1:0", "--truth", str(truth)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as vehicle:
        try:
            assert vehicle.stdout is not None
            announced = vehicle.stdout.readline()  # "... in real time: tcpin:127.0.0.1:PORT"
            assert "in real time" in announced
            yield f"127.0.0.1:{announced.strip().rpartition(':')[2]}"
            vehicle.terminate()
            assert vehicle.wait(30.0) == 143
        finally:
            vehicle.kill()


@pytest.fixture
def vehicle_process() -> Callable[[str, str, Path], contextlib.AbstractContextManager[str]]:
    """`waiting_vehicle`, for the tests with real clients."""
    return waiting_vehicle
