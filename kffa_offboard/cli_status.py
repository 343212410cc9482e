"""What a running daemon shows: a line for each announcement and, on a terminal, a live status line."""

from __future__ import annotations

import time
from math import isnan, nan
from types import TracebackType

from rich.console import Console
from rich.live import Live
from rich.text import Text

from kffa_offboard.offboard.events import (
    Announce,
    AttitudeReceived,
    AttitudeTarget,
    Event,
    HeartbeatReceived,
    Output,
    PositionReceived,
    Severity,
    Signals,
    StatusReceived,
)

REFRESH_S = 0.25
RATE_WINDOW_S = 1.0

_STYLES = {
    Severity.CRITICAL: "bold red",
    Severity.WARNING: "yellow",
    Severity.NOTICE: "green",
    Severity.INFO: "",
}


class RateCounter:
    """Events per second of the last full second."""

    def __init__(self) -> None:
        self._count = 0
        self._since_us: int | None = None
        self.hz = 0.0

    def count(self, time_us: int) -> None:
        """Note one event."""
        if self._since_us is None:
            self._since_us = time_us
            return
        self._count += 1
        elapsed_s = (time_us - self._since_us) / 1e6
        if elapsed_s >= RATE_WINDOW_S:
            self.hz, self._count, self._since_us = self._count / elapsed_s, 0, time_us


class StatusDisplay:
    """Watches a session (give it as `observer`) and tells a person. A context manager.

    Times are those that the service is told: wall time, or the vehicle's in lock-step.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live = (
            Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        )
        self._shown_s = 0.0
        self._begun_us: int | None = None
        self._vehicle = "no vehicle yet"
        self._known: HeartbeatReceived | None = None
        self._state = "waiting"
        self._altitude_m = nan
        self._thrust = nan
        self._latency_s = nan
        self._telemetry = RateCounter()
        self._commands = RateCounter()

    def __enter__(self) -> StatusDisplay:
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()

    def __call__(self, time_us: int, item: Event | Output) -> None:
        """Take note of an event or output of the service."""
        if self._begun_us is None:
            self._begun_us = time_us
        self._note(time_us, item)
        if self._live is not None and time.monotonic() - self._shown_s >= REFRESH_S:
            self._shown_s = time.monotonic()
            self._live.update(self._line(time_us), refresh=True)

    def _note(self, time_us: int, item: Event | Output) -> None:
        match item:
            case AttitudeReceived():
                self._telemetry.count(time_us)
            case PositionReceived():
                self._altitude_m = item.position[2]
            case Signals():
                self._state = item.state
                self._latency_s = item.latency_s
            case AttitudeTarget():
                self._commands.count(time_us)
                self._thrust = item.thrust
            case HeartbeatReceived():
                self._note_heartbeat(time_us, item)
            case StatusReceived():
                self._say(time_us, f"vehicle: {item.text}", "dim")
            case Announce():
                self._say(time_us, item.text, _STYLES[item.severity])

    def _note_heartbeat(self, time_us: int, heartbeat: HeartbeatReceived) -> None:
        before, self._known = self._known, heartbeat
        self._vehicle = (
            f"{heartbeat.firmware} {heartbeat.mode_name} {'armed' if heartbeat.armed else 'disarmed'}"
        )
        if before is None or (before.mode_name, before.armed) != (heartbeat.mode_name, heartbeat.armed):
            self._say(time_us, f"vehicle: {self._vehicle}", "cyan")

    def _say(self, time_us: int, text: str, style: str) -> None:
        assert self._begun_us is not None
        stamp = f"{(time_us - self._begun_us) / 1e6:8.2f} s  "
        self._console.print(Text(stamp, "dim") + Text(text, style), soft_wrap=True, highlight=False)

    def _line(self, time_us: int) -> Text:
        altitude = "   - " if isnan(self._altitude_m) else f"{self._altitude_m:5.2f}"
        thrust = "  - " if isnan(self._thrust) else f"{self._thrust:4.2f}"
        latency = "" if isnan(self._latency_s) else f"  latency {1e3 * self._latency_s:.0f} ms"
        return Text(
            f"{self._state}  {self._vehicle}  {altitude} m  thrust {thrust}  "
            f"in {self._telemetry.hz:.0f} Hz  out {self._commands.hz:.0f} Hz{latency}",
            "bold",
            no_wrap=True,
        )
