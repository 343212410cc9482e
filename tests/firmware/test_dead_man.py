"""The daemon dies or hangs in a swing, in real time: unmodified firmware is level all the same."""

from __future__ import annotations

import signal
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kffa_offboard.compare.plan import Trial
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config import bundled
from kffa_offboard.trials.metrics import read_truth

pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.skipif(sys.platform != "linux", reason="needs Linux"),
]
TRIAL = Trial("flight", "", "kffa-ladrc", "rates", course="attitude")


@pytest.mark.parametrize("switch", [True, False], ids=["with", "without"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "halted"])
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_daemon_that_dies_or_stops_in_a_swing_leaves_a_firmware_level(
    firmware_binary: Callable[[str], Path],
    flying_firmware: Any,
    tmp_path: Path,
    end_in_the_swing: Callable[..., float],
    swing: list[dict[str, Any]],
    autopilot: str,
    number: signal.Signals,
    switch: bool,
) -> None:
    config = tmp_path / "swing.toml"
    gains = tomllib.loads(bundled(f"compare-{autopilot}.toml").read_text(encoding="utf-8"))
    with flying_firmware(autopilot, firmware_binary(autopilot), tmp_path, TRIAL) as (url, system, truth):
        changes: dict[str, Any] = {
            "link": {"url": url, "target_system": system},
            "control": {"output": "rates"},
            "signals": {"rate_hz": 0},
            "process": {"dead_man_switch": switch},
            "scenario": {"segment": swing},
        }
        config.write_text(toml_text(merged(gains, changes)), encoding="utf-8")
        since_s = end_in_the_swing(config, truth, number, "--trust-params")
    flown = read_truth(truth)
    roll = float(np.abs(flown.roll[flown.time_s > since_s]).max())
    if switch:
        assert roll < (0.3 if number is signal.SIGKILL else 0.45)
    else:
        assert roll > 0.3, "there was nothing to prevent"
    print(
        f"\n{autopilot} {number.name} {'with' if switch else 'without'} the switch: roll up to {roll:.3f} rad"
    )
