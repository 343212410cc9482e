"""Configuration files: what is wrong becomes one line with the remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from kffa_offboard.config import ConfigError, DaemonConfig, Overrides, bundled, load
from kffa_offboard.errors import UserError

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


def complaints(file: Path, text: str) -> list[str]:
    """Problems of a file, without the file's name in front."""
    with pytest.raises(ConfigError) as caught:
        loaded(file, text)
    lines = str(caught.value).splitlines()
    assert all(line.startswith(f"{file}: ") for line in lines)
    return [line.removeprefix(f"{file}: ") for line in lines]


def complaint(file: Path, text: str) -> str:
    lines = complaints(file, text)
    assert len(lines) == 1, lines
    return lines[0]


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (
            "[control.rates.roll]\ndelay_ms = 20",
            "control.rates.roll.delay_ms = 20: unknown key; did you mean delay_s (seconds)?",
        ),
        (
            "[control.rates.roll]\ndelay_s = 20",
            "control.rates.roll.delay_s = 20: is above 0.5 s; were these milliseconds?",
        ),
        (
            '[control.rates.roll]\ndelay_s = "20 ms"',
            'control.rates.roll.delay_s = "20 ms": must be a number (seconds), without quotes; write 0.02',
        ),
        (
            "[control.rates.yaw]\nomega_c = -3",
            "control.rates.yaw.omega_c = -3: must be greater than 0 rad/s",
        ),
        (
            "[control.rates.yaw]\nomega_c = nan",
            "control.rates.yaw.omega_c = nan: must be a finite number (radians per second)",
        ),
        (
            "[control.rates.yaw]\nomega_o = -inf",
            "control.rates.yaw.omega_o = -inf: must be a finite number (radians per second)",
        ),
        (
            "[control.rates.yaw]\nomega_c = true",
            "control.rates.yaw.omega_c = true: must be a number (radians per second)",
        ),
        (
            "[limits]\nbattery_min_percent = nan",
            "limits.battery_min_percent = nan: must be a finite number (percent)",
        ),
        (
            "measurement_noise_m = 1e-200",
            "control.altitude.measurement_noise_m = 1e-200: must have a size from 1e-30 to 1e+30",
        ),
        (
            "[control.rates.roll]\ndisturbance_intensity = 1e308",
            "control.rates.roll.disturbance_intensity = 1e+308: must have a size from 1e-30 to 1e+30",
        ),
        (
            "[position]\nerror_max_m = 1" + 400 * "0",
            f"position.error_max_m = 1{56 * '0'}...: must be a finite number (metres)",
        ),
        ("[limits]\ntilt_max_deg = 0.5", "limits.tilt_max_deg = 0.5: is below 3 deg; were these radians?"),
        (
            "[limits]\nthrust_max = 95",
            "limits.thrust_max = 95: is above 1 of full thrust; were these percent?",
        ),
        (
            "[control]\nhover_thrust = 0.4",
            "control.hover_thrust = 0.4: unknown key; did you mean control.altitude.hover_thrust?",
        ),
        ("[limit]\ntilt_max_deg = 30", "limit: unknown table; did you mean limits?"),
        ('[control]\noutput = "rate"', 'control.output = "rate": must be one of "rates", "attitude"'),
        ("[telemetry]\nrequest_limit = 2.5", "telemetry.request_limit = 2.5: must be a whole number"),
        ("[log]\ndirectory = 3", "log.directory = 3: must be text in quotes"),
        ("[failsafe]\naction = 1", 'failsafe.action = 1: must be one of "stop", "hold", "land"'),
        (
            "[limits]\naltitude_min_m = 3\naltitude_max_m = 2",
            "limits.altitude_min_m = 3.0: must be below altitude_max_m = 2.0",
        ),
        (
            "[control.rates.roll]\nomega_c = 4\nomega_c_range = 5",
            "control.rates.roll: omega_c_range = 5 rad/s lets the fuzzy rules take omega_c to zero; "
            "keep it below omega_c = 4 rad/s",
        ),
        (
            "[control.rates.roll]\nomega_c = 9\nomega_o = 9",
            "control.rates.roll: omega_o = 9 rad/s: the observer must be quicker than the controller; "
            "set it above omega_c = 9 rad/s, usually 3 to 5 times",
        ),
        (
            "[telemetry]\ntimeout_s = 30",
            "telemetry.timeout_s = 30: is above 3 s; were these milliseconds?",
        ),
        (
            "[position]\nbraking_m_s2 = 0.001",
            "position.braking_m_s2 = 0.001: must be at least 0.1 m/s^2",
        ),
        (
            "[flight]\nliftoff_height_m = 10",
            "flight.liftoff_height_m = 10: is above 0.5 m; were these millimetres?",
        ),
        (
            "[flight]\nliftoff_climb_rate_m_s = 1.5",
            "flight.liftoff_climb_rate_m_s = 1.5: must be at most 1 m/s",
        ),
        (
            "[flight]\ntouchdown_thrust_fraction = 0.95",
            "flight.touchdown_thrust_fraction = 0.95: must be at most 0.8",
        ),
        (
            "[flight]\ntouchdown_time_s = 0.001",
            "flight.touchdown_time_s = 0.001: must be at least 0.1 s",
        ),
        (
            "[flight]\nlanding_lead_m = 0.01",
            "flight.landing_lead_m = 0.01: must be at least 0.1 m",
        ),
        ("[log]\nfile_size_max_mb = inf", "log.file_size_max_mb = inf: must be a finite number"),
        (
            "[limits]\ntilt_max_deg = 70",
            "limits.tilt_max_rad = 1.222 (tilt_max_deg = 70): must be positive and at most "
            "tilt_failsafe_rad = 1.047 (tilt_failsafe_deg = 60), which must be at most pi/2",
        ),
        ("telemetry = 5", None),
    ],
)
def test_a_bad_value_is_one_line_with_key_value_and_remedy(
    file: Path, lines: str, expected: str | None
) -> None:
    if expected is None:
        assert complaint(file, lines + MINIMAL) == "telemetry = 5: must be a table, with keys of its own"
    else:
        assert complaint(file, MINIMAL + lines) == expected


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        (
            "[control.rates.roll]\ndelay_s = 0.2",
            "control.rates.roll: delay_s = 0.2 s is more than omega_c = 8 rad/s bears; "
            "keep it within 1.5 / omega_c = 0.188 s, or lower omega_c",
        ),
        (
            "prediction_s = 0.3",
            "control.altitude: prediction_s = 0.3 s is more than omega_c = 8 rad/s bears; "
            "keep it within 2 / omega_c = 0.25 s, or lower omega_c",
        ),
        (
            '[control]\noutput = "attitude"\n[control.attitude.roll]\nomega_c = 0.5\nomega_c_range = 0.1',
            "control.attitude.roll: omega_c = 0.5 rad/s takes the autopilot's own hold away and gives too "
            "little for it; give at least 0.8 rad/s, best about natural_frequency_rad_s = 8",
        ),
        (
            "[limits]\nthrust_rate_max_per_s = 2",
            "limits.thrust_rate_max_per_s = 2: thrust would follow too slowly; give at least 3.2, "
            "hover_thrust = 0.4 times 8 rad/s of bandwidth",
        ),
        (
            "[payload]\nvehicle_mass_kg = 10\nmax_load_kg = 15",
            "payload.max_load_kg = 15: takes 1 of full thrust to carry, limits.thrust_max = 0.95; "
            "lower the one or raise the other",
        ),
        (
            '[flight]\nramp_rate_per_s = 0.05\n[[scenario.segment]]\ntype = "takeoff"\naltitude_m = 2',
            "flight.ramp_rate_per_s = 0.05: reaches 0.3 of full thrust in liftoff_timeout_s = 6, and "
            "hover_thrust = 0.4; raise one of them",
        ),
        (
            "[telemetry]\nattitude_hz = 30",
            "telemetry.attitude_hz = 30: is not above rate_fraction times minimum_attitude_hz = 40, so that "
            "control would never be taken; raise the one or lower the other",
        ),
        (
            "[telemetry]\nposition_hz = 20",
            "telemetry.position_hz = 20: is not above rate_fraction times minimum_position_hz = 20, so that "
            "control would never be taken; raise the one or lower the other",
        ),
        (
            "[control]\nreference_filter_s = 0.3\n[position]\nenabled = true",
            "control.reference_filter_s = 0.3: makes roll and pitch later than position.delay_s + lag_s = "
            "0.22; lower it, or raise these and lower position.omega_c",
        ),
        (
            "[position]\nenabled = true\nomega_c = 10\nomega_o = 30",
            "position.omega_c = 10: is too much for delay_s + lag_s = 0.22; give 6.82 rad/s at the most, "
            "usually a third of it",
        ),
        (
            "[position]\nenabled = true\n[payload]\nrope_length_m = 0.5",
            "payload.rope_length_m = 0.5: the position ring would drive the swing; with position.omega_c = 2 "
            "and delay_s + lag_s = 0.22 it damps that of 0.65 to 53 m; "
            "take a longer rope, or hold the load rigidly",
        ),
        (
            "[position]\nenabled = true\n"
            "[payload]\nrope_length_m = 60\nvehicle_mass_kg = 10\nmax_load_kg = 2",
            "payload.rope_length_m = 60: the position ring would drive the swing; with position.omega_c = 2 "
            "and delay_s + lag_s = 0.22 it damps that of 0.39 to 53 m; lower omega_c",
        ),
        (
            "[position]\nenabled = true\ndelay_s = 0.5\nlag_s = 0.5\nomega_c = 1.5\n"
            "[payload]\nrope_length_m = 3",
            "payload.rope_length_m = 3: with position.omega_c = 1.5 and delay_s + lag_s = 1 the ring damps "
            "no swing; lower omega_c",
        ),
        (
            "omega_c = 5\n[payload]\nrope_stiffness_n_m = 3000\nvehicle_mass_kg = 10\nmax_load_kg = 5",
            "payload.rope_stiffness_n_m = 3000: the heaviest load bounces on it with 30 rad/s; "
            "control.altitude.omega_c = 5 would drive that; take a rope of 5333 N/m at least, or "
            "lower omega_c to 3.8",
        ),
        (
            "[payload]\nrope_stiffness_n_m = 3000",
            "payload: rope_stiffness_n_m needs vehicle_mass_kg: set it to the mass that hover_thrust carries",
        ),
    ],
)
def test_numbers_that_do_not_fly_together_are_refused_with_the_remedy(
    file: Path, lines: str, expected: str
) -> None:
    assert complaint(file, MINIMAL + lines) == expected


@pytest.mark.parametrize(
    ("segment", "expected"),
    [
        ('type = "takof"', 'scenario.segment 1: type = "takof": must be one of "takeoff", "altitude", '),
        (
            "altitude_m = 3",
            'scenario.segment 1: type is missing; write type = one of "takeoff", "altitude", ',
        ),
        (
            'type = "takeoff"',
            "scenario.segment 1 (takeoff).altitude_m: missing; give the altitude to climb to",
        ),
        (
            'type = "hold"\nduration = 3\nduration_s = 3',
            "scenario.segment 1 (hold).duration = 3: unknown key; did you mean duration_s (seconds)?",
        ),
        (
            'type = "step"\nchannel = "roll"\namplitude_m = 1\nduration_s = 1',
            'scenario.segment 1 (step): channel = "roll" needs amplitude_deg, and not amplitude_m',
        ),
        (
            'type = "altitude"\naltitude_m = 80',
            "altitude 80.0 m is not below limits.altitude_max_m = 50.0 m; lower the one or raise the other",
        ),
        (
            'type = "takeoff"\naltitude_m = 80',
            "take-off altitude 80.0 m is not below limits.altitude_max_m = 50.0 m; "
            "lower the one or raise the other",
        ),
    ],
)
def test_a_bad_segment_is_named_by_its_place_and_kind(file: Path, segment: str, expected: str) -> None:
    assert complaint(file, f"{MINIMAL}[[scenario.segment]]\n{segment}").startswith(expected)


@pytest.mark.parametrize("key", ["log.directory", "parameters.file", "signing.key_file"])
def test_a_home_directory_of_nobody_and_an_impossible_name_are_refused(file: Path, key: str) -> None:
    table, name = key.split(".")
    assert complaint(file, f'{MINIMAL}[{table}]\n{name} = "~nobody-here/x"') == (
        f'{key} = "~nobody-here/x": nobody of that name has a home directory; write the whole path'
    )
    assert "no file has such a name" in complaint(file, f'{MINIMAL}[{table}]\n{name} = "a\\u0000b"')
    assert complaint(file, f'{MINIMAL}[{table}]\n{name} = ""') == (
        f'{key} = "": no file has such a name; leave the key out for none'
    )


def test_a_landing_that_is_not_the_end_is_refused(file: Path) -> None:
    text = (
        f'{MINIMAL}[[scenario.segment]]\ntype = "land"\n[[scenario.segment]]\ntype = "hold"\nduration_s = 1'
    )
    assert complaint(file, text) == "scenario segment 1 (land): must be the last one; remove what follows"


def test_all_problems_of_a_file_are_reported(file: Path) -> None:
    text = MINIMAL + "[limits]\ntilt_max_deg = nan\nthrust_max = 2\n[telemetry]\nattitude_hz = 0"
    assert len(complaints(file, text)) == 3


def test_what_must_be_given_is_asked_for(file: Path) -> None:
    assert complaints(file, "") == [
        "link: missing; give the table [link] with at least url",
        "control: missing; give the table [control] with [control.altitude] hover_thrust",
    ]
    text = '[link]\nurl = "udpin:127.0.0.1:14540"\n[control.altitude]'
    assert complaint(file, text).startswith(
        "control.altitude.hover_thrust: missing; give the thrust, 0 to 1, "
    )
    assert complaint(file, MINIMAL + "[control.pid.altitude]\np = 40.0\ni = 160.0") == (
        "control.pid.altitude.d: missing; give all three gains, or leave the table out"
    )


@pytest.mark.parametrize("url", ["udp:127.0.0.1:14540", "udpin:127.0.0.1", "serial:/dev/ttyUSB0:fast"])
def test_a_bad_link_is_refused_wherever_it_stands(file: Path, url: str) -> None:
    assert complaint(file, MINIMAL.replace("udpin:127.0.0.1:14540", url)).startswith(f'link.url = "{url}": ')
    with pytest.raises(UserError, match=f"^link '{url}': "):
        loaded(file, MINIMAL, Overrides(link=url))


def test_the_daemon_is_not_the_vehicle(file: Path) -> None:
    """As component 191 of the vehicle's system it is one of its parts, as component 1 its autopilot."""
    ids = "[link]\nsystem_id = 1\ncomponent_id = 1\n"
    assert complaint(file, MINIMAL.replace("[link]\n", ids)) == (
        "link: system_id = 1, component_id = 1: are those of the vehicle (target_system, target_component), "
        "whose messages would be taken for our own; leave component_id at 191"
    )
    assert loaded(file, MINIMAL.replace("[link]\n", "[link]\nsystem_id = 1\n")).link.system_id == 1


def test_a_syntax_error_is_reported_with_its_line(file: Path) -> None:
    assert (
        complaint(file, "[link]\nurl = udpin\n") == "is not valid TOML: Invalid value (at line 2, column 7)"
    )


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as missing:
        load(tmp_path / "none.toml")
    assert str(missing.value) == f"{tmp_path / 'none.toml'}: no such file; check the path"
    with pytest.raises(ConfigError, match="is a directory"):
        load(tmp_path)
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"a = '\xff'")
    with pytest.raises(ConfigError, match="is not UTF-8 text"):
        load(binary)


@pytest.mark.parametrize(
    ("name", "use"),
    [
        ("sim-px4.toml", "sim-vehicle; give it to `sim-vehicle run --config`"),
        ("campaign.toml", "random flights; give it to `kffa-offboard campaign`"),
        ("paper.toml", "the paper's examples, which `kffa-offboard paper` reads by itself"),
    ],
)
def test_a_configuration_of_another_command_is_recognised_in_one_line(name: str, use: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load(bundled(name))
    assert str(refused.value) == f"{bundled(name)}: is a configuration of {use}"


def test_an_unknown_bundled_name_is_refused() -> None:
    with pytest.raises(UserError, match=r"^none\.toml: no configuration of that name"):
        bundled("none.toml")
