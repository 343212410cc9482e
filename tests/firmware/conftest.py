"""Real firmware in software-in-the-loop: in a directory of its own, on loopback, ended by its own pid.

Nothing here is built or downloaded: KFFA_ARDUCOPTER names an `arducopter` binary built for SITL, KFFA_PX4 the
build directory of a PX4. Without it a test is skipped.
"""

from __future__ import annotations

import contextlib
import math
import os
import socket
import struct
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare import firmware, simulation
from kffa_offboard.compare.bridge import Bridge
from kffa_offboard.compare.firmware import find_firmware
from kffa_offboard.compare.flight import daemon_document, wait_for_head_start
from kffa_offboard.compare.plan import AutopilotName, Conditions, Trial, head_start_s
from kffa_offboard.compare.simulation import physics_document, start_physics
from kffa_offboard.compare.toml_text import merged, toml_text
from kffa_offboard.config import bundled
from kffa_offboard.errors import UserError
from kffa_offboard.trials.processes import flown_s, free_port, last_line, process
from sim_vehicle.backends.ardupilot_vehicle import ArdupilotVehicle
from sim_vehicle.config import load

BUILDS: dict[AutopilotName, tuple[str, str]] = {
    "ardupilot": ("KFFA_ARDUCOPTER", "an arducopter binary built for SITL"),
    "px4": ("KFFA_PX4", "a PX4 build directory (with bin/px4 and etc)"),
}
CONFIGS = Path(__file__).parents[2] / "configs"
SILENCE_S = 20.0
GUIDED = 4
POSITION_GOOD = mavlink.EKF_VELOCITY_HORIZ | mavlink.EKF_POS_HORIZ_ABS | mavlink.EKF_PRED_POS_HORIZ_ABS


def loopback() -> socket.socket:
    """A UDP socket on a free port."""
    port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    port.bind(("127.0.0.1", 0))
    return port


class ArduCopter:
    """ArduCopter and its physics in one thread: simulated time goes on only inside `run`.

    `heard` has the last message of each type; `texts` all STATUSTEXTs.
    """

    def __init__(self, binary: Path, directory: Path, sections: dict[str, dict[str, Any]]) -> None:
        self.vehicle = ArdupilotVehicle(load(CONFIGS / "ardupilot-json-vehicle.toml", sections))
        self.heard: dict[str, Any] = {}
        self.texts: list[str] = []
        self._binary, self._directory = binary, directory
        self._physics, self._station = loopback(), loopback()
        self._physics.settimeout(SILENCE_S)
        self._station.setblocking(False)
        self._codec = mavlink.MAVLink(file=None, srcSystem=255, srcComponent=190)
        self._codec.robust_parsing = True
        self._address: Any = None
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def time_s(self) -> float:
        return self.vehicle.plant.time_us * 1e-6

    def start(self) -> None:
        """Power up; a vehicle with default parameters the first time."""
        with loopback() as other:
            rc_port = other.getsockname()[1]
        command = [
            *(str(self._binary), "--model", "JSON:127.0.0.1"),
            *("--sim-port-out", str(self._physics.getsockname()[1]), "--rc-in-port", str(rc_port)),
            *("--defaults", str(CONFIGS / "ardupilot-json.parm")),
            *("--serial0", f"udpclient:127.0.0.1:{self._station.getsockname()[1]}"),
            *("--serial1", "none:0", "--serial2", "none:0"),
        ]
        with (self._directory / "arducopter.log").open("ab") as log:
            self._process = subprocess.Popen(
                command, cwd=self._directory, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT
            )

    def stop(self) -> None:
        """Power down at once."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def close(self) -> None:
        self.stop()
        self._physics.close()
        self._station.close()

    def run(self, limit_s: float, until: Callable[[], object] = lambda: False) -> bool:
        """Let simulated time pass until `until` holds; False if it does not within `limit_s`."""
        end = self.time_s + limit_s
        while not until():
            if self.time_s >= end:
                return False
            for _ in range(8):  # 10 ms
                data, peer = self._physics.recvfrom(1024)
                answer = self.vehicle.receive([(peer, data)])
                if answer is not None:
                    self._physics.sendto(answer.data, peer)
            self._listen()
        return True

    def _listen(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                data, self._address = self._station.recvfrom(4096)
                for message in self._codec.parse_buffer(data) or []:
                    self.heard[message.get_type()] = message
                    if message.get_type() == "STATUSTEXT":
                        self.texts.append(message.text)

    def ask(self, number: int, *parameters: float) -> int | None:
        """Result of a COMMAND_LONG, None if none comes within 3 s of simulated time."""
        values = [*parameters, *[0.0] * (7 - len(parameters))]
        message = mavlink.MAVLink_command_long_message(1, 1, number, 0, *values)
        self.heard.pop("COMMAND_ACK", None)
        self._station.sendto(message.pack(self._codec), self._address)
        if not self.run(3.0, lambda: "COMMAND_ACK" in self.heard):
            return None
        acknowledgement = self.heard["COMMAND_ACK"]
        assert acknowledgement.command == number
        return int(acknowledgement.result)

    def take_off(self, height_m: float) -> None:
        """Wait for a position, arm in GUIDED, take off and settle."""
        assert self.run(30.0, lambda: "HEARTBEAT" in self.heard), "no HEARTBEAT"
        self.ask(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT, 200_000)
        assert self.run(90.0, self._has_position), self.texts
        assert self.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, GUIDED) == mavlink.MAV_RESULT_ACCEPTED
        for _ in range(10):
            if self.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED:
                break
            self.run(2.0)
        else:
            raise AssertionError(self.texts)
        assert self.ask(mavlink.MAV_CMD_NAV_TAKEOFF, *[0] * 6, height_m) == mavlink.MAV_RESULT_ACCEPTED
        self.run(25.0)

    def _has_position(self) -> bool:
        report = self.heard.get("EKF_STATUS_REPORT")
        return report is not None and report.flags & POSITION_GOOD == POSITION_GOOD


@pytest.fixture(scope="session")
def firmware_binary() -> Callable[[AutopilotName], Path]:
    """Finds the program of "px4" or "ardupilot"; skips the test if none is named."""

    def find(autopilot: AutopilotName) -> Path:
        variable, what = BUILDS[autopilot]
        named = os.environ.get(variable, "")
        if not named:
            pytest.skip(f"{variable} does not name {what}")
        try:
            return find_firmware(autopilot, Path(named))
        except UserError as problem:
            pytest.fail(f"{variable}: {problem}")

    return find


@pytest.fixture(scope="module")
def arducopter(
    firmware_binary: Callable[[AutopilotName], Path], tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., ArduCopter]]:
    """Makes ArduCopters, not yet started; keyword arguments are sections of the vehicle's configuration."""
    binary = firmware_binary("ardupilot")
    with contextlib.ExitStack() as stack:

        def make(**sections: dict[str, Any]) -> ArduCopter:
            copter = ArduCopter(binary, tmp_path_factory.mktemp("arducopter"), sections)
            stack.callback(copter.close)
            return copter

        yield make


@contextlib.contextmanager
def _flying_firmware(
    autopilot: Any, binary: Path, directory: Path, trial: Trial, start: Any = None
) -> Iterator[tuple[str, int, Path]]:
    """Physics and firmware in real time, ready to fly; the daemon's link, the system id and the truth.

    `start` instead of the firmware's own way of being started.
    """
    name = firmware.PX4 if autopilot == "px4" else firmware.ARDUCOPTER
    instance, port, truth = firmware.free_instance(), free_port(), directory / "truth.csv"
    (directory / "firmware").mkdir()
    made = (start or name.start)(binary, directory / "firmware", port, instance, trial)
    backend = {"real_time_factor": 1.0, name.section: {"port": made.physics_port}}
    physics = tomllib.loads(bundled(name.physics).read_text(encoding="utf-8"))
    with contextlib.ExitStack() as stack:
        document = physics_document(merged(physics, {"backend": backend}), trial)
        start_physics(directory / "flight", truth, document, stack)
        output = stack.enter_context((directory / "firmware.log").open("w", encoding="utf-8"))
        stack.enter_context(
            process(
                made.command,
                patience_s=2.0,
                cwd=directory / "firmware",
                env={**os.environ, **made.environment},
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        )
        limit = time.monotonic() + 200.0
        while flown_s(truth) < head_start_s(autopilot, trial.conditions):
            assert time.monotonic() < limit, "the firmware does not boot"
            time.sleep(0.2)
        yield f"udpin:127.0.0.1:{port}", name.system_id(instance), truth


@pytest.fixture(scope="session")
def flying_firmware() -> Callable[..., contextlib.AbstractContextManager[tuple[str, int, Path]]]:
    """Flies a firmware in real time."""
    return _flying_firmware


def _fly_in_lockstep(
    autopilot: AutopilotName,
    binary: Path,
    directory: Path,
    output: str,
    changes: dict[str, Any],
    wind: bool = False,
    over: Callable[[Any], bool] | None = None,
    bridge: type[Bridge] = Bridge,
    load_s: tuple[float, float] = (500.0, 600.0),
    vehicle: dict[str, Any] | None = None,
) -> str:
    """One flight of the daemon with `changes` of its configuration; the last line that it said.

    The load comes and goes at `load_s` after lift-off; `vehicle` are changes of the simulator's file.

    With `over` simulated time goes on until that holds of the bridge; a daemon still there is told to end.
    """
    setup = simulation.Setup(autopilot, binary, directory)
    trial = Trial("flight", "", "kffa-ladrc", output, conditions=Conditions(wind=wind))
    with pytest.MonkeyPatch.context() as patch, contextlib.ExitStack() as stack:
        patch.setattr("kffa_offboard.compare.bridge.Bridge", bridge)
        patch.setattr(simulation, "PICKUP_S", load_s[0])
        patch.setattr(simulation, "DROP_S", load_s[1])
        made = simulation.physics_document
        patch.setattr(simulation, "physics_document", lambda *given: merged(made(*given), vehicle or {}))
        running = stack.enter_context(simulation.simulation(setup, trial))
        wait_for_head_start(running, lambda time_s, text: None)
        document = merged(daemon_document(setup, trial, running), changes)
        config = directory / "flight.toml"
        config.write_text(toml_text(merged(document, {"control": {"output": output}})), encoding="utf-8")
        command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config), "--lockstep"]
        command += ["--log", str(directory / "flight.tlog"), "--arm", "--engage", "--fix-params"]
        with (
            (directory / "daemon.log").open("w", encoding="utf-8") as said,
            process(command, stdout=said, stderr=subprocess.STDOUT) as daemon,
        ):
            assert running.bridge is not None
            limit = time.monotonic() + 600.0
            while daemon.poll() is None if over is None else not over(running.bridge):
                assert time.monotonic() < limit, "the flight does not end"
                if daemon.poll() is not None:
                    running.bridge.let_go()
                time.sleep(0.1)
            daemon.terminate()
            daemon.wait(60.0)
            running.bridge.let_go()
    return last_line(directory / "daemon.log")


class ActingBridge(Bridge):
    """Beside the daemon a ground station (255) acts on the firmware; derive from it for each flight.

    Attributes
    ----------
    acts : times after lift-off [s] and what is sent then, given the firmware's system id, in order
    lifted_s : simulated time of lift-off
    acted_s : simulated times of what was sent
    """

    acts: ClassVar[list[tuple[float, Callable[[int], list[Any]]]]]
    acted_s: ClassVar[list[float]]
    lifted_s: ClassVar[float] = math.inf
    ground_m: ClassVar[float] = 0.0
    armed: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        cls.acts, cls.acted_s = [], []

    def _hear_firmware(self) -> bool:
        answered, kind = super()._hear_firmware(), type(self)
        for _, frame in self._to_daemon:
            number = int.from_bytes(frame[7:10], "little")
            if number == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                kind.armed, self._system = bool(frame[16] & mavlink.MAV_MODE_FLAG_SAFETY_ARMED), frame[5]
            elif number == mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED and kind.lifted_s == math.inf:
                (down,) = struct.unpack_from("<f", frame, 22)
                if not kind.armed:  # an estimate that is settling wanders
                    kind.ground_m = -down
                elif -down - kind.ground_m > 0.3:
                    kind.lifted_s = self.time_s
        while kind.acts and self.time_s > kind.lifted_s + kind.acts[0][0]:
            _, messages = kind.acts.pop(0)
            kind.acted_s.append(self.time_s)
            for message in messages(self._system):
                self._firmware.send(message.pack(mavlink.MAVLink(None, 255, 190)))
        return answered


@pytest.fixture(scope="session")
def acting_bridge() -> type[ActingBridge]:
    """To derive from."""
    return ActingBridge


@pytest.fixture(scope="session")
def fly_in_lockstep() -> Callable[..., str]:
    """Flies the daemon on a firmware, in lock-step, as `kffa-offboard compare` does."""
    return _fly_in_lockstep
