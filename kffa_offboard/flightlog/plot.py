"""The inner signals for plotting programs: live as JSON datagrams, afterwards as a table (CSV).

A number is CHANNEL/SIGNAL (``altitude/estimate``) in both, which PlotJuggler and others show as a tree.
PlotJuggler puts a slash before the names of a datagram and nothing before those of a table: there they
have it already, so that a layout made for one opens the other. Units and axes are those of `Signals`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.control.controllers import CHANNELS
from kffa_offboard.flightlog.signals import BLOCKS, STATE_NAMES, SignalTable
from kffa_offboard.offboard.events import PayloadReport, Signals

TIME_KEY = "timestamp"
"""Seconds; what PlotJuggler takes for the time of a datagram if told to use a field."""

_SERIES = tuple(
    (f"{channel}/{block}", block, k) for k, channel in enumerate(CHANNELS) for block in (*BLOCKS, "saturated")
)
"""Name, field of `Signals` and of `SignalTable`, and index in it."""


def series(signals: Signals) -> dict[str, float]:
    """Values of one control step by name; what is not known, or not finite, is left out.

    `state` is the index in `STATE_NAMES`.
    """
    values = {name: float(getattr(signals, block)[k]) for name, block, k in _SERIES}
    values |= {
        "state": float(STATE_NAMES.index(signals.state)),
        "dt": signals.dt,
        "latency_s": signals.latency_s,
    }
    if signals.position_reference is not None:
        values["x/reference"], values["y/reference"] = signals.position_reference
    return {name: value for name, value in values.items() if math.isfinite(value)}


def columns(table: SignalTable) -> dict[str, NDArray[np.float64]]:
    """`series` of every control step of a log, (n,) each; NaN where a value is not known."""
    found = {name: getattr(table, block)[:, k].astype(float) for name, block, k in _SERIES}
    return found | {
        "state": table.state.astype(float),
        "dt": table.dt,
        "latency_s": table.latency_s,
        "x/reference": table.position_reference[:, 0],
        "y/reference": table.position_reference[:, 1],
    }


def csv_lines(table: SignalTable) -> Iterator[str]:
    """The table with a line of names, each line with its end; the first column is `TIME_KEY`, in seconds.

    The other names begin with a slash, as PlotJuggler has them of a `PlotStream`.
    Values have the nine digits that a float32 needs; one that is not known is an empty field.
    """
    found = columns(table)
    yield ",".join([TIME_KEY, *(f"/{name}" for name in found)]) + "\n"
    for time_us, row in zip(table.time_us.tolist(), np.column_stack(list(found.values())), strict=True):
        fields = [f"{value:.9g}" if math.isfinite(value) else "" for value in row.tolist()]
        yield ",".join([f"{time_us // 1_000_000}.{time_us % 1_000_000:06d}", *fields]) + "\n"


class PlotStream:
    """Sends every control step's signals, and the load's mass, as one JSON object to a datagram.

    It is an observer of the session (`mavlink.session.Observer`).

    Parameters
    ----------
    send
        Sends a datagram, and neither waits nor raises.
    vehicle
        Goes before every name if there are several vehicles.

    """

    def __init__(self, send: Callable[[bytes], object], vehicle: str = "") -> None:
        self._send = send
        self._prefix = f"{vehicle}/" if vehicle else ""

    def __call__(self, time_us: int, item: object) -> None:
        """Send what there is to plot of `item`, at its own time."""
        if isinstance(item, Signals):
            self._put(item.time_us, series(item))
        elif isinstance(item, PayloadReport):
            self._put(item.time_us, {"payload/mass_kg": item.mass_kg, "payload/std_kg": item.std_kg})

    def _put(self, time_us: int, values: dict[str, float]) -> None:
        named = {f"{self._prefix}{name}": value for name, value in values.items()}
        self._send(json.dumps({TIME_KEY: time_us / 1e6, **named}, allow_nan=False).encode())
