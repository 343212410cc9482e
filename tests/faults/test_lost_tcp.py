"""A TCP connection to the vehicle that is lost, over real sockets of this machine; time is the vehicle's."""

import contextlib
import socket
import threading

import pytest

from kffa_offboard.faults.check import after_release, bad_frames, blind
from kffa_offboard.faults.edit import message_id, number_of, split
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.shell import RealTimeLoop, Unwatched
from kffa_offboard.offboard.events import Trouble
from kffa_offboard.offboard.service import State

SLOT_US = 10_000
SETPOINT = number_of("SET_ATTITUDE_TARGET")


class TellsNews(Unwatched):
    def __init__(self, link):
        self.link = link

    def turned(self, now_us):
        news = self.link.take_news()
        return () if news is None else [Trouble(news)]


class OverTcp:
    """The daemon's loop in real time on a `tcp` link, and the vehicle's end of it; slot by slot."""

    def __init__(self, flight):
        self.flight = flight
        flight.begin()
        self.vehicle = flight.vehicle
        self.vehicle.add_peer("daemon")
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.place = self.listener.getsockname()
        self.link = open_link(f"tcp:127.0.0.1:{self.place[1]}", self.clock)
        flight.connect(self.link)
        self.loop = RealTimeLoop(flight.session, self.clock, threading.Event(), 60.0, TellsNews(self.link))
        self.connection = None
        self.accept()

    def clock(self):
        return self.vehicle.time_us

    def accept(self):
        """Wait for the daemon to call; its time goes on."""
        self.listener.setblocking(False)
        while self.connection is None:
            self.slot()
            with contextlib.suppress(BlockingIOError):
                self.connection, _ = self.listener.accept()

    def hang_up(self):
        self.connection.close()
        self.connection = None

    def close(self):
        self.link.close()
        self.listener.close()
        if self.connection is not None:
            self.connection.close()

    def slot(self):
        self.flight.look()
        self.vehicle.advance(self.vehicle.time_us + SLOT_US)
        frames = b"".join(data for peer, data in self.vehicle.outgoing() if peer in (None, "daemon"))
        if not self.loop.goes_on():
            return
        datagrams = self.exchange(frames) if self.connection is not None else self.link.receive(0.001)
        self.loop.turn(datagrams)

    def exchange(self, frames):
        """Everything arrives within the slot."""
        with contextlib.suppress(BlockingIOError):
            for frame in split(self.connection.recv(1 << 16, socket.MSG_DONTWAIT)):
                self.vehicle.receive(frame, "daemon")
        self.connection.sendall(frames)
        datagrams, waiting = self.link.receive(0.0), len(frames)
        waiting -= sum(len(datagram.data) for datagram in datagrams)
        while waiting > 0:
            datagrams += (new := self.link.receive(5.0))
            waiting -= sum(len(datagram.data) for datagram in new)
        return datagrams

    def fly(self, until):
        for _ in range(2000):
            if until():
                return
            self.slot()
        raise AssertionError(f"not within 20 s: {self.flight.texts}")

    def fly_for(self, seconds):
        until_us = self.clock() + round(seconds * 1e6)
        self.fly(lambda: self.clock() >= until_us)


@pytest.fixture
def over_tcp():
    with contextlib.ExitStack() as stack:
        yield lambda flight: stack.enter_context(contextlib.closing(OverTcp(flight)))


def setpoints(flight):
    return [time_us for time_us, frame in flight.recorder.sent if message_id(frame) == SETPOINT]


def test_a_tcp_link_that_is_lost_in_flight_ends_control_within_a_quarter_of_a_second(fault_flight, over_tcp):
    flight = fault_flight(settle_s=0.2)
    line = over_tcp(flight)
    line.fly(lambda: flight.service.state is State.ENGAGED)
    line.fly_for(0.5)
    assert setpoints(flight)[-1] > line.clock() - 30_000
    lost_us = line.clock()
    line.hang_up()
    line.fly(lambda: not line.loop.goes_on())
    line.slot()
    assert lost_us + 240_000 <= flight.released_s * 1e6 <= lost_us + 280_000
    assert "failsafe: no attitude for 0.25 s" in flight.texts
    assert [text for text in flight.texts if text.startswith("link lost: ")]
    later = [time_us for time_us in setpoints(flight) if time_us > lost_us + SLOT_US]
    assert len(later) <= 2, "only the last ones, to be still and level, on a connection that is back by then"
    assert len(set(later)) <= 1, "at one moment"
    for found in (
        bad_frames(flight.settings.limits, flight.recorder.sent, True),
        after_release(flight.heard),
        blind(flight.settings, flight.heard),
    ):
        assert found == []


def test_a_tcp_link_that_is_lost_while_observing_comes_back_and_nothing_engages_by_itself(
    fault_flight, over_tcp
):
    flight = fault_flight(settle_s=0.2, changes={"engage": False})
    line = over_tcp(flight)
    line.fly(lambda: flight.service.state is State.READY)
    line.hang_up()
    line.listener.close()
    line.fly_for(4.0)
    assert flight.service.state is State.WAITING and line.loop.goes_on()
    line.listener = socket.create_server(line.place)
    back_us = line.clock()
    line.accept()
    assert line.clock() - back_us <= 2_000_000 + 2 * SLOT_US
    line.fly(lambda: flight.service.state is State.READY)
    assert "link is back" in flight.texts
    assert setpoints(flight) == []
