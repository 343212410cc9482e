"""What a service manager is told: sd_notify(3), datagrams to the socket that $NOTIFY_SOCKET names."""

from __future__ import annotations

import os
import socket
from collections.abc import Mapping

PINGS_PER_TIMEOUT = 3
"""Pings in the time after which the manager takes us for hung; sd_watchdog_enabled(3) asks for two."""

_SHORTEST_PERIOD_US = 1_000


class ServiceManager:
    """Tells systemd how we are; without one every call does nothing. Nothing here waits or raises.

    Parameters
    ----------
    environment
        Where NOTIFY_SOCKET, WATCHDOG_USEC and WATCHDOG_PID are looked for.

    """

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        environment = os.environ if environment is None else environment
        self._address = _address(environment.get("NOTIFY_SOCKET", ""))
        self._period_us = _ping_period_us(environment)
        self._socket: socket.socket | None = None
        self._pinged_us: int | None = None
        self._status = ""
        self._owed = ""
        if self._address is not None:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)

    @property
    def present(self) -> bool:
        """True if a manager listens."""
        return self._socket is not None

    def ready(self) -> None:
        """Say that what must work at the start does: link and log are open."""
        self._owed = "" if self._send("READY=1") else "READY=1"

    def stopping(self) -> None:
        """Say that the end has begun, and stop being watched for hanging."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """Say how we are, one line; the same line again is not repeated, unless it did not get through."""
        if text != self._status and self._send(f"STATUS={' '.join(text.split())}"):
            self._status = text

    def turned(self, now_us: int) -> None:
        """Say that the control loop has come round, as often as the manager wants to hear it."""
        if self._owed and self._send(self._owed):
            self._owed = ""
        if self._period_us is None:
            return
        due = self._pinged_us is None or now_us - self._pinged_us >= self._period_us
        if due and self._send("WATCHDOG=1"):
            self._pinged_us = now_us

    def close(self) -> None:
        """Give the socket back. May be called twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, text: str) -> bool:
        """False if it did not get through: a manager that restarts or does not read. Flying goes on."""
        if self._socket is None or self._address is None:
            return True
        try:
            self._socket.sendto(text.encode(), self._address)
        except OSError:
            return False
        return True


def _address(place: str) -> str | None:
    """The address of the socket: a path, or a name in Linux's abstract space (written with @)."""
    if place.startswith("/"):
        return place
    return f"\0{place[1:]}" if place.startswith("@") else None


def _ping_period_us(environment: Mapping[str, str]) -> int | None:
    """How often to ping; None if nobody asked for it, or asked another process."""
    timeout, process = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
    if not timeout.isascii() or not timeout.isdigit() or (process and process != str(os.getpid())):
        return None
    return max(int(timeout) // PINGS_PER_TIMEOUT, _SHORTEST_PERIOD_US) if int(timeout) > 0 else None
