"""From an excitation flight to gains: the vehicle's log gives its model, the model its bandwidths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from kffa_offboard.config import Overrides, bundled, load, read_toml
from kffa_offboard.config_control import ControlTable
from kffa_offboard.loganalysis.identify import Identification, identify
from kffa_offboard.loganalysis.margins import Wanted
from kffa_offboard.loganalysis.model_file import as_toml, merged, model_tables
from kffa_offboard.loganalysis.read import read_log
from kffa_offboard.loganalysis.shadow import shadow
from kffa_offboard.loganalysis.tune import tune
from kffa_offboard.loganalysis.tune_command import tuned_tables
from kffa_offboard.offboard.segments import Hold, Step, Takeoff
from kffa_offboard.trials.metrics import measure
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

B0 = 246.0 / 10.0
LINK_DELAY_S = 0.04  # 20 ms each way, as demo-px4-vehicle.toml has it


@pytest.fixture
def excitation_log(lock_step_flight: Any, tmp_path: Path) -> Iterator[Path]:
    """Altitude doublets as in identify-px4.toml."""
    flight = lock_step_flight("px4", daemon_file=bundled("identify-px4.toml"))
    waves = [
        Step("altitude", sign * 0.6, duration_s)
        for duration_s in (0.7, 0.4, 0.7, 0.4)
        for sign in (1.0, -1.0, -1.0, 1.0)
    ]
    scenario = (Takeoff(4.0, 2.0), Hold(1.0), *waves, Hold(1.0))
    flight.daemon = replace(flight.daemon, service=replace(flight.daemon.service, scenario=scenario))
    vehicle = {"payload": {"schedule": []}}
    flight.vehicle = SimulatedVehicle(sim_config.load(bundled("demo-px4-vehicle.toml"), vehicle))
    log = tmp_path / "excitation.tlog"
    flight.log = log
    flight.fly(lambda vehicle: vehicle.time_us > 22_000_000)
    yield log


def test_the_vehicles_gain_lag_and_delay_are_found_and_tuned_gains_keep_their_word(
    excitation_log: Path, lock_step_flight: Any, tmp_path: Path
) -> None:
    found = identify([read_log(excitation_log)])
    channels = {channel.name: channel for channel in found.channels}
    altitude = channels["altitude"]
    assert altitude.b0.value == pytest.approx(B0, rel=0.05)
    assert altitude.delay.value == pytest.approx(LINK_DELAY_S, abs=0.01)
    assert altitude.parameters["lag_s"].value == pytest.approx(0.05, abs=0.01)

    tuned_file = tmp_path / "tuned.toml"
    predicted = write_tuned(found, tuned_file)
    flight = lock_step_flight("px4", daemon_file=tuned_file)
    log = tmp_path / "tuned.tlog"

    def enough(vehicle: Any) -> bool:
        drop_s = vehicle.truth.time_of("drop")
        return drop_s is not None and vehicle.time_us * 1e-6 > drop_s + 5.1

    flight.log = log
    flight.fly(enough)
    metrics = measure(flight.truth, 5.0)
    assert metrics.hover_rms_m <= 0.02
    assert metrics.attitude_rms_rad <= 0.02
    for deviation in (metrics.pickup, metrics.drop):
        assert deviation.iae_m_s <= 0.10
        assert deviation.peak_m <= 0.08, "the demonstration's own target, with 5 dB of gain margin"
    assert metrics.drop.peak_m == pytest.approx(predicted, rel=0.15)  # what the linear loop says

    changes = shadow(read_log(log), None).mass
    assert changes is not None
    pickup, drop = changes.changes
    assert 10.0 * pickup.share == pytest.approx(5.0, abs=0.3)
    assert 10.0 * drop.share == pytest.approx(-5.0, abs=0.3)
    assert pickup.time_s == pytest.approx(metrics.pickup_s, abs=0.1)


def write_tuned(found: Identification, path: Path) -> float:
    """The demonstration's configuration with the identified altitude model and tuned bandwidths.

    Returns the peak after the drop of 5 kg in the linear loop.
    """
    document = read_toml(bundled("demo-px4.toml"))
    model = {"altitude": model_tables(found, 0.0)["control"]["altitude"]}
    control = ControlTable.model_validate(merged(document["control"], model))
    (tuned,) = tune(control, (3,), 0.01, Wanted(), peak_m=0.08).channels
    assert tuned.altitude is not None
    tables = tuned_tables(model, control, [tuned])
    scenario = bundled("demo-px4.toml").read_text(encoding="utf-8").partition("[scenario]")[2]
    document.pop("scenario")
    path.write_text(as_toml(merged(document, tables)) + "\n[scenario]" + scenario, encoding="utf-8")
    load(path, Overrides())
    return tuned.altitude.drop_peak_m
