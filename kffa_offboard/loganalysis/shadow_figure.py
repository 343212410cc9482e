"""Disturbances and mass along a recorded flight."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from kffa_offboard.loganalysis.shadow import Shadow


def draw(path: Path, found: Shadow, vehicle_mass_kg: float | None) -> None:
    """Write a picture: altitude, disturbances, total mass; its time is the log's, as in what is told."""
    estimates, time_s = found.estimates, found.estimates.time_s
    figure, axes = plt.subplots(3, 1, figsize=(9, 8), sharex=True, constrained_layout=True)
    axes[0].plot(time_s, estimates.measurement[:, 3], lw=1.0)
    axes[0].set_ylabel("altitude, m")
    axes[0].set_title(found.record.path.name)
    for k, name in enumerate(("roll", "pitch", "yaw")):
        axes[1].plot(time_s, estimates.disturbance[:, k], lw=0.8, label=f"{name}, rad/s²")
    axes[1].plot(time_s, estimates.disturbance[:, 3], lw=0.8, label="altitude, m/s²")
    axes[1].set_ylabel("disturbance")
    axes[1].legend(ncols=4, fontsize=8)
    low, high = np.percentile(estimates.disturbance, [0.5, 99.5])
    axes[1].set_ylim(low - 1.0, high + 1.0)
    if found.mass is not None:
        scale = 1.0 if vehicle_mass_kg is None else vehicle_mass_kg
        axes[2].plot(found.mass.time_s, scale * found.mass.mass_ratio, lw=1.0)
        for change in found.mass.changes:
            axes[2].axvline(change.time_s, color="0.5", lw=0.8, ls="--")
    axes[2].set_ylabel("total / empty mass" if vehicle_mass_kg is None else "total mass, kg")
    axes[2].set_xlabel("time in the log, s")
    for axis in axes:
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
    plt.close(figure)
