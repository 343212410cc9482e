"""Unmodified firmware carries a load on a rope while the position ring holds its place in gusty wind."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.timeout(900)

LENGTH_M, BELOW_M = 1.0, 0.15
PICK_UP_S, DROP_S = 12.0, 47.0
ROPE = {"payload": {"rope_length_m": LENGTH_M, "rope_below_m": BELOW_M}}
SWINGS = "the load swings: damping it"


def swing_of(truth: Path) -> np.ndarray:
    """Angle of the rope while the load hangs on it, degrees, each 10 ms."""
    with truth.open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if float(row["load_mass_kg"]) > 0.0]
    return np.degrees([float(row["load_swing"]) for row in rows])


@pytest.mark.parametrize("told", [True, False])
@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_load_on_a_rope_is_damped_where_it_is_told_and_where_it_shows(
    firmware_binary: Callable[[str], Path],
    fly_in_lockstep: Callable[..., str],
    tmp_path: Path,
    autopilot: str,
    told: bool,
) -> None:
    """5 kg, one metre below a hook: it went up to 80 degrees, and the vehicle 5 m away."""
    segments = [
        {"type": "takeoff", "altitude_m": 5.0, "climb_rate_m_s": 1.0},
        {"type": "hold", "duration_s": DROP_S},
        {"type": "land", "descent_rate_m_s": 1.0},
    ]
    changes: dict[str, Any] = {"scenario": {"segment": segments}, "position": {"enabled": True}}
    if told:
        changes["payload"] = {"rope_length_m": LENGTH_M}
    output = "attitude" if autopilot == "ardupilot" else "rates"
    binary = firmware_binary(autopilot)
    last = fly_in_lockstep(
        autopilot, binary, tmp_path, output, changes, wind=True, load_s=(PICK_UP_S, DROP_S), vehicle=ROPE
    )
    said = (tmp_path / "daemon.log").read_text(encoding="utf-8")
    assert "failsafe" not in said, last
    swing = swing_of(tmp_path / "flight-truth.csv")
    assert swing.size > 3000
    assert (SWINGS in said) is not told
    assert swing[-500:].max() < 5.0
    assert swing.max() < (5.0 if told else 60.0)
