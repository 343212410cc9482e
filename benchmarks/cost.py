"""What an engaged daemon costs: time on a core at 100 and 250 Hz of telemetry, and resident memory."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from common import save
from daemons import daemon

SETTLING_S = 10.0  # the Kalman filter's gain is at rest then
DURATION_S = 20.0


def cost(rate_hz: float) -> dict[str, float]:
    """One flight, with its log and inner signals at 10 Hz."""
    with tempfile.TemporaryDirectory() as directory, daemon(Path(directory)) as flying:
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
    """Two rates."""
    save("cost", {f"engaged, {rate_hz:g} Hz": cost(rate_hz) for rate_hz in (100.0, 250.0)})


if __name__ == "__main__":
    main()
