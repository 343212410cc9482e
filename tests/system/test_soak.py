"""An hour in the air, in simulated time: no growth, and nothing is late that the log does not show.

The daemon's own real-time loop flies, with its log, parameters, ground station streams and watch; its clock
is the vehicle's, and the computer stalls now and then, by a list that the test knows.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Hashable, Iterator
from pathlib import Path

import pytest

from kffa_offboard.config import Overrides, build, bundled, read_toml
from kffa_offboard.config_log import config_of, flight_header, make_companion, parameter_keeper
from kffa_offboard.flightlog.parts import following_parts
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.flightlog.writer import BATCH_SIZE, TlogWriter
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.parameter_file import ParameterFile
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import run_real_time
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.service import Service
from kffa_offboard.process.notify import ServiceManager
from kffa_offboard.process.realtime import Collector
from kffa_offboard.process.timing import StepClock
from kffa_offboard.process.watch import LoopWatch
from kffa_offboard.replay.compare import compare
from kffa_offboard.replay.engine import replay
from kffa_offboard.replay.recording import read_recording
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

SLOT_US = 5_000
LATE_S = 0.005
STALL_EVERY_S = 3.0
STALLS_S = (0.001, 0.012, 0.03)
"""The computer stops for one of these: the first is not late, the others are."""


class SimulatedTimeLink:
    """The vehicle right behind the daemon's link. Waiting moves the clock; answering only if it stalls."""

    name, keeps_frames_whole, trouble = "in-process", True, ""

    def __init__(self, vehicle: SimulatedVehicle, seed: int) -> None:
        self.vehicle = vehicle
        self.frames = 0
        self.stalls = [0, 0]  # those that are no reason to be late, and the others
        self._random = random.Random(seed)
        self._now_us = vehicle.time_us
        self._next_stall_us = round(STALL_EVERY_S * 1e6)
        vehicle.add_peer("daemon")

    def clock(self) -> int:
        return self._now_us

    def receive(self, timeout_s: float) -> list[Datagram]:
        until_us = self._now_us + max(round(timeout_s * 1e6), 1)
        frames: list[bytes] = []
        while self.vehicle.time_us < self._now_us or (not frames and self.vehicle.time_us < until_us):
            self.vehicle.advance(min(self.vehicle.time_us + SLOT_US, until_us))
            frames += [data for peer, data in self.vehicle.outgoing() if peer in (None, "daemon")]
            del self.vehicle.truth.rows[:-1]
        now_us = self._now_us = max(self.vehicle.time_us, self._now_us)
        attitude = any(frame[7:10] == b"\x1e\0\0" for frame in frames)
        if attitude and now_us >= self._next_stall_us:
            self._next_stall_us = now_us + round(STALL_EVERY_S * 1e6)
            stall_s = self._random.choice(STALLS_S)
            self._now_us += round(stall_s * 1e6)
            self.stalls[stall_s > LATE_S] += 1
        self.frames += len(frames)
        return [Datagram(now_us, b"".join(frames), "vehicle")] if frames else []

    def send(self, data: bytes) -> bool:
        self.vehicle.receive(data, "daemon")
        return True

    def lock(self, source: Hashable) -> None:
        """There is only one source."""

    def close(self) -> None:
        """Nothing to close."""


def resident_mib() -> float:
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0]) / 1024


class Soak:
    """A flight of so many seconds in which memory is looked at so often."""

    def __init__(self, directory: Path, duration_s: float, sample_s: float, part_size: int) -> None:
        self.sample_us = round(sample_s * 1e6)
        self.directory = directory
        self.log = directory / "flight.tlog"
        file = bundled("demo-px4.toml")
        hold = {"type": "hold", "duration_s": duration_s}
        scenario = {"segment": [{"type": "takeoff", "altitude_m": 5.0}, hold, {"type": "land"}]}
        self.daemon = build(read_toml(file) | {"scenario": scenario}, file, Overrides(arm=True, engage=True))
        self.part_size = part_size
        changes = {"vehicle": {"physics_dt_s": 0.005}, "payload": {"schedule": []}}
        vehicle = SimulatedVehicle(sim_config.load(bundled("demo-px4-vehicle.toml"), changes))
        self.link = SimulatedTimeLink(vehicle, seed=1)
        self.resident: list[float] = []
        self.clock = StepClock(LATE_S)

    def fly(self) -> None:
        ids = self.daemon.link
        route = Route(ids.system_id, ids.component_id, ids.target_system, ids.target_component)
        changed = ParameterFile(self.directory / "changed.json")
        samples = self._samples()
        collector = Collector(60.0)
        watch = LoopWatch(self.clock, ServiceManager({}), collector, [lambda: next(samples)])
        header = flight_header(self.daemon, lockstep=False, changed=changed)
        with TlogWriter(self.log, header=header, part_size=self.part_size) as writer:
            self.writer = writer
            self.session = Session(
                Service(self.daemon.service),
                self.link,
                route,
                recorder=writer,
                parameters=parameter_keeper(self.daemon, route, changed),
                companion=make_companion(self.daemon, route),
                compare_clocks=True,
            )
            self.result = run_real_time(self.session, self.link.clock, threading.Event(), watch=watch)
            self.session.close("flown")

    def _samples(self) -> Iterator[str | None]:
        """Looks at the memory; never in trouble.

        Simulated time runs faster than the disk at times. In real time no more than this waits for it.
        """
        due_us = self.sample_us
        while True:
            while len(self.writer._records) > 2 * BATCH_SIZE:
                time.sleep(0.001)
            if self.link.vehicle.time_us >= due_us:
                due_us += self.sample_us
                self.resident.append(resident_mib())
            yield None

    def check(self) -> None:
        """Nothing was late but what was made late, and the log has all of it."""
        assert self.result.finished is not None
        assert self.result.finished.reason == "scenario done, landed"  # type: ignore[attr-defined]
        counted = self.clock.summary()
        assert counted["late_steps"] == self.link.stalls[1]
        assert counted["steps"] > 90.0 * (len(self.resident) - 1) * self.sample_us * 1e-6
        assert self._logged("LATE_STEPS") == counted["late_steps"]
        assert self._logged("LATE_DUE") == counted["late_deadlines"]

    def _logged(self, name: str) -> int:
        last = [*[self.log], *following_parts(self.log)][-1]
        values = [
            message.value
            for _, message in read_tlog(last)
            if message.get_type() == "NAMED_VALUE_FLOAT" and message.name == name
        ]
        return int(values[-1])


def test_half_a_minute_in_the_air_leaves_nothing_behind_in_memory(tmp_path: Path) -> None:
    soak = Soak(tmp_path, duration_s=20.0, sample_s=2.0, part_size=500_000)
    soak.fly()
    soak.check()
    assert soak.link.stalls[1] >= 4
    assert soak.resident[-1] - soak.resident[5] < 1.0, soak.resident
    assert len([*following_parts(soak.log)]) >= 2
    recording = read_recording(soak.log)
    comparison = compare(recording, replay(recording, config_of(recording.header, soak.log)))
    assert comparison.difference is None, "what the process reports is replayed, too"


@pytest.mark.soak
@pytest.mark.timeout(7200)
def test_an_hour_in_the_air_is_flat_within_five_mebibytes(tmp_path: Path) -> None:
    soak = Soak(tmp_path, duration_s=3600.0, sample_s=60.0, part_size=20_000_000)
    soak.fly()
    soak.check()
    print(
        f"resident MiB at minute 1, 2, 30, last: {soak.resident[0]:.1f} {soak.resident[1]:.1f} "
        f"{soak.resident[29]:.1f} {soak.resident[-1]:.1f}, most {max(soak.resident):.1f}; "
        f"{soak.clock.summary()}, stalls {soak.link.stalls}, parts {1 + len([*following_parts(soak.log)])}"
    )
    assert max(soak.resident[1:]) - min(soak.resident[1:]) < 5.0, soak.resident
