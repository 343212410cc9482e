"""What a running daemon shows: a line for each announcement and, on a terminal, a live status line.

A thread of its own writes, so that neither drawing nor a terminal that does not read (Ctrl-S, a full pipe)
delays control; what is more than it can take is dropped. A terminal that is gone is no reason to stop flying.
"""

from __future__ import annotations

import sys
import threading
from collections import deque
from contextlib import suppress
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
    ProcessReport,
    Severity,
    Signals,
    StatusReceived,
    StepTiming,
)
from kffa_offboard.process.notify import ServiceManager

REFRESH_S = 0.25
RATE_WINDOW_S = 1.0
LINES_MAX = 1000
"""Lines that may wait for the terminal."""

END_LIMIT_S = 1.0
"""How long the last lines may take at the end."""

_STYLES = {
    Severity.CRITICAL: "bold red",
    Severity.WARNING: "yellow",
    Severity.NOTICE: "green",
    Severity.INFO: "",
}


class StatusConsole(Console):
    """The terminal; one that is gone is an error that can be caught, and does not end the process."""

    def __init__(self) -> None:
        super().__init__(stderr=True)

    def on_broken_pipe(self) -> None:
        """See `rich.console.Console`."""
        raise BrokenPipeError

    def tell(self, text: str) -> None:
        """A plain line, if anybody can see it."""
        with suppress(OSError):
            self.print(text, soft_wrap=True, highlight=False, markup=False)


def complain(text: str) -> None:
    """A line of error, as all commands write it, if anybody can see it."""
    with suppress(OSError):
        print(f"error: {text}", file=sys.stderr, flush=True)


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


class StatusBoard:
    """Where all vehicles of a process are shown, to people and to the service manager. A context manager."""

    def __init__(self, console: Console, manager: ServiceManager) -> None:
        self._console = console
        self._manager = manager
        self._live = (
            Live(console=console, auto_refresh=False, transient=True) if console.is_terminal else None
        )
        self._vehicles: list[VehicleStatus] = []
        self._lines: deque[Text] = deque(maxlen=LINES_MAX)
        self._wake = threading.Event()
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="status", daemon=True)

    def vehicle(self, name: str = "") -> VehicleStatus:
        """A vehicle to be shown; `name` tells it from others."""
        status = VehicleStatus(name, self)
        self._vehicles.append(status)
        return status

    def say(self, line: Text) -> None:
        """Show a line some time soon. Never waits."""
        self._lines.append(line)
        self._wake.set()

    def __enter__(self) -> StatusBoard:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self._ended = True
        self._wake.set()
        self._thread.join(END_LIMIT_S)

    def _run(self) -> None:
        """The thread; it ends early when there is nobody to write to."""
        try:
            if self._live is not None:
                self._live.start()
            while not self._ended:
                self._wake.wait(REFRESH_S)
                self._wake.clear()
                self._show()
            self._show()
            if self._live is not None:
                self._live.stop()
        except OSError:  # nobody looks any more; we fly on
            self._lines.clear()
            while not self._ended:
                self._wake.wait()
                self._wake.clear()
                self._tell_manager()

    def _show(self) -> None:
        while self._lines:
            self._console.print(self._lines.popleft(), soft_wrap=True, highlight=False)
        self._tell_manager()
        if self._live is not None:
            lines = [status.line() for status in self._vehicles]
            self._live.update(Text("\n", no_wrap=True).join(lines), refresh=True)

    def _tell_manager(self) -> None:
        if self._manager.present:
            self._manager.status("; ".join(status.summary() for status in self._vehicles))


class VehicleStatus:
    """Watches a session (give it as `observer`).

    Times are those that the service is told: wall time, or the vehicle's in lock-step.
    """

    def __init__(self, name: str, board: StatusBoard) -> None:
        self._name = f"{name}: " if name else ""
        self._board = board
        self._begun_us: int | None = None
        self._vehicle = "no vehicle yet"
        self._known: HeartbeatReceived | None = None
        self._state = "waiting"
        self._altitude_m = nan
        self._thrust = nan
        self._latency_s = nan
        self._late = 0
        self._telemetry = RateCounter()
        self._commands = RateCounter()

    def __call__(self, time_us: int, item: Event | Output | ProcessReport) -> None:
        """Take note of an event or output of the service, or a report of the process."""
        if self._begun_us is None:
            self._begun_us = time_us
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
            case StepTiming():
                self._late = item.late_steps + item.late_deadlines
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
        self._board.say(Text(stamp, "dim") + Text(self._name + text, style))

    def summary(self) -> str:
        """State, vehicle and punctuality."""
        return f"{self._name}{self._state}, {self._vehicle}, {self._late} late steps"

    def line(self) -> Text:
        """How it flies, in one line."""
        altitude = "   - " if isnan(self._altitude_m) else f"{self._altitude_m:5.2f}"
        thrust = "  - " if isnan(self._thrust) else f"{self._thrust:4.2f}"
        latency = "" if isnan(self._latency_s) else f"  latency {1e3 * self._latency_s:.0f} ms"
        late = f"  late {self._late}" if self._late else ""
        return Text(
            f"{self._name}{self._state}  {self._vehicle}  {altitude} m  thrust {thrust}  "
            f"in {self._telemetry.hz:.0f} Hz  out {self._commands.hz:.0f} Hz{latency}{late}",
            "bold",
            no_wrap=True,
        )
