"""kffa-offboard compare with an unmodified PX4: KFFA_PX4 names its build directory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

NAMED = os.environ.get("KFFA_PX4", "")
pytestmark = [
    pytest.mark.skipif(
        not NAMED, reason="KFFA_PX4 does not name a PX4 build directory (with bin/px4 and etc)"
    ),
    pytest.mark.timeout(900),
]


def test_a_load_moves_it_less_under_kffa_ladrc_than_in_its_own_mode(tmp_path: Path) -> None:
    only = [word for name in ("native-stock", "kffa-ladrc", "release") for word in ("--only", name)]
    command = [sys.executable, "-m", "kffa_offboard", "compare", "--autopilot", "px4", "--firmware", NAMED]
    ended = subprocess.run(
        [*command, *only, "--json", "--out", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=880,
    )
    assert ended.returncode == 0, ended.stderr
    results = json.loads(ended.stdout.splitlines()[-1])
    stock, ours, release = (trial["load"] for trial in results["trials"])
    assert results["firmware_version"] is not None
    for event in ("pickup", "drop"):
        assert stock[event]["peak_m"] > 5.0 * ours[event]["peak_m"]
        assert ours[event]["peak_m"] < 0.08
    assert release["drop"]["peak_m"] < ours["drop"]["peak_m"]
    assert ours["level_rms_deg"] < 0.3
