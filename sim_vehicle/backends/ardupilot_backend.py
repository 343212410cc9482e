"""The shell around `ArdupilotVehicle`: the UDP port, the wall clock, lines for people."""

from __future__ import annotations

import time

from sim_vehicle.backends.ardupilot_vehicle import NAME, ArdupilotVehicle
from sim_vehicle.backends.barrier import Barrier
from sim_vehicle.backends.base import Progress, Say
from sim_vehicle.backends.pacing import Pacer, StallWatch
from sim_vehicle.config import SimConfig
from sim_vehicle.links import Links
from sim_vehicle.plant import Plant

RECEIVE_TIMEOUT_S = 0.2
PROGRESS_S = 0.2
REMEDY = (
    "is the firmware running with --model JSON:127.0.0.1, sending to this port, and not waiting "
    "for a ground station on its SERIAL0?"
)


class ArdupilotJsonBackend:
    """ArduPilot in software-in-the-loop flies the plant."""

    def __init__(self, config: SimConfig, links: Links, say: Say, barrier: Barrier | None = None) -> None:
        self._config = config
        self._barrier = barrier or Barrier(None)
        self._links = links
        self._say = say
        self._vehicle = ArdupilotVehicle(config)

    @property
    def plant(self) -> Plant:
        """The flying body."""
        return self._vehicle.plant

    @property
    def announcement(self) -> str:
        """Where ArduPilot's simulator interface is expected, and who keeps to the clock."""
        backend = self._config.backend
        pace = "as fast as possible"
        if backend.ardupilot_json.pace == "firmware":
            pace = "at the firmware's own speed"
        elif backend.real_time_factor > 0.0:
            pace = f"at {backend.real_time_factor:g} times real time"
        return f"physics for ArduPilot (JSON interface), {pace}: {', '.join(self._links.addresses)}"

    @property
    def autopilot(self) -> str:
        """Do the motors turn?"""
        return "motors on" if self._vehicle.armed else "motors off"

    def run(self, duration_s: float | None, progress: Progress) -> None:
        """Answer servo packets; see `Backend.run`."""
        backend = self._config.backend
        pacer = Pacer(0.0 if backend.ardupilot_json.pace == "firmware" else backend.real_time_factor)
        watch = StallWatch(
            NAME,
            "servo packet",
            REMEDY,
            warning_s=backend.stall_warning_s,
            timeout_s=backend.stall_timeout_s,
            now_s=time.monotonic(),
        )
        end_us = None if duration_s is None else round(duration_s * 1e6)
        next_progress = 0.0
        try:
            while end_us is None or self.plant.time_us < end_us:
                self._exchange(pacer, watch)
                if time.monotonic() >= next_progress:
                    next_progress = time.monotonic() + PROGRESS_S
                    progress()
        finally:
            self._say(f"{NAME}: {self._vehicle.counters}")

    def _exchange(self, pacer: Pacer, watch: StallWatch) -> None:
        """Wait for a servo packet and answer it when it is due."""
        answer = self._vehicle.receive(self._links.receive(RECEIVE_TIMEOUT_S))
        for line in self._vehicle.notices:
            self._say(line)
        self._vehicle.notices.clear()
        now = time.monotonic()
        news = watch.check(now, self.plant.time_us) if answer is None else watch.heard(now)
        if news is not None:
            self._say(news)
        if answer is not None:
            time.sleep(pacer.wait(answer.time_us, now))
            self._barrier.wait(answer.time_us)
            self._links.send(answer.peer, answer.data)
