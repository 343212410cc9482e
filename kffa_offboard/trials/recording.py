"""The controller's signals of a flight, in the vehicle's own time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.flightlog.signals import SignalTable, is_signals, table
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.trials.metrics import FlightFailed


@dataclass(frozen=True)
class Recording:
    """Signals of one flight; `time_s` (n,) is the vehicle's time since power-up."""

    time_s: NDArray[np.float64]
    signals: SignalTable


def read_recording(log: Path) -> Recording:
    """Read a flight log.

    Log times are arrival times. ATTITUDE says when its sample was taken, in the vehicle's time; the
    smallest difference of the two is the offset of the clocks (and the least delay of the link).
    Raises FlightFailed if the log holds no control steps.
    """
    signals, offsets_us = [], []
    for time_us, message in read_tlog(log):
        if is_signals(message):
            signals.append(message)
        elif message.get_type() == "ATTITUDE":
            offsets_us.append(time_us - message.time_boot_ms * 1000)
    if not signals or not offsets_us:
        raise FlightFailed(f"{log} holds no control steps")
    found = table(signals)
    return Recording((found.time_us - min(offsets_us)) / 1e6, found)
