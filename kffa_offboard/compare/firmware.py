"""How the firmwares are started: command, directory, environment. Nothing here starts anything.

ArduCopter: software-in-the-loop with its JSON physics interface. PX4: software-in-the-loop with its HIL
interface; its start scripts are found on PATH, so ours come first.
"""

from __future__ import annotations

import os
import secrets
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kffa_offboard.compare.plan import AutopilotName, HeightSource, Trial
from kffa_offboard.config import bundled
from kffa_offboard.errors import UserError
from kffa_offboard.trials.processes import free_port

HOME = "47.397742,8.545594,488,0"
"""Where ArduCopter believes to start: latitude, longitude, altitude [m], heading [deg]."""

OUTPUTS_TIMEOUT_S = 0.25

PX4_AIRFRAME = "10016"
FIRST_INSTANCE, LAST_INSTANCE = 20, 220
"""PX4's system id is its instance + 1, so there are no more than 254."""

PARAMETER_FILES: dict[AutopilotName, str] = {
    "px4": "px4-hil/px4-rc.params",
    "ardupilot": "ardupilot-json.parm",
}
TUNED_FILES: dict[AutopilotName, str] = {
    "px4": "compare-px4-tuned.params",
    "ardupilot": "compare-ardupilot-tuned.parm",
}
HEIGHT_FILES: dict[HeightSource, str] = {
    "range finder": "compare-px4-range.params",
    "barometer": "compare-px4-baro.params",
}
"""What has PX4's estimate take its height from there."""


@dataclass(frozen=True)
class FirmwareProcess:
    """A firmware that is about to be started.

    Attributes
    ----------
    command, directory, environment : of its process
    physics_port : where it looks for its physics
    """

    command: tuple[str, ...]
    directory: Path
    physics_port: int
    environment: Mapping[str, str] = field(default_factory=dict)


def find_firmware(autopilot: AutopilotName, path: Path) -> Path:
    """The firmware's binary.

    For PX4 `path` may be the build directory (build/px4_sitl_default) or the binary in its bin/.
    Raises UserError if there is none.
    """
    path = path.resolve()
    if path.is_dir():
        path = path / ("bin/px4" if autopilot == "px4" else "bin/arducopter")
    if not path.is_file() or not os.access(path, os.X_OK):
        raise UserError(
            f"--firmware {path}: no program; give the "
            + ("build directory of px4_sitl_default" if autopilot == "px4" else "arducopter of a SITL build")
        )
    if autopilot == "px4" and not (path.parent.parent / "etc").is_dir():
        raise UserError(
            f"--firmware {path}: {path.parent.parent}/etc is missing; give the binary in its build directory"
        )
    return path


def parameter_files(autopilot: AutopilotName, trial: Trial) -> list[str]:
    """What a trial's firmware is given, later files over earlier ones."""
    names = [PARAMETER_FILES[autopilot]]
    if trial.tuned:
        names.append(TUNED_FILES[autopilot])
    if trial.conditions.height_source in HEIGHT_FILES:
        names.append(HEIGHT_FILES[trial.conditions.height_source])
    return names


def arducopter(binary: Path, directory: Path, link_port: int, instance: int, trial: Trial) -> FirmwareProcess:
    """ArduCopter that sends MAVLink to `link_port` on loopback; all its ports are free ones."""
    physics_port = free_port()
    names = parameter_files("ardupilot", trial)
    command = [
        str(binary),
        "--model",
        "JSON:127.0.0.1",
        "-I",
        "0",
        "--speedup",
        "1",
        "--home",
        HOME,
        "--wipe",
    ]
    command += ["--defaults", ",".join(str(bundled(name)) for name in names)]
    command += ["--sim-port-out", str(physics_port), "--sim-port-in", str(free_port())]
    command += ["--rc-in-port", str(free_port())]
    command += ["--serial0", f"udpclient:127.0.0.1:{link_port}", "--serial1", "none:", "--serial2", "none:"]
    return FirmwareProcess(tuple(command), directory, physics_port)


def px4(binary: Path, directory: Path, link_port: int, instance: int, trial: Trial) -> FirmwareProcess:
    """PX4 that sends MAVLink to `link_port` on loopback, on one link with the rates of its offboard link."""
    build = binary.parent.parent
    scripts = directory / "scripts"
    scripts.mkdir()
    parameters = "".join(bundled(name).read_text(encoding="utf-8") for name in parameter_files("px4", trial))
    (scripts / "px4-rc.params").write_text(parameters, encoding="utf-8")
    (scripts / "px4-rc.mavlink").write_text(
        f"#!/bin/sh\nmavlink start -x -u {free_port()} -r 4000000 -f -m onboard -o {link_port}\n",
        encoding="utf-8",
    )
    return FirmwareProcess(
        (str(binary), "-d", "-i", str(instance), "-w", str(directory), str(build / "etc")),
        directory,
        physics_port=4560 + instance,
        environment={
            "PATH": f"{scripts}{os.pathsep}{os.environ.get('PATH', os.defpath)}",
            "PX4_SYS_AUTOSTART": PX4_AIRFRAME,
            "PX4_SIM_HOST_ADDR": "127.0.0.1",
        },
    )


@dataclass(frozen=True)
class Firmware:
    """What the comparison must know of a firmware beside how to start it.

    Attributes
    ----------
    physics : configuration of sim-vehicle that flies it
    section : of that configuration, below [backend]
    start : makes its process
    system_id : its MAVLink system id, from its instance
    barrier_period_s : how often firmware, physics and daemon wait for each other
    answers : it answers a TIMESYNC while its time stands still
    """

    physics: str
    section: str
    start: Callable[[Path, Path, int, int, Trial], FirmwareProcess]
    system_id: Callable[[int], int]
    barrier_period_s: float
    answers: bool = False


ARDUCOPTER = Firmware("ardupilot-json-vehicle.toml", "ardupilot_json", arducopter, lambda instance: 1, 0.0025)
PX4 = Firmware("px4-hil-vehicle.toml", "px4_hil", px4, lambda instance: instance + 1, 0.004, True)


def physics_backend(
    name: Firmware, port: int, barrier_port: int, height_source: HeightSource = "default"
) -> dict[str, Any]:
    """[backend] of physics that goes as fast as the firmware can; `barrier_port` 0 for no barrier."""
    section: dict[str, Any] = {"port": port}
    if name.section == PX4.section:
        # OFFBOARD before its first setpoint stops PX4's outputs, and with them its time: go on soon.
        section |= {
            "outputs_timeout_s": OUTPUTS_TIMEOUT_S,
            "range_finder": height_source == "range finder",
        }
    backend: dict[str, Any] = {"real_time_factor": 0.0, name.section: section}
    if barrier_port:
        backend |= {"barrier_port": barrier_port, "barrier_period_s": name.barrier_period_s}
    return backend


def free_instance() -> int:
    """A PX4 instance number whose physics port nobody holds.

    Raises UserError if all are taken.
    """
    numbers = range(FIRST_INSTANCE, LAST_INSTANCE)
    start = secrets.randbelow(len(numbers))
    for k in range(len(numbers)):
        instance = numbers[(start + k) % len(numbers)]
        if _tcp_port_is_free(4560 + instance):
            return instance
    raise UserError(f"all PX4 instances from {FIRST_INSTANCE} on are taken; end those that are not needed")


def _tcp_port_is_free(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True
