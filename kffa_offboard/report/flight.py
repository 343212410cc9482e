"""One flight as a report shows it, whatever file it came from.

Everything is in the paper's axes (x north, y west, z up), SI units and radians; times count in seconds from
the first record of the log. Whoever reads another kind of log builds a `Flight`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Channel = Literal["roll", "pitch", "yaw", "altitude", "north", "east"]
Quantity = Literal["reference", "measured", "estimate", "command", "disturbance", "omega_c"]
EventKind = Literal["state", "mode", "armed", "load", "text"]
CommandKind = Literal["rates", "attitude"]

CHANNELS: tuple[Channel, ...] = ("roll", "pitch", "yaw", "altitude")
QUANTITIES: tuple[Quantity, ...] = (
    "reference",
    "measured",
    "estimate",
    "command",
    "disturbance",
    "omega_c",
)


@dataclass(frozen=True)
class Line:
    """Values (n,) of one quantity at times (n,) [s], ascending; NaN where it is not known."""

    time_s: Array
    values: Array

    def __len__(self) -> int:
        return len(self.time_s)


def line(time_s: Any, values: Any) -> Line:
    """Build a line from sequences. Raises ValueError if they differ in length."""
    times, rows = np.asarray(time_s, dtype=float), np.asarray(values, dtype=float)
    if times.shape != rows.shape or times.ndim != 1:
        raise ValueError(f"{times.shape} times for {rows.shape} values; both must be (n,)")
    return Line(times, rows)


@dataclass(frozen=True)
class FlightEvent:
    """Something that happened: state of the daemon, flight mode, arming, load, or a text of either side.

    `mass_kg` is the announced mass of a load picked up (positive) or dropped (negative).
    """

    time_s: float
    kind: EventKind
    text: str
    mass_kg: float | None = None


@dataclass(frozen=True)
class Origin:
    """Where a flight comes from.

    Attributes
    ----------
    file : name of the file, without its directory
    start_us : time of the first record, us since 1970 (or since power-up, in lock-step)
    version, libraries : of kffa-offboard and of what takes part in the arithmetic; "" if not known
    configuration : tables of the TOML file; empty if not known
    command_kind : what the command of roll, pitch and yaw is
    """

    file: str
    start_us: int = 0
    version: str = ""
    libraries: Mapping[str, str] = field(default_factory=dict)
    configuration: Mapping[str, Any] = field(default_factory=dict)
    command_kind: CommandKind = "rates"


@dataclass(frozen=True)
class Flight:
    """A recorded flight.

    Attributes
    ----------
    name : what it is called on the page; different for each flight of a report
    duration_s : from the first to the last record
    lines : by quantity and channel; what the log does not have is left out
    saturated : (n, 4) in the channels' order, at the times of the altitude's command
    engaged : begin and end [s] of each stretch in which the daemon was in control
    load, load_std : estimated mass of the load and its standard deviation, kg
    latency : from taking a sample until the autopilot has the command, s
    arrivals : when each message of a telemetry stream arrived, s, by the stream's name
    frames_dropped : that the link did not take; None if not known
    remarks : what is missing or damaged, one line each
    """

    name: str
    origin: Origin
    duration_s: float = 0.0
    lines: Mapping[tuple[Quantity, Channel], Line] = field(default_factory=dict)
    saturated: NDArray[np.bool_] | None = None
    engaged: tuple[tuple[float, float], ...] = ()
    load: Line | None = None
    load_std: Line | None = None
    latency: Line | None = None
    arrivals: Mapping[str, Array] = field(default_factory=dict)
    events: tuple[FlightEvent, ...] = ()
    frames_dropped: int | None = None
    remarks: tuple[str, ...] = ()
