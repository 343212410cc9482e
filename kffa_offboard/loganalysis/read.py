"""Any flight log: which kind it is, its content says, not its name."""

from __future__ import annotations

from pathlib import Path

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.tlog import TIMESTAMP
from kffa_offboard.loganalysis import dataflash
from kffa_offboard.loganalysis.record import FlightRecord

_MARKERS = (0xFD, 0xFE)
ULOG_MAGIC = b"ULog"


def read_log(path: Path) -> FlightRecord:
    """Read a telemetry log (.tlog), a DataFlash log (.BIN) or a PX4 log (.ulg).

    A damaged file gives what could be read, with `FlightRecord.damage` saying what is wrong.
    Raises UserError, one line, for a file that is missing, empty, of another kind, or without a flight in it.
    """
    try:
        with path.open("rb") as file:
            head = file.read(16)
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}; check the path") from error
    if not head:
        raise UserError(f"{path}: the file is empty; copy it again from the vehicle or the ground station")
    if head.startswith(ULOG_MAGIC):
        from kffa_offboard.loganalysis import read_ulog  # pyulog is slow to import

        return read_ulog.read(path)
    if head.startswith(dataflash.HEADER):
        from kffa_offboard.loganalysis import read_dataflash

        return read_dataflash.read(path)
    if len(head) > TIMESTAMP.size and head[TIMESTAMP.size] in _MARKERS:
        from kffa_offboard.loganalysis import read_tlog

        return read_tlog.read(path)
    raise UserError(
        f"{path}: no flight log that is known; give a telemetry log (.tlog), an ArduPilot .BIN or a PX4 .ulg"
    )
