"""TCP links: `tcp` connects to the vehicle (and keeps trying), `tcpin` waits for it to connect."""

from __future__ import annotations

import select
import socket

from kffa_offboard.mavlink.address import NetworkAddress, resolve
from kffa_offboard.mavlink.stream import READ_SIZE, StreamLink
from kffa_offboard.mavlink.transport import Clock, LinkLost
from kffa_offboard.mavlink.udp import explain

SEND_BUFFER = 16384
"""Bytes that the kernel may hold back; the default keeps minutes of setpoints for a stalled vehicle."""


class _TcpLink(StreamLink):
    """A TCP connection, however it came about."""

    def __init__(self, address: NetworkAddress, clock: Clock) -> None:
        super().__init__(address.url, clock)
        self._family, self._place = resolve(address)
        self._socket: socket.socket | None = None

    def _adopt(self, connected: socket.socket) -> None:
        connected.setblocking(False)
        # Setpoints are small and each of them matters now: never wait to fill a segment.
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        self._socket = connected
        self._start_connection()

    def _opened(self) -> socket.socket:
        if self._socket is None:
            raise LinkLost(f"link {self.name!r}: not connected")
        return self._socket

    def _is_open(self) -> bool:
        return self._socket is not None

    def _file_descriptor(self) -> int:
        return self._opened().fileno()

    def _read(self) -> bytes:
        return self._opened().recv(READ_SIZE)

    def _write(self, data: bytes) -> int:
        return self._opened().send(data)

    def close(self) -> None:
        """See `transport.Link`."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class TcpClientLink(_TcpLink):
    """Connects to a vehicle that listens; until it does, tries again during each wait."""

    def _connect(self, timeout_s: float) -> None:
        if timeout_s <= 0.0:
            return
        deadline = self._clock() + int(timeout_s * 1e6)
        attempt = socket.socket(self._family, socket.SOCK_STREAM)
        attempt.settimeout(timeout_s)
        try:
            attempt.connect(self._place)
        except OSError as error:
            attempt.close()
            self.trouble = (error.strerror or "connecting timed out").lower()
            # A refusal comes at once: wait the rest of the time, or we would try as fast as we can.
            select.select([], [], [], max(0.0, (deadline - self._clock()) / 1e6))
        else:
            self._adopt(attempt)

    def _lost(self, reason: str) -> None:
        self.close()
        raise LinkLost(f"link {self.name!r}: connection lost ({reason}); is the vehicle still running?")


class TcpServerLink(_TcpLink):
    """Listens for the vehicle to connect; one connection at a time."""

    def __init__(self, address: NetworkAddress, clock: Clock) -> None:
        super().__init__(address, clock)
        self._listener = socket.socket(self._family, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.bind(self._place)
            self._listener.listen(1)
        except OSError as error:
            self._listener.close()
            raise explain(address, error) from error
        self._listener.setblocking(False)
        self.name = NetworkAddress(address.kind, address.host, self._listener.getsockname()[1]).url

    def _connect(self, timeout_s: float) -> None:
        readable, _, _ = select.select([self._listener], [], [], max(timeout_s, 0.0))
        if not readable:
            return
        try:
            connected, _ = self._listener.accept()
        except OSError as error:  # the caller hung up before we answered
            self.trouble = (error.strerror or str(error)).lower()
        else:
            self._adopt(connected)

    def _lost(self, reason: str) -> None:
        super().close()
        if self._locked:
            raise LinkLost(f"link {self.name!r}: connection lost ({reason}); is the vehicle still running?")
        self.trouble = reason

    def close(self) -> None:
        """See `transport.Link`."""
        super().close()
        self._listener.close()
