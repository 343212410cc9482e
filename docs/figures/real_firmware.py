"""Draw docs/images/real-firmware.png: what 5 kg do to PX4 and ArduCopter, and to the daemon on them.

    python docs/figures/real_firmware.py PX4_DIRECTORY ARDUPILOT_DIRECTORY [FILE.png]

The directories are those of `kffa-offboard compare --autopilot px4 --firmware ... --seed 9 --out ...
--only native-stock --only native-tuned --only kffa-ladrc`, and of
the same with `--autopilot ardupilot --seed 4`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from kffa_offboard.compare.estimate import read_heights
from kffa_offboard.plot_style import BLUE, GREY, ORANGE, figure_to
from kffa_offboard.trials.metrics import WINDOW_S, read_truth

TARGET = Path(__file__).parents[1] / "images" / "real-firmware.png"
BEFORE_S, AFTER_S = 1.0, 15.0
ROWS = {"native-stock": ORANGE, "native-tuned": GREY, "kffa-ladrc": BLUE}
TITLES = {"px4": "unmodified PX4", "ardupilot": "unmodified ArduCopter"}


def main(directories: list[Path], target: Path) -> None:
    """Draw both flights of each directory's rows, in metres and once more in centimetres."""
    flights = [json.loads((place / "results.json").read_text(encoding="utf-8")) for place in directories]
    with figure_to(target, (10.5, 7.2), dpi=130) as figure:
        figure.suptitle("5 kg picked up by 10 kg, and dropped again", fontsize=13, fontweight="bold")
        axes = figure.subplots(2, 2, sharex=True, sharey="row")
        for column, (directory, results) in enumerate(zip(directories, flights, strict=True)):
            for row, scale in enumerate((1.0, 100.0)):
                _draw(axes[row][column], directory, results, scale)
            axes[0][column].set_title(TITLES[results["autopilot"]])
            axes[0][column].legend(loc="lower right")
            _draw_estimate(axes[1][column], directory, results)
            axes[1][column].set_ylim(-12.0, 12.0)
            axes[1][column].set_title("the same, larger")
            axes[1][column].set_xlabel("time since 5 kg were picked up [s]")
        axes[0][0].set_ylabel("deviation of true height [m]")
        axes[1][0].set_ylabel("deviation of true height [cm]")


def _draw(axis: Any, directory: Path, results: Any, scale: float) -> None:
    for trial in results["trials"]:
        if trial["name"] not in ROWS:
            continue
        truth, load = read_truth(directory / f"{trial['name']}-truth.csv"), trial["load"]
        time = truth.time_s - load["pickup_s"]
        near = (time >= -BEFORE_S) & (time <= AFTER_S)
        peaks = ", ".join(f"{100 * load[event]['peak_m']:.1f}" for event in ("pickup", "drop"))
        axis.plot(
            time[near],
            scale * (truth.z[near] - load["reference_m"]),
            color=ROWS[trial["name"]],
            label=f"{trial['label']}: {peaks} cm",
            linewidth=1.6,
        )
    for event_s in (0.0, load["drop_s"] - load["pickup_s"]):
        axis.axvline(event_s, color=GREY, linewidth=1.0, linestyle=(0, (4, 3)))


def _draw_estimate(axis: Any, directory: Path, results: Any) -> None:
    """Where a vehicle would be that holds the autopilot's own height, which is off by its error, exactly."""
    trial = next(trial for trial in results["trials"] if trial["name"] == "kffa-ladrc")
    truth = read_truth(directory / "kffa-ladrc-truth.csv")
    log = read_heights(directory / "kffa-ladrc.tlog", trial["conditions"]["delay_s"])
    time = log.time_s - trial["load"]["pickup_s"]
    held = np.interp(log.time_s, truth.time_s, truth.z) - log.height_m
    before, near = (time >= -WINDOW_S) & (time < 0.0), (time >= -BEFORE_S) & (time <= AFTER_S)
    label = "if the autopilot's own height were held exactly"
    held_cm = 100.0 * (held - held[before].mean())
    lines = axis.plot(time[near], held_cm[near], color=BLUE, label=label, linewidth=1.2, linestyle=":")
    axis.legend(handles=lines, loc="upper left")


if __name__ == "__main__":
    places = [Path(name) for name in sys.argv[1:]]
    if len(places) not in (2, 3):
        sys.exit(__doc__)
    main(places[:2], places[2] if places[2:] else TARGET)
