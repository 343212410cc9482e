"""Simulated time that waits for somebody else: whoever brings the firmware its commands in lock-step.

After each period a datagram with the simulated time [us] (unsigned 64 bits, little-endian) goes to a UDP port
on loopback, and time stands still until the same bytes come back.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from collections.abc import Iterator

from sim_vehicle.errors import SimulatorError

RESEND_S = 1.0
REFUSED_S = 0.05
"""Pause where nobody listens yet: the refusal comes at once."""

ANSWER_LIMIT_S = 60.0


class Barrier:
    """Waits at each multiple of `period_us`, on a connected socket; with None, not at all.

    An answer may take `timeout_s` of wall time.
    """

    def __init__(
        self, sock: socket.socket | None, period_us: int = 1, timeout_s: float = ANSWER_LIMIT_S
    ) -> None:
        self._socket = sock
        self._period_us = period_us
        self._timeout_s = timeout_s
        self._passed = 0

    def wait(self, time_us: int) -> None:
        """Come to `time_us`. Raises SimulatorError if nobody lets us go on."""
        if self._socket is None or time_us // self._period_us <= self._passed:
            return
        self._passed = time_us // self._period_us
        word = struct.pack("<Q", time_us)
        give_up = time.monotonic() + self._timeout_s
        while time.monotonic() < give_up:
            try:
                self._socket.send(word)
                while self._socket.recv(64) != word:
                    pass
                return
            except TimeoutError:
                continue
            except ConnectionRefusedError:
                time.sleep(REFUSED_S)
        raise SimulatorError(
            f"backend.barrier_port: nobody let time go on at {time_us * 1e-6:.2f} s"
            f" within {self._timeout_s:g} s; is the other side running?"
        )


@contextlib.contextmanager
def open_barrier(port: int, period_us: int) -> Iterator[Barrier]:
    """A barrier on `port` of loopback, or for 0 one that lets everything pass."""
    if port == 0:
        yield Barrier(None)
        return
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", port))
        sock.settimeout(RESEND_S)
        yield Barrier(sock, period_us)
