"""What the faults of the configuration do to motors, wind and estimate; pure functions of time."""

from __future__ import annotations

import numpy as np

from sim_vehicle.config_faults import FaultsSection
from sim_vehicle.frames import Array


def motor_commands(faults: FaultsSection, time_s: float, commands: Array) -> Array:
    """Commands (4[, N]), 0..1, that the faulty motors follow: thrust is proportional to command."""
    commands = np.clip(commands, 0.0, 1.0)
    for sag in faults.battery_sag:
        commands = commands * _left(sag.loss_per_s, sag.lowest, time_s - sag.start_s)
    for weak in faults.weak_motor:
        if time_s >= weak.start_s:
            share = np.ones(4)
            share[weak.motor - 1] = 1.0 - weak.loss
            commands = (commands.T * share).T
    for limit in faults.thrust_limit:
        if limit.start_s <= time_s < limit.start_s + limit.duration_s:
            commands = np.minimum(commands, limit.share)
    return np.asarray(commands)


def _left(loss_per_s: float, lowest: float, elapsed_s: float) -> float:
    return max(lowest, 1.0 - loss_per_s * max(elapsed_s, 0.0))


def wind(faults: FaultsSection, time_s: float) -> Array:
    """Velocity (3,) m/s that gusts add to the wind."""
    total = np.zeros(3)
    for gust in faults.gust:
        if gust.start_s <= time_s < gust.start_s + gust.duration_s:
            total += gust.velocity_m_s
    return total


def without_satellites(faults: FaultsSection, time_s: float) -> Array | None:
    """Error (4,) of the estimated x, y [m], vx and vy [m/s]; None while there are satellites."""
    for loss in faults.satellite_loss:
        lost_s = time_s - loss.start_s
        if lost_s >= 0.0 and (loss.duration_s is None or lost_s < loss.duration_s):
            drift = np.array(loss.drift_m_s2)
            return np.concatenate((0.5 * lost_s**2 * drift, lost_s * drift))
    return None
