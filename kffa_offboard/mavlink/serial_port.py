"""Serial links: a telemetry port of the autopilot, or its USB port.

An autopilot's own USB port (CDC ACM: /dev/ttyACM0) ignores the baud rate; any standard one will do. USB
adapters (/dev/ttyUSB0) and UARTs (/dev/ttyAMA0) need the rate that the autopilot's port is set to.

A device that is unplugged is looked for again, under the same name: names in /dev/serial/by-id stay the same
whatever else is plugged in.
"""

from __future__ import annotations

import errno
import select
from pathlib import Path

import serial

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.address import SerialAddress
from kffa_offboard.mavlink.stream import READ_SIZE, StreamLink
from kffa_offboard.mavlink.transport import Clock

REOPEN_PERIOD_S = 0.2
"""How often a device that is gone is looked for."""


class SerialLink(StreamLink):
    """A serial device, ours alone while it is open. Unplugged, it is opened again when it returns."""

    def __init__(self, address: SerialAddress, clock: Clock) -> None:
        super().__init__(address.url, clock)
        self._address = address
        self._news: str | None = None
        self._tried_us: int | None = None
        if not Path(address.device).exists():
            raise UserError(
                f"link {self.name!r}: no such device {address.device!r}; is it plugged in? "
                "See what is there with: python -m serial.tools.list_ports"
            )
        try:
            self._port = _open(address)
        except (OSError, ValueError) as error:
            raise _explain(address, error) from error
        self._start_connection()

    def take_news(self) -> str | None:
        """See `transport.Link`."""
        news, self._news = self._news, None
        return news

    def _is_open(self) -> bool:
        return bool(self._port.is_open)

    def _connect(self, timeout_s: float) -> None:
        now_us = self._clock()
        due_us = now_us if self._tried_us is None else self._tried_us + round(REOPEN_PERIOD_S * 1e6)
        if now_us >= due_us:
            self._tried_us = now_us
            if self._reopen():
                return
            due_us = now_us + round(REOPEN_PERIOD_S * 1e6)
        select.select([], [], [], max(0.0, min(timeout_s, (due_us - now_us) * 1e-6)))

    def _reopen(self) -> bool:
        if not Path(self._address.device).exists():
            return False
        try:
            self._port = _open(self._address)
        except (OSError, ValueError) as error:  # udev may not have finished with it
            self.trouble = str(_explain(self._address, error)).partition(": ")[2]
            return False
        self.trouble = ""
        self._news = "serial device is back"
        self._start_connection()
        return True

    def _file_descriptor(self) -> int:
        return int(self._port.fileno())

    def _read(self) -> bytes:
        return bytes(self._port.read(READ_SIZE))

    def _write(self, data: bytes) -> int:
        return int(self._port.write(data) or 0)

    def _lost(self, reason: str) -> None:
        self._port.close()
        self.trouble = f"{self._address.device} stopped answering ({reason}); was it unplugged?"
        self._news = "serial device lost; unplugged?"
        self._tried_us = self._clock()

    def close(self) -> None:
        """See `transport.Link`."""
        self._port.close()


def _open(address: SerialAddress) -> serial.Serial:
    return serial.Serial(
        port=address.device, baudrate=address.baud, timeout=0, write_timeout=0, exclusive=True
    )


def _explain(address: SerialAddress, error: OSError | ValueError) -> UserError:
    """Say in one line why a device could not be opened, and what to do."""
    text, number = str(error).lower(), getattr(error, "errno", None)
    if "lock" in text:
        reason, remedy = "another program has it open", "stop that program"
    elif number == errno.EBUSY:
        reason, remedy = "it is busy", "stop what uses it (ModemManager probes new devices for half a minute)"
    elif number in (errno.EACCES, errno.EPERM) or "permission denied" in text:
        group = _group_of(address.device)
        reason = f"not allowed to open it, which belongs to group {group}"
        remedy = f"join it (sudo usermod -aG {group} $USER) and log in again"
    elif number == errno.ENOTTY or "ioctl" in text or "configure" in text:
        reason, remedy = "it is not a serial device", "name a serial device, such as /dev/ttyACM0"
    elif isinstance(error, ValueError):
        reason, remedy = f"it cannot run at {address.baud} baud", "choose a standard rate, such as 57600"
    else:
        reason, remedy = " ".join(text.split()), "check the device"
    return UserError(f"link {address.url!r}: cannot open {address.device!r}: {reason}; {remedy}")


def _group_of(device: str) -> str:
    """Name of the group that owns a device; the usual one if it cannot be told."""
    try:
        return Path(device).group()
    except (OSError, KeyError):
        return "dialout"
