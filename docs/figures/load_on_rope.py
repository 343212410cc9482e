"""Draw docs/images/load-on-rope.png: 5 kg on a rope in gusty wind, under either position ring.

    python docs/figures/load_on_rope.py [FILE.png]

Daemon and simulated vehicle (PX4, the wind of demo --position) fly joined in one process, in simulated time.
"""

from __future__ import annotations

import sys
import tempfile
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
from ground_effect import Link

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import run_lock_step
from kffa_offboard.offboard.service import Service
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.plot_style import BLUE, GREEN, RED, figure_to
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

TARGET = Path(__file__).parents[1] / "images" / "load-on-rope.png"
LOAD_KG = 5.0
PANELS = ((1.0, 40.0), (10.0, 420.0))
"""Length of the rope, m, and how long the flight hovers with the load, s."""

ALONE, SHOWS, TOLD = "position ring by KFFA-LADRC alone", "rope not told: noticed", "rope told"
COLOURS = {ALONE: RED, SHOWS: GREEN, TOLD: BLUE}


def settings_of(case: str, length: float, seconds: float) -> ServiceSettings:
    """The demonstration with the position ring, hovering 5 m above the end of the rope."""
    text = bundled("demo-px4-position.toml").read_text(encoding="utf-8").partition("[scenario]")[0]
    if case == TOLD:
        text = text.replace("[payload]", f"[payload]\nrope_length_m = {length}")
    height = length + 5.0
    text += (
        f'[scenario]\nsegment = [{{ type = "takeoff", altitude_m = {height} }},'
        f'{{ type = "hold", duration_s = {seconds + 6.0} }}, {{ type = "land" }}]\n'
    )
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "rope.toml"
        file.write_text(text, encoding="utf-8")
        service = load(file, Overrides(arm=True, engage=True)).service
    assert service.position is not None
    return replace(service, position=replace(service.position, damping=None)) if case == ALONE else service


def fly(case: str, length: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Seconds since the pick-up, and the rope's angle from the vertical in degrees."""
    pick_up_s = length + 5.0 + 9.0  # since power-up; the climb is one of 1 m/s
    schedule = [{"time_s": pick_up_s, "mass_kg": LOAD_KG}, {"time_s": pick_up_s + seconds, "mass_kg": 0.0}]
    payload = {"clock": "boot", "rope_length_m": length, "schedule": schedule}
    vehicle = SimulatedVehicle(
        sim_config.load(bundled("demo-px4-position-vehicle.toml"), {"payload": payload})
    )
    session = Session(Service(settings_of(case, length, seconds)), Link(vehicle), Route())
    run_lock_step(session, lambda: vehicle.time_us, threading.Event())
    rows = [row for row in vehicle.truth.rows if row.load_mass_kg > 0.0]
    time_s = np.array([row.time_s for row in rows])
    return time_s - time_s[0], np.degrees([row.load_swing for row in rows])


def main(target: Path) -> None:
    """Fly all and write the figure."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with figure_to(target, (10.0, 3.8), 110) as figure:
        for axes, (length, seconds) in zip(figure.subplots(1, len(PANELS)), PANELS, strict=True):
            for case, colour in COLOURS.items():
                axes.plot(*fly(case, length, seconds), color=colour, label=case, linewidth=1.0)
            axes.set(xlabel="time since the pick-up [s]", ylabel="swing [degrees]", xlim=(0.0, seconds))
            axes.set_title(f"{LOAD_KG:g} kg on {length:g} m of rope")
        figure.axes[1].legend(loc="upper left")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else TARGET)
