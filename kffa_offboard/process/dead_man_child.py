"""The other half of `dead_man`: waits for the daemon's end, and says its last words if it had any to say.

Started by its path with `python -I -S`, so that it is there at once and small: it imports nothing of ours.
A packet is host and port on a line each (empty and 0 where the descriptor knows the way), then the bytes to
send; the descriptor comes with it. An empty line alone: there is nothing to say.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import time

SIZE = 4096
FRESH_S = 0.5
"""Words that are older come from a daemon that hung before it died: others fly by then."""

IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT)
"""What a terminal or a service manager sends to a whole group: our own end is the daemon's."""


def wait(channel: socket.socket) -> tuple[int, bytes, float]:
    """Descriptor, packet and time of the last words when the daemon has gone; -1 and empty for none."""
    held, words, heard_s = -1, b"", 0.0
    while True:
        try:
            packet, descriptors, _, _ = socket.recv_fds(channel, SIZE, 1)
        except ConnectionError:
            return held, words, heard_s
        if not packet:
            return held, words, heard_s
        if held >= 0:
            os.close(held)
        held, words, heard_s = (descriptors or [-1])[0], packet, time.monotonic()


def say(descriptor: int, packet: bytes) -> None:
    """Send the words in the daemon's place."""
    host, port, data = packet.split(b"\n", 2)
    if host:
        socket.socket(fileno=descriptor).sendto(data, (host.decode(), int(port)))
    else:
        os.write(descriptor, data)


def main() -> None:
    """The channel's descriptor is the argument."""
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)
    descriptor, packet, heard_s = wait(socket.socket(fileno=int(sys.argv[1])))
    if descriptor >= 0 and time.monotonic() - heard_s <= FRESH_S:
        say(descriptor, packet)


if __name__ == "__main__":
    main()
