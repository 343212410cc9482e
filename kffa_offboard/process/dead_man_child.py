"""The other half of `dead_man`: says the daemon's last words when it is gone, or not heard for a while.

Started by its path with `python -I -S`, so that it is there at once and small: it imports nothing of ours.
A packet is host and port on a line each (empty and 0 where the descriptor knows the way), then the bytes to
send; the descriptor comes with it. An empty line alone: there is nothing to say.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys

SIZE = 4096
NOTHING = b"\n"
LATE_S = 0.3
"""A daemon that hangs for so long has stopped to control, and the autopilot still waits for it (PX4 1 s)."""

IGNORED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT)
"""What a terminal or a service manager sends to a whole group: our own end is the daemon's."""


def attend(channel: socket.socket) -> None:
    """Keep the newest words; say them, once, at the daemon's end or when newer ones are late."""
    descriptor, words = -1, NOTHING
    while True:
        channel.settimeout(None if words == NOTHING else LATE_S)
        try:
            packet, descriptors, _, _ = socket.recv_fds(channel, SIZE, 1)
        except TimeoutError:
            say(descriptor, words)
            words = NOTHING
            continue
        except ConnectionError:
            packet, descriptors = b"", []
        if not packet:
            say(descriptor, words)
            return
        if descriptor >= 0:
            os.close(descriptor)
        descriptor, words = (descriptors or [-1])[0], packet


def say(descriptor: int, words: bytes) -> None:
    """Send the words in the daemon's place."""
    if words == NOTHING:
        return
    host, port, data = words.split(b"\n", 2)
    with contextlib.suppress(OSError):  # no way, and nobody to be told
        if host:
            socket.socket(fileno=os.dup(descriptor)).sendto(data, (host.decode(), int(port)))
        else:
            os.write(descriptor, data)


def main() -> None:
    """The channel's descriptor is the argument."""
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)
    attend(socket.socket(fileno=int(sys.argv[1])))


if __name__ == "__main__":
    main()
