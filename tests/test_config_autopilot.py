"""`[autopilot]` and what the command line says about parameters."""

from __future__ import annotations

from pathlib import Path

import pytest

from kffa_offboard.cli import main
from kffa_offboard.config import AutopilotSettings, ConfigError, Overrides, load

MINIMAL = '[link]\nurl = "udpin:127.0.0.1:14540"\n[control.altitude]\nhover_thrust = 0.4\n'


def autopilot(file: Path, text: str = "", overrides: Overrides | None = None) -> AutopilotSettings:
    file.write_text(MINIMAL + text)
    return load(file, overrides).autopilot


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "vehicle.toml"


def test_parameters_are_checked_and_not_changed_unless_said_otherwise(file: Path) -> None:
    assert autopilot(file) == AutopilotSettings(True, False, "guided")
    text = '[autopilot]\nfix_parameters = true\nardupilot_mode = "guided_nogps"\n'
    assert autopilot(file, text) == AutopilotSettings(True, True, "guided_nogps")


def test_the_command_line_wins_over_the_file(file: Path) -> None:
    assert autopilot(file, overrides=Overrides(fix_parameters=True)) == AutopilotSettings(True, True)
    trust = Overrides(trust_parameters=True)
    assert autopilot(file, "[autopilot]\nfix_parameters = true\n", trust) == AutopilotSettings(False, False)


def test_setting_without_reading_is_a_contradiction(file: Path) -> None:
    with pytest.raises(ConfigError, match="fix_parameters = true needs check_parameters = true"):
        autopilot(file, "[autopilot]\nfix_parameters = true\ncheck_parameters = false\n")


@pytest.mark.parametrize("other", ["--shadow", "--trust-params"])
def test_what_changes_nothing_cannot_fix(other: str, file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.write_text(MINIMAL)
    with pytest.raises(SystemExit) as exit_info:
        main(["run", "--config", str(file), "--fix-params", other])
    assert exit_info.value.code == 2
    assert f"{other} does not; leave out one of them" in capsys.readouterr().err
