"""UDP links: `udpin` binds and answers whoever sends, `udpout` sends to one place and hears only it."""

from __future__ import annotations

import errno
import logging
import select
import socket
import struct
import sys
import time
from collections.abc import Hashable

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.address import NetworkAddress, resolve
from kffa_offboard.mavlink.transport import Clock, Datagram, Posting

LOG = logging.getLogger(__name__)

DATAGRAM_SIZE = 65535
DATAGRAMS_AT_ONCE = 256
"""One `receive` returns at most so many, so that a flood of traffic cannot keep control from running."""

RECEIVE_BUFFER = 1 << 20

STRANGER_PERIOD_US = 100_000
"""So often at most a datagram of another than the locked sender is handed on, marked as a stranger's."""
_TIMESTAMP = 35 if sys.platform == "linux" else None
"""SO_TIMESTAMPNS, socket(7): each datagram comes with the wall time at which the kernel got it."""

_STAMP = struct.Struct("@qq")  # seconds, nanoseconds
_ANCILLARY_SIZE = socket.CMSG_SPACE(_STAMP.size)


def _open_socket(address: NetworkAddress) -> socket.socket:
    family, place = resolve(address)
    opened = socket.socket(family, socket.SOCK_DGRAM)
    try:
        opened.setblocking(False)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
        if _TIMESTAMP is not None:
            opened.setsockopt(socket.SOL_SOCKET, _TIMESTAMP, 1)
        if address.listens:
            opened.bind(place)
        else:
            # Connected, the kernel drops what anybody else sends to our port.
            opened.connect(place)
    except OSError as error:
        opened.close()
        raise explain(address, error) from error
    return opened


def explain(address: NetworkAddress, error: OSError) -> UserError:
    """Say in one line why a socket could not be opened, and what to do."""
    if error.errno == errno.EADDRINUSE:
        return UserError(
            f"link {address.url!r}: port {address.port} is busy: another program listens there "
            "(a ground station, a second daemon?); stop it or choose another port"
        )
    if error.errno == errno.EADDRNOTAVAIL:
        return UserError(
            f"link {address.url!r}: {address.host} is not an address of this machine; "
            "listen on one of its own, such as 127.0.0.1"
        )
    if error.errno in (errno.EACCES, errno.EPERM):
        return UserError(
            f"link {address.url!r}: not allowed to use port {address.port}; choose one above 1023"
        )
    return UserError(f"link {address.url!r}: cannot be opened: {error.strerror}; check host and port")


class UdpLink:
    """One UDP socket (see `transport.Link`).

    A `udpin` link has nobody to answer until it is locked onto the sender that turned out to be the
    vehicle. Lost datagrams, also those that find nobody listening, are not errors here: whether
    silence is serious is the service's to judge.
    """

    keeps_frames_whole = True

    def __init__(self, address: NetworkAddress, clock: Clock) -> None:
        self._socket = _open_socket(address)
        self._waiting = select.poll()
        self._waiting.register(self._socket, select.POLLIN)
        self._clock = clock
        self._listens = address.listens
        self._peer: Hashable | None = None
        self._stranger_us: int | None = None
        self._received_us: int | None = None
        self.trouble = ""
        port = int(self._socket.getsockname()[1]) if address.listens else address.port
        self.name = NetworkAddress(address.kind, address.host, port).url

    @property
    def descriptor(self) -> int | None:
        """See `transport.Link`."""
        return self._socket.fileno()

    def take_news(self) -> str | None:
        """See `transport.Link`; a socket neither goes nor returns."""
        return None

    def receive(self, timeout_s: float) -> list[Datagram]:
        """See `transport.Link`. Of others than the locked sender ten datagrams a second are shown."""
        select.select([self._socket], [], [], max(timeout_s, 0.0))
        datagrams: list[Datagram] = []
        now_us: int | None = None
        for _ in range(DATAGRAMS_AT_ONCE):
            try:
                data, ancillary, _, source = self._socket.recvmsg(DATAGRAM_SIZE, _ANCILLARY_SIZE)
            except BlockingIOError:
                break
            except OSError as error:
                self._note(error)
                continue
            if self._peer is None or source == self._peer:
                now_us = self._clock()
                datagrams.append(Datagram(now_us, data, source, waited_us=self._waited_us(now_us, ancillary)))
                self.trouble = ""
            elif self._is_due(now_us := self._clock()):
                datagrams.append(Datagram(now_us, data, source, stranger=True))
            if not self._waiting.poll(0):  # to try and fail takes four times as long
                break
        self._received_us = self._clock() if now_us is None else now_us
        return datagrams

    def _is_due(self, now_us: int) -> bool:
        """May a stranger's datagram be shown now?"""
        if self._stranger_us is not None and now_us - self._stranger_us < STRANGER_PERIOD_US:
            return False
        self._stranger_us = now_us
        return True

    def _waited_us(self, now_us: int, ancillary: list[tuple[int, int, bytes]]) -> int:
        """How long the kernel had a datagram; at most since we last looked, whatever wall time does."""
        if self._received_us is None or not ancillary or len(ancillary[0][2]) != _STAMP.size:
            return 0
        seconds, nanoseconds = _STAMP.unpack(ancillary[0][2])
        waited_us = (time.time_ns() - int(seconds) * 1_000_000_000 - int(nanoseconds)) // 1000
        return max(0, min(waited_us, now_us - self._received_us))

    def send(self, data: bytes) -> bool:
        """See `transport.Link`."""
        try:
            if not self._listens:
                self._socket.send(data)
            elif isinstance(self._peer, tuple):
                self._socket.sendto(data, self._peer)
            else:
                return False
        except OSError as error:
            self._note(error)
            return False
        return True

    def posting(self, data: bytes) -> Posting | None:
        """See `transport.Link`."""
        if not self._listens:
            return Posting(self._socket.fileno(), data)
        if not isinstance(self._peer, tuple):
            return None
        host, port = self._peer[:2]
        return Posting(self._socket.fileno(), data, (host, port))

    def _note(self, error: OSError) -> None:
        """Remember why the last datagram was lost; say it once, not for each."""
        reason = (error.strerror or str(error)).lower()
        if reason != self.trouble:
            LOG.info("%s: %s", self.name, reason)
        self.trouble = reason

    def lock(self, source: Hashable) -> None:
        """See `transport.Link`."""
        self._peer = source

    def fileno(self) -> int:
        """For `select`, beside other sockets."""
        return self._socket.fileno()

    def close(self) -> None:
        """See `transport.Link`."""
        self._socket.close()
