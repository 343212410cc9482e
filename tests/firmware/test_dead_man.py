"""The daemon dies or hangs in a swing, in real time: unmodified firmware is level all the same."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kffa_offboard.compare import firmware
from kffa_offboard.compare.plan import Trial, head_start_s
from kffa_offboard.compare.simulation import physics_document, start_physics
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config import bundled
from kffa_offboard.trials.metrics import read_truth
from kffa_offboard.trials.processes import flown_s, free_port, process

pytestmark = [
    pytest.mark.timeout(300),
    pytest.mark.skipif(sys.platform != "linux", reason="needs Linux"),
]
TRIAL = Trial("flight", "", "kffa-ladrc", "rates", course="attitude")


@contextlib.contextmanager
def flying_firmware(autopilot: Any, binary: Path, directory: Path) -> Iterator[tuple[str, int, Path]]:
    """Physics and firmware in real time, ready to fly; the daemon's link, the system id and the truth."""
    name = firmware.PX4 if autopilot == "px4" else firmware.ARDUCOPTER
    instance, port, truth = firmware.free_instance(), free_port(), directory / "truth.csv"
    (directory / "firmware").mkdir()
    made = name.start(binary, directory / "firmware", port, instance, TRIAL)
    backend = {"real_time_factor": 1.0, name.section: {"port": made.physics_port}}
    physics = tomllib.loads(bundled(name.physics).read_text(encoding="utf-8"))
    with contextlib.ExitStack() as stack:
        document = physics_document(merged(physics, {"backend": backend}), TRIAL)
        start_physics(directory / "flight", truth, document, stack)
        output = stack.enter_context((directory / "firmware.log").open("w", encoding="utf-8"))
        stack.enter_context(
            process(
                made.command,
                patience_s=2.0,
                cwd=directory / "firmware",
                env={**os.environ, **made.environment},
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        )
        limit = time.monotonic() + 200.0
        while flown_s(truth) < head_start_s(autopilot, TRIAL.conditions):
            assert time.monotonic() < limit, "the firmware does not boot"
            time.sleep(0.2)
        yield f"udpin:127.0.0.1:{port}", name.system_id(instance), truth


@pytest.mark.parametrize("switch", [True, False], ids=["with", "without"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "halted"])
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_daemon_that_dies_or_stops_in_a_swing_leaves_a_firmware_level(
    firmware_binary: Callable[[str], Path],
    tmp_path: Path,
    end_in_the_swing: Callable[..., float],
    swing: list[dict[str, Any]],
    autopilot: str,
    number: signal.Signals,
    switch: bool,
) -> None:
    config = tmp_path / "swing.toml"
    gains = tomllib.loads(bundled(f"compare-{autopilot}.toml").read_text(encoding="utf-8"))
    with flying_firmware(autopilot, firmware_binary(autopilot), tmp_path) as (url, system, truth):
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
