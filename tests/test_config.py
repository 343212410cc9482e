"""Configuration files: what is right becomes settings."""

from __future__ import annotations

import math
import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from kffa_offboard.config import ConfigError, DaemonConfig, Overrides, bundled, load
from kffa_offboard.config_control import ControlTable
from kffa_offboard.config_tables import FlightTable, LimitsTable, SequenceTable, TelemetryTable
from kffa_offboard.control.controllers import ALTITUDE, NAMES, PITCH, ROLL, YAW
from kffa_offboard.offboard import segments
from kffa_offboard.offboard.settings import (
    FlightSettings,
    LimitSettings,
    SequenceSettings,
    TelemetrySettings,
)

MINIMAL = """
[link]
url = "udpin:127.0.0.1:14540"
[control.altitude]
hover_thrust = 0.4
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "vehicle.toml"


def loaded(file: Path, text: str, overrides: Overrides | None = None) -> DaemonConfig:
    file.write_text(text)
    return load(file, overrides)


CONFIGS = (
    *("demo-px4", "demo-ardupilot", "demo-px4-position", "demo-ardupilot-position"),
    *("demo-px4-release", "demo-ardupilot-release", "demo-px4-rope", "demo-ardupilot-rope"),
    *("px4-udp", "ardupilot-udp", "serial"),
)


@pytest.mark.parametrize("name", CONFIGS)
def test_every_bundled_configuration_can_be_flown_as_it_is(name: str) -> None:
    config = load(bundled(f"{name}.toml"))
    assert config.service.controller.name == "kffa-ladrc"
    assert not (config.service.arm or config.service.engage)  # a file alone never takes control


@pytest.mark.parametrize("output", ["rates", "attitude"])
@pytest.mark.parametrize("controller", NAMES)
def test_every_controller_can_be_chosen_with_either_output(file: Path, controller: str, output: str) -> None:
    config = loaded(file, f'{MINIMAL}[control]\ncontroller = "{controller}"\noutput = "{output}"')
    assert config.service.controller.name == controller
    assert config.service.output == output


def test_a_key_that_is_left_out_has_the_default_of_the_settings(file: Path) -> None:
    service = loaded(file, MINIMAL).service
    assert service.telemetry == TelemetrySettings()
    assert service.sequence == SequenceSettings()
    assert service.flight == FlightSettings()
    for item in fields(LimitSettings):
        assert getattr(service.limits, item.name) == pytest.approx(getattr(LimitSettings(), item.name))


@pytest.mark.parametrize(
    ("record", "table", "beside"),
    [
        (TelemetrySettings, TelemetryTable, {"connect_timeout_s", "barrier_timeout_s"}),
        (SequenceSettings, SequenceTable, set()),
        (FlightSettings, FlightTable, set()),
        (LimitSettings, LimitsTable, {f"{axis}_rate_max_deg_s" for axis in ("roll", "pitch", "yaw")}),
    ],
)
def test_every_setting_can_be_set(record: type, table: type[ControlTable], beside: set[str]) -> None:
    wanted = {re.sub("_rad(_|$)", r"_deg\1", item.name) for item in fields(record)} - {"body_rate_max_deg_s"}
    assert set(table.model_fields) == wanted | beside


def test_degrees_at_the_edge_are_radians_inside(file: Path) -> None:
    limits = loaded(
        file, f"{MINIMAL}[limits]\ntilt_max_deg = 20\nyaw_rate_max_deg_s = 90\ntilt_failsafe_deg = 45"
    ).service.limits
    assert limits.tilt_max_rad == pytest.approx(math.radians(20))
    assert limits.body_rate_max_rad_s[2] == pytest.approx(math.pi / 2)
    assert limits.tilt_failsafe_rad == pytest.approx(math.pi / 4)


def test_altitude_acceleration_per_thrust_is_gravity_over_hover_thrust(file: Path) -> None:
    controller = loaded(file, MINIMAL).service.controller
    assert controller.model.b0[ALTITUDE] == pytest.approx(9.80665 / 0.4)
    assert controller.model.damping[ALTITUDE] == 0.0


def test_a_body_rate_loop_with_a_lag_has_known_gain_and_damping(file: Path) -> None:
    text = f"{MINIMAL}[control.rates.pitch]\nrate_time_constant_s = 0.05\ndelay_s = 0.03"
    controller = loaded(file, text).service.controller
    assert controller.model.b0[PITCH] == controller.model.damping[PITCH] == pytest.approx(20.0)
    assert controller.model.stiffness[PITCH] == 0.0
    assert controller.actuator.delay[PITCH] == 0.03
    assert controller.prediction is not None
    assert controller.prediction[PITCH] == 0.03
    assert controller.limits.upper[YAW] == pytest.approx(LimitSettings().body_rate_max_rad_s[2])


def test_an_attitude_loop_is_a_second_order_plant_and_its_command_an_angle(file: Path) -> None:
    text = (
        f'{MINIMAL}[control]\noutput = "attitude"\n'
        "[control.attitude.roll]\nnatural_frequency_rad_s = 10\ndamping_ratio = 0.7"
    )
    controller = loaded(file, text).service.controller
    assert controller.model.b0[ROLL] == controller.model.stiffness[ROLL] == pytest.approx(100.0)
    assert controller.model.damping[ROLL] == pytest.approx(14.0)
    assert controller.limits.upper[ROLL] == pytest.approx(math.radians(30))
    assert np.isinf(controller.limits.upper[YAW])


def test_a_scenario_becomes_segments_in_radians_and_metres(file: Path) -> None:
    text = f"""{MINIMAL}
    [scenario]
    segment = [
      {{ type = "takeoff", altitude_m = 5 }},
      {{ type = "altitude", altitude_m = 3, speed_m_s = 0.5 }},
      {{ type = "step", channel = "roll", amplitude_deg = 10, duration_s = 2 }},
      {{ type = "sine", channel = "altitude", amplitude_m = -0.5, period_s = 4, cycles = 2 }},
      {{ type = "triangle", channel = "yaw", amplitude_deg = 90, period_s = 8 }},
      {{ type = "gripper", action = "release" }},
      {{ type = "hold", duration_s = 3 }},
      {{ type = "land" }},
    ]
    """
    assert loaded(file, text).service.scenario == (
        segments.Takeoff(5.0),
        segments.Altitude(3.0, 0.5),
        segments.Step("roll", math.radians(10), 2.0),
        segments.Sine("altitude", -0.5, 4.0, 2.0),
        segments.Triangle("yaw", math.radians(90), 8.0),
        segments.Gripper("release"),
        segments.Hold(3.0),
        segments.Land(),
    )


def test_the_command_line_wins_over_the_file(file: Path) -> None:
    overrides = Overrides(
        "tcp:127.0.0.1:5760", controller="cascaded-pid", output="attitude", arm=True, engage=True
    )
    config = loaded(file, MINIMAL, overrides)
    assert config.link.url == "tcp:127.0.0.1:5760"
    assert config.service.controller.name == "cascaded-pid"
    assert config.service.output == "attitude"
    assert config.service.arm
    assert config.service.engage
    assert not config.service.shadow


def test_nothing_arms_or_engages_unless_the_command_line_says_so(file: Path) -> None:
    service = loaded(file, MINIMAL).service
    assert not service.arm
    assert not service.engage
    with pytest.raises(ConfigError, match=r"\A\S+: control\.arm = true: unknown key[^\n]*\Z"):
        loaded(file, f"{MINIMAL}[control]\narm = true")


def test_measured_rates_are_fused_unless_told_otherwise(file: Path) -> None:
    fused = loaded(file, f"{MINIMAL}climb_rate_noise_m_s = 0.03").service.controller.kalman
    assert fused is not None
    assert fused.rate_variance is not None
    assert fused.rate_variance[ALTITUDE] == pytest.approx(0.03**2)
    plain = loaded(file, f"{MINIMAL}[control]\nfuse_rates = false").service.controller.kalman
    assert plain is not None
    assert plain.rate_variance is None
