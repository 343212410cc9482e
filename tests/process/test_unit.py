"""The systemd unit fits the daemon that it starts."""

import configparser
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
import typer

from kffa_offboard.cli import app
from kffa_offboard.process.realtime import RealtimeSettings

UNIT = Path(__file__).parents[2] / "systemd" / "kffa-offboard.service"


@pytest.fixture(scope="module")
def service():
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str
    parser.read_string(UNIT.read_text())
    return parser["Service"]


def test_the_command_line_of_the_unit_is_one_that_the_daemon_knows(service):
    program, command, *options = shlex.split(service["ExecStart"])
    assert program.endswith("/kffa-offboard")
    known = typer.main.get_command(app).commands[command].params
    names = {name for parameter in known for name in parameter.opts}
    given = [option for option in options if option.startswith("--")]
    assert given == ["--config", "--realtime"], "it does not engage by itself"
    assert set(given) <= names


def test_the_unit_watches_the_daemon_and_permits_what_real_time_needs(service):
    assert service["Type"] == "notify"
    assert float(service["WatchdogSec"]) >= 1.0
    assert service["Restart"] == "on-failure"
    assert int(service["LimitRTPRIO"]) >= RealtimeSettings().priority
    assert service["LimitMEMLOCK"] == "infinity"
    assert "RestrictRealtime" not in service


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_finds_nothing_wrong_but_that_the_daemon_is_not_installed_here(tmp_path):
    unit = tmp_path / UNIT.name
    program = shlex.split("/opt/kffa-offboard/bin/kffa-offboard")[0]
    unit.write_text(UNIT.read_text().replace(program, "/bin/true"))
    checked = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True, timeout=30)
    assert UNIT.name not in checked.stderr, checked.stderr
