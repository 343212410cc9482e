"""Where time 0 of a flight is put, so that several flights can be laid over one another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from kffa_offboard.report.flight import Flight

Alignment = Literal["start", "engage", "event"]


@dataclass(frozen=True)
class Zero:
    """Time 0 of a flight on the page: seconds since its log began, and what happened then."""

    time_s: float
    what: str


def zero_of(flight: Flight, alignment: Alignment) -> Zero:
    """Time 0 for an alignment. A flight without it falls back, and `what` says to what.

    "engage" is the first moment in which the daemon began to engage, the first arming where there was none;
    "event" the first pick-up or drop; "start" the log's first record.
    """
    if alignment == "start":
        return Zero(0.0, "start of the log")
    if alignment == "event":
        for event in flight.events:
            if event.kind == "load":
                return Zero(event.time_s, event.text)
        return Zero(0.0, "start of the log (no pick-up or drop was announced)")
    for event in flight.events:
        if event.kind == "state" and event.text in ("engaging", "engaged"):
            return Zero(event.time_s, "engaging")
    for event in flight.events:
        if event.kind == "armed" and event.text == "armed":
            return Zero(event.time_s, "arming (the daemon never engaged)")
    return Zero(0.0, "start of the log (never engaged nor armed)")
