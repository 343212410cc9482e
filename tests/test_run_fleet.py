"""Several vehicles in one process: what happens to one does not touch the others."""

import json
import os
import socket
import threading
from types import SimpleNamespace

import pytest

from kffa_offboard import cli, cli_fleet
from kffa_offboard.cli_fleet import Fleet
from kffa_offboard.cli_vehicle import RunOptions
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.shell import RunResult, real_time_clock
from kffa_offboard.mavlink.transmission import Counters
from kffa_offboard.offboard.service import Finished

VEHICLE = """
[link]
url = "{url}"
[telemetry]
connect_timeout_s = 0.3
[control.altitude]
hover_thrust = 0.4
[log]
directory = "{logs}"
"""


def status_of(*options):
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", *options])
    return int(ended.value.code or 0)


@pytest.fixture
def configs(tmp_path):
    """Writes configurations of vehicles by name and URL; returns the options that name them."""

    def write(logs="{name}-logs", **urls):
        options = []
        for name, url in urls.items():
            path = tmp_path / f"{name}.toml"
            path.write_text(VEHICLE.format(url=url, logs=tmp_path / logs.format(name=name)))
            options += ["--config", str(path)]
        return options

    return write


def test_each_vehicle_has_its_own_log_and_its_own_end(configs, tmp_path, capsys):
    assert status_of(*configs(north="udpin:127.0.0.1:0", south="udpin:127.0.0.1:0")) == 1
    said = capsys.readouterr().err
    for name in ("north", "south"):
        assert f"{name}: waiting for a vehicle on udpin:127.0.0.1:" in said
        assert f"error: {name}: no vehicle answered on " in said
        assert len([*(tmp_path / f"{name}-logs").glob("*.tlog")]) == 1


def test_a_busy_port_keeps_one_vehicle_from_flying_and_not_the_other(configs, capsys):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as busy:
        busy.bind(("127.0.0.1", 0))
        port = busy.getsockname()[1]
        assert status_of(*configs(busy=f"udpin:127.0.0.1:{port}", free="udpin:127.0.0.1:0")) == 1
    said = capsys.readouterr().err
    assert f"error: busy: link 'udpin:127.0.0.1:{port}': port {port} is busy" in said
    assert "error: free: no vehicle answered" in said


@pytest.mark.parametrize(
    ("urls", "logs", "problem"),
    [
        ({"a": "udpin:127.0.0.1:5001", "b": "udpin:127.0.0.1:5001"}, "{name}", "one vehicle a link"),
        ({"a": "udpin:127.0.0.1:5001", "b": "tcp:127.0.0.1:5002"}, "{name}", "udp, serial or tcpin"),
        ({"a": "udpin:127.0.0.1:5001", "b": "udpin:127.0.0.1:5002"}, "one", "log.directory of its own"),
    ],
)
def test_configurations_that_do_not_fit_together_are_refused_before_anything_is_opened(
    configs, capsys, urls, logs, problem
):
    assert status_of(*configs(logs, **urls)) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("error: ")
    assert problem in line


def test_what_belongs_to_one_vehicle_is_not_an_option_of_several(configs, capsys):
    two = configs(a="udpin:127.0.0.1:0", b="udpin:127.0.0.1:0")
    assert status_of(*two, "--link", "udpin:127.0.0.1:0") == 2
    assert "are for one vehicle" in capsys.readouterr().err


class Loop:
    """A vehicle's loop that does as told: ends after so many turns, or raises."""

    def __init__(self, session, clock, stop, timeout_s, watch):
        self.session = session
        self.left = session.turns

    def turn(self, datagrams):
        self.left -= 1
        if self.left == 0 and self.session.error is not None:
            raise self.session.error

    def goes_on(self):
        return self.left > 0

    def wait_s(self):
        return 0.001

    def result(self):
        return RunResult(Counters(), Finished(True, "landed"), False, None)


def test_errors_and_even_mistakes_of_one_vehicle_leave_the_others_flying(monkeypatch, capsys):
    ends = {
        "lost": (3, UserError("link lost; plug it in")),
        "broken": (5, ZeroDivisionError("a mistake")),
        "well": (50, None),
    }
    closed, silent, reader = [], [], os.pipe()[0]

    class Opened:
        def __init__(self, config, options, shared, name):
            self.name = name

        def __enter__(self):
            turns, error = ends[self.name]
            link = SimpleNamespace(descriptor=reader, receive=lambda timeout_s: [])
            session = SimpleNamespace(turns=turns, error=error, link=link, close=lambda reason: None)
            session.fall_silent = lambda: silent.append(self.name)
            watch = SimpleNamespace(summary=dict)
            return SimpleNamespace(name=self.name, session=session, watch=watch, log=None)

        def __exit__(self, *_):
            closed.append(self.name)

    monkeypatch.setattr(cli_fleet, "open_vehicle", Opened)
    monkeypatch.setattr(cli_fleet, "RealTimeLoop", Loop)
    shared = SimpleNamespace(clock=real_time_clock(), console=SimpleNamespace(tell=lambda text: None))
    config = SimpleNamespace(link=SimpleNamespace(connect_timeout_s=1.0))
    with Fleet(shared, RunOptions(json=True), threading.Event()) as fleet:
        for name in ends:
            fleet.open(name, config)
        fleet.fly()
    said = capsys.readouterr()
    assert "error: lost: link lost; plug it in" in said.err
    assert "error: broken: a mistake" in said.err
    assert "ZeroDivisionError" in said.err, "the journal has the whole of it"
    assert silent == ["lost", "broken", "well"], "before its link is closed each may say its last words"
    summary = json.loads(said.out)
    assert (summary["vehicle"], summary["reason"]) == ("well", "landed")
    assert sorted(closed) == sorted(ends)
    assert fleet.status == 1
