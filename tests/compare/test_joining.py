"""Joining a firmware that is already running: what is refused, who is met, how the load comes and goes."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.cli import main
from kffa_offboard.compare import joining
from kffa_offboard.compare.firmware_end import FirmwareEnd, Hand
from kffa_offboard.compare.plan import ComparePlan, Join, trials
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config import bundled
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.component import Component, Message, Route
from kffa_offboard.offboard.events import SetGripper
from kffa_offboard.trials.metrics import FlightFailed
from kffa_offboard.trials.processes import free_port

JOIN = ["--join", "udpin:127.0.0.1:0"]
GRAB, OPEN = SetGripper("grab"), SetGripper("release")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ([*JOIN, "--firmware", "arducopter"], "leave out one of them"),
        (["--truth", "truth.csv"], "go with --join URL"),
        ([*JOIN, "--lockstep"], "ours is in lock-step anyway"),
        ([*JOIN, "--truth", "t.csv", "--physics-port", "9002"], "leave out one of them"),
        ([*JOIN, "--truth", "t.csv", "--load", "2"], "belong to the physics, which is running"),
        ([*JOIN, "--truth", "t.csv"], "sim-vehicle run --truth FILE"),
        (["--join", "tcp:127.0.0.1:5760"], "the firmware is met over UDP"),
        ([*JOIN, "--only", "native-tuned"], "--only native-tuned: no such trial"),
        ([*JOIN, "--config", "no-such.toml"], "no-such.toml"),
    ],
)
def test_what_cannot_be_had_is_one_line_and_status_2(
    options: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main(["compare", *options, "--out", str(tmp_path)])
    assert ended.value.code == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line


def test_only_what_a_running_firmware_can_fly_is_flown() -> None:
    """It keeps its gains, and its physics the load; other telemetry and another link are ours to make."""

    def names(join: Join) -> set[str]:
        return {trial.name for trial in trials(ComparePlan(Path("out"), full=True, join=join))}

    ours = names(Join("udpin:127.0.0.1:0"))
    assert {"native-stock", "kffa-ladrc", "release", "kffa-ladrc-50hz", "kffa-ladrc-delay"} <= ours
    assert not {"native-tuned", "kffa-ladrc-2kg", "kffa-ladrc-offset"} & ours
    assert ours - names(Join("udpin:127.0.0.1:0", truth=Path("truth.csv"))) == {"kffa-ladrc-delay"}


# ------------------------------------------------------------------------------- the gripper


def position(time_s: float, height_m: float) -> Message:
    return mavlink.MAVLink_local_position_ned_message(round(time_s * 1e3), 0.0, 0.0, -height_m, 0.0, 0.0, 0.0)


def heartbeat(armed: bool, autopilot: int = mavlink.MAV_AUTOPILOT_PX4) -> Message:
    mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, autopilot, mode, 0, 4, 3)


def works(hand: Hand, ground_m: float = 0.7, lift_off_s: float = 100.0) -> list[tuple[float, SetGripper]]:
    """When the hand does what, in a flight that begins on `ground_m` of the estimator's height."""
    done = []
    hand.see(heartbeat(armed=False))
    for k in range(600):
        time_s = 90.0 + 0.1 * k
        if k == 50:
            hand.see(heartbeat(armed=True))
        height_m = ground_m + (5.0 if time_s > lift_off_s else 0.0)
        done += [(time_s - lift_off_s, action) for action in hand.see(position(time_s, height_m))]
    return done


def test_the_load_comes_18_and_goes_28_seconds_after_lift_off() -> None:
    opened, grabbed, released = works(Hand("load"))
    assert (opened[1], grabbed[1], released[1]) == (OPEN, GRAB, OPEN)
    assert opened[0] == pytest.approx(-10.0)
    assert grabbed[0] == pytest.approx(18.1, abs=0.11)
    assert released[0] == pytest.approx(28.1, abs=0.11)


def test_the_daemons_own_release_and_the_steps_are_left_alone() -> None:
    assert [action for _, action in works(Hand("release"))] == [OPEN, GRAB]
    assert [action for _, action in works(Hand("attitude"))] == [OPEN]


# ------------------------------------------------------------------------------- who is met


@contextlib.contextmanager
def sending(url: str, message: Message, system: int) -> Iterator[None]:
    """Somebody who says one thing again and again."""
    component, end = Component(Route(own_system=system, own_component=1)), FirmwareEnd(url)
    enough = threading.Event()

    def say() -> None:
        while not enough.wait(0.05):
            end.send(component.pack(message))

    thread = threading.Thread(target=say)
    thread.start()
    try:
        yield
    finally:
        enough.set()
        thread.join()
        end.close()


def test_another_autopilot_than_asked_for_is_named(tmp_path: Path) -> None:
    truth = tmp_path / "truth.csv"
    truth.write_text("time_s\n")
    port = free_port()
    join = Join(f"udpin:127.0.0.1:{port}", truth=truth)
    plan = ComparePlan(tmp_path, "px4", join=join)
    copter = heartbeat(armed=False, autopilot=mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA)
    with (
        sending(f"udpout:127.0.0.1:{port}", copter, system=7),
        pytest.raises(UserError, match="system 7 there runs ardupilot; give --autopilot ardupilot"),
        joining.joined(plan, join),
    ):
        pass


def test_a_firmware_that_never_calls_is_said_after_a_while(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(joining, "FOUND_LIMIT_S", 0.5)
    port = free_port()
    join = Join("udpin:127.0.0.1:0", physics_port=port)
    plan = ComparePlan(tmp_path, "ardupilot", join=join)
    with (
        pytest.raises(UserError, match=f"no firmware asked for its physics on 127.0.0.1:{port} .UDP."),
        joining.joined(plan, join),
    ):
        pass


# ------------------------------------------------------------------------------- and flown


@pytest.mark.timeout(400)  # two flights of a minute each in lock-step
def test_two_flights_on_one_running_vehicle(tmp_path: Path) -> None:
    """The bundled imitation, started by somebody else; its gripper brings the load."""
    truth, out, port = tmp_path / "truth.csv", tmp_path / "out", free_port()
    document = tomllib.loads(bundled("demo-px4-vehicle.toml").read_text(encoding="utf-8"))
    patient = {"lockstep": {"enabled": True, "connect_timeout_s": 120.0, "answer_timeout_s": 60.0}}
    config = tmp_path / "vehicle.toml"
    config.write_text(toml_text(merged(document, patient)), encoding="utf-8")
    vehicle = [sys.executable, "-m", "sim_vehicle", "run", "--config", str(config)]
    vehicle += ["--link", f"udpout:127.0.0.1:{port}", "--truth", str(truth)]
    command = [sys.executable, "-m", "kffa_offboard", "compare", "--join", f"udpin:127.0.0.1:{port}"]
    command += ["--truth", str(truth), "--lockstep", "--config", str(bundled("demo-px4.toml"))]
    command += ["--only", "native-stock", "--only", "kffa-ladrc", "--json", "--out", str(out)]
    with subprocess.Popen(vehicle, stdout=subprocess.PIPE, text=True) as sim:
        try:
            assert sim.stdout is not None
            assert "in lock-step" in sim.stdout.readline()
            ended = subprocess.run(command, capture_output=True, text=True, timeout=380)
        finally:
            sim.terminate()
    assert ended.returncode == 0, ended.stderr
    results = json.loads(ended.stdout.splitlines()[-1])
    assert results["firmware"] == f"joined on udpin:127.0.0.1:{port}"
    stock, ours = (trial["load"] for trial in results["trials"])
    assert results["trials"][0]["label"] == "Hold, as it is"
    for event in ("pickup", "drop"):
        assert stock[event]["peak_m"] > 5.0 * ours[event]["peak_m"]
        assert ours[event]["peak_m"] < 0.1


def test_a_vehicle_that_is_still_armed_is_not_flown_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The row before failed in the air; the next one must not begin there."""
    monkeypatch.setattr(joining, "REST_WALL_LIMIT_S", 0.3)
    truth, port = tmp_path / "truth.csv", free_port()
    truth.write_text("time_s\n")
    join = Join(f"udpin:127.0.0.1:{port}", truth=truth)
    plan = ComparePlan(tmp_path, "px4", join=join)
    trial = trials(plan)[0]
    with (
        sending(f"udpout:127.0.0.1:{port}", heartbeat(armed=True), system=1),
        joining.joined(plan, join) as running,
    ):
        with running.flight(trial, tmp_path / "first.csv") as simulation:
            assert (simulation.target_system, simulation.lockstep) == (1, False)
        with (
            pytest.raises(FlightFailed, match="the firmware is still armed since its last flight"),
            running.flight(trial, tmp_path / "second.csv"),
        ):
            pass
