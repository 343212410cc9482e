"""A daemon that dies or hangs while the vehicle rolls: it is level before its autopilot misses anybody."""

from __future__ import annotations

import csv
import signal
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from kffa_offboard.compare.toml_text import toml_text


@pytest.mark.timeout(100)
@pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")
@pytest.mark.parametrize(("number", "roll"), [(signal.SIGKILL, 0.25), (signal.SIGSTOP, 0.35)])
def test_a_daemon_that_dies_or_stops_in_a_swing_leaves_a_level_vehicle(
    tmp_path: Path,
    vehicle_process: Callable[[str, str, Path], AbstractContextManager[str]],
    end_in_the_swing: Callable[..., float],
    swing: list[dict[str, Any]],
    number: signal.Signals,
    roll: float,
) -> None:
    """Without the switch its last body rate goes on for a second: 0.5 rad."""
    truth, config = tmp_path / "truth.csv", tmp_path / "swing.toml"
    document = {
        "control": {"output": "rates", "altitude": {"hover_thrust": 0.398}},
        "telemetry": {"settle_time_s": 0.5},
        "signals": {"rate_hz": 0},
        "scenario": {"segment": swing},
    }
    with vehicle_process("px4", "udp", truth) as place:
        config.write_text(toml_text({"link": {"url": f"udpout:{place}"}, **document}), encoding="utf-8")
        since_s = end_in_the_swing(config, truth, number, "--trust-params")
    with truth.open() as file:
        rolls = [float(row["roll"]) for row in csv.DictReader(file) if float(row["time_s"]) > since_s]
    assert len(rolls) > 100
    assert max(map(abs, rolls)) < roll
