"""Link URLs: what may be written in a configuration or after ``--link``, and what is wrong with it."""

from __future__ import annotations

import ipaddress
import socket
from dataclasses import dataclass
from typing import Literal, TypeAlias, cast

from kffa_offboard.errors import UserError

NetworkKind: TypeAlias = Literal["udpin", "udpout", "tcpin", "tcp"]

FORMS = "udpin:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT or serial:DEVICE:BAUD"
NETWORK_KINDS = ("udpin", "udpout", "tcpin", "tcp")
LISTENING_KINDS = ("udpin", "tcpin")
MOST_DIGITS = 9
"""Longer numbers are no ports and no baud rates."""


@dataclass(frozen=True, slots=True)
class NetworkAddress:
    """A UDP or TCP end. The kinds ending in `in` listen on it, the others send to it."""

    kind: NetworkKind
    host: str
    port: int

    @property
    def listens(self) -> bool:
        """True if the address is our own."""
        return self.kind in LISTENING_KINDS

    @property
    def url(self) -> str:
        """The address as people write it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.kind}:{host}:{self.port}"


@dataclass(frozen=True, slots=True)
class SerialAddress:
    """A serial device and its speed [bit/s]."""

    device: str
    baud: int

    @property
    def url(self) -> str:
        """The address as people write it."""
        return f"serial:{self.device}:{self.baud}"


LinkAddress: TypeAlias = NetworkAddress | SerialAddress


def parse_url(url: str) -> LinkAddress:
    """Read a link URL.

    Port 0 (any free port) is accepted where we listen. An IPv6 host is written in brackets.
    Raises UserError naming what is wrong and the forms that are right.
    """
    kind, _, rest = url.partition(":")
    place, _, number = rest.rpartition(":")
    if kind not in (*NETWORK_KINDS, "serial"):
        raise UserError(f"link {url!r}: unknown kind {kind!r}; write {FORMS}")
    if not place or place.startswith("//"):
        raise UserError(f"link {url!r}: incomplete or not in the right form; write {FORMS}")
    digits = number.isascii() and number.isdigit() and len(number) <= MOST_DIGITS
    if kind == "serial":
        if not digits or int(number) == 0:
            raise UserError(
                f"link {url!r}: baud rate {number!r} is not a positive number; try 57600 or 921600"
            )
        return SerialAddress(place, int(number))
    lowest = 0 if kind in LISTENING_KINDS else 1
    if not digits or not lowest <= int(number) <= 65535:
        raise UserError(f"link {url!r}: port {number!r} is not a number from {lowest} to 65535")
    return NetworkAddress(cast(NetworkKind, kind), place.removeprefix("[").removesuffix("]"), int(number))


def resolve(address: NetworkAddress) -> tuple[socket.AddressFamily, tuple[str, int]]:
    """Look the host up: address family and (IP address, port).

    Raises UserError for a host that nobody knows.
    """
    try:
        found = socket.getaddrinfo(address.host, address.port, type=socket.SOCK_DGRAM)
    except (socket.gaierror, UnicodeError) as error:
        raise UserError(
            f"link {address.url!r}: unknown host {address.host!r}; check the name or write the IP address"
        ) from error
    family, _, _, _, place = found[0]
    return family, (str(place[0]), int(place[1]))


def check_url(url: str, *, allow_remote: bool) -> LinkAddress:
    """Read a link URL and refuse to listen where other machines could reach us, unless that is allowed.

    Raises UserError as `parse_url` and `resolve` do. Opens nothing.
    """
    address = parse_url(url)
    if isinstance(address, SerialAddress):
        return address
    _, (ip, _) = resolve(address)
    if address.listens and not allow_remote and not ipaddress.ip_address(ip.partition("%")[0]).is_loopback:
        raise UserError(
            f"link {url!r}: any machine that reaches {address.host} could fly this vehicle; "
            "listen on 127.0.0.1, or set link.allow_remote = true"
        )
    return address
