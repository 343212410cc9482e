"""A proxy between daemon and vehicle over UDP on this machine, with faults both ways, in real time."""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Iterator

from kffa_offboard.faults.line import FaultLine

HOST = "127.0.0.1"
DATAGRAM_SIZE = 65535
LONGEST_SLEEP_S = 0.005
"""Also how finely a flood is spread."""

AT_ONCE = 256


class FaultProxy:
    """Two sockets and a thread: the vehicle sends to `vehicle_port`, the daemon hears it from there.

    Parameters
    ----------
    daemon_port : where the daemon listens (a `udpin` link)
    down, up : faults towards the daemon and towards the vehicle; their clock starts at 0 with the thread

    Raises OSError if no port can be had.
    """

    def __init__(self, daemon_port: int, down: FaultLine, up: FaultLine) -> None:
        self._vehicle_side = self._open()
        self._daemon_side = self._open()
        self._daemon = (HOST, daemon_port)
        self._down, self._up = down, up
        self._vehicle: tuple[str, int] | None = None
        self._origin_us = time.monotonic_ns() // 1000
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fault-proxy", daemon=True)

    @staticmethod
    def _open() -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.setblocking(False)
        opened.bind((HOST, 0))
        return opened

    @property
    def vehicle_port(self) -> int:
        """Where the vehicle sends to."""
        return int(self._vehicle_side.getsockname()[1])

    @property
    def elapsed_s(self) -> float:
        """The clock of the faults."""
        return (time.monotonic_ns() // 1000 - self._origin_us) * 1e-6

    @contextlib.contextmanager
    def running(self) -> Iterator[FaultProxy]:
        """Pass datagrams on until the block ends."""
        self._origin_us = time.monotonic_ns() // 1000
        self._thread.start()
        try:
            yield self
        finally:
            self._stop.set()
            self._thread.join()
            self._vehicle_side.close()
            self._daemon_side.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            ready, _, _ = select.select([self._vehicle_side, self._daemon_side], [], [], LONGEST_SLEEP_S)
            now_us = time.monotonic_ns() // 1000 - self._origin_us
            if self._vehicle_side in ready:
                for data, source in self._received(self._vehicle_side):
                    self._vehicle = source
                    self._down.put(now_us, data)
            if self._daemon_side in ready:
                for data, _ in self._received(self._daemon_side):
                    self._up.put(now_us, data)
            self._deliver(now_us)

    def _deliver(self, now_us: int) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):  # lost, as datagrams are
            for data in self._down.take(now_us):
                self._daemon_side.sendto(data, self._daemon)
            for data in self._up.take(now_us):
                if self._vehicle is not None:
                    self._vehicle_side.sendto(data, self._vehicle)

    @staticmethod
    def _received(side: socket.socket) -> list[tuple[bytes, tuple[str, int]]]:
        received: list[tuple[bytes, tuple[str, int]]] = []
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            for _ in range(AT_ONCE):
                received.append(side.recvfrom(DATAGRAM_SIZE))
        return received
