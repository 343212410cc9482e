"""An excerpt of a log that ArduCopter 4.7-dev wrote itself: a hover of 10 kg that picks up 5 kg and drops it.

The firmware flew the body of the simulated vehicle over its JSON interface; everything at 10 Hz.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from kffa_offboard.loganalysis.read import read_log
from kffa_offboard.loganalysis.shadow import shadow

LOG = Path(__file__).parents[1] / "data" / "arducopter-pickup-drop.BIN"


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
