"""TCP links: `tcp` connects to the vehicle (and keeps trying), `tcpin` waits for it to connect.

A connection that is lost is made again: the telemetry timeouts decide what that means for a flight.
"""

from __future__ import annotations

import select
import socket

from kffa_offboard.mavlink.address import NetworkAddress, resolve
from kffa_offboard.mavlink.stream import READ_SIZE, StreamLink
from kffa_offboard.mavlink.transport import Clock
from kffa_offboard.mavlink.udp import explain

SEND_BUFFER = 16384
"""Bytes that the kernel may hold back; the default keeps minutes of setpoints for a stalled vehicle."""

NOT_SENT = 1024
"""Bytes that the kernel may hold and has not sent yet (TCP_NOTSENT_LOWAT, tcp(7)); more waits here."""

UNANSWERED_MS = 1000
"""A connection that acknowledges nothing for that long is lost, although nobody closed it.

What it holds is lost with it: setpoints that arrive later than PX4 waits for them (COM_OF_LOSS_T, 1 s) would
bring it back to OFFBOARD, with nobody behind them.
"""

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.2, 2.0
"""Between attempts to connect again: the first, twice as long each time, and no longer than that."""


class _TcpLink(StreamLink):
    """A TCP connection, however it came about."""

    def __init__(self, address: NetworkAddress, clock: Clock) -> None:
        super().__init__(address.url, clock)
        self._family, self._place = resolve(address)
        self._socket: socket.socket | None = None
        self._news: str | None = None
        self._was_lost = False

    def take_news(self) -> str | None:
        """See `transport.Link`."""
        news, self._news = self._news, None
        return news

    def _adopt(self, connected: socket.socket) -> None:
        connected.setblocking(False)
        # Setpoints are small and each of them matters now: never wait to fill a segment.
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connected.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, NOT_SENT)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, UNANSWERED_MS)
        self._socket = connected
        self._start_connection()
        if self._was_lost:
            self._was_lost, self._news, self.trouble = False, "link is back", ""

    def _opened(self) -> socket.socket:
        assert self._socket is not None, "only asked while it is open"
        return self._socket

    def _is_open(self) -> bool:
        return self._socket is not None

    def _file_descriptor(self) -> int:
        return self._opened().fileno()

    def _read(self) -> bytes:
        return self._opened().recv(READ_SIZE)

    def _write(self, data: bytes) -> int:
        return self._opened().send(data)

    def _lost(self, reason: str) -> None:
        self._hang_up()
        self.trouble = f"connection lost ({reason}); is the vehicle still running?"
        self._news, self._was_lost = f"link lost: {reason}", True

    def _hang_up(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def close(self) -> None:
        """See `transport.Link`."""
        self._hang_up()


class TcpClientLink(_TcpLink):
    """Connects to a vehicle that listens; until it does, tries again during each wait, later in pauses."""

    def __init__(self, address: NetworkAddress, clock: Clock) -> None:
        super().__init__(address, clock)
        self._pause_s = 0.0
        self._next_us: int | None = None

    def _connect(self, timeout_s: float) -> None:
        if timeout_s <= 0.0:
            return
        now_us = self._clock()
        if self._next_us is not None and now_us < self._next_us:
            select.select([], [], [], min(timeout_s, (self._next_us - now_us) * 1e-6))
            return
        deadline = now_us + int(timeout_s * 1e6)
        attempt = socket.socket(self._family, socket.SOCK_STREAM)
        attempt.settimeout(timeout_s)
        try:
            attempt.connect(self._place)
        except OSError as error:
            attempt.close()
            self.trouble = (error.strerror or "connecting timed out").lower()
            self._pause()
            # A refusal comes at once: wait the rest of the time, or we would try as fast as we can.
            select.select([], [], [], max(0.0, (deadline - self._clock()) / 1e6))
        else:
            self._adopt(attempt)

    def _lost(self, reason: str) -> None:
        super()._lost(reason)
        self._pause_s = FIRST_PAUSE_S
        self._pause()

    def _pause(self) -> None:
        """Put the next attempt off; nothing is put off before the first connection."""
        if self._was_lost:
            self._next_us = self._clock() + round(self._pause_s * 1e6)
            self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)


class TcpServerLink(_TcpLink):
    """Listens for the vehicle to connect, and to connect again; one connection at a time."""

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
        if self._locked:
            super()._lost(reason)
        else:  # it was not the vehicle
            self._hang_up()
            self.trouble = reason

    def close(self) -> None:
        """See `transport.Link`."""
        super().close()
        self._listener.close()
