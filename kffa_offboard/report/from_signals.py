"""The controller's inner signals as lines, and the states of the daemon as events."""

from __future__ import annotations

import numpy as np

from kffa_offboard.flightlog.signals import STATE_NAMES, SignalTable
from kffa_offboard.report.flight import CHANNELS, QUANTITIES, Channel, FlightEvent, Line, Quantity

_BLOCKS: dict[Quantity, str] = {name: "measurement" if name == "measured" else name for name in QUANTITIES}
IN_CONTROL = ("engaging", "engaged", "releasing")
"""States in which the daemon's setpoints fly the vehicle."""


def signal_lines(table: SignalTable, begin_us: int) -> dict[tuple[Quantity, Channel], Line]:
    """Lines of every block, seconds since `begin_us`; none for a table without rows."""
    if not len(table.time_us):
        return {}
    time_s = (table.time_us - begin_us) / 1e6
    lines: dict[tuple[Quantity, Channel], Line] = {
        (quantity, channel): Line(time_s, getattr(table, block)[:, column])
        for quantity, block in _BLOCKS.items()
        for column, channel in enumerate(CHANNELS)
    }
    if np.any(np.isfinite(table.position_reference)):
        lines["reference", "north"] = Line(time_s, table.position_reference[:, 0])
        lines["reference", "east"] = Line(time_s, -table.position_reference[:, 1])
    return lines


def state_events(
    table: SignalTable, begin_us: int
) -> tuple[tuple[FlightEvent, ...], tuple[tuple[float, float], ...]]:
    """Changes of the daemon's state, and begin and end [s] of the stretches in which it was engaged."""
    if not len(table.time_us):
        return (), ()
    time_s = (table.time_us - begin_us) / 1e6
    changes = np.flatnonzero(np.diff(table.state, prepend=-1))
    events = tuple(FlightEvent(float(time_s[row]), "state", _name(int(table.state[row]))) for row in changes)
    engaged = (table.state == STATE_NAMES.index("engaged")).astype(int)
    edges = np.flatnonzero(np.diff(engaged, prepend=0, append=0))
    ends = np.append(time_s, time_s[-1])
    spans = tuple(
        (float(time_s[begin]), float(ends[end])) for begin, end in zip(edges[::2], edges[1::2], strict=True)
    )
    return events, spans


def _name(state: int) -> str:
    return STATE_NAMES[state] if 0 <= state < len(STATE_NAMES) else f"state {state}"
