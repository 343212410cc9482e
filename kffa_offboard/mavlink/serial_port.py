"""Serial links: a telemetry port of the autopilot, or its USB port.

An autopilot's own USB port (CDC ACM: /dev/ttyACM0) ignores the baud rate; any standard one will do. USB
adapters (/dev/ttyUSB0) and UARTs (/dev/ttyAMA0) need the rate that the autopilot's port is set to.
"""

from __future__ import annotations

import errno
from pathlib import Path

import serial

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.address import SerialAddress
from kffa_offboard.mavlink.stream import READ_SIZE, StreamLink
from kffa_offboard.mavlink.transport import Clock, LinkLost


class SerialLink(StreamLink):
    """A serial device, ours alone while it is open."""

    def __init__(self, address: SerialAddress, clock: Clock) -> None:
        super().__init__(address.url, clock)
        if not Path(address.device).exists():
            raise UserError(
                f"link {self.name!r}: no such device {address.device!r}; is it plugged in? "
                "See what is there with: python -m serial.tools.list_ports"
            )
        try:
            self._port = serial.Serial(
                port=address.device, baudrate=address.baud, timeout=0, write_timeout=0, exclusive=True
            )
        except (OSError, ValueError) as error:
            raise _explain(address, error) from error
        self._start_connection()

    def _is_open(self) -> bool:
        return bool(self._port.is_open)

    def _connect(self, timeout_s: float) -> None:
        raise LinkLost(f"link {self.name!r}: {self._port.port} is closed; plug it in and start again")

    def _file_descriptor(self) -> int:
        return int(self._port.fileno())

    def _read(self) -> bytes:
        return bytes(self._port.read(READ_SIZE))

    def _write(self, data: bytes) -> int:
        return int(self._port.write(data) or 0)

    def _lost(self, reason: str) -> None:
        device = self._port.port
        self._port.close()
        raise LinkLost(f"link {self.name!r}: {device} stopped answering ({reason}); was it unplugged?")

    def close(self) -> None:
        """See `transport.Link`."""
        self._port.close()


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
