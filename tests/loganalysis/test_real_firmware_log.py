"""Excerpts of logs that real firmware wrote itself: a hover of 10 kg that picks up 5 kg and drops it.

ArduCopter 4.7-dev and PX4 1.16-dev flew the body of the simulated vehicle; ArduCopter's excerpt has 10 Hz,
PX4's 25 Hz (50 Hz of thrust).
"""

from __future__ import annotations

from pathlib import Path

import pytest

from kffa_offboard.loganalysis.identify_command import run_identify
from kffa_offboard.loganalysis.read import read_log
from kffa_offboard.loganalysis.shadow import shadow

LOG = Path(__file__).parents[1] / "data" / "arducopter-pickup-drop.BIN"
PX4_LOG = LOG.with_name("px4-pickup-drop.ulg")


def test_the_firmwares_own_log_tells_of_the_load() -> None:
    found = shadow(read_log(LOG), None)
    assert found.mass is not None
    pickup, drop = found.mass.changes
    assert drop.time_s - pickup.time_s == pytest.approx(10.0, abs=0.3)
    # Throttle is not quite thrust there (MOT_THST_EXPO): 5 kg on 10 kg read as 5.4 kg.
    assert pickup.share == pytest.approx(0.5, rel=0.15)
    assert drop.share == pytest.approx(-0.5, rel=0.15)


def test_the_firmwares_axes_are_turned() -> None:
    record = read_log(LOG)
    hover = record.position.values[:, 2]
    assert hover.min() > 4.5
    assert hover.max() < 5.5
    climb = record.velocity.values[:, 2]
    after_pickup = (record.velocity.time_s > 74.4) & (record.velocity.time_s < 74.7)
    assert climb[after_pickup].min() < -0.05


def test_px4s_own_log_tells_of_the_load() -> None:
    record = read_log(PX4_LOG)
    assert (record.source, record.autopilot, record.damage) == ("ulog", "px4", ())
    found = shadow(record, None)
    assert found.model.hover_thrust == pytest.approx(98.0 / 246.0, rel=0.01)
    assert found.mass is not None
    pickup, drop = found.mass.changes
    assert drop.time_s - pickup.time_s == pytest.approx(10.0, abs=0.1)
    assert pickup.share == pytest.approx(0.5, abs=0.02)
    assert drop.share == pytest.approx(-0.5, abs=0.02)


def test_px4s_axes_are_turned() -> None:
    record = read_log(PX4_LOG)
    hover = record.position.values[:, 2]
    assert hover.min() > 4.7
    assert hover.max() < 5.2
    climb = record.velocity.values[:, 2]
    after_drop = (record.velocity.time_s > 70.05) & (record.velocity.time_s < 70.3)
    assert climb[after_drop].max() > 0.05
    assert abs(record.attitude.values[:, :2]).max() < 0.05


def test_identify_warns_of_a_load_that_comes_and_goes(capsys: pytest.CaptureFixture[str]) -> None:
    """A flight with 5 kg for a while gave b0 of the altitude with an interval that the truth was not in."""
    run_identify([PX4_LOG], None, 0.0, as_json=False)
    said = " ".join(capsys.readouterr().out.split())
    assert f"warning: {PX4_LOG.name}: a load came or went at 60.1 s, 70.1 s; the figures mix two" in said
