"""The command `kffa-offboard export`: a flight's inner signals as CSV."""

from __future__ import annotations

from pathlib import Path

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.parts import following_parts
from kffa_offboard.flightlog.plot import TIME_KEY, csv_lines
from kffa_offboard.flightlog.signals import ARRAY_ID, LIVE_ARRAY_ID, SignalRows, SignalTable, is_signals
from kffa_offboard.flightlog.tlog import SIGNAL_KINDS, read_tlog
from kffa_offboard.loganalysis.output_files import refuse_others


def run_export(log: Path, out: Path | None) -> int:
    """Write the table, beside the log unless `out` says where, and say what is in it. Returns 0.

    Raises UserError for a log that cannot be read or holds no signals, and a file that cannot be written.
    """
    out = log.with_name(f"{log.name.removesuffix('.gz').removesuffix('.tlog')}.csv") if out is None else out
    refuse_others(out, (log, *following_parts(log)), begins=f"{TIME_KEY},")
    found = _signals(log)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with out.open("w", encoding="ascii") as file:
            file.writelines(csv_lines(found))
    except OSError as error:
        raise UserError(f"--out {out}: {error.strerror}; choose another place") from error
    print(f"{out}: {found.time_us.size} control steps, {found.time_s[-1]:.1f} s")
    return 0


def _signals(log: Path) -> SignalTable:
    """Signals of the flight with its further parts: of every step, else those that were sent live."""
    found = {ARRAY_ID: SignalRows(), LIVE_ARRAY_ID: SignalRows()}
    for part in (log, *following_parts(log)):
        for _, message in read_tlog(part, kinds=SIGNAL_KINDS):
            for array_id, rows in found.items():
                if is_signals(message, array_id):
                    rows.add(message)
    chosen = found[ARRAY_ID] or found[LIVE_ARRAY_ID]
    if not chosen:
        raise UserError(
            f"flight log {log}: no inner signals; only logs of `kffa-offboard run`, and of ground stations "
            "while it ran with [signals] rate_hz above 0, have them"
        )
    return chosen.table()
