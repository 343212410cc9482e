"""The `[payload]` table: from keys to what the service watches loads with."""

from pathlib import Path

import pytest

from kffa_offboard.config import ConfigError, bundled, load

MINIMAL = """
[link]
url = "udpin:127.0.0.1:14540"
[control.altitude]
hover_thrust = 0.4
delay_s = 0.06
lag_s = 0.05
climb_rate_noise_m_s = 0.03
"""


def written(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "vehicle.toml"
    file.write_text(MINIMAL + text)
    return file


@pytest.mark.parametrize(
    "text", ["", "[payload]\nreport_hz = 2\n", "[payload]\nenabled = false\nvehicle_mass_kg = 9\n"]
)
def test_without_a_mass_or_switched_off_loads_are_not_weighed(tmp_path: Path, text: str) -> None:
    assert load(written(tmp_path, text)).service.payload is None


def test_the_numbers_reach_the_estimator(tmp_path: Path) -> None:
    text = "[payload]\nvehicle_mass_kg = 9.0\nmax_load_kg = 4.0\ngripper_open_s = 0.2\nreport_hz = 2\n"
    payload = load(written(tmp_path, text)).service.payload
    assert payload is not None
    assert (payload.max_load_kg, payload.gripper_open_s, payload.report_hz) == (4.0, 0.2, 2.0)
    estimator = payload.estimator
    assert (estimator.vehicle_mass, estimator.hover_thrust) == (9.0, 0.4)
    assert estimator.rate_variance == pytest.approx(0.03**2)
    assert (estimator.actuator.delay.tolist(), estimator.actuator.lag.tolist()) == ([0.06], [0.05])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("max_load_kg = 3.0", "payload: max_load_kg needs vehicle_mass_kg"),
        ("gripper_open_s = 0.1", "payload: gripper_open_s needs vehicle_mass_kg"),
        ("vehicle_mass_kg = -1", "payload.vehicle_mass_kg = -1"),
        ("vehicle_mass = 1", "payload.vehicle_mass = 1: unknown key; did you mean vehicle_mass_kg"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        load(written(tmp_path, f"[payload]\n{text}\n"))
    (line,) = str(refusal.value).splitlines()
    assert message in line


@pytest.mark.parametrize("name", ["px4", "ardupilot", "px4-position", "ardupilot-position"])
def test_the_demonstrations_weigh_their_loads(name: str) -> None:
    payload = load(bundled(f"demo-{name}.toml")).service.payload
    assert payload is not None and payload.estimator.vehicle_mass == 10.0
