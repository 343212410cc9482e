"""MAVProxy, as people install it, lists and sets the daemon's own parameters, by a router beside a vehicle.

Real time, over UDP. Needs the extra "clients".
"""

from __future__ import annotations

import os
import select
import socket
import subprocess
import sys
import sysconfig
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from kffa_offboard.config import bundled, load
from kffa_offboard.config_log import make_companion
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import real_time_clock, run_real_time
from kffa_offboard.offboard.service import Service

pytest.importorskip(
    "MAVProxy", reason='extra "clients" is not installed: no MAVProxy; pip install "kffa-offboard[clients]"'
)

MAVPROXY = Path(sysconfig.get_path("scripts")) / "mavproxy.py"
PATIENCE_S = 40.0


class Router(threading.Thread):
    """Passes every datagram on to the other two, as mavlink-router does."""

    def __init__(self, vehicle: tuple[str, int], daemon: tuple[str, int]) -> None:
        super().__init__()
        self._sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(3)]
        for each in self._sockets:
            each.bind(("127.0.0.1", 0))
        self.port = self._sockets[2].getsockname()[1]
        self._peers: list[Any] = [vehicle, daemon, None]
        self._stopped = threading.Event()
        self._sockets[0].sendto(b"\0", vehicle)  # a listening vehicle answers whoever calls

    def run(self) -> None:
        while not self._stopped.is_set():
            for ready in select.select(self._sockets, [], [], 0.1)[0]:
                source = self._sockets.index(ready)
                data, self._peers[source] = ready.recvfrom(2048)
                for other in range(3):
                    if other != source and self._peers[other] is not None:
                        self._sockets[other].sendto(data, self._peers[other])
        for each in self._sockets:
            each.close()

    def stop(self) -> None:
        self._stopped.set()
        self.join()


@pytest.fixture
def router(vehicle_process: Callable[..., Any], tmp_path: Path) -> Iterator[Router]:
    """Vehicle, daemon (shadow) and a router between them."""
    config = load(bundled("demo-px4.toml"))
    clock, stop, route = real_time_clock(), threading.Event(), Route()
    link = open_link("udpin:127.0.0.1:0", clock, allow_remote=False)
    companion = make_companion(config, route)
    session = Session(Service(config.service), link, route, companion=companion, compare_clocks=True)
    options = {"connect_timeout_s": PATIENCE_S}
    daemon = threading.Thread(target=run_real_time, args=(session, clock, stop), kwargs=options)
    with vehicle_process("px4", "udp", tmp_path / "truth.csv") as address:
        made = Router(("127.0.0.1", int(address.split(":")[1])), ("127.0.0.1", int(link.name.split(":")[2])))
        made.start()
        daemon.start()
        try:
            yield made
        finally:
            stop.set()
            daemon.join()
            made.stop()
            link.close()


def test_mavproxy_lists_and_sets_the_parameters_of_component_191(router: Router, tmp_path: Path) -> None:
    command = [sys.executable, "-u", str(MAVPROXY), f"--master=udpout:127.0.0.1:{router.port}"]
    command += ["--state-basedir", str(tmp_path), "--default-modules=link,param,cmdlong"]
    said: list[str] = []
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "HOME": str(tmp_path)},
    ) as proxy:
        assert proxy.stdin is not None and proxy.stdout is not None
        reader = threading.Thread(target=lambda: said.extend(proxy.stdout or ()))
        reader.start()

        def ask(line: str, answer: str) -> None:
            deadline = time.monotonic() + PATIENCE_S
            proxy.stdin.write(line + "\n")  # type: ignore[union-attr]
            proxy.stdin.flush()  # type: ignore[union-attr]
            while not any(answer in heard for heard in said):
                assert time.monotonic() < deadline, "".join(said)
                time.sleep(0.1)

        try:
            ask("", "Saved")
            ask("vehicle 245:191", "")
            ask("param fetch", f"Received {len(load(bundled('demo-px4.toml')).tuning.tunables)} parameters")
            ask("param set ALT_OMEGA_C 7", "ALT_OMEGA_C 8 -> 7")
            ask("param fetch ALT_OMEGA_C", "ALT_OMEGA_C = 7.0")
            ask("long PREFLIGHT_STORAGE 1", "nowhere to store")
        finally:
            proxy.kill()
            reader.join()
