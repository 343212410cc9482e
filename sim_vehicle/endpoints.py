"""Link URLs: `udpin:HOST:PORT`, `udpout:HOST:PORT`, `tcpin:HOST:PORT`, `tcp:HOST:PORT`."""

from __future__ import annotations

import difflib
import ipaddress
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

Scheme: TypeAlias = Literal["udpin", "udpout", "tcpin", "tcp"]


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One link: udpin and tcpin wait at (host, port), udpout and tcp go there."""

    scheme: Scheme
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.scheme}:{self.host}:{self.port}"

    @property
    def address(self) -> tuple[str, int]:
        """Host and port."""
        return self.host, self.port


def parse_endpoint(url: str, allow_remote: bool) -> Endpoint:
    """Take a link URL apart.

    Raises ValueError, for people, if it is malformed, or leaves this machine without `allow_remote`.
    """
    scheme, _, rest = url.partition(":")
    host, _, port_text = rest.rpartition(":")
    if scheme not in get_args(Scheme):
        close = difflib.get_close_matches(scheme, get_args(Scheme), n=1)
        hint = f"did you mean {close[0]}?" if close else f"choose one of {', '.join(get_args(Scheme))}"
        raise ValueError(f"{url!r}: unknown kind {scheme!r}; {hint}")
    digits = port_text.isascii() and port_text.isdigit() and len(port_text) <= 5
    if not host or not digits or int(port_text) > 65535:
        raise ValueError(f"{url!r}: not of the form {scheme}:HOST:PORT with a port of 0 to 65535")
    if not allow_remote and not is_loopback(host):
        raise ValueError(
            f"{url!r}: {host} is not this machine; use 127.0.0.1 or set link.allow_remote = true"
        )
    return Endpoint(_scheme(scheme), host, int(port_text))


def _scheme(text: str) -> Scheme:
    return next(scheme for scheme in get_args(Scheme) if scheme == text)


def is_loopback(host: str) -> bool:
    """Does a host name or address mean this machine?"""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
