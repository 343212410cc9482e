"""Sockets of the simulated vehicle: UDP and TCP, several at once. No MAVLink in here.

A peer is known by `(link number, address)`.
"""

from __future__ import annotations

import errno
import select
import socket
from abc import ABC, abstractmethod
from collections.abc import Hashable, Sequence
from typing import TypeAlias

from sim_vehicle.endpoints import Endpoint
from sim_vehicle.errors import SimulatorError

Address: TypeAlias = tuple[str, int]
PeerKey: TypeAlias = tuple[int, Address]

RECEIVE_BUFFER = 1 << 20
LARGEST_READ = 65536
CONNECT_TIMEOUT_S = 5.0


class Link(ABC):
    """One configured endpoint with its socket or sockets."""

    def __init__(self, number: int, endpoint: Endpoint) -> None:
        self.number = number
        self.endpoint = endpoint

    @property
    @abstractmethod
    def address(self) -> Address:
        """Where the socket really is (matters for port 0)."""

    @abstractmethod
    def sockets(self) -> list[socket.socket]:
        """Sockets to wait for."""

    @abstractmethod
    def peers(self) -> list[PeerKey]:
        """Peers that are known without having sent anything."""

    @abstractmethod
    def read(self, ready: socket.socket) -> list[tuple[PeerKey, bytes]]:
        """What a ready socket holds; empty bytes mean that the peer has gone."""

    @abstractmethod
    def send(self, peer: PeerKey, data: bytes) -> None:
        """Send to one peer; lost without a word if the peer has gone, as on any radio."""

    @abstractmethod
    def close(self) -> None:
        """Close all sockets."""


class UdpLink(Link):
    """udpin: bound, answers whoever sends. udpout: sends to one address and listens to that only."""

    def __init__(self, number: int, endpoint: Endpoint) -> None:
        super().__init__(number, endpoint)
        self._outwards = endpoint.scheme == "udpout"
        try:
            family, resolved = _resolve(endpoint, socket.SOCK_DGRAM)
            self._remote = resolved
            self._socket = socket.socket(family, socket.SOCK_DGRAM)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            if self._outwards:
                self._socket.connect(resolved)  # else anybody could send to us, from anywhere
            else:
                self._socket.bind(resolved)
            self._socket.setblocking(False)
        except OSError as problem:
            raise _cannot_open(endpoint, problem) from problem

    @property
    def address(self) -> Address:
        """Local address; the remote one for udpout."""
        return self._remote if self._outwards else _pair(self._socket.getsockname())

    def sockets(self) -> list[socket.socket]:
        """The one socket."""
        return [self._socket]

    def peers(self) -> list[PeerKey]:
        """The remote address of udpout."""
        return [(self.number, self._remote)] if self._outwards else []

    def read(self, ready: socket.socket) -> list[tuple[PeerKey, bytes]]:
        """All datagrams that wait."""
        received: list[tuple[PeerKey, bytes]] = []
        while True:
            try:
                data, sender = ready.recvfrom(LARGEST_READ)
            except BlockingIOError:
                return received
            except ConnectionError:  # an earlier datagram found nobody; on a radio we would not know
                continue
            source = _pair(sender)
            if data and (not self._outwards or source == self._remote):
                received.append(((self.number, source), data))

    def send(self, peer: PeerKey, data: bytes) -> None:
        """One datagram."""
        try:
            self._socket.sendto(data, peer[1])
        except (BlockingIOError, ConnectionError):
            return  # a full buffer or nobody there: the datagram is lost

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class TcpLink(Link):
    """tcpin: listens, any number of clients. tcp: connects to one server."""

    def __init__(self, number: int, endpoint: Endpoint) -> None:
        super().__init__(number, endpoint)
        self._listener: socket.socket | None = None
        self._streams: dict[PeerKey, socket.socket] = {}
        try:
            family, resolved = _resolve(endpoint, socket.SOCK_STREAM)
            if endpoint.scheme == "tcpin":
                self._listener = socket.socket(family, socket.SOCK_STREAM)
                self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                self._listener.bind(resolved)
                self._listener.listen()
                self._listener.setblocking(False)
            else:
                self._adopt(socket.create_connection(resolved, timeout=CONNECT_TIMEOUT_S), resolved)
            self._address = resolved
        except OSError as problem:
            raise _cannot_open(endpoint, problem) from problem

    def _adopt(self, stream: socket.socket, address: Address) -> None:
        stream.setblocking(False)
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._streams[(self.number, address)] = stream

    @property
    def address(self) -> Address:
        """Local address of tcpin, remote address of tcp."""
        return _pair(self._listener.getsockname()) if self._listener else self._address

    def sockets(self) -> list[socket.socket]:
        """Listener and connections."""
        return [*([self._listener] if self._listener else []), *self._streams.values()]

    def peers(self) -> list[PeerKey]:
        """Everybody who is connected."""
        return list(self._streams)

    def read(self, ready: socket.socket) -> list[tuple[PeerKey, bytes]]:
        """What a connection holds, or a new connection (which says nothing yet)."""
        if ready is self._listener:
            stream, sender = ready.accept()
            self._adopt(stream, _pair(sender))
            return []
        peer = next((key for key, stream in self._streams.items() if stream is ready), None)
        if peer is None:
            return []
        try:
            data = ready.recv(LARGEST_READ)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._streams.pop(peer).close()
        return [(peer, data)]

    def send(self, peer: PeerKey, data: bytes) -> None:
        """Write to a connection; a client that does not read loses its connection, not our time."""
        stream = self._streams.get(peer)
        if stream is None:
            return
        try:
            stream.sendall(data)
        except OSError:
            self._streams.pop(peer).close()

    def close(self) -> None:
        """Close listener and connections."""
        for stream in self.sockets():
            stream.close()


class Links:
    """All links of a vehicle."""

    def __init__(self, endpoints: Sequence[Endpoint]) -> None:
        self._links: list[Link] = []
        try:
            for number, endpoint in enumerate(endpoints):
                kind = UdpLink if endpoint.scheme in ("udpin", "udpout") else TcpLink
                self._links.append(kind(number, endpoint))
        except SimulatorError:
            self.close()
            raise

    def __enter__(self) -> Links:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def addresses(self) -> list[str]:
        """Links as URLs with the ports that they really have."""
        return [f"{link.endpoint.scheme}:{link.address[0]}:{link.address[1]}" for link in self._links]

    def peers(self) -> list[PeerKey]:
        """Peers that are known by configuration or connection."""
        return [peer for link in self._links for peer in link.peers()]

    def receive(self, timeout_s: float) -> list[tuple[PeerKey, bytes]]:
        """Wait at most `timeout_s` for something; all that is there, in order of arrival per link."""
        owners = {ready: link for link in self._links for ready in link.sockets()}
        readable, _, _ = select.select(list(owners), [], [], max(0.0, timeout_s))
        return [entry for ready in readable for entry in owners[ready].read(ready)]

    def send(self, peer: Hashable | None, data: bytes) -> None:
        """Send to one peer, or to all known ones for None."""
        if peer is None:
            for known in self.peers():
                self._links[known[0]].send(known, data)
        elif isinstance(peer, tuple):
            self._links[peer[0]].send(peer, data)

    def close(self) -> None:
        """Close everything."""
        for link in self._links:
            link.close()


def _resolve(endpoint: Endpoint, kind: socket.SocketKind) -> tuple[socket.AddressFamily, Address]:
    family, _, _, _, address = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)[0]
    return family, _pair(address)


def _pair(address: tuple[str | int, ...] | tuple[int, bytes]) -> Address:
    return str(address[0]), int(address[1])


def _cannot_open(endpoint: Endpoint, problem: OSError) -> SimulatorError:
    if problem.errno == errno.EADDRINUSE:
        reason = f"port {endpoint.port} is in use; stop the program that has it or choose another port"
    elif problem.errno == errno.ECONNREFUSED:
        reason = f"nothing listens at {endpoint.host} port {endpoint.port}; start that program first"
    elif isinstance(problem, socket.gaierror):
        reason = f"unknown host {endpoint.host}; give an address such as 127.0.0.1"
    else:
        reason = f"cannot be opened: {problem.strerror or problem}"
    return SimulatorError(f"link {endpoint}: {reason}")
