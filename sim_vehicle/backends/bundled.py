"""The simulator's own firmware as a backend."""

from __future__ import annotations

from pathlib import Path

from sim_vehicle.backends.base import Progress
from sim_vehicle.config import SimConfig
from sim_vehicle.links import Links
from sim_vehicle.plant import Plant
from sim_vehicle.server import run_lockstep, run_real_time
from sim_vehicle.signing import Signing, read_key
from sim_vehicle.vehicle import SimulatedVehicle


class BundledBackend:
    """`SimulatedVehicle` behind MAVLink links. Raises SimulatorError for a signing key that is no good."""

    def __init__(self, config: SimConfig, links: Links) -> None:
        self._config = config
        self._links = links
        key_file = config.signing.key_file
        signing = None if key_file is None else Signing(read_key(Path(key_file).expanduser()))
        self._vehicle = SimulatedVehicle(config, signing)

    @property
    def plant(self) -> Plant:
        """The flying body."""
        return self._vehicle.plant

    @property
    def announcement(self) -> str:
        """Personality, system id, where time comes from, links."""
        vehicle = self._config.vehicle
        mode = "in lock-step" if self._config.lockstep.enabled else "in real time"
        links = ", ".join(self._links.addresses)
        return f"{vehicle.personality} vehicle, system {vehicle.system_id}, {mode}: {links}"

    @property
    def autopilot(self) -> str:
        """Mode and arming."""
        firmware = self._vehicle.firmware
        return f"{firmware.mode_name} {'armed' if firmware.armed else 'disarmed'}"

    def run(self, duration_s: float | None, progress: Progress) -> None:
        """Fly in real time or in lock-step with the controller."""
        fly = run_lockstep if self._config.lockstep.enabled else run_real_time
        fly(self._vehicle, self._links, duration_s, lambda vehicle: progress())
