"""Somebody else on the link: what is noticed, what is said, and that the log tells the same again."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import FrameParser, Route
from kffa_offboard.mavlink.rivals import RivalWatch
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import IntrusionNoticed

NOW_US = 1_000_000
IDENTITY = [1.0, 0.0, 0.0, 0.0]
SECRET = bytes(range(60, 92))


class Told:
    """A service that only listens."""

    finished = None

    def __init__(self):
        self.events = []

    def handle(self, time_us, event):
        self.events.append(event)
        return []

    def advance(self, time_us):
        return []

    def next_deadline(self):
        return None


class NoWire:
    name, trouble, keeps_frames_whole = "test", "", True

    def __init__(self):
        self.locked = None
        self.sent = []

    def send(self, data):
        self.sent.append(data)
        return True

    def lock(self, source):
        self.locked = source


class Notebook:
    def __init__(self):
        self.frames, self.requests = [], []

    def write(self, time_us, frame):
        self.frames.append(frame)

    def write_begin(self, time_us):
        pass

    def write_request(self, time_us, request):
        self.requests.append(request)


def attitude_target(system, component):
    return mavlink.MAVLink_set_attitude_target_message(1, system, component, 128, IDENTITY, 0, 0, 0, 0.5)


def position_target(system, component):
    return mavlink.MAVLink_set_position_target_local_ned_message(
        1, system, component, 1, 2552, 0, 0, -5, 0, 0, 0, 0, 0, 0, 0, 0
    )


def global_target(system, component):
    return mavlink.MAVLink_set_position_target_global_int_message(
        1, system, component, 6, 2552, 0, 0, 5, 0, 0, 0, 0, 0, 0, 0, 0
    )


def actuator_target(system, component):
    return mavlink.MAVLink_set_actuator_control_target_message(1, 0, system, component, [0.0] * 8)


@pytest.fixture
def watch(route):
    return RivalWatch(route)


@pytest.mark.parametrize(
    "message",
    [
        attitude_target(1, 1),
        attitude_target(1, 0),
        position_target(0, 0),
        global_target(1, 1),
        actuator_target(0, 1),
    ],
)
def test_setpoints_of_somebody_else_for_the_vehicle_are_noticed(watch, scripted, message):
    noticed = watch.watch(NOW_US, scripted(255, 190).over_the_wire(message))
    assert noticed == IntrusionNoticed("255/190 sends setpoints to the vehicle", "ends")


@pytest.mark.parametrize(
    "message", [attitude_target(245, 191), attitude_target(2, 1), position_target(1, 154)]
)
def test_setpoints_for_us_for_another_vehicle_or_for_a_gimbal_are_not(watch, scripted, message):
    assert watch.watch(NOW_US, scripted(255, 190).over_the_wire(message)) is None


def test_setpoints_for_a_daemon_with_the_vehicles_system_id_are_for_it(scripted):
    watch = RivalWatch(Route(own_system=1, own_component=191))
    sender = scripted(255, 190)
    assert watch.watch(NOW_US, sender.over_the_wire(attitude_target(1, 191))) is None
    assert watch.watch(NOW_US, sender.over_the_wire(attitude_target(1, 0))) is not None


def boots(watch, scripted, times_ms, period_us=10_000):
    """What is noticed about attitudes with these boot times, in order."""
    vehicle = scripted()
    return [
        noticed
        for k, boot_ms in enumerate(times_ms)
        if (noticed := watch.watch(NOW_US + k * period_us, vehicle.over_the_wire(scripted.attitude(boot_ms))))
    ]


@pytest.mark.parametrize("apart_ms", [300, 1500, 3_600_000])
def test_two_vehicles_by_turns_are_noticed_within_a_tenth_of_a_second(watch, scripted, apart_ms):
    times = [start + 10 * k for k in range(5, 12) for start in (apart_ms, 0)]
    noticed = boots(watch, scripted, times, period_us=7_000)
    assert noticed
    assert set(noticed) == {IntrusionNoticed("two vehicles are 1/1, or old telemetry", "ends")}


def test_a_restart_lost_doubled_and_overtaken_samples_are_no_second_vehicle(watch, scripted):
    steady = list(range(100_000, 110_000, 10))
    overtaken = [steady[k ^ 1] for k in range(1000)]
    doubled = [time_ms for time_ms in steady for _ in (0, 1)]
    restarted = [*steady, *range(0, 5000, 10), *range(0, 5000, 10)]
    for times in (steady, steady[::7], overtaken, doubled, restarted):
        assert boots(RivalWatch(Route()), scripted, times) == []


@pytest.mark.parametrize(
    ("back_ms", "steps", "period_us", "noticed"),
    [
        (251, 5, 500_000, True),
        (250, 5, 500_000, False),  # overtaken on its way
        (251, 4, 500_000, False),  # an autopilot that is started again, and again
        (251, 5, 500_001, False),
    ],
)
def test_five_steps_back_of_more_than_a_quarter_of_a_second_within_two_seconds_are_two_clocks(
    watch, scripted, back_ms, steps, period_us, noticed
):
    times = [time_ms for k in range(steps) for time_ms in (100_000 + k, 100_000 + k - back_ms)]
    vehicle = scripted()
    found = [
        watch.watch(NOW_US + k // 2 * period_us, vehicle.over_the_wire(scripted.attitude(time_ms)))
        for k, time_ms in enumerate(times)
    ]
    assert [one is not None for one in found] == [False] * (2 * steps - 1) + [noticed]


def test_a_heartbeat_of_another_kind_of_vehicle_under_its_id_is_noticed(watch, scripted):
    def beat(kind):
        return mavlink.MAVLink_heartbeat_message(kind, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 3, 3)

    vehicle = scripted()
    assert watch.watch(NOW_US, vehicle.over_the_wire(beat(mavlink.MAV_TYPE_QUADROTOR))) is None
    assert watch.watch(NOW_US, vehicle.over_the_wire(beat(mavlink.MAV_TYPE_HEXAROTOR))) is not None


def test_a_heartbeat_of_another_firmware_under_the_vehicles_id_is_noticed(watch, scripted):
    vehicle = scripted()
    px4 = vehicle.over_the_wire(scripted.heartbeat())
    copter = vehicle.over_the_wire(scripted.heartbeat(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA))
    assert watch.watch(NOW_US, px4) is None
    assert watch.watch(NOW_US, copter) == IntrusionNoticed("two vehicles are 1/1", "forbids")
    assert watch.watch(NOW_US, px4) is None


# ------------------------------------------------------------------------ what the link itself shows


@pytest.fixture
def session(route):
    session = Session(Told(), NoWire(), route, recorder=Notebook())
    session.advance(NOW_US)
    return session


def read(session, frame, source=("127.0.0.1", 14550), time_us=NOW_US, **marks):
    """Hand over a datagram as the real-time loop does; the messages that are left."""
    messages = session.read(Datagram(time_us, frame, source, **marks))
    for message in messages:
        session.handle(time_us, message)
    session.report_notices(time_us)
    return messages


def noticed_by(session):
    return [event for event in session.service.events if isinstance(event, IntrusionNoticed)]


def test_a_second_vehicle_at_another_address_is_noticed_and_not_listened_to(session, scripted):
    vehicle = scripted()
    read(session, vehicle.pack(scripted.heartbeat()))
    assert session.link.locked == ("127.0.0.1", 14550)
    beat = vehicle.pack(scripted.heartbeat(armed=True))
    assert read(session, beat, ("10.0.0.7", 9999), stranger=True) == []
    expected = IntrusionNoticed("another vehicle is 1/1: 10.0.0.7:9999", "forbids")
    assert noticed_by(session) == session._recorder.requests == [expected]
    assert session.link.locked == ("127.0.0.1", 14550)
    assert beat not in session._recorder.frames


def test_a_vehicle_that_comes_back_from_another_address_after_silence_is_listened_to(session, scripted):
    """The autopilot, or the router before it, was started again: the port of its end is a new one."""
    vehicle, elsewhere = scripted(), ("127.0.0.1", 40001)
    beat = vehicle.pack(scripted.heartbeat())
    read(session, beat)
    assert read(session, beat, elsewhere, NOW_US + 2_900_000, stranger=True) == []
    assert session.link.locked == ("127.0.0.1", 14550)
    read(session, scripted(255, 190).pack(scripted.heartbeat()), elsewhere, NOW_US + 3_000_000, stranger=True)
    assert session.link.locked == ("127.0.0.1", 14550), "a ground station is no vehicle"
    read(session, beat, elsewhere, NOW_US + 3_100_000, stranger=True)
    assert session.link.locked == elsewhere
    assert noticed_by(session)[-1] == IntrusionNoticed("vehicle 1/1 is now at 127.0.0.1:40001", "forbids")
    assert len(read(session, beat, elsewhere, NOW_US + 3_200_000)) == 1
    read(session, beat, ("127.0.0.1", 14550), NOW_US + 3_300_000, stranger=True)
    assert session.link.locked == elsewhere, "now that one is the stranger"


def signing(system, component):
    """Somebody who signs."""
    mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = SECRET, True, 1
    return mav


def test_a_vehicle_that_signs_is_announced_once_where_we_do_not(session, scripted):
    """It does not listen to us: no rates, no parameters, and nothing else would say why."""
    beat = scripted.heartbeat()
    read(session, beat.pack(signing(255, 190)))
    read(session, scripted().pack(beat))
    assert noticed_by(session) == [], "a ground station that signs means nothing for the vehicle"
    vehicle = signing(1, 1)
    for _ in range(3):
        assert len(read(session, beat.pack(vehicle))) == 1, "it is heard all the same"
    expected = IntrusionNoticed("vehicle signs messages: give [signing] key_file", "said")
    assert noticed_by(session) == session._recorder.requests == [expected]


def test_a_ground_station_at_another_address_is_nothing_to_speak_of(session, scripted):
    ground = scripted(255, 190)
    read(session, ground.pack(scripted.heartbeat()), ("10.0.0.7", 9999), stranger=True)
    read(session, b"\xfd noise", ("10.0.0.7", 9999), stranger=True)
    assert noticed_by(session) == []


def test_a_second_daemon_with_our_ids_is_noticed_and_kept_out_of_the_log(session, scripted):
    """The log takes what is under our ids for what we sent."""
    impostor = scripted(245, 191).pack(attitude_target(1, 1))
    assert read(session, impostor) == []
    expected = IntrusionNoticed("somebody else is 245/191: a second daemon?", "forbids")
    assert noticed_by(session) == session._recorder.requests == [expected]
    assert session._recorder.frames == []


def test_two_vehicles_behind_one_address_are_noticed(session, scripted):
    """By their clocks, and by their kinds."""
    vehicle = scripted()
    for k in range(5):
        for boot_ms in (500_000 + 10 * k, 10 * k):
            read(session, vehicle.pack(scripted.attitude(boot_ms)))
    assert noticed_by(session) == [IntrusionNoticed("two vehicles are 1/1, or old telemetry", "ends")]
    for autopilot in (mavlink.MAV_AUTOPILOT_PX4, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA):
        read(session, vehicle.pack(scripted.heartbeat(autopilot)))
    assert noticed_by(session)[1:] == [IntrusionNoticed("two vehicles are 1/1", "forbids")]


def test_an_echo_of_what_we_sent_is_not_taken_for_a_second_daemon(session, scripted):
    ping = scripted(255, 190).pack(mavlink.MAVLink_ping_message(5, 1, 0, 0))
    read(session, ping)
    (answer,) = session.link.sent
    assert read(session, answer) == []
    assert noticed_by(session) == []
    assert session._recorder.frames == [ping, answer]


def test_an_echo_is_known_for_256_frames(watch, scripted):
    """As many as leave in two seconds; what is older is kept no longer."""
    ours = scripted(245, 191)
    frames = [ours.over_the_wire(scripted.attitude(boot_ms)) for boot_ms in range(257)]
    for frame in frames[:256]:
        watch.note_sent([bytes(frame.get_msgbuf())])
    assert not any(watch.is_impostor(frame) for frame in frames[:256])
    assert watch.is_impostor(frames[256])
    watch.note_sent([bytes(frames[256].get_msgbuf())])
    assert watch.is_impostor(frames[0]) and not watch.is_impostor(frames[1])


def test_a_flood_of_strangers_is_not_kept(session, scripted):
    vehicle = scripted()
    for port in range(1000):
        frame = vehicle.pack(scripted.heartbeat())
        session.read(Datagram(NOW_US, frame, ("10.0.0.7", port), stranger=True))
    assert len(session._reception.take_notices()) <= 16


# -------------------------------------------------------------------------------- SETUP_SIGNING


def test_setup_signing_is_ignored_announced_and_its_key_is_in_no_log(session, scripted):
    ground = scripted(255, 190)
    for target in ((245, 191), (0, 0)):
        read(session, ground.pack(mavlink.MAVLink_setup_signing_message(*target, list(SECRET), 12345)))
    assert set(noticed_by(session)) == {IntrusionNoticed("SETUP_SIGNING of 255/190 ignored", "said")}
    recorded = b"".join(session._recorder.frames)
    assert SECRET[:8] not in recorded
    messages = FrameParser(True).parse(Datagram(0, recorded, None))
    assert [message.get_type() for message in messages] == ["SETUP_SIGNING"] * 2
    assert {tuple(message.secret_key) for message in messages} == {(0,) * 32}


def test_setup_signing_for_the_vehicle_is_not_ours_to_speak_of_and_not_to_keep_either(session, scripted):
    ground = scripted(255, 190)
    read(session, ground.pack(mavlink.MAVLink_setup_signing_message(1, 191, list(SECRET), 12345)))
    (message,) = read(session, ground.pack(mavlink.MAVLink_setup_signing_message(1, 1, list(SECRET), 12345)))
    assert noticed_by(session) == []
    assert (message.target_system, message.get_srcSystem(), message.get_seq()) == (1, 255, 1)
    assert SECRET[:8] not in b"".join(session._recorder.frames)
