"""Draw docs/images/ground-effect.png: a landing with a 5 kg load, with and without the ground effect.

    python docs/figures/ground_effect.py [FILE.png]

Daemon and simulated vehicle (PX4) fly joined in one process, in simulated time; the same seed twice.
"""

from __future__ import annotations

import sys
import tempfile
import threading
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import run_lock_step
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import Signals
from kffa_offboard.offboard.service import Service
from sim_vehicle import config as sim_config
from sim_vehicle.proximity import Proximity, ceiling_ratio, ground_ratio
from sim_vehicle.vehicle import SimulatedVehicle

TARGET = Path(__file__).parents[1] / "images" / "ground-effect.png"
SLOT_US = 10_000
LOAD_KG = 5.0
SCENARIO = """
[scenario]
segment = [
  { type = "takeoff", altitude_m = 2.0 },
  { type = "hold", duration_s = 3.0 },
  { type = "land", descent_rate_m_s = 0.7 },
]
"""
WITHOUT, WITH = "tab:gray", "tab:blue"


class Link:
    """The daemon's link with the vehicle behind it, one slot of simulated time at each `receive`."""

    name = "in-process"
    keeps_frames_whole = True
    trouble = ""

    def __init__(self, vehicle: SimulatedVehicle) -> None:
        self.vehicle = vehicle
        vehicle.add_peer("daemon")

    def receive(self, timeout_s: float) -> list[Datagram]:
        """Telemetry of one slot, then the barrier."""
        self.vehicle.advance(self.vehicle.time_us + SLOT_US)
        frames = [data for _, data in self.vehicle.outgoing()]
        frames.append(self.vehicle.time_request("daemon"))
        return [Datagram(self.vehicle.time_us, frame, "vehicle") for frame in frames]

    def send(self, data: bytes) -> bool:
        """To the vehicle's end of the link."""
        self.vehicle.receive(data, "daemon")
        return True

    def lock(self, source: Hashable) -> None:
        """There is only one source."""

    def close(self) -> None:
        """Nothing to close."""


def fly(ground_effect: bool) -> dict[str, np.ndarray]:
    """Take off with the load, hover, land; series over the seconds since landing began."""
    text = bundled("demo-px4.toml").read_text(encoding="utf-8").partition("[scenario]")[0]
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "landing.toml"
        file.write_text(text + SCENARIO, encoding="utf-8")
        daemon = load(file, Overrides(arm=True, engage=True))
    changes = {
        "payload": {"clock": "boot", "schedule": [{"time_s": 0.0, "mass_kg": LOAD_KG}]},
        "environment": {"ground_effect": ground_effect},
    }
    vehicle = SimulatedVehicle(sim_config.load(bundled("demo-px4-vehicle.toml"), changes))
    signals: list[Signals] = []

    def hear(_: int, item: Any) -> None:
        if isinstance(item, Signals) and item.state == "engaged":
            signals.append(item)

    ids = daemon.link
    route = Route(ids.system_id, ids.component_id, ids.target_system, ids.target_component)
    session = Session(Service(daemon.service), Link(vehicle), route, observer=hear)
    result = run_lock_step(session, lambda: vehicle.time_us, threading.Event())
    assert result.finished is not None and result.finished.successful, result
    height = np.array([item.reference[3] for item in signals])
    time_s = np.array([item.time_us for item in signals]) * 1e-6
    begins = time_s[np.flatnonzero(height > 1.98)[-1]]
    rows = vehicle.truth.rows
    return {
        "time": time_s - begins,
        "reference": height,
        "disturbance": np.array([item.disturbance[3] for item in signals]),
        "true_time": np.array([row.time_s for row in rows]) - begins,
        "true_height": np.array([row.state[2] for row in rows]),
        "thrust": np.convolve([row.thrust_n for row in rows], np.full(30, 1.0 / 30.0), mode="same"),
    }


def draw_ratios(axes: Any) -> None:
    """The two published curves over the distance in rotor radii."""
    rotors = Proximity()
    distance = np.linspace(0.02, 4.0, 500)
    lone = Proximity(rotor_spacing=1e6)
    radius = rotors.rotor_radius
    axes.plot(distance, ground_ratio(rotors, distance * radius), color=WITH, label="ground, quadrotor")
    axes.plot(distance, ground_ratio(lone, distance * radius), "--", color=WITH, label="ground, lone rotor")
    axes.plot(distance, ceiling_ratio(rotors, distance * radius), color="tab:orange", label="ceiling")
    axes.axvline(rotors.rotor_height / radius, color="black", linewidth=0.8, linestyle=":")
    axes.text(rotors.rotor_height / radius + 0.05, 1.5, "standing on the ground", va="center", fontsize=9)
    axes.set(xlabel="rotors to surface / rotor radius", ylabel="thrust / thrust far away", ylim=(0.98, 1.8))
    axes.legend(frameon=False)


def main(target: Path) -> None:
    """Fly both landings and write the figure."""
    flights = [
        ("without ground effect", WITHOUT, fly(False)),
        ("with ground effect", WITH, fly(True)),
    ]
    figure, ((ratio, height), (thrust, error)) = plt.subplots(2, 2, figsize=(10, 6.5), layout="constrained")
    draw_ratios(ratio)
    for label, colour, flown in flights:
        height.plot(flown["true_time"], flown["true_height"], color=colour, label=label)
        thrust.plot(flown["true_time"], flown["thrust"], color=colour, label=label)
        error.plot(flown["time"], flown["disturbance"], color=colour, label=label)
    height.plot(flights[1][2]["time"], flights[1][2]["reference"], "k:", linewidth=1, label="reference")
    height.text(2.3, 1.0, "both flights lie on the same line", fontsize=9)
    height.set(xlabel="time since landing began [s]", ylabel="height [m]", ylim=(-0.2, 2.2))
    thrust.set(xlabel="time since landing began [s]", ylabel="thrust of the motors, mean of 0.3 s [N]")
    error.set(xlabel="time since landing began [s]", ylabel="estimated disturbance [m/s²]", ylim=(-18, -8))
    thrust.set_ylim(80.0, 180.0)
    for axes in (height, thrust, error):
        axes.set_xlim(-1.0, 6.0)
        axes.legend(frameon=False)
    for axes in (ratio, height, thrust, error):
        axes.grid(alpha=0.3)
    figure.suptitle(
        f"Landing with {LOAD_KG:g} kg through the ground effect (22 inch rotors, PX4, KFFA-LADRC)"
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(target, dpi=110)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else TARGET)
