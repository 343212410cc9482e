"""The link between daemon and a firmware whose physics is running already: frames are passed on at once.

If that vehicle is in lock-step, it waits for an answer to each of its TIMESYNC requests. They are the
daemon's to answer; between two flights, when there is none, ours, so that time goes on.
"""

from __future__ import annotations

import contextlib
import select
import threading
from collections.abc import Iterator

from kffa_offboard.compare.bridge import POLL_S, Address, loopback_socket, received
from kffa_offboard.compare.firmware_end import FirmwareEnd
from kffa_offboard.mavlink.commands import is_timesync_request, timesync_answer
from kffa_offboard.mavlink.component import Component, FrameParser, Message, Route
from kffa_offboard.mavlink.transport import Datagram


class Relay:
    """See the module. `daemon_port` is our end of the daemon's link."""

    def __init__(self, firmware: FirmwareEnd, lockstep: bool) -> None:
        self._firmware, self._daemon = firmware, loopback_socket()
        self.daemon_port = int(self._daemon.getsockname()[1])
        self._lockstep = lockstep
        self._own = Component(Route())
        self._parser = FrameParser(keeps_frames_whole=True)
        self._turn = threading.Lock()
        self._daemon_at: Address | None = None
        self._between_flights = True
        self._request: Message | None = None

    def check(self) -> None:
        """Nothing can go wrong here that the daemon does not notice itself."""

    @property
    def time_s(self) -> float:
        """Unknown: time is the running physics' own."""
        return 0.0

    def welcome(self) -> None:
        """Wait for the next daemon, or another pilot; the one before has ended."""
        with self._turn:
            for _ in received(self._daemon):  # last words
                pass
            self._between_flights = False

    def let_go(self) -> None:
        """The daemon has ended."""
        with self._turn:
            self._between_flights, self._daemon_at = True, None
            self._answer()

    def run(self) -> None:
        """Pass frames on until the sockets are closed."""
        while True:
            try:
                select.select([self._firmware.fileno(), self._daemon.fileno()], [], [], POLL_S)
                with self._turn:
                    self._pass()
            except (OSError, ValueError):  # closed
                return

    def close(self) -> None:
        """Close the sockets."""
        for end in (self._firmware, self._daemon):
            end.close()

    def _pass(self) -> None:
        for data, sender in received(self._daemon):
            if not self._between_flights:
                self._daemon_at = sender
                self._watch(data)
                self._firmware.send(data)
        for message in self._firmware.receive():
            if self._lockstep and is_timesync_request(message):
                self._request = message
            if self._daemon_at is not None:
                self._daemon.sendto(bytes(message.get_msgbuf()), self._daemon_at)
        if self._daemon_at is None:
            self._answer()

    def _watch(self, data: bytes) -> None:
        """Has the daemon answered the request that is open?"""
        for message in self._parser.parse(Datagram(0, data, None)) if self._request is not None else ():
            if self._request is not None and message.get_type() == "TIMESYNC":
                self._request = self._request if message.ts1 != self._request.ts1 else None

    def _answer(self) -> None:
        if self._request is not None:
            request, self._request = self._request, None
            self._firmware.send(self._own.pack(timesync_answer(request, max(request.ts1, 1))))


@contextlib.contextmanager
def relay(firmware: FirmwareEnd, lockstep: bool) -> Iterator[Relay]:
    """A relay that serves in a thread of its own until the block is left."""
    served = Relay(firmware, lockstep)
    thread = threading.Thread(target=served.run, name="relay", daemon=True)
    thread.start()
    try:
        yield served
    finally:
        served.close()
        thread.join()
