"""What the benchmarks share: percentiles, table, results.json, and a vehicle that only sends telemetry."""

from __future__ import annotations

import contextlib
import json
import os
import platform
import random
import select
import socket
import struct
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink
from rich.console import Console
from rich.table import Table

RESULTS = Path(__file__).parent / "results.json"
SO_TIMESTAMPNS = 35  # Linux: the kernel says when a datagram arrived
AWAKE = "[realtime]\nenabled = true\nrequired = false\nkeep_awake = true\n"
OFFBOARD = 6 << 16  # PX4's custom_mode
POSITION = 3 << 16


def percentiles(seconds: list[float]) -> dict[str, float]:
    """Median and 99th percentile, us, and how many there were."""
    ordered = sorted(seconds)
    at = [ordered[min(len(ordered) - 1, int(share * len(ordered)))] * 1e6 for share in (0.5, 0.99)]
    return {"p50_us": round(at[0], 1), "p99_us": round(at[1], 1), "samples": len(ordered)}


def machine() -> dict[str, Any]:
    """Where and with what this was measured; the load says whether others were busy there, too."""
    packages = ("numpy", "filterpy", "pymavlink", "fastcrc", "pydantic")
    return {
        "platform": platform.platform(),
        "cores": os.cpu_count(),
        "load_average": os.getloadavg(),
        "python": platform.python_version(),
        "versions": {name: version(name) for name in packages},
    }


def save(section: str, rows: dict[str, dict[str, Any]]) -> None:
    """Print the rows as a table and put them into results.json, beside those of the other benchmarks."""
    columns = list(dict.fromkeys(key for row in rows.values() for key in row))
    table = Table("", *columns, title=section)
    for name, row in rows.items():
        table.add_row(name, *(str(row.get(key, "")) for key in columns))
    Console().print(table)
    results = json.loads(RESULTS.read_text()) if RESULTS.exists() else {}
    results[section] = {"machine": machine(), "rows": rows}
    RESULTS.write_text(json.dumps(results, indent=2) + "\n")


class Probe:
    """A hovering PX4 as a companion computer sees it; the process under test listens on `port`.

    Its sensors are a little noisy: telemetry that repeats itself to the last bit is what a dead sensor
    sends, and forbids engaging.

    `arrived_ns` is when the last datagram that was heard had arrived, by the kernel's clock: what this
    process takes to wake up is not in it.
    """

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.arrived_ns = 0
        self._mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._parser = mavlink.MAVLink(None)
        self._parser.robust_parsing = True
        self._mode = POSITION
        self._began = time.perf_counter()
        self._random = random.Random(0)

    def fileno(self) -> int:
        """For select."""
        return self._socket.fileno()

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def send(self, message: Any) -> int:
        """One datagram, and when it was handed over, ns; nobody listening yet is no error."""
        frame = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        sent_ns = time.time_ns()
        with contextlib.suppress(ConnectionRefusedError):
            self._socket.send(frame)
        return sent_ns

    def heartbeat(self) -> None:
        """Armed, in the air."""
        armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self.send(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, armed, self._mode, 4, 3
            )
        )
        self.send(mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR))
        self.send(mavlink.MAVLink_vfr_hud_message(0.0, 0.0, 0, 40, 5.0, 0.0))

    def _boot_ms(self) -> int:
        return int((time.perf_counter() - self._began) * 1e3) + 1000

    def attitude(self) -> int:
        """Level; when it was handed over, ns."""
        return self.send(mavlink.MAVLink_attitude_message(self._boot_ms(), *self._noise(6, 1e-4)))

    def position(self) -> None:
        """5 m above the origin."""
        x, y, z, *velocity = self._noise(6, 1e-3)
        self.send(mavlink.MAVLink_local_position_ned_message(self._boot_ms(), x, y, z - 5.0, *velocity))

    def _noise(self, count: int, deviation: float) -> list[float]:
        return [self._random.gauss(0.0, deviation) for _ in range(count)]

    def hear(self, timeout_s: float) -> list[str]:
        """Names of what arrives within the time, at once when something does; modes asked for are taken."""
        if not select.select([self._socket], [], [], max(0.0, timeout_s))[0]:
            return []
        try:
            frame, ((_, _, stamp),), _, _ = self._socket.recvmsg(65535, socket.CMSG_SPACE(16))
        except ConnectionRefusedError:
            return []
        seconds, rest_ns = struct.unpack("qq", stamp)
        self.arrived_ns = seconds * 1_000_000_000 + rest_ns
        names = []
        for message in self._parser.parse_buffer(frame) or []:
            names.append(message.get_type())
            if message.get_type() == "COMMAND_LONG":
                if message.command == mavlink.MAV_CMD_DO_SET_MODE:
                    self._mode = OFFBOARD
                self.send(mavlink.MAVLink_command_ack_message(message.command, 0, 0, 0, 245, 191))
                self.heartbeat()
        return names

    def round_trips(self, rate_hz: float, duration_s: float) -> tuple[list[float], int]:
        """From handing over every ATTITUDE to the arrival of the SET_ATTITUDE_TARGET that answers it, s.

        Then how many had none.
        """
        trips: list[float] = []
        period, missed = 1.0 / rate_hz, 0
        for number in range(round(duration_s * rate_hz)):
            began = time.perf_counter()
            if number % round(rate_hz / 5.0) == 0:
                self.heartbeat()
            self.position()
            while (left := began + period / 2 - time.perf_counter()) > 0.0:
                self.hear(left)  # whatever else the other side says
            sent_ns = self.attitude()
            # Until it answers at all, the rate must be kept; a late answer is waited for.
            end, answered = time.perf_counter() + (5.0 if trips else 0.4) * period, False
            while not answered and (left := end - time.perf_counter()) > 0.0:
                answered = "SET_ATTITUDE_TARGET" in self.hear(left)
            if answered:
                trips.append((self.arrived_ns - sent_ns) * 1e-9)
            else:
                missed += 1
            time.sleep(max(0.0, began + period - time.perf_counter()))
        return trips, missed


def free_port() -> int:
    """A UDP port that nobody uses."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.bind(("127.0.0.1", 0))
        return int(asking.getsockname()[1])


def daemon_config(directory: Path, port: int) -> Path:
    """The demonstration's configuration on a port of its own, holding where it is."""
    text = (Path(__file__).parents[1] / "configs" / "demo-px4.toml").read_text()
    text = text[: text.index("[scenario]")].replace("127.0.0.1:14540", f"127.0.0.1:{port}")
    text += "[autopilot]\ncheck_parameters = false\n"
    hold = '[scenario]\n[[scenario.segment]]\ntype = "hold"\nduration_s = 600\n'
    path = directory / "daemon.toml"
    path.write_text(text + hold)
    return path
