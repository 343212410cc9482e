"""How much faster than it was flown a flight is replayed: 100 Hz, PX4, pick-up and drop.

One is flown here, in real time against the simulated vehicle, and read as `run` left it on disk: a minute.
The other is a golden flight of 19 s in lock-step, compressed and without inner signals.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from common import free_port, save

from kffa_offboard.config_log import config_of
from kffa_offboard.replay.compare import compare
from kffa_offboard.replay.engine import replay
from kffa_offboard.replay.recording import read_recording

ROOT = Path(__file__).parents[1]
GOLDEN = ROOT / "tests" / "golden" / "flights" / "px4-drop.tlog.gz"
HOLD_S = 40.0
RUNS = 7
SCENARIO = f"""[scenario]
[[scenario.segment]]
type = "takeoff"
altitude_m = 5.0
[[scenario.segment]]
type = "hold"
duration_s = {HOLD_S}
[[scenario.segment]]
type = "land"
"""


def fly(directory: Path) -> Path:
    """The demonstration's flight with a longer hold, by both commands; its log."""
    port, log = free_port(), directory / "flight.tlog"
    daemon, vehicle = directory / "daemon.toml", directory / "vehicle.toml"
    text = (ROOT / "configs" / "demo-px4.toml").read_text().replace("127.0.0.1:14540", f"127.0.0.1:{port}")
    daemon.write_text(text[: text.index("[scenario]")] + SCENARIO)
    text = (ROOT / "configs" / "demo-px4-vehicle.toml").read_text()
    vehicle.write_text(text.replace("127.0.0.1:14540", f"127.0.0.1:{port}"))
    simulate = [sys.executable, "-m", "sim_vehicle", "run", "--config", str(vehicle)]
    run = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(daemon), "--log", str(log)]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(simulate, cwd=directory, **quiet) as flying:
        try:
            subprocess.run([*run, "--arm", "--engage"], cwd=directory, check=True, timeout=180.0, **quiet)
        finally:
            flying.kill()
    return log


def measure(log: Path) -> dict[str, float]:
    """Replay and compare several times; the processor's time tells the cost, whoever else is busy."""
    wall, processor = [], []
    for _ in range(RUNS):
        began, used = time.perf_counter(), time.process_time()
        recording = read_recording(log)
        comparison = compare(recording, replay(recording, config_of(recording.header, log)))
        wall.append(time.perf_counter() - began)
        processor.append(time.process_time() - used)
        if comparison.difference is not None:
            raise SystemExit(f"error: {log} replays differently: {comparison.difference}")
    flown = (recording.end_us - recording.begin_us) / 1e6
    return {
        "flight [s]": round(flown, 1),
        "times real time, median": round(flown / sorted(wall)[RUNS // 2], 1),
        "times real time, best": round(flown / min(wall), 1),
        "us per 10 ms of flight, best": round(min(wall) / flown * 1e4),
        "times real time, processor, median": round(flown / sorted(processor)[RUNS // 2], 1),
    }


def main() -> None:
    """Two flights."""
    with tempfile.TemporaryDirectory() as directory:
        save("replay", {"flown here": measure(fly(Path(directory))), "golden": measure(GOLDEN)})


if __name__ == "__main__":
    main()
