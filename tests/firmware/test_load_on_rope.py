"""Unmodified firmware with a load on a rope in gusty wind: holding a place, and a whole delivery."""

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


def events_of(truth: Path) -> list[str]:
    """What happened to the load."""
    with truth.open(encoding="utf-8", newline="") as file:
        texts = [text for row in csv.DictReader(file) for text in row["event"].split("; ")]
    return [text for text in texts if text.startswith("load ")]


@pytest.mark.parametrize("autopilot", ["ardupilot", "px4"])
def test_a_load_is_lifted_carried_set_down_and_landed_beside(
    firmware_binary: Callable[[str], Path],
    fly_in_lockstep: Callable[..., str],
    tmp_path: Path,
    autopilot: str,
) -> None:
    """5 kg on 3 m of rope, 10 m to the north: once set down and lifted again, once landed with."""
    segments = [
        {"type": "takeoff", "altitude_m": 2.0, "climb_rate_m_s": 1.0},
        {"type": "altitude", "altitude_m": 6.0, "speed_m_s": 0.5},
        {"type": "move", "north_m": 10.0, "duration_s": 12.0},
        {"type": "altitude", "altitude_m": 2.5, "speed_m_s": 0.5},
        {"type": "altitude", "altitude_m": 6.0},
        {"type": "hold", "duration_s": 3.0},
        {"type": "land", "descent_rate_m_s": 0.7},
    ]
    changes = {
        "scenario": {"segment": segments},
        "position": {"enabled": True},
        "payload": {"rope_length_m": 3.0},
    }
    rope = {"payload": {"rope_length_m": 3.0, "rope_below_m": BELOW_M}}
    output = "attitude" if autopilot == "ardupilot" else "rates"
    binary = firmware_binary(autopilot)
    last = fly_in_lockstep(
        autopilot, binary, tmp_path, output, changes, wind=True, load_s=(0.0, 500.0), vehicle=rope
    )
    said = (tmp_path / "daemon.log").read_text(encoding="utf-8")
    assert "failsafe" not in said and "scenario done, landed" in said, last
    assert events_of(tmp_path / "flight-truth.csv") == ["load lifted", "load set down"] * 2
    assert (said.count("picked up"), said.count("dropped")) == (2, 2)
    assert swing_of(tmp_path / "flight-truth.csv").max() < 12.0
    with (tmp_path / "flight-truth.csv").open(encoding="utf-8", newline="") as file:
        *_, end = csv.DictReader(file)
    assert float(end["x"]) == pytest.approx(10.0, abs=0.7) and float(end["y"]) == pytest.approx(0.0, abs=0.7)
