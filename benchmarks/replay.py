"""How much faster than it was flown a flight is replayed: 19 s, 100 Hz, PX4, pick-up and drop."""

from __future__ import annotations

import time
from pathlib import Path

from common import save

from kffa_offboard.config_log import config_of
from kffa_offboard.replay.engine import replay
from kffa_offboard.replay.recording import read_recording

GOLDEN = Path(__file__).parents[1] / "tests" / "golden" / "flights" / "px4-drop.tlog.gz"
RUNS = 7


def main() -> None:
    """Replay several times; the processor's time tells the program's cost, whoever else is busy."""
    wall, processor = [], []
    for _ in range(RUNS):
        began, used = time.perf_counter(), time.process_time()
        recording = read_recording(GOLDEN)
        replay(recording, config_of(recording.header, GOLDEN))
        wall.append(time.perf_counter() - began)
        processor.append(time.process_time() - used)
    flown = (recording.end_us - recording.begin_us) / 1e6
    rows = {}
    for name, times in (("wall time", wall), ("processor time", processor)):
        median = sorted(times)[RUNS // 2]
        rows[name] = {
            "times real time, median": round(flown / median, 1),
            "times real time, best": round(flown / min(times), 1),
            "us per 10 ms of flight, best": round(min(times) / flown * 1e4),
        }
    save("replay", rows)


if __name__ == "__main__":
    main()
