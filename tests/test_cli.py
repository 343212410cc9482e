"""The command line: help worth reading, one line for each mistake, the right exit status."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest

from kffa_offboard import __version__, cli
from kffa_offboard.config import bundled
from kffa_offboard.control.controllers import NAMES


def status_of(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        cli.main(list(arguments))
    return int(ended.value.code or 0)


def test_the_version_is_the_package_s(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("--version") == 0
    assert capsys.readouterr().out == f"kffa-offboard {__version__}\n"


@pytest.mark.parametrize("command", ["run", "check", "demo", "paper", "campaign"])
def test_help_has_examples_and_exit_statuses(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of(command, "--help") == 0
    text = capsys.readouterr().out
    assert "Example" in text
    assert f"kffa-offboard {command}" in text
    assert "Exit status" in text


def test_every_controller_can_be_named_on_the_command_line() -> None:
    assert get_args(cli.Controller) == NAMES


def test_right_files_are_summed_up_in_a_line_each(capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(bundled("demo-px4.toml")), str(bundled("px4-udp.toml"))]
    assert status_of("check", *files) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{files[0]}: ok: kffa-ladrc, output rates, ")
    assert "scenario takeoff, hold, land" in lines[0]
    assert "scenario hold until released" in lines[1]


def test_all_mistakes_of_all_files_are_lines_on_stderr(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text(
        '[link]\nurl = "udpin:127.0.0.1:14540"\n[control.altitude]\nhover_thrust = 40\nomega_c = nan'
    )
    assert status_of("check", str(bad), str(tmp_path / "none.toml"), str(bundled("serial.toml"))) == 2
    captured = capsys.readouterr()
    assert set(captured.err.splitlines()) == {
        f"error: {bad}: control.altitude.hover_thrust = 40: is above 0.9 of full thrust; were these percent?",
        f"error: {bad}: control.altitude.omega_c = nan: must be a finite number (radians per second)",
        f"error: {tmp_path / 'none.toml'}: no such file; check the path",
    }
    assert captured.out.startswith(str(bundled("serial.toml")))


@pytest.mark.parametrize("flag", ["--arm", "--engage"])
def test_shadow_and_control_contradict_each_other(flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("run", "--config", str(bundled("px4-udp.toml")), "--shadow", flag) == 2
    assert capsys.readouterr().err.startswith("error: --shadow only observes; ")


def test_a_bad_link_on_the_command_line_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("run", "--config", str(bundled("px4-udp.toml")), "--link", "udp:1") == 2
    assert capsys.readouterr().err.startswith("error: link 'udp:1': unknown kind 'udp'; write udpin:")


def test_listening_to_the_network_needs_permission(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("run", "--config", str(bundled("px4-udp.toml")), "--link", "udpin:0.0.0.0:0") == 2
    assert "set link.allow_remote = true" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("campaign", "--flights", "0"), "--flights 0: must be at least 1; give 1 to 10000000"),
        (("campaign", "--flights", "1e3"), "--flights 1e3: must be a whole number; give 1 to 10000000"),
        (("campaign", "--seed", "-1"), "--seed -1: must be at least 0; give 0 or more"),
        (("compare", "--load", "nan"), "--load nan: must be at most 6.73; give 0.1 to 6.73"),
        (("compare", "--load", "5kg"), "--load 5kg: must be a number; give 0.1 to 6.73"),
        (("run", "--config", "a.toml", "--output", "x"), "--output x: 'x' is not one of 'rates', 'attitude'"),
    ],
)
def test_a_wrong_value_of_an_option_is_one_line_with_value_limit_and_remedy(
    arguments: tuple[str, ...], line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of(*arguments) == 2
    assert capsys.readouterr().err == f"error: {line}\n"


@pytest.mark.parametrize(
    ("arguments", "named"),
    [(["run", "--config"], "--config"), (["replay"], "FLIGHT.tlog"), (["identify"], "LOG...")],
)
def test_a_file_that_may_not_be_read_is_one_line_with_its_name_and_the_remedy(
    arguments: list[str],
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "somebody_elses"
    file.touch()
    # What tests run as may read everything.
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.R_OK)
    assert status_of(*arguments, str(file)) == 2
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].startswith(f"error: {named}: path '{file}' is not readable; chmod u+r it")


def test_a_missing_option_is_said_with_the_usage(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("run") == 2
    said = capsys.readouterr().err
    assert "Usage:" in said and "Missing option '--config'" in said


def test_a_log_that_exists_is_never_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = tmp_path / "flight.tlog"
    log.write_bytes(b"precious")
    arguments = ["--config", str(bundled("px4-udp.toml")), "--link", "udpin:127.0.0.1:0", "--log", str(log)]
    assert status_of("run", *arguments) == 2
    assert "exists already" in capsys.readouterr().err
    assert log.read_bytes() == b"precious"


def test_a_directory_that_cannot_be_made_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    assert status_of("demo", "--out", str(tmp_path / "file" / "out")) == 2
    assert capsys.readouterr().err.startswith(f"error: --out {tmp_path / 'file' / 'out'}: ")


def test_the_help_of_identify_names_its_tables_in_full(capsys: pytest.CaptureFixture[str]) -> None:
    assert status_of("identify", "--help") == 0
    assert "[control.attitude.*]" in capsys.readouterr().out


INTERRUPTED_WHILE_LOADING = """
import sys
from {package}.__main__ import main

class CtrlC:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            raise KeyboardInterrupt

sys.meta_path.insert(0, CtrlC())
main()
"""


@pytest.mark.parametrize("package", ["kffa_offboard", "sim_vehicle"])
def test_ctrl_c_while_the_program_is_being_loaded_ends_it_without_a_traceback(package: str) -> None:
    code = INTERRUPTED_WHILE_LOADING.format(package=package)
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert ended.returncode == 130
    assert "Traceback" not in ended.stderr


@pytest.mark.parametrize("package", ["kffa_offboard", "sim_vehicle"])
@pytest.mark.parametrize(("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_small_matrices_get_one_thread_unless_the_environment_says_otherwise(
    package: str, given: dict[str, str], threads: str
) -> None:
    """Those of a pool of OpenBLAS's own only wait for a core, by computing."""
    program = f"import sys; from {package}.__main__ import main; sys.argv[1:] = ['--version']\n"
    program += "try: main()\nexcept SystemExit: import os; print(os.environ['OPENBLAS_NUM_THREADS'])"
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    said = subprocess.run(
        [sys.executable, "-c", program], env=environment | given, capture_output=True, text=True, check=True
    )
    assert said.stdout.splitlines()[-1] == threads


def test_ctrl_c_ends_a_command_that_reads_logs_with_a_word(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(plan: object) -> int:
        raise KeyboardInterrupt

    monkeypatch.setattr("kffa_offboard.replay.command.run_replay", interrupt)
    assert status_of("replay", "flight.tlog") == 130
    assert capsys.readouterr().err == "stopped\n"
