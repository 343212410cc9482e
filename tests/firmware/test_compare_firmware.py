"""kffa-offboard compare with unmodified firmware: own height hold, KFFA-LADRC, and its own release."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.timeout(900)


@dataclass(frozen=True)
class Figures:
    """docs/comparison-px4.md, with room for the centimetre by which two flights differ.

    PX4 misses the last two at seed 0 (docs/comparison-px4.md): nobody holds a height better than it is
    known, and its estimate wanders by more. Then the test is expected to fail there.
    """

    peak_m: float
    peak_ratio: float
    iae_ratio: float
    release_peak_m: float


DOCUMENTED = {
    "px4": Figures(peak_m=0.065, peak_ratio=8.0, iae_ratio=15.0, release_peak_m=0.035),
    "ardupilot": Figures(peak_m=0.065, peak_ratio=3.5, iae_ratio=1.5, release_peak_m=0.035),
}
BESIDE_THE_ESTIMATE_M_S = 0.045
"""By so much at most the vehicle's IAE is more than that of the estimate's error; 0.035 was seen."""

BESIDE_THE_ESTIMATE_M = 0.015
"""The same of the peak after a release."""


def flown(autopilot: str, binary: Path, out: Path, names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """The rows of these names, as results.json has them."""
    command = [sys.executable, "-m", "kffa_offboard", "compare", "--autopilot", autopilot, "--full"]
    command += ["--firmware", str(binary), "--json", "--out", str(out)]
    only = [word for name in names for word in ("--only", name)]
    ended = subprocess.run([*command, *only], capture_output=True, text=True, timeout=880)
    assert ended.returncode == 0, ended.stderr
    results = json.loads(ended.stdout.splitlines()[-1])
    assert results["firmware_version"] is not None
    return {trial["name"]: trial for trial in results["trials"]}


@pytest.mark.parametrize("autopilot", DOCUMENTED)
def test_a_load_moves_it_less_under_kffa_ladrc_than_in_its_own_mode(
    autopilot: str, firmware_binary: Callable[[str], Path], tmp_path: Path
) -> None:
    names = ("native-stock", "kffa-ladrc", "release")
    rows = flown(autopilot, firmware_binary(autopilot), tmp_path / "out", names)
    stock, ours, release = (rows[name]["load"] for name in names)
    estimate, released = (rows[name]["estimate"] for name in names[1:])
    documented = DOCUMENTED[autopilot]
    for event in ("pickup", "drop"):
        assert ours[event]["peak_m"] < documented.peak_m
        assert stock[event]["peak_m"] > documented.peak_ratio * ours[event]["peak_m"]
        assert ours[event]["iae_m_s"] < estimate[event]["iae_m_s"] + BESIDE_THE_ESTIMATE_M_S
        seen = estimate[f"seen_{event}"]
        assert stock[event]["peak_m"] > documented.peak_ratio * seen["peak_m"]
        assert stock[event]["iae_m_s"] > documented.iae_ratio * seen["iae_m_s"]
    assert release["drop"]["peak_m"] < released["drop"]["peak_m"] + BESIDE_THE_ESTIMATE_M
    assert released["seen_drop"]["peak_m"] < documented.release_peak_m
    assert ours["level_rms_deg"] < 0.3
    wander = max(estimate[event]["iae_m_s"] / stock[event]["iae_m_s"] for event in ("pickup", "drop"))
    if autopilot == "px4" and wander * documented.iae_ratio > 1.0:
        pytest.xfail(f"PX4's own estimate is off by {wander:.3f} of what its Hold moves by")
    ratios = [stock[event]["iae_m_s"] / ours[event]["iae_m_s"] for event in ("pickup", "drop")]
    assert min(ratios) > documented.iae_ratio
    assert release["drop"]["peak_m"] < documented.release_peak_m


@pytest.mark.parametrize("ending", ["-range", "-baro"])
def test_with_another_height_px4s_true_height_keeps_within_every_bound(
    ending: str, firmware_binary: Callable[[str], Path], tmp_path: Path
) -> None:
    """Beside PX4's own mode with the same one: a range finder, or the barometer."""
    names = [name + ending for name in ("native-stock", "kffa-ladrc", "release")]
    rows = flown("px4", firmware_binary("px4"), tmp_path / "out", names)
    stock, ours, release = (rows[name]["load"] for name in names)
    documented = DOCUMENTED["px4"]
    for event in ("pickup", "drop"):
        assert ours[event]["peak_m"] < documented.peak_m
        assert stock[event]["peak_m"] > documented.peak_ratio * ours[event]["peak_m"]
        assert stock[event]["iae_m_s"] > documented.iae_ratio * ours[event]["iae_m_s"]
    assert release["drop"]["peak_m"] < documented.release_peak_m
    assert ours["level_rms_deg"] < 0.3
