"""Every series as CSV: a file for each flight, controllers side by side; Example 4's seeds as one table."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from kffa_offboard.control import Array
from kffa_offboard.control.controllers import CHANNELS
from kffa_offboard.experiments.evaluate import labels, noise_of
from kffa_offboard.experiments.examples import DISTURBANCES, Traces
from kffa_offboard.experiments.position_flights import FLIGHTS, PositionTraces
from kffa_offboard.experiments.settings import PaperSettings

SHOWN_SEED = 0
_PLACE = ("x", "y", "z", "roll", "pitch", "yaw")


def write_series(
    directory: Path, settings: PaperSettings, traces: Traces, examples: Iterable[int]
) -> list[Path]:
    """Write the CSV files and return their paths.

    Columns: ``time_s``, ``reference_<channel>``, then ``<controller>:<channel>`` (true output),
    ``...:command`` and ``...:omega_c``, in rad, m, N (yaw command: N m), rad/s. Of Example 4 the series of
    the first seed are written, and the numbers of all seeds.
    """
    directory.mkdir(parents=True, exist_ok=True)
    names = dict.fromkeys(name for _, name in traces)
    shown = [name for name in names if not name.startswith("4/") or name.endswith(f"/{SHOWN_SEED}")]
    paths = [_write_flight(directory, traces, name) for name in shown]
    if 4 in examples:
        paths.append(_write_seeds(directory, settings, traces))
    return paths


def _write_flight(directory: Path, traces: Traces, name: str) -> Path:
    flown = labels(traces, name)
    first = traces[flown[0], name]
    header = ["time_s", *(f"reference_{channel}" for channel in CHANNELS)]
    columns: list[Array] = [first.time, *first.reference.T]
    for label in flown:
        trace = traces[label, name]
        for i, channel in enumerate(CHANNELS):
            header += [f"{label}:{channel}", f"{label}:{channel}:command", f"{label}:{channel}:omega_c"]
            columns += [trace.output[:, i], trace.command[:, i], trace.omega_c[:, i]]
    return _save(directory / f"example{name.replace('/', '-')}.csv", header, columns)


def _save(path: Path, header: list[str], columns: list[Array]) -> Path:
    np.savetxt(
        path, np.column_stack(columns), fmt="%.7g", delimiter=",", header=",".join(header), comments=""
    )
    return path


def _write_seeds(directory: Path, settings: PaperSettings, traces: Traces) -> Path:
    path = directory / "example4-seeds.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["controller", "case", "seed", "quantity", *CHANNELS])
        for label in labels(traces, "4/load/0"):
            for case in DISTURBANCES:
                for quantity, values in noise_of(settings, traces, label, case).items():
                    for seed, four in enumerate(values):
                        rows.writerow([label, case, seed, quantity, *(f"{value:.7g}" for value in four)])
    return path


def write_position_series(directory: Path, traces: PositionTraces) -> list[Path]:
    """Write the position ring's flights of the first seed, a file each, and return the paths.

    Columns: ``time_s``, ``target_x``, ``target_y``, ``load_mass_kg``, then ``<controller>:x`` and so on; m,
    rad, true.
    """
    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    for flight in FLIGHTS:
        flown = {
            label: trace
            for (label, name, seed), trace in traces.items()
            if (name, seed) == (flight, SHOWN_SEED)
        }
        first = next(iter(flown.values()))
        header = ["time_s", "target_x", "target_y", "load_mass_kg"]
        header += [f"{label}:{name}" for label in flown for name in _PLACE]
        columns: list[Array] = [first.time, *first.target.T, first.load_mass]
        for trace in flown.values():
            columns += [*trace.place.T, *trace.attitude.T]
        paths.append(_save(directory / f"position-{flight}.csv", header, columns))
    return paths
