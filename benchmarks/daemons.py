"""A daemon in a process of its own for the benchmarks: engaged, and what it costs the machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from common import Probe, daemon_config, free_port

PATIENT = "timeout_s = 3\nposition_timeout_s = 3\nheartbeat_timeout_s = 20\nlate_max_s = 20\n"
"""What a loaded machine does to telemetry is to be measured, not to end the flight."""

TICKS_PER_S = os.sysconf("SC_CLK_TCK")


class Daemon:
    """A running `kffa-offboard run`, and the vehicle that it flies."""

    def __init__(self, running: subprocess.Popen[str], probe: Probe) -> None:
        self.process = running
        self.probe = probe

    def engage(self, rate_hz: float) -> None:
        """Telemetry until setpoints come."""
        for _ in range(60):
            if len(self.probe.round_trips(rate_hz, 1.0)[0]) > 0.3 * rate_hz:
                return
            if self.process.poll() is not None:
                break
        raise SystemExit("error: the daemon did not engage; run it by hand to see why")

    def processor_s(self) -> float:
        """Time on a core so far, s."""
        fields = Path(f"/proc/{self.process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / TICKS_PER_S

    def resident_mib(self) -> float:
        """Resident memory, MiB."""
        status = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(status.partition("VmRSS:")[2].split()[0]) / 1024

    def summary(self) -> dict[str, Any]:
        """End it; what it says about itself."""
        self.process.terminate()
        said, _ = self.process.communicate(timeout=30.0)
        summary: dict[str, Any] = json.loads(said.splitlines()[-1])
        return summary


def patient_config(directory: Path, port: int, tables: str) -> Path:
    """`common.daemon_config` for a machine that is busy; `tables` are added to it."""
    config = daemon_config(directory, port)
    text = config.read_text().replace("[telemetry]\n", f"[telemetry]\n{PATIENT}")
    config.write_text(f"{text}\n{tables}")
    return config


@contextmanager
def daemon(directory: Path, *options: str, tables: str = "") -> Iterator[Daemon]:
    """A daemon with a log that is to engage, `tables` in its configuration; it has ended afterwards."""
    port = free_port()
    config = patient_config(directory, port, tables)
    command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config), "--engage", "--json"]
    command += ["--log", str(directory / "flight.tlog"), *options]
    probe = Probe(port)
    running = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        yield Daemon(running, probe)
    finally:
        running.kill()
        running.communicate()
        probe.close()
