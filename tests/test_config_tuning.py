"""Parameters made from a configuration: names, ranges, storing."""

import pytest

from kffa_offboard.config import ConfigError, Overrides, bundled, load
from kffa_offboard.offboard.tuning import TuningProblem

FILES = ["demo-px4.toml", "demo-ardupilot.toml", "demo-px4-position.toml", "serial.toml"]


@pytest.fixture
def config_file(tmp_path):
    """A configuration that stores parameters beside itself."""
    text = bundled("demo-px4.toml").read_text()
    file = tmp_path / "mine.toml"
    file.write_text(text + '\n[parameters]\nfile = "mine.tuned.toml"\n')
    return file


def values(tuning):
    return {tunable.name: tunable.value for tunable in tuning.tunables}


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("output", ["rates", "attitude"])
@pytest.mark.parametrize("controller", ["kffa-ladrc", "pid", "cascaded-pid"])
def test_every_name_fits_the_wire_and_is_there_once(file, output, controller):
    tuning = load(bundled(file), Overrides(output=output, controller=controller)).tuning
    names = [tunable.name for tunable in tuning.tunables]
    assert len(set(names)) == len(names) > 40
    assert all(len(name) <= 16 and name == name.upper() and name.isascii() for name in names)
    assert all(tunable.lower <= tunable.value <= tunable.upper for tunable in tuning.tunables)


def test_parameters_are_those_of_what_is_flown():
    rates = values(load(bundled("demo-px4.toml"), Overrides(output="rates")).tuning)
    attitude = values(load(bundled("demo-px4.toml"), Overrides(output="attitude")).tuning)
    ring = values(load(bundled("demo-px4-position.toml")).tuning)
    cascade = values(load(bundled("demo-px4.toml"), Overrides(controller="cascaded-pid")).tuning)
    assert "ROLL_RATE_TC_S" in rates.keys() - attitude.keys()
    assert "ROLL_NAT_FREQ" in attitude.keys() - rates.keys()
    assert "POS_OMEGA_C" in ring.keys() - rates.keys()
    assert "PID_CLIMB_P" in cascade.keys() - rates.keys()
    single = load(bundled("compare-px4.toml"), Overrides(controller="pid")).tuning
    assert {name for name in values(single) if name.startswith("PID_")} == {
        "PID_ALT_P",
        "PID_ALT_I",
        "PID_ALT_D",
    }
    changed = single.with_value("PID_ALT_I", 100.0).settings.controller.pid
    assert (changed.kp[3], changed.ki[3], changed.kd[3]) == (40.0, 100.0, 14.0)


def test_the_settings_follow_a_value_and_nothing_else_changes():
    config = load(bundled("demo-px4.toml"), Overrides(arm=True, engage=True))
    assert config.tuning.settings is config.service
    changed = config.tuning.with_value("ALT_OMEGA_C", 6.5)
    assert changed.settings.controller.law.omega_c[3] == 6.5
    assert changed.settings.arm and changed.settings.engage
    assert changed.settings.scenario == config.service.scenario
    assert {name for name, value in values(changed).items() if value != values(config.tuning)[name]} == {
        "ALT_OMEGA_C"
    }
    assert config.tuning.settings.controller.law.omega_c[3] == config.service.controller.law.omega_c[3]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("ALT_OMEGA_C", 2000.0, "above 1000 rad/s"),
        ("ALT_OMEGA_C", 24.9, None),
        ("ALT_OMEGA_C", 49.9, r"delay_s = 0\.06 s is more than omega_c = 49\.9 rad/s bears"),
        ("ALT_OMEGA_C", 50.0, "the observer must be quicker than the controller"),
        ("ALT_OMEGA_C", float("nan"), "must be a finite number"),
        ("ALT_DELAY_S", 60.0, "were these milliseconds"),
        ("ALT_DELAY_S", -0.01, "must be at least 0 s"),
        ("LIM_TILT_DEG", 70.0, "at most tilt_failsafe_rad"),
        ("LIM_THR_MIN", 0.5, "must lie between"),
        ("LIM_THR_PER_S", 3.0, "thrust would follow too slowly; give at least 3.18"),
        ("LIM_THR_MAX", 0.6, "max_load_kg = 6.73: takes 0.666 of full thrust"),
        ("LIM_TILT", 30.0, "no such parameter"),
    ],
)
def test_ranges_are_those_of_the_file(name, value, reason):
    tuning = load(bundled("demo-px4.toml")).tuning
    if name == "ALT_OMEGA_C":
        tuning = tuning.with_value("ALT_OMEGA_O", 50.0)
    if reason is None:
        assert values(tuning.with_value(name, value))[name] == value
        return
    with pytest.raises(TuningProblem, match=reason):
        tuning.with_value(name, value)


def test_stored_values_are_there_after_the_next_start(config_file):
    tuning = load(config_file).tuning
    assert tuning.changes == {}
    tuning = tuning.with_value("ALT_OMEGA_C", 6.5).with_value("LIM_TILT_DEG", 25.0)
    assert tuning.stored() == "2 changed parameters stored in mine.tuned.toml"
    assert sorted(path.name for path in config_file.parent.iterdir()) == ["mine.toml", "mine.tuned.toml"]
    again = load(config_file)
    assert again.tuning.changes == {"ALT_OMEGA_C": 6.5, "LIM_TILT_DEG": 25.0}
    assert again.service.controller.law.omega_c[3] == 6.5
    assert values(again.tuning) == values(tuning)


def test_stored_values_can_be_read_again_and_left(config_file):
    tuning = load(config_file).tuning
    before = values(tuning)
    stored = tuning.with_value("ALT_OMEGA_C", 6.5)
    stored.stored()
    assert values(stored.with_value("ALT_OMEGA_C", 5.0).reread()) == values(stored)
    assert values(stored.original()) == before
    stored.original().stored()
    assert values(load(config_file).tuning) == before


def test_without_a_file_nothing_is_stored():
    tuning = load(bundled("demo-px4.toml")).tuning.with_value("ALT_OMEGA_C", 6.5)
    with pytest.raises(TuningProblem, match=r"no \[parameters\] file in the configuration"):
        tuning.stored()
    assert tuning.reread().changes == {}


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[control.altitude]\nomega_c = 2000.0\n", "must be at most|is above 1000 rad/s"),
        ("[control.altitude]\nomega_c = true\n", "omega_c = True: must be a number"),
        ("[link]\nurl = 'udpin:127.0.0.1:1'\n", "link.url: is no parameter of this configuration; remove it"),
        ("[control", "is not valid TOML"),
    ],
)
def test_a_stored_file_that_cannot_be_flown_is_named_with_its_problem(config_file, text, problem):
    (config_file.parent / "mine.tuned.toml").write_text(text)
    with pytest.raises(ConfigError, match=rf"mine\.tuned\.toml: .*({problem})"):
        load(config_file)


def test_a_directory_that_cannot_be_written_is_a_reason(config_file):
    tuning = load(config_file).tuning
    (config_file.parent / "mine.tuned.toml.part").mkdir()
    with pytest.raises(TuningProblem, match=r"cannot write .*mine\.tuned\.toml"):
        tuning.stored()
