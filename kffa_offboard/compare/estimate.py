"""How far the autopilot's own estimate of height wanders while a flight is measured.

A controller knows the height from the autopilot's estimate only. One that held that estimate without any
error would move the vehicle by the estimate's error: no such controller can be expected to show less.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.measure import LoadFigures
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.trials.metrics import WINDOW_S, Deviation, FlightFailed, Truth

Array = NDArray[np.float64]


@dataclass(frozen=True)
class EstimateFigures:
    """Of the estimated height; deviations are from its mean in the 5 s before the pick-up.

    Attributes
    ----------
    pickup, drop : largest and integrated deviation of its error, in the 5 s after each
    seen_pickup, seen_drop : the same of the estimated height itself: what the controller sees and leaves
    before_m_s, after_m_s : mean error of the climb rate in the 5 s before the pick-up, and after it
    """

    pickup: Deviation
    drop: Deviation
    seen_pickup: Deviation
    seen_drop: Deviation
    before_m_s: float
    after_m_s: float


@dataclass(frozen=True)
class HeightLog:
    """What the autopilot told of its height: arrays ``(n,)``.

    Attributes
    ----------
    time_s : simulated time of the sample
    height_m : estimated
    climb_rate_m_s : estimated
    """

    time_s: Array
    height_m: Array
    climb_rate_m_s: Array


def read_heights(log: Path, delay_s: float) -> HeightLog:
    """The LOCAL_POSITION_NED of a flight log over a link that takes `delay_s` to the daemon.

    The log's clock is the simulated time. Raises FlightFailed if there are none.
    """
    rows = [
        (time_us * 1e-6, message.time_boot_ms * 1e-3, -message.z, -message.vz)
        for time_us, message in read_tlog(log, kinds=(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,))
    ]
    if not rows:
        raise FlightFailed(f"{log} holds no LOCAL_POSITION_NED")
    arrival, sample, height, climb_rate = np.array(rows).T
    offset = float(np.median(arrival - sample)) - delay_s
    return HeightLog(sample + offset, height, climb_rate)


def measure_estimate(truth: Truth, log: HeightLog, load: LoadFigures) -> EstimateFigures:
    """Measure the estimate of a flight whose height `load` has measured."""
    error = log.height_m - np.interp(log.time_s, truth.time_s, truth.z)
    climb_rate = np.interp(log.time_s, truth.time_s, np.gradient(truth.z, truth.time_s))
    rate_error = log.climb_rate_m_s - climb_rate
    before = _window(log, load.pickup_s - WINDOW_S)
    after = _window(log, load.pickup_s)
    if not before.any():
        raise FlightFailed("the log holds no estimate of height before the pick-up")

    def deviation(values: Array, event_s: float) -> Deviation:
        window = _window(log, event_s)
        distance = np.abs(values[window] - values[before].mean())
        return Deviation(float(distance.max()), float(np.trapezoid(distance, log.time_s[window])))

    return EstimateFigures(
        pickup=deviation(error, load.pickup_s),
        drop=deviation(error, load.drop_s),
        seen_pickup=deviation(log.height_m, load.pickup_s),
        seen_drop=deviation(log.height_m, load.drop_s),
        before_m_s=float(rate_error[before].mean()),
        after_m_s=float(rate_error[after].mean()),
    )


def _window(log: HeightLog, start_s: float) -> NDArray[np.bool_]:
    return np.asarray((log.time_s >= start_s) & (log.time_s < start_s + WINDOW_S))
