"""The loop in real time, with a scripted link and a clock that only waiting moves."""

import threading
from dataclasses import dataclass, field

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import LONGEST_SLEEP_S, run_real_time
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import (
    AttitudeReceived,
    AttitudeTarget,
    EngageRequested,
    GiveUpRequested,
    HangNoticed,
    HeartbeatReceived,
    OwnHeartbeat,
    ReleaseRequested,
    Signals,
)

START_US = 1_000_000
SETPOINT = AttitudeTarget(0.5, body_rates=(0.0, 0.0, 0.0))
SIGNALS = Signals(0, "engaged", *[(0.0,) * 4] * 9)


class ScriptedLink:
    """Delivers what was scripted, each at its time; waiting is what moves the clock."""

    keeps_frames_whole = True
    name = "udpin:127.0.0.1:14540"

    def __init__(self, script=()):
        self.now_us = START_US
        self.script = sorted(script, key=lambda entry: entry[0])
        self.sent = []
        self.waits = []
        self.locked = None
        self.trouble = ""
        self.open = True

    def clock(self):
        return self.now_us

    def receive(self, timeout_s):
        self.waits.append(timeout_s)
        until = self.now_us + max(round(timeout_s * 1e6), 1)
        if self.script and self.script[0][0] <= until:
            time_us, data = self.script.pop(0)
            self.now_us = max(time_us, self.now_us)
            return [Datagram(self.now_us, data, "vehicle")]
        self.now_us = until
        return []

    def send(self, data):
        self.sent.append((self.now_us, data))
        return self.open

    def lock(self, source):
        self.locked = source

    def close(self):
        self.open = False


@dataclass
class FakeService:
    """Notes what it is told. Finishes at `finish_us`, or `release_takes_us` after a release request."""

    finish_us: int = START_US + 1_000_000
    release_takes_us: int = 50_000
    period_us: int = 10**12
    answers: dict = field(default_factory=dict)
    finished: str | None = None
    told: list = field(default_factory=list)
    advanced: list = field(default_factory=list)
    due_us: int = START_US

    def handle(self, time_us, event):
        self.told.append((time_us, event))
        if isinstance(event, ReleaseRequested):
            self.finish_us = min(self.finish_us, time_us + self.release_takes_us)
        return list(self.answers.get(type(event), ()))

    def advance(self, time_us):
        self.advanced.append(time_us)
        outputs = []
        while self.due_us <= time_us:
            self.due_us += self.period_us
            outputs += self.answers.get("deadline", ())
        if time_us >= self.finish_us:
            self.finished = "done"
        return outputs

    def next_deadline(self):
        return min(self.due_us, self.finish_us)

    def events(self, kind):
        return [(time_us, event) for time_us, event in self.told if isinstance(event, kind)]


@dataclass
class FakeRecorder:
    frames: list = field(default_factory=list)
    signals: list = field(default_factory=list)
    requests: list = field(default_factory=list)
    begun_us: int | None = None

    def write(self, time_us, frame):
        self.frames.append((time_us, frame))

    def write_signals(self, signals):
        self.signals.append(signals)

    def write_begin(self, time_us):
        self.begun_us = time_us

    def write_request(self, time_us, request):
        self.requests.append((time_us, request))


def run(service, link, *, stop=None, **options):
    session = Session(service, link, Route(), **options)
    return run_real_time(session, link.clock, stop or threading.Event())


def stop_at(time_us, stop):
    def observe(now_us, item):
        if now_us >= time_us:
            stop.set()

    return observe


def sent(link, read, kind):
    return [message for _, data in link.sent for message in read(data) if message.get_type() == kind]


@pytest.fixture
def beat(autopilot):
    return autopilot.pack(autopilot.heartbeat())


def test_events_reach_the_service_with_their_arrival_time_and_their_sample_time(autopilot, beat):
    link = ScriptedLink(
        [(START_US + 5, beat), (START_US + 700, autopilot.pack(autopilot.attitude(42, pitch=0.2)))]
    )
    service = FakeService()
    run(service, link)
    assert [time_us for time_us, _ in service.told] == [START_US + 5, START_US + 700]
    assert isinstance(service.told[0][1], HeartbeatReceived)
    attitude = service.told[1][1]
    assert isinstance(attitude, AttitudeReceived)
    assert (attitude.sample_time_us, attitude.attitude[1]) == (42_000, pytest.approx(-0.2))


class StoppedLink(ScriptedLink):
    """The process is stopped for 3 s while it waits, or while it handles what came."""

    def __init__(self, script, while_waiting):
        super().__init__(script)
        self.stopped_us = 3_000_000
        self.while_waiting = while_waiting

    def receive(self, timeout_s):
        if self.while_waiting and self.now_us > START_US + 500_000:
            self.now_us += self.stopped_us
            self.stopped_us = 0
        return super().receive(timeout_s)

    def stop_here(self, time_us, item):
        if not self.while_waiting and isinstance(item, AttitudeReceived):
            self.now_us += self.stopped_us
            self.stopped_us = 0


@pytest.mark.parametrize("while_waiting", [True, False])
def test_a_process_that_was_stopped_tells_the_service_before_what_fell_due_meanwhile(
    autopilot, beat, while_waiting
):
    """Ctrl-Z and fg, say: what would be sent for then finds a vehicle that somebody else flies by now."""
    arrived_us = START_US + 495_000
    link = StoppedLink([(START_US, beat), (arrived_us, autopilot.pack(autopilot.attitude(1)))], while_waiting)
    service = FakeService(finish_us=START_US + 5_000_000)
    recorder = FakeRecorder()
    run(service, link, recorder=recorder, observer=link.stop_here)
    ((told_us, noticed),) = service.events(HangNoticed)
    assert arrived_us <= told_us <= START_US + 700_000, "when it began"
    assert noticed.seconds == pytest.approx(3.0, abs=0.11)
    assert max(time_us for time_us in service.advanced if time_us <= told_us) <= told_us
    assert recorder.requests == [(told_us, noticed)]


def test_another_systems_attitude_never_reaches_the_service(autopilot, scripted, beat):
    stranger = scripted(2, 1)
    link = ScriptedLink([(START_US, beat), (START_US + 1, stranger.pack(stranger.attitude(1)))])
    service = FakeService()
    result = run(service, link)
    assert service.events(AttitudeReceived) == []
    assert result.counters.telemetry_received == 1


def test_deadlines_are_met_without_any_traffic_and_without_spinning(beat):
    link = ScriptedLink([(START_US, beat)])
    service = FakeService(period_us=10_000)
    run(service, link)
    assert service.advanced[:50] == list(range(START_US, START_US + 500_000, 10_000))
    assert len(link.waits) < 110


def test_without_deadlines_the_loop_sleeps_as_long_as_a_stop_request_may_wait(beat):
    link = ScriptedLink([(START_US, beat)])
    run(FakeService(), link)
    assert max(link.waits) == LONGEST_SLEEP_S
    assert len(link.waits) < 15


def test_what_the_service_answers_is_sent_before_anything_else_is_read(autopilot, beat, read):
    link = ScriptedLink(
        [(START_US, beat)]
        + [(START_US + 10_000 * n, autopilot.pack(autopilot.attitude(n))) for n in range(1, 6)]
    )
    service = FakeService(answers={AttitudeReceived: [SETPOINT]})
    result = run(service, link)
    assert [time_us for time_us, _ in link.sent] == [START_US + 10_000 * n for n in range(1, 6)]
    assert len(sent(link, read, "SET_ATTITUDE_TARGET")) == result.counters.commands_sent == 5
    assert result.counters.telemetry_received == 6


def test_commands_that_the_link_dropped_are_not_counted_or_recorded_as_sent(autopilot, beat):
    link = ScriptedLink([(START_US, beat), (START_US + 10, autopilot.pack(autopilot.attitude(1)))])
    link.open = False
    recorder = FakeRecorder()
    service = FakeService(answers={AttitudeReceived: [SETPOINT]})
    counters = run(service, link, recorder=recorder).counters
    assert (counters.commands_sent, counters.frames_sent, counters.frames_dropped) == (0, 0, 1)
    assert len(recorder.frames) == 2


def test_the_link_is_tied_to_the_sender_of_the_target_only(autopilot, scripted, beat):
    stranger = scripted(255, 190)
    gcs = stranger.heartbeat(mavlink.MAV_AUTOPILOT_INVALID, kind=mavlink.MAV_TYPE_GCS)
    link = ScriptedLink([(START_US, stranger.pack(gcs))])
    session = Session(FakeService(), link, Route())
    session.read(link.receive(0.0)[0])
    assert link.locked is None
    session.read(Datagram(START_US, beat, "vehicle"))
    assert link.locked == "vehicle"


def test_the_log_holds_both_directions_in_order_and_the_signals(autopilot, beat, read):
    attitude = autopilot.pack(autopilot.attitude(1))
    link = ScriptedLink([(START_US, beat), (START_US + 10, attitude)])
    recorder = FakeRecorder()
    run(FakeService(answers={AttitudeReceived: [SIGNALS, SETPOINT]}), link, recorder=recorder)
    assert [frame for _, frame in recorder.frames] == [beat, attitude, link.sent[0][1]]
    assert [time_us for time_us, _ in recorder.frames] == [START_US, START_US + 10, START_US + 10]
    assert recorder.signals == [SIGNALS]


def test_what_was_asked_for_at_the_start_is_told_right_after_the_first_heartbeat(autopilot, beat):
    link = ScriptedLink([(START_US + 5, beat), (START_US + 9, beat)])
    service = FakeService()
    run(service, link, on_connected=[EngageRequested()])
    kinds = [type(event) for _, event in service.told]
    assert kinds == [HeartbeatReceived, EngageRequested, HeartbeatReceived]


def test_the_vehicle_s_clock_questions_are_answered(autopilot, beat, read):
    link = ScriptedLink([(START_US, beat), (START_US + 10, autopilot.pack(autopilot.timesync(777)))])
    run(FakeService(), link)
    (answer,) = sent(link, read, "TIMESYNC")
    assert (answer.ts1, answer.tc1) == (777, (START_US + 10) * 1000)


def test_other_systems_clock_questions_and_answers_are_left_alone(autopilot, scripted, beat, read):
    stranger = scripted(2, 1)
    link = ScriptedLink(
        [
            (START_US, beat),
            (START_US + 1, stranger.pack(stranger.timesync(777))),
            (START_US + 2, autopilot.pack(autopilot.timesync(777, tc1_ns=5))),
        ]
    )
    run(FakeService(), link)
    assert sent(link, read, "TIMESYNC") == []


# ------------------------------------------------------------------ ends and errors


def test_a_stop_request_releases_control_and_the_loop_runs_on_until_the_service_is_done(beat):
    stop = threading.Event()
    link = ScriptedLink([(START_US, beat)])
    service = FakeService(release_takes_us=300_000)
    result = run(service, link, stop=stop, observer=stop_at(START_US, stop))
    assert [event.reason for _, event in service.events(ReleaseRequested)] == ["stop requested"]
    assert result.stopped
    assert result.finished == "done"
    assert link.now_us >= START_US + 300_000


def test_a_service_that_cannot_let_go_holds_the_loop_for_three_seconds_at_most(beat):
    stop = threading.Event()
    link = ScriptedLink([(START_US, beat)])
    service = FakeService(finish_us=10**12, release_takes_us=10**11)
    result = run(service, link, stop=stop, observer=stop_at(START_US, stop))
    assert result.finished is None
    ((told_us, _),) = service.events(GiveUpRequested)
    assert told_us == pytest.approx(START_US + 3_000_000, abs=200_000)
    assert 3_000_000 <= link.now_us - START_US <= 3_200_000


def test_a_stop_request_before_any_vehicle_answered_ends_at_once():
    stop = threading.Event()
    stop.set()
    link = ScriptedLink()
    result = run(FakeService(release_takes_us=10**11), link, stop=stop)
    assert result.stopped
    assert link.now_us == START_US


def test_an_output_that_must_not_be_sent_makes_the_service_let_go(autopilot, beat, read, caplog):
    link = ScriptedLink(
        [(START_US, beat)] + [(START_US + n, autopilot.pack(autopilot.attitude(n))) for n in (1, 2, 3)]
    )
    bad = AttitudeTarget(float("nan"), body_rates=(0.0, 0.0, 0.0))
    service = FakeService(answers={AttitudeReceived: [bad, OwnHeartbeat("active")]})
    result = run(service, link)
    assert sent(link, read, "SET_ATTITUDE_TARGET") == []
    assert len(sent(link, read, "HEARTBEAT")) == 3
    assert len(service.events(ReleaseRequested)) == 1
    assert result.refusal == "thrust nan is outside 0..1; not sent"
    assert result.refusal in caplog.text


def never_finishing():
    return FakeService(finish_us=10**12)


def test_no_vehicle_for_ten_seconds_is_explained():
    link = ScriptedLink()
    with pytest.raises(UserError) as info:
        run(never_finishing(), link)
    assert str(info.value) == (
        "no vehicle answered on udpin:127.0.0.1:14540 for 10 s; is it running, and does it send there?"
    )
    assert link.now_us - START_US == pytest.approx(10_000_000, abs=2e5)


def test_a_refused_connection_is_mentioned():
    link = ScriptedLink()
    link.trouble = "connection refused"
    with pytest.raises(UserError, match=r"is it running.*\(connection refused\)"):
        run(never_finishing(), link)


def test_hearing_only_another_system_is_mentioned(scripted):
    stranger = scripted(2, 1)
    link = ScriptedLink([(START_US, stranger.pack(stranger.heartbeat()))])
    with pytest.raises(UserError, match=r"heard only 2/1 .*not 1/1; is link.target_system right"):
        run(never_finishing(), link)


def test_hearing_the_vehicle_but_no_heartbeat_is_mentioned(autopilot):
    link = ScriptedLink([(START_US, autopilot.pack(autopilot.attitude(1)))])
    with pytest.raises(UserError, match="system 1 sends, but no HEARTBEAT"):
        run(never_finishing(), link)


def test_hearing_something_that_is_not_mavlink_is_mentioned():
    link = ScriptedLink([(START_US, b"\x00\xff" * 20)])
    with pytest.raises(UserError, match=r"40 bytes arrived, but they are not MAVLink.*baud rate"):
        run(never_finishing(), link)


def test_a_vehicle_that_falls_silent_later_is_the_services_concern(beat):
    link = ScriptedLink([(START_US, beat)])
    assert run(FakeService(finish_us=START_US + 30_000_000), link).finished == "done"
