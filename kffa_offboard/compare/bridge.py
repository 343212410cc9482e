"""The link between firmware and daemon, in lock-step with the physics.

Physics on its way stops at each barrier (`backend.barrier_port`) and tells the simulated time. What the
firmware has sent by then, and is old enough for the link's delay, goes to the daemon, followed by a TIMESYNC
request, which is the daemon's barrier (`mavlink.shell`). Its answer ends its turn; its frames go to the
firmware when the delay has passed for them too, and physics goes on. So neither a busy computer nor a slow
one changes the flight. Before the daemon has said a word, and after its end, physics is let go at once. With
`meeting_s` the daemon is met at that time, not earlier, and waited for: each flight with a seed begins at the
same moment of the noise.

The firmware's own TIMESYNC is left out: it would be taken for a barrier. PX4 takes commands in a thread of
its own that its lock-step does not wait for: it is asked for a TIMESYNC after them, and time goes on when it
has answered. ArduCopter takes them in its one loop and could not answer before time goes on.

A firmware whose process is known (`watch`) has done all that is to be done at this time before it is heard.
"""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Iterator
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.firmware_end import FirmwareEnd
from kffa_offboard.compare.idle import Threads
from kffa_offboard.compare.limits import FlightCut
from kffa_offboard.mavlink.component import Component, FrameParser, Message, Route
from kffa_offboard.mavlink.transport import Datagram

POLL_S = 0.1
FIRMWARE_ANSWER_S = 0.5
"""Wall time that is given to a firmware to say that it has taken its commands."""

ANSWER_LIMIT_S = 30.0
"""Wall time that daemon or firmware may take for one barrier."""

SIZE = 65535
LOOPBACK = "127.0.0.1"
Address: TypeAlias = tuple[str, int]


class Bridge:
    """See the module. `firmware_port`, `daemon_port` and `physics_port` are our ends of the three links.

    Parameters
    ----------
    target_system : system id of the firmware, in whose name the barrier is sent
    delay_s : of the link, in simulated time, each way
    firmware : where the firmware is met, if not on a free port
    meeting_s : simulated time at which the daemon is met and waited for; 0 for whenever it comes
    answers : the firmware answers a TIMESYNC while time stands still
    """

    def __init__(
        self,
        target_system: int,
        delay_s: float,
        firmware: FirmwareEnd | None = None,
        meeting_s: float = 0.0,
        answers: bool = False,
    ) -> None:
        self._firmware = firmware or FirmwareEnd()
        self._daemon, self._physics = loopback_socket(), loopback_socket()
        self.firmware_port = self._firmware.port
        self.daemon_port, self.physics_port = (
            int(end.getsockname()[1]) for end in (self._daemon, self._physics)
        )
        self._delay_us = round(delay_s * 1e6)
        self._meeting_us = round(meeting_s * 1e6)
        self._answers = answers
        self._barrier = Component(Route(own_system=target_system, own_component=1))
        self._parser = FrameParser(keeps_frames_whole=True)
        self._turn = threading.Lock()
        self._daemon_at: Address | None = None
        self._time_us = 0
        self._to_daemon: deque[tuple[int, bytes]] = deque()
        self._to_firmware: deque[tuple[int, bytes]] = deque()
        self._stop = threading.Event()
        self._threads: Threads | None = None
        self.trouble = ""

    def check(self) -> None:
        """Raises FlightCut if daemon or firmware did not come to an end in the middle of the flight."""
        if self.trouble:
            raise FlightCut(self.trouble)

    @property
    def time_s(self) -> float:
        """Simulated time of the latest barrier, s."""
        return self._time_us * 1e-6

    def watch(self, pid: int) -> None:
        """Before it is heard, wait until the firmware, which is process `pid`, has nothing left to do."""
        self._threads = Threads(pid)

    def let_go(self) -> None:
        """The daemon has ended: nobody is waited for any more."""
        self._stop.set()

    def welcome(self, target_system: int, delay_s: float) -> None:
        """Wait for the next daemon or other pilot, over a link with this delay; the last one has ended."""
        with self._turn:
            self._barrier = Component(Route(own_system=target_system, own_component=1))
            self._delay_us = round(delay_s * 1e6)
            deque(received(self._daemon), maxlen=0)  # last words
            self._daemon_at, self.trouble = None, ""
            self._to_daemon.clear()
            self._to_firmware.clear()
            self._stop.clear()

    def run(self) -> None:
        """Serve barriers until the sockets are closed."""
        with contextlib.suppress(OSError, ValueError):  # closed
            while True:
                ready, _, _ = select.select([self._physics], [], [], POLL_S)
                if ready:
                    word, physics_at = self._physics.recvfrom(64)
                    with self._turn:
                        self._pass((struct.unpack("<Q", word))[0])
                    self._physics.sendto(word, physics_at)
        if self._threads is not None:
            self._threads.close()

    def close(self) -> None:
        """Close the sockets."""
        self._stop.set()
        for end in (self._firmware, self._daemon, self._physics):
            end.close()

    # ----------------------------------------------------------------------------- one barrier

    def _pass(self, time_us: int) -> None:
        slack_us = (time_us - self._time_us) // 2  # the barrier nearest to the due time
        self._time_us = time_us
        if self._threads is not None and not self._threads.wait_until_idle(ANSWER_LIMIT_S):
            self.trouble = f"the firmware was busy for {ANSWER_LIMIT_S:g} s of wall time at one barrier"
        self._hear_firmware()
        if not self._stop.is_set() and not self.trouble:
            if self._daemon_at is None and time_us >= self._meeting_us:
                self._meet_daemon()
            if self._daemon_at is not None:
                self._give_turn(self._daemon_at, slack_us)
        due = 0
        while self._to_firmware and self._to_firmware[0][0] <= time_us + slack_us:
            self._firmware.send(self._to_firmware.popleft()[1])
            due += 1
        if due and self._answers:
            self._await_firmware()

    def _hear_firmware(self) -> bool:
        """Take in what it says; True if it answered our TIMESYNC of this barrier."""
        answered = False
        for message in self._firmware.receive():
            if message.get_type() == "TIMESYNC":
                answered = answered or self._is_answer(message)
            else:
                self._to_daemon.append((self._time_us + self._delay_us, bytes(message.get_msgbuf())))
        return answered

    def _await_firmware(self) -> None:
        self._firmware.send(self._barrier.pack(mavlink.MAVLink_timesync_message(0, self._time_us * 1000)))
        give_up = time.monotonic() + FIRMWARE_ANSWER_S
        while not self._hear_firmware() and time.monotonic() < give_up:
            select.select([self._firmware.fileno()], [], [], POLL_S)

    def _meet_daemon(self) -> None:
        """The daemon's first words tell where it is; what the firmware said before is stale."""
        give_up = time.monotonic() + ANSWER_LIMIT_S
        while True:
            for _, sender in received(self._daemon):
                self._daemon_at = sender
            if self._daemon_at is not None or not self._meeting_us or self._stop.is_set():
                break
            if time.monotonic() > give_up:
                self.trouble = f"no daemon within {ANSWER_LIMIT_S:g} s of wall time"
                break
            select.select([self._daemon], [], [], POLL_S)
        while self._to_daemon and self._to_daemon[0][0] < self._time_us:
            self._to_daemon.popleft()

    def _give_turn(self, daemon_at: Address, slack_us: int) -> None:
        """Bring the daemon to this time, and take what it has to say."""
        while self._to_daemon and self._to_daemon[0][0] <= self._time_us + slack_us:
            self._daemon.sendto(self._to_daemon.popleft()[1], daemon_at)
        request = mavlink.MAVLink_timesync_message(0, self._time_us * 1000)
        self._daemon.sendto(self._barrier.pack(request), daemon_at)
        give_up = time.monotonic() + ANSWER_LIMIT_S
        while not self._stop.is_set():
            if time.monotonic() > give_up:
                self.trouble = f"the daemon did not answer a barrier for {ANSWER_LIMIT_S:g} s of wall time"
                return
            select.select([self._daemon], [], [], POLL_S)
            for data, _ in received(self._daemon):
                for message in self._parser.parse(Datagram(self._time_us, data, daemon_at)):
                    if self._is_answer(message):
                        return
                    self._to_firmware.append((self._time_us + self._delay_us, bytes(message.get_msgbuf())))

    def _is_answer(self, message: Message) -> bool:
        return bool(message.get_type() == "TIMESYNC" and message.tc1 and message.ts1 == self._time_us * 1000)


@contextlib.contextmanager
def bridge(
    target_system: int,
    delay_s: float,
    firmware: FirmwareEnd | None = None,
    meeting_s: float = 0.0,
    answers: bool = False,
) -> Iterator[Bridge]:
    """A bridge that serves in a thread of its own until the block is left."""
    served = Bridge(target_system, delay_s, firmware, meeting_s, answers)
    thread = threading.Thread(target=served.run, name="bridge", daemon=True)
    thread.start()
    try:
        yield served
    finally:
        served.close()
        thread.join()


def loopback_socket() -> socket.socket:
    """A UDP socket on a free port of loopback that never waits."""
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.bind((LOOPBACK, 0))
    end.setblocking(False)
    return end


def received(end: socket.socket) -> Iterator[tuple[bytes, Address]]:
    """What has come, without waiting."""
    while True:
        try:
            yield end.recvfrom(SIZE)
        except BlockingIOError:
            return
        except ConnectionError:  # the last datagram found nobody
            continue
