"""Late steps and deadlines: each one is counted, and the count reaches the wire, the log and the people."""

import itertools
import threading
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.mavlink.companion import Companion
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import real_time_clock, run_real_time
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import Announce, OwnHeartbeat, StepTiming, Trouble
from kffa_offboard.process.notify import ServiceManager
from kffa_offboard.process.realtime import Collector
from kffa_offboard.process.timing import StepClock
from kffa_offboard.process.watch import LoopWatch

PERIOD_US = 10_000


class StallingLink:
    """100 Hz of ATTITUDE; some are answered late, since the computer is busy. Waiting moves the clock."""

    name, keeps_frames_whole, trouble = "scripted", True, ""

    def __init__(self, stalls, waits=()):
        self.now_us = 0
        self.sent = []
        self.stalls = dict(stalls)
        self.waits = dict(waits)
        self._packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self._number = 0

    def clock(self):
        return self.now_us

    def receive(self, timeout_s):
        due_us, until_us = self._number * PERIOD_US, self.now_us + round(timeout_s * 1e6)
        if due_us > until_us:
            self.now_us = until_us
            return []
        self.now_us = max(self.now_us, due_us)
        number, self._number = self._number, self._number + 1
        waited_us = self.waits.get(number, 0)
        if number == 0:
            message = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 0, 3)
        else:
            message = mavlink.MAVLink_attitude_message(number * 10, 0, 0, 0, 0, 0, 0)
        return [Datagram(self.now_us, bytes(message.pack(self._packer)), "vehicle", waited_us=waited_us)]

    def send(self, data):
        self.sent.append((self.now_us, data))
        return True

    def lock(self, source):
        pass

    def close(self):
        pass


class BusyService:
    """Takes its time with some samples; beats every 0.1 s; is done after 30 s."""

    def __init__(self, link):
        self.link = link
        self.finished = None
        self.due_us = 100_000
        self.samples = itertools.count(1)

    def handle(self, time_us, event):
        if type(event).__name__ == "AttitudeReceived":
            self.link.now_us += self.link.stalls.get(next(self.samples), 100)
        return []

    def advance(self, time_us):
        while self.due_us <= time_us:
            self.due_us += 100_000
        if time_us >= 30_000_000:
            self.finished = "done"
        return [OwnHeartbeat("standby")]

    def next_deadline(self):
        return self.due_us


def fly(link, tmp_path, sources=()):
    log, heard = tmp_path / "flight.tlog", []
    clock = StepClock(late_s=0.002)
    watch = LoopWatch(clock, ServiceManager({}), Collector(None), sources)
    with TlogWriter(log) as writer:
        session = Session(
            BusyService(link), link, Route(), recorder=writer, observer=lambda t, item: heard.append(item)
        )
        run_real_time(session, link.clock, threading.Event(), watch=watch)
    values = [
        (message.name, message.value)
        for _, message in read_tlog(log)
        if message.get_type() == "NAMED_VALUE_FLOAT"
    ]
    return values, heard, clock


def test_every_late_step_is_counted_and_published(tmp_path):
    stalls = {k: 3_000 + 10 * k for k in range(100, 2900, 70)}
    values, heard, clock = fly(StallingLink(stalls), tmp_path)
    counts = [value for name, value in values if name == "LATE_STEPS"]
    assert counts == sorted(counts)
    assert counts[-1] == len(stalls) == clock.summary()["late_steps"]
    assert max(value for name, value in values if name == "DELAY_MAX") == pytest.approx(0.0313, abs=1e-5)
    texts = [item.text for item in heard if isinstance(item, Announce)]
    assert len(texts) == 3, "in words no more than every ten seconds"
    assert texts[0] == "late steps: 1, longest 4 ms"
    assert any(isinstance(item, StepTiming) for item in heard), "the status line is told"


def test_what_waited_in_the_operating_system_is_late_too(tmp_path):
    waits = {50: 5_000, 51: 1_000}
    _, _, clock = fly(StallingLink({}, waits), tmp_path)
    assert clock.summary()["late_steps"] == 1


def test_a_deadline_that_a_long_step_delayed_is_counted(tmp_path):
    """The service's beat is due each 0.1 s; the 19th sample, at 0.19 s, takes 25 ms."""
    _, _, clock = fly(StallingLink({19: 25_000}), tmp_path)
    assert clock.summary()["late_deadlines"] == 1


def test_a_punctual_loop_reports_nothing_late(tmp_path):
    values, heard, clock = fly(StallingLink({}), tmp_path)
    assert clock.summary() == {"steps": 3000, "late_steps": 0, "late_deadlines": 0}
    assert not [item for item in heard if isinstance(item, Announce)]
    assert len([1 for name, _ in values if name == "LATE_STEPS"]) == 31, "once a second, and at the end"


def test_trouble_beside_the_flight_is_announced(tmp_path):
    news = iter([None] * 50 + ["flight log: No space left on device"])
    _, heard, _ = fly(StallingLink({}), tmp_path, [lambda: next(news, None)])
    assert Trouble("flight log: No space left on device") in heard
    assert "flight log: No space left on device" in [i.text for i in heard if isinstance(i, Announce)]


def test_the_watchdog_is_not_fed_while_a_step_hangs(tmp_path):
    fed = []

    class Manager(ServiceManager):
        def turned(self, now_us):
            fed.append(now_us)

    link = StallingLink({1500: 4_000_000})
    session = Session(BusyService(link), link, Route())
    watch = LoopWatch(StepClock(0.002), Manager({}), Collector(None))
    run_real_time(session, link.clock, threading.Event(), watch=watch)
    pauses = [b - a for a, b in itertools.pairwise(fed)]
    assert max(pauses) >= 4_000_000
    assert sorted(pauses)[-2] <= 100_000


def test_how_long_a_datagram_waited_in_the_kernel_is_known_and_a_clock_step_cannot_fake_it(monkeypatch):
    clock = real_time_clock()
    link, sender = open_link("udpin:127.0.0.1:0", clock), open_link("udpin:127.0.0.1:0", clock)
    sender.lock(("127.0.0.1", int(link.name.rpartition(":")[2])))
    wall = time.time_ns
    try:
        sender.send(b"x")
        (datagram,) = link.receive(5.0)
        assert 0 <= datagram.waited_us < 5_000_000
        sender.send(b"x")
        monkeypatch.setattr(time, "time_ns", lambda: wall() + 3_600_000_000_000)
        began = clock()
        (datagram,) = link.receive(5.0)
        assert 0 < datagram.waited_us < 5_000_000 + clock() - began
        monkeypatch.setattr(time, "time_ns", lambda: wall() - 3_600_000_000_000)
        sender.send(b"x")
        (datagram,) = link.receive(5.0)
        assert datagram.waited_us == 0
    finally:
        link.close()
        sender.close()


def test_reports_are_repeated_by_a_replay():
    """The companion's answers depend on the reports alone, not on any clock."""
    reports = [(t * 1_000_000, StepTiming(100 * t, t // 3, 0, 0.001 * t)) for t in range(1, 40)]

    def frames():
        companion, sent = Companion(Route()), []
        for time_us, report in reports:
            companion.report(time_us, report)
            sent += [str(reply) for reply in companion.take()]
        return sent

    assert frames() == frames()
