"""The daemon on unmodified firmware: parameters put right and back, a load weighed, component 191 heard.

One short flight with each firmware (take-off, pick-up, drop, landing), in lock-step as in the comparison;
a ground station sits on a second link of the firmware, which passes on what is said. With `--bless` its log
becomes the golden one that tests/system/test_golden_flights.py replays without any firmware.
"""

from __future__ import annotations

import gzip
import json
import math
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare import firmware, simulation
from kffa_offboard.compare.flight import daemon_document, wait_for_head_start
from kffa_offboard.compare.plan import Trial
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config_log import config_of
from kffa_offboard.flightlog.signals import is_signals
from kffa_offboard.flightlog.tlog import TIMESTAMP, read_tlog
from kffa_offboard.mavlink.parameters import decode_value, name_of
from kffa_offboard.replay.compare import compare
from kffa_offboard.replay.engine import replay
from kffa_offboard.replay.recording import Recording, read_recording
from kffa_offboard.trials.metrics import Truth, read_truth
from kffa_offboard.trials.processes import last_line, process

pytestmark = pytest.mark.timeout(900)

GOLDEN = Path(__file__).parents[1] / "golden" / "flights"
PUT_RIGHT = {
    "ardupilot": {"GUID_OPTIONS": (0, 8), "GUID_TIMEOUT": (3, 0.5), "ATC_ANGLE_BOOST": (1, 0)},
    "px4": {"COM_OF_LOSS_T": (2, 1), "COM_OBL_RC_ACT": (7, 5)},
}
"""What the firmware was started with, and what the daemon flies with."""


HEIGHT_M, PICKUP_S, DROP_S, END_S = 2.0, 5.5, 8.0, 9.0
"""Times are seconds since lift-off."""

BARRIER_PERIOD_S = {"ardupilot": 0.005, "px4": 0.004}
"""Barriers are most of the log. With 8 ms the gains for PX4 swing: the commands act 8 ms later."""

OUTPUT = {"ardupilot": "attitude", "px4": "rates"}
OMEGA_C = b"ALT_OMEGA_C"
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32


@dataclass
class Station:
    """A ground station on loopback; the daemon is reached through the firmware.

    Attributes
    ----------
    heard : everything
    tuned_s : when the daemon confirmed the new value, by its own clock
    """

    heard: list[Any] = field(default_factory=list)
    tuned_s: float = 0.0

    def __post_init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.1)
        self.port = int(self._socket.getsockname()[1])
        self._mav: Any = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
        self._mav.robust_parsing = True
        self._peer: Any = None
        self._next_heartbeat = 0.0

    def close(self) -> None:
        self._socket.close()

    def send(self, message: Any) -> None:
        self._socket.sendto(message.pack(self._mav), self._peer)
        self._mav.seq = (self._mav.seq + 1) % 256

    def of_daemon(self, kind: str) -> list[Any]:
        return [m for m in self.heard if m.get_type() == kind and m.get_srcSystem() == 245]

    def listen(self) -> None:
        """Take in what came, for a moment."""
        try:
            data, self._peer = self._socket.recvfrom(65535)
        except TimeoutError:
            return
        self.heard += self._mav.parse_buffer(data) or []
        if time.monotonic() >= self._next_heartbeat:  # so that the firmware learns where we are
            self._next_heartbeat = time.monotonic() + 0.5
            self.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3))

    def wait(self, until: Callable[[], object], limit_s: float = 300.0) -> None:
        end = time.monotonic() + limit_s
        while not until():
            assert time.monotonic() < end, f"the daemon said {[m.text for m in self.of_daemon('STATUSTEXT')]}"
            self.listen()

    def named(self, name: str) -> list[Any]:
        return [m for m in self.of_daemon("NAMED_VALUE_FLOAT") if m.name == name]

    def ask(self, request: Any, answers: int = 1) -> None:
        """Send a request that so many PARAM_VALUE answer."""
        expected = len(self.of_daemon("PARAM_VALUE")) + answers
        self.send(request)
        self.wait(lambda: len(self.of_daemon("PARAM_VALUE")) >= expected)

    def fetch_rest(self) -> None:
        """Firmwares lose some of what they pass on; what is missing is asked for, as ground stations do."""
        every = set(range(self.of_daemon("PARAM_VALUE")[0].param_count))
        heard_at, known = time.monotonic(), 0
        while missing := every - {m.param_index for m in self.of_daemon("PARAM_VALUE")}:
            self.listen()
            if len(missing) != known:
                heard_at, known = time.monotonic(), len(missing)
            if time.monotonic() - heard_at > 0.3:
                heard_at = time.monotonic()
                for index in sorted(missing)[:5]:
                    self.send(mavlink.MAVLink_param_request_read_message(245, 191, b"", index))

    def tune(self) -> None:
        """In the air: the list, one value read, one set, and one that is refused."""
        self.wait(lambda: any(m.value > 0.9 * HEIGHT_M for m in self.named("ALT_EST")))
        self.ask(mavlink.MAVLink_param_request_list_message(245, 191))
        self.fetch_rest()
        (value,) = {m.param_value for m in self.of_daemon("PARAM_VALUE") if m.param_id == OMEGA_C.decode()}
        self.ask(mavlink.MAVLink_param_request_read_message(245, 191, OMEGA_C, -1))
        for wanted in (value - 0.5, 1e4):
            self.ask(mavlink.MAVLink_param_set_message(245, 191, OMEGA_C, wanted, REAL32))
        self.tuned_s = self.of_daemon("NAMED_VALUE_FLOAT")[-1].time_boot_ms * 1e-3


@dataclass
class DaemonFlight:
    """What is left of one flight; times are the simulation's, s."""

    autopilot: str
    log: Path
    truth: Truth
    station: Station
    summary: dict[str, Any]
    recording: Recording

    def truth_of(self, event: str) -> float:
        (time_s,) = [t for t, text in self.truth.events if text.startswith(event)]
        return time_s

    def of_firmware(self, kind: str) -> list[tuple[float, Any]]:
        return [
            (t * 1e-6, message)
            for t, message in self.recording.incoming
            if getattr(message, "get_type", str)() == kind and message.get_srcComponent() == 1
        ]

    def of_daemon(self, kind: str) -> list[tuple[float, Any]]:
        parser = mavlink.MAVLink(None)
        sent = [(t * 1e-6, parser.decode(bytearray(frame))) for t, frame in self.recording.sent]
        return [(t, message) for t, message in sent if message.get_type() == kind]

    def parameter_values(self, name: str) -> list[float]:
        """What the firmware said a parameter was, each time."""
        encoding = "bytewise" if self.autopilot == "px4" else "c-cast"
        return [
            decode_value(message.param_value, message.param_type, encoding)
            for _, message in self.of_firmware("PARAM_VALUE")
            if name_of(message) == name
        ]

    def said(self, beginning: str) -> tuple[float, str]:
        """The first announcement that begins so; PX4's flights ring, and had a "picked up 0.3 kg" later."""
        found, *more = [(t, m.text) for t, m in self.of_daemon("STATUSTEXT") if m.text.startswith(beginning)]
        assert all(float(text.split()[2]) < 0.5 for _, text in more if "picked" in text)
        return found

    def said_values(self, name: str) -> list[tuple[float, float]]:
        return [(t, m.value) for t, m in self.of_daemon("NAMED_VALUE_FLOAT") if m.name == name]


def with_second_link(start: Callable[..., Any], port: int, wrong: dict[str, float]) -> Callable[..., Any]:
    """`start` of a firmware, with the ground station's link and with parameters that must be put right."""

    def started(binary: Path, directory: Path, *arguments: Any) -> Any:
        made = start(binary, directory, *arguments)
        if made.environment:  # PX4: its start scripts
            scripts = directory / "scripts"
            with (scripts / "px4-rc.params").open("a", encoding="utf-8") as file:
                file.writelines(f"param set-default {name} {value}\n" for name, value in wrong.items())
            links = scripts / "px4-rc.mavlink"
            text = links.read_text(encoding="utf-8").replace("-m onboard", "-m minimal")
            local = firmware.free_port()
            links.write_text(
                f"{text}mavlink start -x -u {local} -r 4000000 -f -m minimal -o {port}\n", encoding="utf-8"
            )
            return made
        file = directory / "wrong.parm"
        file.write_text("".join(f"{name} {value}\n" for name, value in wrong.items()), encoding="utf-8")
        command = list(made.command)
        command[command.index("--defaults") + 1] += f",{file}"
        command[command.index("--serial1") + 1] = f"udpclient:127.0.0.1:{port}"
        return replace(made, command=tuple(command))

    return started


def scenario() -> dict[str, Any]:
    takeoff = {"type": "takeoff", "altitude_m": HEIGHT_M, "climb_rate_m_s": 1.0}
    land = {"type": "land", "descent_rate_m_s": 1.0}
    return {"segment": [takeoff, {"type": "hold", "duration_s": END_S - HEIGHT_M}, land]}


def fly(autopilot: Any, binary: Path, directory: Path, station: Station) -> dict[str, Any]:
    """The daemon from its start to its end, and the ground station meanwhile; the daemon's summary."""
    setup = simulation.Setup(autopilot, binary, directory)
    trial = Trial("flight", "", "kffa-ladrc", OUTPUT[autopilot])
    with simulation.simulation(setup, trial) as running:
        wait_for_head_start(running, lambda time_s, text: None)
        changes = {
            "scenario": scenario(),
            "signals": {"rate_hz": 2.0},
            "sequence": {"disarm_timeout_s": 2.0},  # ArduCopter often refuses: LAND mode soon
            "payload": {"max_load_kg": 4.0},
            "control": {"output": OUTPUT[autopilot]},
        }
        config = directory / "flight.toml"
        config.write_text(
            toml_text(merged(daemon_document(setup, trial, running), changes)), encoding="utf-8"
        )
        command = [
            sys.executable,
            "-m",
            "kffa_offboard",
            "run",
            "--config",
            str(config),
            "--lockstep",
            "--json",
        ]
        command += ["--log", str(directory / "flight.tlog"), "--arm", "--engage", "--fix-params"]
        with (
            (directory / "daemon.log").open("w", encoding="utf-8") as said,
            process(command, stdout=subprocess.PIPE, stderr=said) as daemon,
        ):
            station.tune()
            station.wait(lambda: daemon.poll() is not None)
            assert daemon.stdout is not None and running.bridge is not None
            running.bridge.let_go()
            lines = daemon.stdout.read().splitlines()
            assert lines, last_line(directory / "daemon.log")
            return dict(json.loads(lines[-1]))


@pytest.fixture(scope="module", params=["ardupilot", "px4"])
def flight(
    request: pytest.FixtureRequest,
    firmware_binary: Callable[[str], Path],
    tmp_path_factory: pytest.TempPathFactory,
) -> Any:
    autopilot, directory = request.param, tmp_path_factory.mktemp(request.param)
    binary, station = firmware_binary(autopilot), Station()
    name = "ARDUCOPTER" if autopilot == "ardupilot" else "PX4"
    plain = getattr(firmware, name)
    wrong = {key: value for key, (value, _) in PUT_RIGHT[autopilot].items()}
    changed = replace(
        plain,
        start=with_second_link(plain.start, station.port, wrong),
        barrier_period_s=BARRIER_PERIOD_S[autopilot],
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(firmware, name, changed)
        patch.setattr(simulation, "PICKUP_S", PICKUP_S)
        patch.setattr(simulation, "DROP_S", DROP_S)
        summary = fly(autopilot, binary, directory, station)
    station.close()
    log = directory / "flight.tlog"
    truth = read_truth(directory / "flight-truth.csv")
    return DaemonFlight(autopilot, log, truth, station, summary, read_recording(log))


def test_the_flight_ends_on_the_ground_with_nothing_left_behind(flight: Any) -> None:
    assert flight.summary["reason"] in ("scenario done, landed", "disarming was refused"), flight.summary
    assert flight.truth.z[-1] < 0.05
    assert flight.truth.z.max() == pytest.approx(HEIGHT_M, abs=0.2)
    assert not list(flight.log.parent.glob("changed-parameters-*"))


def test_parameters_are_put_right_before_the_flight_and_back_after_it(flight: Any) -> None:
    for name, (wrong, right) in PUT_RIGHT[flight.autopilot].items():
        history = flight.parameter_values(name)
        changes = [value for k, value in enumerate(history) if k == 0 or value != history[k - 1]]
        assert changes == pytest.approx([wrong, right, wrong]), name


def test_the_load_is_weighed_within_5_percent_a_second_after_the_pick_up(flight: Any) -> None:
    reports = flight.said_values("payload_kg")
    pick_up, drop = flight.truth_of("pick-up"), flight.truth_of("drop")
    loaded = [mass for t, mass in reports if pick_up + 1.0 <= t < drop]
    assert len(loaded) >= 7
    assert loaded == pytest.approx([5.0] * len(loaded), abs=0.25)


def test_pick_up_drop_and_overload_are_announced_and_the_drop_within_0_3_s(flight: Any) -> None:
    pick_up, drop = flight.truth_of("pick-up"), flight.truth_of("drop")
    picked = flight.said("picked up ")
    dropped = flight.said("dropped ")
    assert 0.0 < picked[0] - pick_up < 1.0
    assert picked[1] in ("picked up 4.9 kg", "picked up 5.0 kg", "picked up 5.1 kg")
    assert 0.0 < dropped[0] - drop < 0.3
    assert dropped[1] in ("dropped 4.9 kg", "dropped 5.0 kg", "dropped 5.1 kg")
    assert pick_up < flight.said("load of ")[0] < drop


def test_a_ground_station_on_the_firmwares_other_link_tunes_the_daemon_in_flight(flight: Any) -> None:
    station = flight.station
    names = {message.param_id for message in station.of_daemon("PARAM_VALUE")}
    (count,) = {message.param_count for message in station.of_daemon("PARAM_VALUE")}
    assert len(names) == count > 30
    values = [m.param_value for m in station.of_daemon("PARAM_VALUE") if m.param_id == "ALT_OMEGA_C"]
    before = values[0]
    assert values[-3:] == pytest.approx([before, before - 0.5, before - 0.5])
    assert any("ALT_OMEGA_C" in message.text for message in station.of_daemon("STATUSTEXT"))
    assert np.interp(station.tuned_s, flight.truth.time_s, flight.truth.z) > 0.5 * HEIGHT_M


def test_the_inner_signals_reach_the_ground_station(flight: Any) -> None:
    """Of so many messages at once PX4 passes on neither the last few (the commands) nor the large array."""
    station = flight.station
    named = {message.name for message in station.of_daemon("NAMED_VALUE_FLOAT")}
    channels = ("ROLL", "PITCH", "YAW", "ALT")
    assert named >= {f"{c}_{s}" for c in channels for s in ("REF", "EST", "DIST", "WC")}
    arrays = station.of_daemon("DEBUG_FLOAT_ARRAY")
    assert {message.name for message in arrays} == ({"kffa"} if flight.autopilot == "ardupilot" else set())
    estimates = [m.value for m in station.of_daemon("NAMED_VALUE_FLOAT") if m.name == "ALT_EST"]
    assert max(estimates) == pytest.approx(HEIGHT_M, abs=0.3)
    level = [m.value for m in station.of_daemon("NAMED_VALUE_FLOAT") if m.name in ("ROLL_EST", "PITCH_EST")]
    assert max(abs(angle) for angle in level) < math.radians(5.0)


def test_its_log_replays_to_the_same_bytes(flight: Any) -> None:
    recording = flight.recording
    found = compare(recording, replay(recording, config_of(recording.header, flight.log)))
    assert found.difference is None
    assert found.frames > 3000


def test_what_happened_is_kept_on_request(flight: Any, request: pytest.FixtureRequest) -> None:
    """Last: with --bless this flight becomes the golden one, without its own record of the inner signals."""
    if not request.config.getoption("--bless"):
        pytest.skip("only with --bless")
    name = f"real-{flight.autopilot}"
    parser = mavlink.MAVLink(None)
    with (
        (GOLDEN / f"{name}.tlog.gz").open("wb") as file,
        gzip.GzipFile(filename="", fileobj=file, mode="wb", mtime=0) as packed,
    ):
        for time_us, frame in read_tlog(flight.log).frames():
            if not is_signals(parser.decode(bytearray(frame))):
                packed.write(TIMESTAMP.pack(time_us) + frame)
    facts = GOLDEN / "real-flights.json"
    known = json.loads(facts.read_text(encoding="utf-8")) if facts.exists() else {}
    known[name] = {
        "load_kg": 5.0,
        "pick_up_s": flight.truth_of("pick-up"),
        "drop_s": flight.truth_of("drop"),
    }
    facts.write_text(json.dumps(known, indent=1, sort_keys=True) + "\n", encoding="utf-8")
