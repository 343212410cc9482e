"""Any flight log: which kind it is, its content says, not its name."""

from __future__ import annotations

from pathlib import Path

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.tlog import GZIP_MAGIC, TIMESTAMP
from kffa_offboard.loganalysis import dataflash
from kffa_offboard.loganalysis.record import FlightRecord

_MARKERS = (0xFD, 0xFE)
ULOG_MAGIC = b"ULog"


def is_flight_log(path: Path) -> bool:
    """True if a file begins as a flight log does, packed or not. Raises UserError if it cannot be read."""
    head = first_bytes(path)
    return head.startswith((ULOG_MAGIC, dataflash.HEADER, GZIP_MAGIC)) or _is_tlog(head)


def first_bytes(path: Path) -> bytes:
    """What tells the kind of a log. Raises UserError if it cannot be read, or not more than once."""
    try:
        if path.is_fifo():
            raise UserError(f"{path}: is a pipe, and a log is read more than once; give a file")
        with path.open("rb") as file:
            return file.read(16)
    except OSError as error:
        raise UserError(f"cannot read flight log {path}: {error.strerror}; check the path") from error


def _is_tlog(head: bytes) -> bool:
    return len(head) > TIMESTAMP.size and head[TIMESTAMP.size] in _MARKERS


def read_log(path: Path) -> FlightRecord:
    """Read a telemetry log (.tlog, .tlog.gz), a DataFlash log (.BIN) or a PX4 log (.ulg).

    A damaged file gives what could be read, with `FlightRecord.damage` saying what is wrong.
    Raises UserError, one line, for a file that is missing, empty, of another kind, or without a flight in it.
    """
    head = first_bytes(path)
    if not head:
        raise UserError(f"{path}: the file is empty; copy it again from the vehicle or the ground station")
    if head.startswith(ULOG_MAGIC):
        from kffa_offboard.loganalysis import read_ulog  # pyulog is slow to import

        return read_ulog.read(path)
    if head.startswith(dataflash.HEADER):
        from kffa_offboard.loganalysis import read_dataflash

        return read_dataflash.read(path)
    if _is_tlog(head) or head.startswith(GZIP_MAGIC):
        from kffa_offboard.loganalysis import read_tlog

        return read_tlog.read(path)
    raise UserError(
        f"{path}: no flight log that is known; give a telemetry log (.tlog), an ArduPilot .BIN or a PX4 .ulg"
    )
