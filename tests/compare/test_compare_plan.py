"""What is flown, and how it is configured."""

from __future__ import annotations

import math
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from kffa_offboard.compare.course import course, flown_steps
from kffa_offboard.compare.firmware import PX4, parameter_files, physics_backend
from kffa_offboard.compare.flight import daemon_document
from kffa_offboard.compare.plan import (
    AutopilotName,
    ComparePlan,
    Conditions,
    HeightSource,
    Trial,
    head_start_s,
    trials,
)
from kffa_offboard.compare.simulation import Setup, Simulation, physics_document
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config import bundled, load, read_toml
from kffa_offboard.config_control import ControlTable
from sim_vehicle.config import build


def plan(autopilot: str = "px4", full: bool = True) -> ComparePlan:
    return ComparePlan(Path("out"), "px4" if autopilot == "px4" else "ardupilot", Path("firmware"), full=full)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_every_trials_configuration_can_be_flown(autopilot: str, tmp_path: Path) -> None:
    wanted = plan(autopilot)
    setup = Setup(wanted.autopilot, Path("firmware"), tmp_path)
    running = Simulation("udpout:127.0.0.1:9", 21, tmp_path / "truth.csv", 0.0, ())
    for trial in trials(wanted):
        if trial.native:
            continue
        file = tmp_path / "daemon.toml"
        file.write_text(toml_text(daemon_document(setup, trial, running)), encoding="utf-8")
        assert load(file).service.scenario


def test_names_of_trials_are_theirs_alone() -> None:
    names = [trial.name for trial in trials(plan())]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_imitation_flies_no_row_whose_gains_or_sensors_it_has_not(autopilot: str) -> None:
    """It flew "tuned gains, range finder" with its stock gains and its usual height."""
    real, imitated = trials(plan(autopilot)), trials(replace(plan(autopilot), firmware=None))
    named = ("tuned", "range finder", "barometer")
    assert imitated == [trial for trial in real if not any(word in trial.label for word in named)]
    assert len(imitated) < len(real)


def test_a_slower_link_is_told_to_every_observer(tmp_path: Path) -> None:
    setup = Setup("px4", Path("firmware"), tmp_path)
    running = Simulation("udpout:127.0.0.1:9", 21, tmp_path / "truth.csv", 0.0, ())
    chosen = {trial.name: trial for trial in trials(plan())}
    usual = daemon_document(setup, chosen["kffa-ladrc"], running)["control"]
    slow = daemon_document(setup, chosen["kffa-ladrc-delay"], running)["control"]
    assert slow["altitude"]["delay_s"] == pytest.approx(usual["altitude"]["delay_s"] + 0.05)
    assert slow["rates"]["yaw"]["delay_s"] == pytest.approx(usual["rates"]["yaw"]["delay_s"] + 0.05)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_over_a_slower_link_the_law_looks_as_much_further_ahead(autopilot: str, tmp_path: Path) -> None:
    wanted = plan(autopilot)
    setup = Setup(wanted.autopilot, Path("firmware"), tmp_path)
    running = Simulation("udpout:127.0.0.1:9", 21, tmp_path / "truth.csv", 0.0, ())
    usual, slow = (
        ControlTable.model_validate(daemon_document(setup, trial, running)["control"]).altitude.prediction
        for trial in trials(wanted)
        if trial.name in ("kffa-ladrc", "kffa-ladrc-delay")
    )
    assert slow == pytest.approx(usual + 0.05)


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_in_the_rows_with_wind_it_blows_and_only_the_daemon_of_these_holds_the_place(
    autopilot: str, tmp_path: Path
) -> None:
    wanted = plan(autopilot)
    setup = Setup(wanted.autopilot, Path("firmware"), tmp_path)
    running = Simulation("udpout:127.0.0.1:9", 21, tmp_path / "truth.csv", 0.0, ())
    for trial in trials(wanted):
        document = physics_document(read_toml(bundled("px4-hil-vehicle.toml")), trial)
        vehicle, windy = build(document, "test"), trial.name.endswith("-wind")
        assert math.hypot(*vehicle.wind.mean_m_s) == (5.0 if windy else 0.0)
        assert (vehicle.wind.gust_std_m_s, vehicle.vehicle.drag_n_s_m) == (
            (1.5, 0.6) if windy else (0.0, 0.15)
        )
        if not trial.native:
            daemon = daemon_document(setup, trial, running)
            assert daemon["position"]["enabled"] == windy
            late = 0.05 if trial.name.endswith("-delay") else 0.0
            assert daemon["position"]["delay_s"] == pytest.approx(0.1 + late)


def test_the_measured_steps_are_those_that_are_flown() -> None:
    flown, time_s = [], 0.0
    for segment in course(Trial("steps", "", "kffa-ladrc", course="attitude"))[2:-1]:
        if segment["type"] == "step":
            flown.append((segment["channel"], time_s))
        time_s += segment["duration_s"]
    assert [(step.channel, step.after_s) for step in flown_steps()] == flown


def test_a_bundled_configuration_survives_being_written_again() -> None:
    for name in ("compare-px4.toml", "px4-hil-vehicle.toml", "demo-ardupilot-vehicle.toml"):
        document = tomllib.loads(bundled(name).read_text(encoding="utf-8"))
        assert tomllib.loads(toml_text(document)) == document


def test_changes_reach_into_tables_and_replace_arrays() -> None:
    base = {"a": {"x": 1, "y": [1, 2]}, "b": 2}
    assert merged(base, {"a": {"y": [3]}}) == {"a": {"x": 1, "y": [3]}, "b": 2}


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_each_seed_takes_another_stretch_of_the_firmwares_own_noise(autopilot: AutopilotName) -> None:
    starts = [head_start_s(autopilot, Conditions(seed=seed)) for seed in range(3)]
    assert starts[1] - starts[0] == starts[2] - starts[1] > 1.0


@pytest.mark.parametrize(
    ("source", "ending", "file"),
    [
        ("range finder", "-range", "compare-px4-range.params"),
        ("barometer", "-baro", "compare-px4-baro.params"),
    ],
)
def test_rows_with_another_height_have_the_sensor_and_parameters_that_use_it(
    source: HeightSource, ending: str, file: str
) -> None:
    rows = {trial.name: trial for trial in trials(plan())}
    for name in ("native-stock", "native-tuned", "kffa-ladrc", "release"):
        row = rows[name + ending]
        assert row.label == f"{rows[name].label}, {source}"
        assert replace(row, name=name, label=rows[name].label, conditions=Conditions()) == rows[name]
        assert parameter_files("px4", row)[-1] == file
        assert row.conditions == Conditions(height_source=source)
    assert parameter_files("px4", rows["native-stock"]) == ["px4-hil/px4-rc.params"]
    assert all(trial.conditions.height_source == "default" for trial in trials(plan("ardupilot")))
    backend = physics_backend(PX4, 4581, 0, source)
    built = build({"backend": {"kind": "px4-hil", **backend}}, "test").backend.px4_hil
    assert built.range_finder == (source == "range finder")
