"""One process that flies ten vehicles: from each one's ATTITUDE, 50 times a second, to its setpoint."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from common import Probe, free_port, percentiles, save
from daemons import Daemon, patient_config

VEHICLES = 10
RATE_HZ = 50.0
DURATION_S = 30.0


def round_trips(probes: list[Probe], duration_s: float) -> tuple[list[list[float]], int]:
    """Times of each vehicle, s, and how many ATTITUDE had no answer before the next; evenly spread."""
    slot_s = 1.0 / RATE_HZ / len(probes)
    trips: list[list[float]] = [[] for _ in probes]
    asked: dict[int, int] = {}
    missed, began = 0, time.perf_counter()
    for number in range(round(duration_s / slot_s)):
        k = number % len(probes)
        if number // len(probes) % 10 == 0:
            probes[k].heartbeat()
        probes[(k + len(probes) // 2) % len(probes)].position()
        missed += k in asked
        asked[k] = probes[k].attitude()
        end = began + (number + 1) * slot_s
        while (left := end - time.perf_counter()) > 0.0:
            for probe in select.select(probes, [], [], left)[0]:
                which = probes.index(probe)
                if "SET_ATTITUDE_TARGET" in probe.hear(0.0) and which in asked:
                    trips[which].append((probe.arrived_ns - asked.pop(which)) * 1e-9)
    return trips, missed


def fly(directory: Path, *options: str) -> dict[str, Any]:
    """All vehicles, engaged, each with its log."""
    command, probes = [sys.executable, "-m", "kffa_offboard", "run", "--engage", *options], []
    for k in range(VEHICLES):
        own = directory / f"vehicle-{k}"
        own.mkdir()
        port = free_port()
        config = patient_config(own, port, "").rename(own / f"v{k}.toml")
        config.write_text(config.read_text() + f'[log]\ndirectory = "{own}"\n')
        command += ["--config", str(config)]
        probes.append(Probe(port))
    running = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, text=True)
    process = Daemon(running, probes[0])
    try:
        for _ in range(60):
            if all(len(trips) > 0.8 * RATE_HZ for trips in round_trips(probes, 1.0)[0]):
                break
        began, used = time.perf_counter(), process.processor_s()
        trips, missed = round_trips(probes, DURATION_S)
        used, elapsed = process.processor_s() - used, time.perf_counter() - began
        worst = max(percentiles(each)["p99_us"] for each in trips)
        return {
            **percentiles([trip for each in trips for trip in each]),
            "p99_us of the worst vehicle": worst,
            "unanswered": missed,
            "of a core [%]": round(100.0 * used / elapsed, 1),
            "resident [MiB]": round(process.resident_mib()),
        }
    finally:
        running.kill()
        running.communicate()
        for probe in probes:
            probe.close()


def main() -> None:
    """Ordinary scheduling, or as the options say: `fleet.py --realtime`."""
    with tempfile.TemporaryDirectory() as directory:
        row = fly(Path(directory), *sys.argv[1:])
    policy = "SCHED_FIFO" if os.sched_getscheduler(0) == os.SCHED_FIFO else "ordinary scheduling"
    save("fleet", {f"{VEHICLES} vehicles, {RATE_HZ:g} Hz, {policy}": row})


if __name__ == "__main__":
    main()
