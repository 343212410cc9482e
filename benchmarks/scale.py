"""Flight-steps a second of a batch: airframe, link, load and four-channel KFFA-LADRC, on one core.

Beside it rotorpy's batched simulator with its batched SE3 controller, the same number of vehicles and steps,
in an interpreter that has it (ROTORPY_PYTHON; this one without it). Draws docs/images/scale.png. Wants
OMP_NUM_THREADS=1, as `make bench` sets it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
from common import save

from kffa_offboard.campaign.flight import WIDTH as CAMPAIGN_WIDTH
from kffa_offboard.campaign.flight import Batch
from kffa_offboard.campaign.settings import Campaign, load_campaign
from kffa_offboard.config import bundled
from kffa_offboard.plot_style import BLUE, GREY, figure_to

COUNTS = (1, 3, 10, 30, 100, 300, 1000, 3000, 10_000, 30_000, 100_000)
STEPS = 64
WIDTH = 5000
"""Flights of a batch: quickest on one core. A campaign's are narrower, so that more processes have work."""
SIDE_BY_SIDE = 10_000
FIGURE = Path(__file__).parents[1] / "docs" / "images" / "scale.png"
CONTROLLER = "kffa-ladrc"


def short(campaign: Campaign) -> Campaign:
    """The campaign with pick-up and drop within `STEPS`."""
    file = campaign.file
    flight = file.flight.model_copy(update={"settle_s": 0.2})
    random = file.random.model_copy(update={"drop_after_s": (0.1, 0.3)})
    return Campaign(
        file.model_copy(update={"flight": flight, "random": random}), campaign.services, campaign.control_s
    )


def steps_of(campaign: Campaign, flights: int, width: int | None = None) -> tuple[float, float]:
    """Wall and processor time of `STEPS` steps, batch after batch; drawing conditions is left out."""
    wall = processor = 0.0
    width = width or WIDTH
    for first in range(0, flights, width):
        batch = Batch(campaign, CONTROLLER, np.arange(first, min(first + width, flights)))
        began, used = time.perf_counter(), time.process_time()
        for k in range(STEPS):
            batch.step(k * campaign.control_s)
        wall += time.perf_counter() - began
        processor += time.process_time() - used
    return wall, processor


def rotorpy(integrator: str) -> tuple[float, float] | None:
    """The same of rotorpy; None if the interpreter does not have it."""
    python = os.environ.get("ROTORPY_PYTHON", sys.executable)
    script = Path(__file__).with_name("rotorpy_batch.py")
    command = [python, str(script), str(SIDE_BY_SIDE), str(STEPS), integrator]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        print(f"rotorpy left out ({done.stderr.strip().splitlines()[-1]}); set ROTORPY_PYTHON")
        return None
    wall, processor = json.loads(done.stdout.splitlines()[-1])
    return wall, processor


def row(flights: int, steps: int, wall: float, processor: float) -> dict[str, object]:
    """One row of the table."""
    return {
        "flights": flights,
        "steps": steps,
        "wall [s]": round(wall, 3),
        "processor [s]": round(processor, 3),
        "million flight-steps/s of wall time": round(flights * steps / wall / 1e6, 3),
        "of processor time": round(flights * steps / processor / 1e6, 3),
    }


def draw(measured: dict[int, float]) -> None:
    """Processor time of `STEPS` steps against the number of flights."""
    counts, times = np.array(list(measured)), np.array(list(measured.values()))
    with figure_to(FIGURE, (7.0, 4.2), dpi=130) as figure:
        axis = figure.subplots()
        per_flight = times[-1] / counts[-1]
        axis.loglog(
            counts, per_flight * counts, color=GREY, linestyle=(0, (4, 3)), linewidth=1.1,
            label=f"proportional: {1e6 * per_flight / STEPS:.2f} µs a step of a flight",
        )  # fmt: skip
        axis.loglog(counts, times, color=BLUE, marker="o", markersize=4.5, label="measured, one core")
        axis.set_title("64 steps (0.64 s) of a batch of flights: airframe, link, load, KFFA-LADRC")
        axis.set_xlabel("flights")
        axis.set_ylabel("processor time [s]")
        axis.legend(loc="upper left")


def main() -> None:
    """Measure, print, save and draw."""
    if os.environ.get("OMP_NUM_THREADS") != "1":
        sys.exit("error: set OMP_NUM_THREADS=1 (and OPENBLAS_NUM_THREADS=1): one core is measured")
    campaign = load_campaign(bundled("campaign.toml"), (CONTROLLER,))
    brief = short(campaign)
    rows, measured = {}, {}
    steps_of(brief, WIDTH)  # warm
    for flights in COUNTS:
        runs = 5 if flights <= 10_000 else 1
        wall, processor = min((steps_of(brief, flights) for _ in range(runs)), key=lambda times: times[1])
        measured[flights] = processor
        rows[f"{flights:,} flights"] = row(flights, STEPS, wall, processor)
    narrow = min(
        (steps_of(brief, SIDE_BY_SIDE, CAMPAIGN_WIDTH) for _ in range(5)), key=lambda times: times[1]
    )
    rows[f"{SIDE_BY_SIDE:,} flights, {CAMPAIGN_WIDTH:,} at a time"] = row(SIDE_BY_SIDE, STEPS, *narrow)
    for integrator in ("rk4", "dopri5"):
        times = rotorpy(integrator)
        if times is not None:
            rows[f"rotorpy, SE3 controller, {integrator}"] = row(SIDE_BY_SIDE, STEPS, *times)
    save("scale", rows)
    draw(measured)


if __name__ == "__main__":
    main()
