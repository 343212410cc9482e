"""A proxy between daemon and vehicle over UDP on this machine, with faults both ways.

In real time or, between two that fly in lock-step, on the clock of their barrier: then a slow machine changes
nothing.
"""

from __future__ import annotations

import contextlib
import select
import socket
import threading
import time
from collections.abc import Iterator

from kffa_offboard.faults.barrier import BarrierFaults
from kffa_offboard.faults.line import FaultLine

HOST = "127.0.0.1"
DATAGRAM_SIZE = 65535
LONGEST_SLEEP_S = 0.005
"""Also how finely a flood is spread."""

AT_ONCE = 256
RECEIVE_BUFFER = 1 << 20


class FaultProxy:
    """Two sockets and a thread: the vehicle sends to `vehicle_port`, the daemon hears it from there.

    Parameters
    ----------
    daemon_port : where the daemon listens (a `udpin` link)
    down, up : faults towards the daemon and towards the vehicle; their clock starts at 0 with the thread
    lockstep : their clock is the simulated time of the barrier instead

    Raises OSError if no port can be had.
    """

    def __init__(self, daemon_port: int, down: FaultLine, up: FaultLine, *, lockstep: bool = False) -> None:
        self._vehicle_side = self._open()
        self._daemon_side = self._open()
        self._daemon = (HOST, daemon_port)
        self._down, self._up = down, up
        self._barrier = BarrierFaults(down, up) if lockstep else None
        self._vehicle: tuple[str, int] | None = None
        self._origin_us = time.monotonic_ns() // 1000
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="fault-proxy", daemon=True)

    @staticmethod
    def _open() -> socket.socket:
        opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        opened.setblocking(False)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
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
            for data in self._received(self._vehicle_side, ready):
                if self._barrier is None:
                    self._down.put(now_us, data)
                else:
                    self._to_daemon(self._barrier.from_vehicle(data))
            for data in self._received(self._daemon_side, ready):
                if self._barrier is None:
                    self._up.put(now_us, data)
                else:
                    self._to_vehicle(self._barrier.from_daemon(data))
            if self._barrier is None:
                self._to_daemon(self._down.take(now_us))
                self._to_vehicle(self._up.take(now_us))

    def _to_daemon(self, arrived: list[bytes]) -> None:
        for data in arrived:
            with contextlib.suppress(BlockingIOError, ConnectionRefusedError):  # lost, as datagrams are
                self._daemon_side.sendto(data, self._daemon)

    def _to_vehicle(self, arrived: list[bytes]) -> None:
        for data in arrived:
            if self._vehicle is not None:
                with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                    self._vehicle_side.sendto(data, self._vehicle)

    def _received(self, side: socket.socket, ready: list[socket.socket]) -> list[bytes]:
        """What waits on a side; the vehicle's tells where it is."""
        received: list[bytes] = []
        if side not in ready:
            return received
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            for _ in range(AT_ONCE):
                data, source = side.recvfrom(DATAGRAM_SIZE)
                received.append(data)
                if side is self._vehicle_side:
                    self._vehicle = source
        return received
