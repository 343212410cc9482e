"""The TCP port where PX4's simulator_mavlink connects. No MAVLink in here."""

from __future__ import annotations

import errno
import select
import socket

from sim_vehicle.endpoints import is_loopback
from sim_vehicle.errors import SimulatorError

SEND_BUFFER = 4096
"""Bytes on their way at most on our side, so that a PX4 that does not read is noticed soon."""

LARGEST_READ = 65536


class Px4Port:
    """A listener and one connection. PX4 connects once in its life: others are turned away while it is there.

    Raises SimulatorError if the port cannot be had, or leaves this machine without `allow_remote`.

    Attributes
    ----------
    turned_away : address of the latest that was turned away; empty if nobody was
    """

    turned_away = ""

    def __init__(self, host: str, port: int, allow_remote: bool = False) -> None:
        where = f"backend.px4_hil: {host} port {port}"
        if not allow_remote and not is_loopback(host):
            raise SimulatorError(
                f"{where} is not this machine; use 127.0.0.1 or set link.allow_remote = true"
            )
        self._stream: socket.socket | None = None
        self._listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
            self._listener.bind((host, port))
            self._listener.listen()
            self._listener.setblocking(False)
        except OSError as problem:
            self._listener.close()
            used = problem.errno == errno.EADDRINUSE
            reason = "is in use; stop the program that has it or choose another port"
            raise SimulatorError(f"{where} {reason if used else f'cannot be had: {problem}'}") from problem

    def __enter__(self) -> Px4Port:
        return self

    def __exit__(self, *_: object) -> None:
        self._drop()
        self._listener.close()

    @property
    def address(self) -> str:
        """Host and port, as they really are (matters for port 0)."""
        host, port = self._listener.getsockname()
        return f"{host}:{port}"

    @property
    def connected(self) -> bool:
        """PX4 is there."""
        return self._stream is not None

    def accept(self, timeout_s: float) -> bool:
        """Wait for a connection; is there a new one?"""
        ready, _, _ = select.select([self._listener], [], [], timeout_s)
        if not ready:
            return False
        self._drop()
        self.turned_away = ""
        self._stream, _ = self._listener.accept()
        self._stream.setblocking(False)
        self._stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return True

    def receive(self, timeout_s: float) -> bytes:
        """What PX4 sent within the time; drops the connection if PX4 has closed it."""
        if self._stream is None:
            return b""
        ready, _, _ = select.select([self._stream, self._listener], [], [], max(0.0, timeout_s))
        if self._listener in ready:
            self._meet(self._stream)
        if self._stream not in ready or self._stream is None:
            return b""
        try:
            data = self._stream.recv(LARGEST_READ)
        except OSError:  # reset by a PX4 that was killed: the same as closed
            data = b""
        if not data:
            self._drop()
        return data

    def _meet(self, present: socket.socket) -> None:
        """A newcomer takes the place of a PX4 that has gone, and of nobody else."""
        poll = select.poll()
        poll.register(present, select.POLLRDHUP)
        if poll.poll(0):  # closed, though unread bytes may be left
            self._drop()
            return
        newcomer, (host, port) = self._listener.accept()
        newcomer.close()
        self.turned_away = f"{host}:{port}"

    def send(self, data: bytes, timeout_s: float) -> bytes:
        """Send; returns what could not be sent within the time. Drops the connection if PX4 has closed it."""
        while data and self._stream is not None:
            _, ready, _ = select.select([], [self._stream], [], timeout_s)
            if not ready:
                return data
            try:
                data = data[self._stream.send(data) :]
            except BlockingIOError:
                continue
            except OSError:
                self._drop()
        return b""

    def _drop(self) -> None:
        if self._stream is not None:
            self._stream.close()
            self._stream = None
