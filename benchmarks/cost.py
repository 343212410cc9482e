"""What an engaged daemon costs: time on a core at 100 and 250 Hz of telemetry, and resident memory."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from common import AWAKE, save
from daemons import daemon

SETTLING_S = 10.0  # the Kalman filter's gain is at rest then
DURATION_S = 20.0


def cost(rate_hz: float, tables: str) -> dict[str, float]:
    """One flight, with its log and inner signals at 10 Hz; `tables` are added to the configuration."""
    with tempfile.TemporaryDirectory() as directory, daemon(Path(directory), tables=tables) as flying:
        flying.engage(min(rate_hz, 100.0))
        flying.probe.round_trips(rate_hz, SETTLING_S)
        began, used = time.perf_counter(), flying.processor_s()
        trips, missed = flying.probe.round_trips(rate_hz, DURATION_S)
        elapsed, used = time.perf_counter() - began, flying.processor_s() - used
        if flying.process.poll() is not None:
            raise SystemExit("error: control ended on the way; the machine is too busy to measure")
        return {
            "of a core [%]": round(100.0 * used / elapsed, 1),
            "processor time per setpoint [us]": round(1e6 * used / max(len(trips), 1)),
            "setpoints a second": round(len(trips) / elapsed, 1),
            "resident [MiB]": round(flying.resident_mib()),
            "unanswered": missed,
        }


def main() -> None:
    """Two rates, as it comes and in real time with a processor that is kept awake."""
    rows = {}
    for rate_hz in (100.0, 250.0):
        rows[f"engaged, {rate_hz:g} Hz"] = cost(rate_hz, "")
        rows[f"engaged, {rate_hz:g} Hz, --realtime and keep_awake"] = cost(rate_hz, AWAKE)
    save("cost", rows)


if __name__ == "__main__":
    main()
