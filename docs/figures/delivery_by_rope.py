"""Draw docs/images/delivery-by-rope.png: demo-px4-rope.toml, and what the care with set points is worth.

    python docs/figures/delivery_by_rope.py [FILE.png]

Daemon and simulated vehicle (PX4, the wind of demo --position) fly joined in one process, in simulated time.
"""

from __future__ import annotations

import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from ground_effect import Link

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import run_lock_step
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.service import Service
from kffa_offboard.plot_style import BLUE, GREEN, RED, figure_to
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

TARGET = Path(__file__).parents[1] / "images" / "delivery-by-rope.png"
EVENTS = ("load lifted", "load set down", "drop 5 kg")
NAMES = ("lifted", "set down", "let go")


class Watched(Link):
    """Notes time, vehicle and load at each slot."""

    def __init__(self, vehicle: SimulatedVehicle) -> None:
        super().__init__(vehicle)
        self.rows: list[tuple[float, ...]] = []

    def receive(self, timeout_s: float) -> list[Datagram]:
        """Vehicle and load as they are, then what the vehicle sends."""
        rigid, place = self.vehicle.state.rigid, self.vehicle.plant._rope.place
        self.rows.append((self.vehicle.time_us * 1e-6, *rigid[:3].tolist(), *place.tolist()))
        return super().receive(timeout_s)


def fly(careful: bool) -> tuple[np.ndarray, SimulatedVehicle]:
    """Rows of time, the vehicle's place and the load's, and the vehicle with its truth."""
    service = load(bundled("demo-px4-rope.toml"), Overrides(arm=True, engage=True)).service
    ring = service.position
    assert ring is not None and ring.damping is not None and ring.damping.controller.pid is not None
    if not careful:
        controller = ring.damping.controller
        controller = replace(controller, pid=replace(controller.pid, follow=False))
        ring = replace(ring, sway_rad_s=0.0, damping=replace(ring.damping, controller=controller))
    vehicle = SimulatedVehicle(sim_config.load(bundled("demo-px4-rope-vehicle.toml")))
    link = Watched(vehicle)
    session = Session(Service(replace(service, position=ring)), link, Route())
    run_lock_step(session, lambda: vehicle.time_us, threading.Event())
    return np.array(link.rows), vehicle


def main(target: Path) -> None:
    """Fly both and write the figure."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with figure_to(target, (10.0, 6.4), 110) as figure:
        height, north, swing = figure.subplots(3, 1, sharex=True)
        for careful, colour in ((False, RED), (True, BLUE)):
            rows, vehicle = fly(careful)
            words = "as it flies" if careful else "set point's place alone"
            north.plot(rows[:, 0], rows[:, 1], color=colour, label=words)
            truth = vehicle.truth.rows
            swing.plot(
                [row.time_s for row in truth],
                np.degrees([row.load_swing for row in truth]),
                color=colour,
                label=words,
            )
        grabbed = vehicle.truth.time_of("pick-up") or 0.0
        carried = rows[:, 0] > grabbed
        height.plot(rows[:, 0], rows[:, 3], color=BLUE, label="vehicle")
        height.plot(rows[carried, 0], rows[carried, 6], color=GREEN, label="load")
        for text, name, level in zip(EVENTS, NAMES, (8.6, 8.6, 1.0), strict=True):
            time_s = vehicle.truth.time_of(text)
            assert time_s is not None
            height.axvline(time_s, color="0.6", linewidth=0.8)
            height.annotate(name, (time_s, level), xytext=(3, 0), textcoords="offset points", fontsize=8)
        height.set(ylabel="height [m]", ylim=(-0.3, 9.5))
        north.set(ylabel="vehicle, north [m]")
        swing.set(ylabel="swing [degrees]", xlabel="time [s]", xlim=(0.0, rows[-1, 0]))
        for axes in (height, north, swing):
            axes.legend(loc="upper right", fontsize=8)
        height.set_title(
            "5 kg on 4 m of rope, lifted, carried 10 m, set down and left, in a gusty wind of 5 m/s"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else TARGET)
