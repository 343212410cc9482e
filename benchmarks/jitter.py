"""Setpoints on a busy machine: 250 Hz for a minute with all cores loaded, with and without --realtime.

Times are from handing ATTITUDE to the kernel until the setpoint has arrived at the probe's socket; where
that is permitted the probe runs with real-time scheduling, too, before the daemon. A process that answers
with bytes made before, scheduled as the daemon with --realtime, tells what the machine itself allows.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from common import Probe, free_port, save
from daemons import daemon

RATE_HZ = 250.0
DURATION_S = 60.0
LATE_S = 0.002


@contextmanager
def busy_cores() -> Iterator[None]:
    """A process on each core that does nothing else but compute."""
    busy = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(os.cpu_count() or 1)]
    try:
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()


def probe_in_real_time() -> bool:
    """Let this process go before all others, its children not; False if that is not permitted."""
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(80))
    except PermissionError:
        return False
    return True


def jitter(duration_s: float, *options: str) -> dict[str, Any]:
    """One flight."""
    with tempfile.TemporaryDirectory() as directory, daemon(Path(directory), *options) as flying:
        flying.engage(RATE_HZ / 2.5)
        with busy_cores():
            row = summed_up(*flying.probe.round_trips(RATE_HZ, duration_s))
        row["kept control"] = bool(flying.summary()["stopped"])
    return row


def machine_alone(duration_s: float) -> dict[str, Any]:
    """A process that only answers, before all others and on one core where that is permitted."""
    port = free_port()
    command = [sys.executable, str(Path(__file__).parent / "bare_socket.py"), str(port)]
    answering, probe = subprocess.Popen(command), Probe(port)
    try:
        while len(probe.round_trips(RATE_HZ / 2.5, 1.0)[0]) < RATE_HZ / 5.0:
            answering.poll()
            if answering.returncode is not None:
                raise SystemExit("error: bare_socket.py ended; run it by hand to see why")
        with contextlib.suppress(PermissionError):
            os.sched_setscheduler(answering.pid, os.SCHED_FIFO, os.sched_param(50))
        os.sched_setaffinity(answering.pid, {max(os.sched_getaffinity(0))})
        with busy_cores():
            return summed_up(*probe.round_trips(RATE_HZ, duration_s))
    finally:
        answering.kill()
        answering.wait()
        probe.close()


def summed_up(trips: list[float], missed: int) -> dict[str, Any]:
    """Percentiles; setpoints that did not come within five periods count as that late."""
    ordered = sorted([*trips, *[5.0 / RATE_HZ] * missed])
    row: dict[str, Any] = {
        name: round(1e6 * ordered[min(len(ordered) - 1, int(share * len(ordered)))])
        for name, share in (("p50_us", 0.5), ("p99_us", 0.99), ("p99.9_us", 0.999), ("longest_us", 1.0))
    }
    row["over 2 ms"] = sum(trip > LATE_S for trip in ordered)
    row["unanswered"] = missed
    row["samples"] = len(ordered)
    return row


def main() -> None:
    """Both ways, one after the other, under the same load."""
    duration_s = float(sys.argv[1]) if len(sys.argv) > 1 else DURATION_S
    first = probe_in_real_time()
    rows = {"ordinary": jitter(duration_s), "--realtime": jitter(duration_s, "--realtime")}
    rows["bytes made before, as --realtime"] = machine_alone(duration_s)
    for row in rows.values():
        row["probe in real time"] = first
    save("jitter, 250 Hz, all cores busy", rows)


if __name__ == "__main__":
    main()
