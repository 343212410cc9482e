"""The simulator's configuration: defaults, the files that ship, and one-line errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from sim_vehicle.airframe import AirframeParameters
from sim_vehicle.config import SimConfig, build, load
from sim_vehicle.errors import SimulatorError

CONFIGS = Path(__file__).parents[2] / "configs"


def error_of(text: str, tmp_path: Path) -> str:
    """What `load` says about a file with this text, without the file's name."""
    path = tmp_path / "sim.toml"
    path.write_text(text)
    with pytest.raises(SimulatorError) as problem:
        load(path)
    message = str(problem.value)
    assert "\n" not in message
    assert message.startswith(f"{path}: ")
    return message.removeprefix(f"{path}: ")


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_the_files_that_ship_load_as_they_are(personality):
    config = load(CONFIGS / f"sim-{personality}.toml")
    assert config.vehicle.personality == personality
    assert config.payload.gripper_mass_kg == 5.0


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_the_files_that_ship_spell_out_the_defaults(personality):
    """Except the link and the firmware's parameters, and the period of a sine that is not used."""
    config = load(CONFIGS / f"sim-{personality}.toml")
    default = SimConfig()
    for section in ("sensors", "wind", "payload", "lockstep"):
        assert getattr(config, section) == getattr(default, section)


def test_the_vehicle_for_ardupilot_spells_out_the_defaults_of_its_backend():
    config = load(CONFIGS / "ardupilot-json-vehicle.toml")
    assert config == build({"backend": {"kind": "ardupilot-json"}}, "test")


def test_parameters_for_ardupilot_agree_with_the_vehicle():
    lines = (CONFIGS / "ardupilot-json.parm").read_text().splitlines()
    pairs = [line.split() for line in lines if line and not line.startswith("#")]
    values = {name: float(value) for name, value in pairs}
    assert len(values) == len(pairs)
    config = load(CONFIGS / "ardupilot-json-vehicle.toml")
    outputs = config.backend.ardupilot_json
    assert values["SIM_RATE_HZ"] == 1.0 / config.vehicle.physics_dt_s
    assert (values["MOT_PWM_MIN"], values["MOT_PWM_MAX"]) == (
        outputs.motor_pwm_min_us,
        outputs.motor_pwm_max_us,
    )
    assert values[f"SERVO{outputs.gripper_channel}_FUNCTION"] == 28
    assert (values["GRIP_GRAB"], values["GRIP_RELEASE"]) == (
        outputs.gripper_grab_us,
        outputs.gripper_release_us,
    )
    assert values["MOT_THST_HOVER"] == pytest.approx(AirframeParameters().hover_thrust(), abs=1e-3)


def test_options_go_over_the_file():
    config = load(CONFIGS / "sim-px4.toml", {"vehicle": {"seed": 7}, "lockstep": {"enabled": True}})
    assert config.vehicle.seed == 7
    assert config.vehicle.personality == "px4"
    assert config.lockstep.enabled


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (
            "[backend.ardupilot_json]\nmotor_channels = [1, 2, 2, 4]",
            "backend.ardupilot_json.motor_channels = [1, 2, 2, 4]: a channel is given twice; "
            "name four outputs: front, left, rear, right",
        ),
        (
            "[backend.ardupilot_json]\ngripper_channel = 2",
            "backend.ardupilot_json.gripper_channel = 2: that output drives a motor; "
            "choose another, or 0 for no gripper",
        ),
        (
            "[backend.ardupilot_json]\nmotor_pwm_min_us = 1950",
            "backend.ardupilot_json.motor_pwm_max_us = 2000: not 100 us above motor_pwm_min_us = 1950; "
            "give the firmware's MOT_PWM_MIN and MOT_PWM_MAX",
        ),
        (
            "[backend.ardupilot_json]\ngripper_grab_us = 1150",
            "backend.ardupilot_json.gripper_grab_us = 1150: within 100 us of gripper_release_us = 1100; "
            "give the firmware's GRIP_GRAB and GRIP_RELEASE",
        ),
        (
            '[backend]\nkind = "ardupilot-json"\n[backend.ardupilot_json]\nhost = "0.0.0.0"',
            "backend.ardupilot_json.host = 'udpin:0.0.0.0:9002': 0.0.0.0 is not this machine; "
            "use 127.0.0.1 or set link.allow_remote = true",
        ),
        (
            '[backend]\nkind = "ardupilot-json"\n[vehicle]\nprofile = "paper"',
            "vehicle.profile = 'paper': backend.kind = 'ardupilot-json' needs motors with limits; "
            "choose 'airframe'",
        ),
        (
            "[link]\ntelemetry_delay_ms = 20",
            "link.telemetry_delay_ms = 20: unknown key; did you mean telemetry_delay_s (in seconds)?",
        ),
        (
            "[link]\ntelemetry_delay_s = '20 ms'",
            "link.telemetry_delay_s = '20 ms': not a number; give a number of seconds, without quotes",
        ),
        (
            "[link]\ntelemetry_delay_s = 20",
            "link.telemetry_delay_s = 20: too large; the limit is 2.0 seconds",
        ),
        (
            "[vehicle]\nschedule = []",
            "vehicle.schedule = (): unknown key here; it belongs to [payload] schedule",
        ),
        ("[vehicles]\nseed = 1", "vehicles = {'seed': 1}: unknown key; did you mean vehicle?"),
        (
            "[payload]\ngripper_mass_kg = -1.0",
            "payload.gripper_mass_kg = -1.0: load of -1 kg is below zero; give a mass of 0 to 6.73 kg",
        ),
        (
            "[payload]\ngripper_mass_kg = 7",
            "payload.gripper_mass_kg = 7: load of 7 kg is above the limit of 6.73 kg; choose a lighter load",
        ),
        (
            "[payload]\nschedule = [{time_s = 1.0, mass_kg = 6.8}]",
            "payload.schedule[0].mass_kg = 6.8: load of 6.8 kg is above the limit of 6.73 kg; "
            "choose a lighter load",
        ),
        (
            "[payload]\nschedule = [{time_s = 1.0}]",
            "payload.schedule[0].mass_kg: missing; give a value in kg",
        ),
        (
            "[sensors]\nattitude_noise_rad = nan",
            "sensors.attitude_noise_rad = nan: not finite; give a number of radians",
        ),
        (
            "[sensors]\naltitude_noise_m = -0.1",
            "sensors.altitude_noise_m = -0.1: too small; the limit is at least 0.0 metres",
        ),
        (
            "[sensors]\naltitude_noise_m = 1e308",
            "sensors.altitude_noise_m = 1e+308: too large; the limit is 1000.0 metres",
        ),
        (
            "[wind]\nmean_m_s = [0.0, 1e30, 0.0]",
            "wind.mean_m_s[1] = 1e+30: too large; the limit is 1000.0 m/s",
        ),
        (
            "[vehicle]\nposition_ready_s = 1e308",
            "vehicle.position_ready_s = 1e+308: too large; the limit is 1000000.0 seconds",
        ),
        (
            "[parameters]\nMPC_Z_P = 1e39",
            "parameters.MPC_Z_P = 1e+39: 1e+39 does not fit real32; the limit is 3.402823e+38",
        ),
        (
            "[vehicle]\npersonality = 'betaflight'",
            "vehicle.personality = 'betaflight': not a choice; choose 'px4' or 'ardupilot'",
        ),
        (
            "[vehicle]\nseed = 1.5",
            "vehicle.seed = 1.5: not a whole number; give a whole number, without quotes",
        ),
        (
            "[link]\nendpoints = ['udp:127.0.0.1:14540']",
            "link.endpoints = 'udp:127.0.0.1:14540': unknown kind 'udp'; did you mean udpin?",
        ),
        (
            "[link]\nendpoints = ['udpin:127.0.0.1']",
            "link.endpoints = 'udpin:127.0.0.1': not of the form udpin:HOST:PORT with a port of 0 to 65535",
        ),
        (
            "[link]\nendpoints = ['udpin:0.0.0.0:14540']",
            "link.endpoints = 'udpin:0.0.0.0:14540': 0.0.0.0 is not this machine; "
            "use 127.0.0.1 or set link.allow_remote = true",
        ),
        (
            "[parameters]\nCOM_OF_LOS_T = 1.0",
            "parameters.COM_OF_LOS_T = 1.0: unknown parameter; did you mean COM_OF_LOSS_T?",
        ),
        (
            "[parameters]\nCOM_OBL_RC_ACT = 1.5",
            "parameters.COM_OBL_RC_ACT = 1.5: 1.5 is not a whole number; "
            "COM_OBL_RC_ACT is an integer parameter",
        ),
        (
            "[lockstep]\nperiod_s = 0.011",
            "lockstep.period_s = 0.011: not a multiple of vehicle.physics_dt_s = 0.0025; "
            "choose for instance 0.01",
        ),
    ],
)
def test_an_error_names_key_value_and_remedy_in_one_line(text, error, tmp_path):
    assert error_of(text, tmp_path) == error


def test_a_missing_file_and_bad_toml_are_named(tmp_path):
    with pytest.raises(SimulatorError, match=r"nowhere\.toml: no such file; "):
        load(tmp_path / "nowhere.toml")
    assert "not valid TOML" in error_of("[vehicle\n", tmp_path)


def test_load_changes_out_of_order_are_refused(tmp_path):
    text = "[payload]\nschedule = [{time_s = 2.0, mass_kg = 1.0}, {time_s = 1.0, mass_kg = 0.0}]"
    assert "list the changes in order of time" in error_of(text, tmp_path)


def test_another_machine_may_be_reached_if_that_is_allowed():
    config = build({"link": {"endpoints": ["udpin:0.0.0.0:14540"], "allow_remote": True}}, "test")
    assert config.link.endpoints == ("udpin:0.0.0.0:14540",)


def test_a_key_in_the_home_directory_of_nobody_is_refused(tmp_path):
    assert error_of('[signing]\nkey_file = "~nobody-here/key"', tmp_path) == (
        "signing.key_file = '~nobody-here/key': nobody of that name has a home directory; "
        "write the whole path"
    )
