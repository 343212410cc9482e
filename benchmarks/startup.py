"""From starting `kffa-offboard run` to its first message to the vehicle; processor time and memory."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import Probe, daemon_config, free_port, save

RUNS = 3
WATCHED_S = 3.0


def start(directory: Path) -> tuple[float, float, float]:
    """Seconds to the first datagram, of them on a core, and resident MiB with the observers running."""
    port = free_port()
    probe = Probe(port)
    command = ["-m", "kffa_offboard", "run", "--config", str(daemon_config(directory, port))]
    began = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, *command], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as running:
        first = 0.0
        while time.perf_counter() - began < 30.0 and not first:
            probe.heartbeat()
            if probe.hear(0.01):
                first = time.perf_counter() - began
        fields = Path(f"/proc/{running.pid}/stat").read_text().rpartition(")")[2].split()
        used = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
        probe.round_trips(100.0, WATCHED_S)
        status = Path(f"/proc/{running.pid}/status").read_text()
        running.kill()
    probe.close()
    (resident,) = [line.split()[1] for line in status.splitlines() if line.startswith("VmRSS")]
    return first, used, int(resident) / 1024


def main() -> None:
    """Start several times."""
    with tempfile.TemporaryDirectory() as directory:
        runs = sorted(start(Path(directory)) for _ in range(RUNS))
    names = ("start to first message [s]", "of it on a core [s]", "resident memory [MiB]")
    rows = {}
    for name, values in zip(names, zip(*runs, strict=True), strict=True):
        ordered = sorted(values)
        rows[name] = {"median": round(ordered[RUNS // 2], 2), "best": round(ordered[0], 2)}
    save("startup", rows)


if __name__ == "__main__":
    main()
