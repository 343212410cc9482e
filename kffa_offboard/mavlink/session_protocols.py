"""What a session needs of the service that it talks for, and of a flight log."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, TypeAlias

from kffa_offboard.offboard.events import (
    EngageRequested,
    Event,
    GiveUpRequested,
    HangNoticed,
    IntrusionNoticed,
    Output,
    ProcessReport,
    ReleaseRequested,
    Signals,
)

ProcessRequest: TypeAlias = (
    EngageRequested | ReleaseRequested | IntrusionNoticed | GiveUpRequested | HangNoticed
)
"""What comes in no MAVLink message, but from the daemon's own process or its link."""


class OffboardService(Protocol):
    """What a session needs of `offboard.service.Service`. Times are integer microseconds."""

    @property
    def finished(self) -> object | None:
        """Why there is nothing left to do, or None."""

    def handle(self, time_us: int, event: Event) -> Sequence[Output]:
        """Take an event; deadlines up to `time_us` come first."""

    def advance(self, time_us: int) -> Sequence[Output]:
        """Do what is due up to `time_us`."""

    def next_deadline(self) -> int | None:
        """When something is due without any event; None if nothing is."""

    def last_words(self) -> Sequence[Output]:
        """What is to be sent by a process that ends in the middle of control."""


class Recorder(Protocol):
    """What a session needs of a flight log."""

    def write(self, time_us: int, frame: bytes) -> None:
        """Record one MAVLink frame, received or sent."""

    def write_signals(self, signals: Signals) -> None:
        """Record the controller's inner signals."""

    def write_begin(self, time_us: int) -> None:
        """Record that the run begins, and with what."""

    def write_request(self, time_us: int, request: ProcessRequest) -> None:
        """Record what the daemon's own process asked for or noticed."""

    def write_report(self, time_us: int, report: ProcessReport) -> None:
        """Record what the daemon's own process reports."""

    def write_end(self, time_us: int, reason: str, frames_dropped: int) -> None:
        """Record that the run is over, and why."""
