"""A dead man's switch: if the daemon dies or hangs in control, a process of its own says its last words.

`kill -9`, a crash of the interpreter, or the memory's end leave no time for a last setpoint, and the
autopilot would fly the last body rates on until its own timeout. So a small process keeps what would have to
be said, a tenth of a second old at most, and the way to the vehicle. It learns of the end from the kernel,
which closes the channel between the two, whatever the reason; and of a daemon that hangs from its silence.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Protocol, TypeAlias

from kffa_offboard.process import dead_man_child

PERIOD_S = 0.1
"""So often the words are brought up to date."""

PATIENCE_S = 1.0

Posting: TypeAlias = tuple[int, bytes, tuple[str, int] | None]
"""Descriptor, bytes, and host and port where the descriptor does not know the way."""


class LastWords(Protocol):
    """Whose death is watched."""

    @property
    def has_control(self) -> bool:
        """Our setpoints may be what flies the vehicle."""

    def posting(self) -> Posting | None:
        """What would have to be sent now; None for nothing."""


def is_available() -> bool:
    """Needs Linux: elsewhere nobody tells a process of the other's end, packet by packet."""
    return sys.platform == "linux"


class DeadManSwitch:
    """The daemon's half. Ask `take_trouble` in each turn of the loop; it keeps the words up to date, too.

    Raises OSError if the process cannot be started.
    """

    def __init__(self, words: LastWords) -> None:
        self._words = words
        self._told = False
        self._full = False
        self._due_s = 0.0
        self._trouble = False
        self._channel, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._channel.setblocking(False)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", str(Path(dead_man_child.__file__)), str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )

    def take_trouble(self) -> str | None:
        """Bring the words up to date; that the other process is gone, once, else None."""
        if not self._words.has_control:
            if not self._told:
                return None
            trouble = self._tell(dead_man_child.NOTHING, ())
            self._told = self._full  # then once more in the next turn
            return trouble
        now_s = time.monotonic()
        if self._told and now_s < self._due_s:
            return None
        posting = self._words.posting()
        self._told, self._due_s = True, now_s + PERIOD_S
        if posting is None:
            return self._tell(dead_man_child.NOTHING, ())
        descriptor, data, place = posting
        host, port = place or ("", 0)
        return self._tell(b"%s\n%d\n%s" % (host.encode(), port, data), (descriptor,))

    def _tell(self, packet: bytes, descriptors: tuple[int, ...]) -> str | None:
        self._full = False
        try:
            socket.send_fds(self._channel, [packet], descriptors)
        except BlockingIOError:
            self._full = True  # it has not run for seconds
        except OSError as error:
            trouble, self._trouble = not self._trouble, True
            return f"dead man's switch: {(error.strerror or str(error)).lower()}" if trouble else None
        return None

    def close(self) -> None:
        """The daemon ends as it should: there is nothing to say. May be called twice."""
        if self._channel.fileno() < 0:
            return
        self._tell(dead_man_child.NOTHING, ())
        if self._full:
            self._process.kill()  # it would say what it was told before
        self._channel.close()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
