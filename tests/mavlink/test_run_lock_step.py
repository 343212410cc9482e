"""The loop in lock-step: barriers over a real UDP socket, all of them scripted before the loop starts."""

import contextlib
import itertools
import socket
import threading

import pytest

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import run_lock_step
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import (
    AttitudeReceived,
    AttitudeTarget,
    GiveUpRequested,
    HeartbeatReceived,
    OwnHeartbeat,
    ReleaseRequested,
)

PERIOD_NS = 10_000_000
HALF_PERIOD_US = 5_000
SETPOINT = AttitudeTarget(0.5, body_rates=(0.0, 0.0, 0.0))


class FakeService:
    """A setpoint for every attitude, and a heartbeat due in the middle of each of its slots."""

    def __init__(self, slots):
        self.slots = slots
        self.due_us = HALF_PERIOD_US
        self.calls = []

    @property
    def finished(self):
        return "done" if self.due_us > self.slots * 2 * HALF_PERIOD_US else None

    def handle(self, time_us, event):
        self.calls.append((time_us, type(event)))
        return [SETPOINT] if isinstance(event, AttitudeReceived) else []

    def advance(self, time_us):
        self.calls.append((time_us, "advance"))
        if time_us < self.due_us:
            return []
        self.due_us += 2 * HALF_PERIOD_US
        return [OwnHeartbeat("active")]

    def next_deadline(self):
        return self.due_us


class Recorder:
    def __init__(self):
        self.frames = []
        self.requests = []

    def write(self, time_us, frame):
        self.frames.append((time_us, frame))

    def write_signals(self, signals):
        raise AssertionError("none were given")

    def write_begin(self, time_us):
        self.begun_us = time_us

    def write_request(self, time_us, request):
        self.requests.append((time_us, request))


@pytest.fixture
def wall_clock():
    return itertools.count(0, 1000).__next__


@pytest.fixture
def link(wall_clock):
    with contextlib.closing(open_link("udpin:127.0.0.1:0", wall_clock)) as opened:
        yield opened


@pytest.fixture
def peer():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        yield opened


def send(peer, link, *datagrams):
    for data in datagrams:
        peer.sendto(data, ("127.0.0.1", int(link.name.rpartition(":")[2])))


def answers(peer, read):
    """Everything that has arrived at the vehicle, as (message type, message)."""
    peer.setblocking(False)
    messages = []
    with contextlib.suppress(BlockingIOError):
        while True:
            messages += read(peer.recv(1000))
    return [(message.get_type(), message) for message in messages]


def flight(autopilot, barriers):
    """Datagrams of a vehicle: each period an attitude and a barrier; a heartbeat first."""
    yield autopilot.pack(autopilot.heartbeat())
    for n in range(1, barriers + 1):
        yield autopilot.pack(autopilot.attitude(10 * n - 5, roll=0.01 * n))
        yield autopilot.pack(autopilot.timesync(n * PERIOD_NS))


def run(service, link, wall_clock, *, stop=None, **options):
    session = Session(service, link, Route(), **options)
    return run_lock_step(session, wall_clock, stop or threading.Event())


def test_messages_are_handled_at_the_time_of_the_barrier_after_them_and_deadlines_before_at_their_own(
    autopilot, link, peer, wall_clock
):
    send(peer, link, *flight(autopilot, 2))
    service = FakeService(slots=2)
    run(service, link, wall_clock)
    assert service.calls == [
        (10_000, "advance"),
        (10_000, HeartbeatReceived),
        (10_000, AttitudeReceived),
        (15_000, "advance"),
        (20_000, AttitudeReceived),
    ]


def test_each_barrier_is_answered_exactly_once_and_after_the_commands(
    autopilot, link, peer, wall_clock, read
):
    send(peer, link, *flight(autopilot, 3))
    result = run(FakeService(slots=3), link, wall_clock)
    received = answers(peer, read)
    assert [kind for kind, _ in received] == ["HEARTBEAT", "SET_ATTITUDE_TARGET", "TIMESYNC"] * 3
    syncs = [message for kind, message in received if kind == "TIMESYNC"]
    assert [(m.ts1, m.tc1) for m in syncs] == [(n * PERIOD_NS, n * PERIOD_NS) for n in (1, 2, 3)]
    assert result.counters.commands_sent == 3
    assert result.finished == "done"


def test_a_request_at_time_zero_gets_an_answer_that_is_not_a_request(autopilot, link, peer, wall_clock, read):
    send(peer, link, autopilot.pack(autopilot.heartbeat()), autopilot.pack(autopilot.timesync(0)))
    run(FakeService(slots=0), link, wall_clock)
    (answer,) = [message for kind, message in answers(peer, read) if kind == "TIMESYNC"]
    assert answer.ts1 == 0
    assert answer.tc1 != 0


def test_a_repeated_barrier_is_answered_again_without_moving_time(autopilot, link, peer, wall_clock, read):
    again = autopilot.pack(autopilot.timesync(PERIOD_NS))
    send(peer, link, autopilot.pack(autopilot.heartbeat()), again, again)
    send(peer, link, autopilot.pack(autopilot.timesync(2 * PERIOD_NS)))
    service = FakeService(slots=2)
    run(service, link, wall_clock)
    assert [kind for kind, _ in answers(peer, read)].count("TIMESYNC") == 3
    assert [time_us for time_us, call in service.calls if call == "advance"] == [10_000, 15_000]


def test_another_systems_timesync_is_no_barrier(autopilot, scripted, link, peer, wall_clock, read):
    stranger = scripted(2, 1)
    send(peer, link, autopilot.pack(autopilot.heartbeat()), stranger.pack(stranger.timesync(PERIOD_NS)))
    send(peer, link, autopilot.pack(autopilot.timesync(2 * PERIOD_NS)))
    service = FakeService(slots=2)
    run(service, link, wall_clock)
    assert [time_us for time_us, call in service.calls if call == "advance"] == [20_000, 15_000]
    assert [m.ts1 for kind, m in answers(peer, read) if kind == "TIMESYNC"] == [2 * PERIOD_NS]


def test_two_runs_send_and_record_the_same_bytes(scripted, wall_clock, read):
    logs, commands = [], []
    for _ in range(2):
        autopilot, recorder = scripted(), Recorder()
        with (
            contextlib.closing(open_link("udpin:127.0.0.1:0", wall_clock)) as link,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer,
        ):
            send(peer, link, *flight(autopilot, 5))
            run(FakeService(slots=5), link, wall_clock, recorder=recorder)
            commands.append([bytes(message.get_msgbuf()) for _, message in answers(peer, read)])
        logs.append(recorder.frames)
    assert logs[0] == logs[1]
    assert commands[0] == commands[1]
    assert len(commands[0]) == 15


def test_how_messages_are_cut_into_datagrams_does_not_matter(scripted, wall_clock):
    calls = []
    for joined in (False, True):
        autopilot = scripted()
        with (
            contextlib.closing(open_link("udpin:127.0.0.1:0", wall_clock)) as link,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer,
        ):
            datagrams = list(flight(autopilot, 3))
            send(peer, link, *([b"".join(datagrams)] if joined else datagrams))
            service = FakeService(slots=3)
            run(service, link, wall_clock)
            calls.append(service.calls)
    assert calls[0] == calls[1]


def test_the_log_is_in_simulated_time_and_in_the_order_of_the_service(
    autopilot, link, peer, wall_clock, read
):
    recorder = Recorder()
    send(peer, link, *flight(autopilot, 2))
    run(FakeService(slots=2), link, wall_clock, recorder=recorder)
    assert [(time_us, read(frame)[0].get_type()) for time_us, frame in recorder.frames] == [
        (10_000, "HEARTBEAT"),  # our own, due before the vehicle's first message
        (10_000, "HEARTBEAT"),
        (10_000, "ATTITUDE"),
        (10_000, "SET_ATTITUDE_TARGET"),
        (10_000, "TIMESYNC"),
        (10_000, "TIMESYNC"),
        (15_000, "HEARTBEAT"),
        (20_000, "ATTITUDE"),
        (20_000, "SET_ATTITUDE_TARGET"),
        (20_000, "TIMESYNC"),
        (20_000, "TIMESYNC"),
    ]


def test_a_stop_request_is_told_at_the_next_barrier_and_runs_three_simulated_seconds_at_most(
    autopilot, link, peer, wall_clock
):
    stop = threading.Event()
    send(peer, link, autopilot.pack(autopilot.heartbeat()))
    for second in range(1, 8):
        send(peer, link, autopilot.pack(autopilot.timesync(second * 10**9)))
    service = FakeService(slots=10**6)
    result = run(service, link, wall_clock, stop=stop, observer=lambda time_us, item: stop.set())
    assert (1_000_000, ReleaseRequested) in service.calls
    assert service.calls[-2:] == [(3_995_000, "advance"), (4_000_000, GiveUpRequested)]
    assert result.stopped
    assert result.finished is None


def test_a_stop_request_before_the_first_barrier_ends_at_once(link, wall_clock):
    stop = threading.Event()
    stop.set()
    assert run(FakeService(slots=0), link, wall_clock, stop=stop).stopped


def test_a_calling_daemon_says_hello_without_disturbing_its_sequence(autopilot, peer, wall_clock, read):
    recorder = Recorder()
    with contextlib.closing(open_link(f"udpout:127.0.0.1:{peer.getsockname()[1]}", wall_clock)) as link:
        session = Session(FakeService(slots=1), link, Route(), recorder=recorder)
        receive = link.receive

        def receive_after_hello(timeout_s):
            hello, place = peer.recvfrom(1000)
            assert read(hello)[0].get_type() == "HEARTBEAT"
            for datagram in flight(autopilot, 1):
                peer.sendto(datagram, place)
            return receive(timeout_s)

        link.receive = receive_after_hello
        run_lock_step(session, wall_clock, threading.Event())
    assert [message.get_seq() for _, message in answers(peer, read)] == [0, 1, 2]
    assert len([f for _, f in recorder.frames if read(f)[0].get_srcSystem() == 245]) == 3


class SilentLink:
    """A link on which nothing more arrives; waiting on it moves the wall clock."""

    keeps_frames_whole = True
    name = "udpin:127.0.0.1:14540"
    trouble = ""

    def __init__(self, datagrams):
        self.datagrams = datagrams
        self.now_us = 0

    def clock(self):
        return self.now_us

    def receive(self, timeout_s):
        self.now_us += round(timeout_s * 1e6)
        waiting, self.datagrams = self.datagrams, []
        return waiting

    def send(self, data):
        return True

    def lock(self, source):
        pass


def test_a_vehicle_that_never_answers_is_explained():
    link = SilentLink([])
    with pytest.raises(UserError, match=r"no vehicle answered on udpin:.*:14540 for 10 s"):
        run(FakeService(slots=10**6), link, link.clock)
    assert link.now_us == pytest.approx(10_000_000, abs=2e5)


def test_a_vehicle_that_is_not_in_lock_step_is_called_so(autopilot, scripted):
    frames = [autopilot.pack(autopilot.heartbeat()), autopilot.pack(autopilot.attitude(100, 0.1))]
    link = SilentLink([Datagram(0, data, "vehicle") for data in frames])
    with pytest.raises(
        UserError,
        match=r"lock-step: the vehicle on udpin:.*:14540 sends HEARTBEAT and no TIMESYNC request in 10 s, so "
        r"it is not in lock-step; start sim-vehicle with --lockstep, or leave it out here",
    ):
        run(FakeService(slots=10**6), link, link.clock)
    other = scripted(system=7)
    link = SilentLink([Datagram(0, other.pack(other.heartbeat()), "vehicle")])
    with pytest.raises(UserError, match=r"no vehicle answered on .* heard only 7/1"):
        run(FakeService(slots=10**6), link, link.clock)


def test_barriers_that_stop_coming_are_explained(autopilot):
    link = SilentLink([Datagram(0, data, "vehicle") for data in flight(autopilot, 2)])
    with pytest.raises(UserError, match=r"no TIMESYNC request .* for 5 s; is the simulated vehicle still"):
        run(FakeService(slots=10**6), link, link.clock)


def test_time_that_goes_back_is_explained(autopilot, link, peer, wall_clock):
    send(peer, link, *flight(autopilot, 3), autopilot.pack(autopilot.timesync(PERIOD_NS)))
    with pytest.raises(UserError, match=r"went back from 0.030 s to 0.010 s.*restart the daemon"):
        run(FakeService(slots=10**6), link, wall_clock)
