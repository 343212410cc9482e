"""Opening the link that a URL names. What a link can do is in `transport.Link`."""

from __future__ import annotations

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.address import SerialAddress, check_url
from kffa_offboard.mavlink.serial_port import SerialLink
from kffa_offboard.mavlink.signed_link import SigningSettings, sign_link
from kffa_offboard.mavlink.tcp import TcpClientLink, TcpServerLink
from kffa_offboard.mavlink.transport import Clock, Link
from kffa_offboard.mavlink.udp import UdpLink


def open_link(
    url: str, clock: Clock, *, allow_remote: bool = False, signing: SigningSettings | None = None
) -> Link:
    """Open `url`; arrival times are read from `clock`. With `signing`, everything on it is signed.

    A `tcp` link connects while it is being used, so that the vehicle may be started later.
    Raises UserError, one line: bad URL, unknown host, busy port, no such device, or an address that
    other machines can reach without `allow_remote`; a signing key that is missing or that others can read.
    """
    link = _open(url, clock, allow_remote)
    if signing is None:
        return link
    try:
        return sign_link(link, signing, clock)
    except UserError:
        link.close()
        raise


def _open(url: str, clock: Clock, allow_remote: bool) -> Link:
    address = check_url(url, allow_remote=allow_remote)
    if isinstance(address, SerialAddress):
        return SerialLink(address, clock)
    if address.kind == "tcp":
        return TcpClientLink(address, clock)
    if address.kind == "tcpin":
        return TcpServerLink(address, clock)
    return UdpLink(address, clock)
