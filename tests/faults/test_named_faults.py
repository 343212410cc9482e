"""Each fault of the link, in flight on the simulated vehicle: what is announced, when, and how it flies on.

Bounds are those of docs/safety.md.
"""

from dataclasses import replace
from math import inf, nan

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.faults.faults import (
    Corrupt,
    Delay,
    Duplicate,
    Flood,
    Freeze,
    Lose,
    Offset,
    Overwrite,
    ShiftClock,
    Thin,
)
from kffa_offboard.offboard.events import Announce, AttitudeTarget

AT = 3.2  # s; the daemon is engaged at 2.42
ATTITUDE, POSITION, HEARTBEAT = ("ATTITUDE",), ("LOCAL_POSITION_NED",), ("HEARTBEAT",)
PERIOD = 0.02


EARLIER = 1.1  # s; ArduPilot's heartbeats are quicker, and what settles is not what is tested


def sooner(fault):
    return replace(fault, start_s=max(fault.start_s - EARLIER, 0.0))


def frames(system, *messages):
    packer = mavlink.MAVLink(None, system, 1)
    return tuple(bytes(message.pack(packer)) for message in messages)


ATTITUDE_OF_OLD = mavlink.MAVLink_attitude_message(100, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
IRRELEVANT = mavlink.MAVLink_raw_imu_message(0, 0, 0, 0, 0, 0, 0, 0, 0, 0)

ESTIMATE = ("ESTIMATOR_STATUS", "EKF_STATUS_REPORT")
INVALID = {"messages": ESTIMATE, "values": {"flags": 0x033E}}  # the attitude

ENDS = {  # fault, longest time until control is given up [s], reason
    "lost": (Lose(AT), 0.25, "no attitude for 0.25 s"),
    "position-lost": (Lose(AT, messages=POSITION), 0.25, "no position for 0.25 s"),
    "attitude-lost": (Lose(AT, messages=ATTITUDE), 0.25, "no attitude for 0.25 s"),
    "heartbeat-lost": (Lose(AT, messages=HEARTBEAT), 3.0, "no heartbeat for 3 s"),
    "late": (
        Delay(AT, delay_s=0.2),
        0.45,
        "late",
    ),  # "comes later than before", or TIMESYNC tells first: "latency"
    "very-late": (Delay(AT, delay_s=0.4), 0.25, "no attitude for 0.25 s"),
    "frozen": (Freeze(AT, messages=ATTITUDE + POSITION), 0.5, "stands still for 0.5 s"),
    "attitude-frozen": (Freeze(AT, messages=ATTITUDE), 0.5, "attitude stands still for 0.5 s"),
    "position-frozen": (Freeze(AT, messages=POSITION), 0.5, "position stands still for 0.5 s"),
    "time-back": (ShiftClock(AT, offset_s=-1.0), 0.25, "samples with a standing clock"),
    "time-forward": (ShiftClock(AT, offset_s=2.0), PERIOD, "s between samples"),
    "not-a-number": (
        Overwrite(AT, messages=ATTITUDE, values={"roll": nan}),
        PERIOD,
        "attitude is not finite",
    ),
    "infinite": (Overwrite(AT, messages=POSITION, values={"z": inf}), PERIOD, "position is not finite"),
    "attitude-jump": (Offset(AT, messages=ATTITUDE, values={"pitch": 0.6}), PERIOD, "attitude jumped"),
    "altitude-jump": (Offset(AT, messages=POSITION, values={"z": -3.0}), PERIOD, "altitude jumped"),
    "body-rate-huge": (Overwrite(AT, messages=ATTITUDE, values={"rollspeed": 1e30}), PERIOD, "body rate"),
    "body-rate-wrong": (Overwrite(AT, messages=ATTITUDE, values={"rollspeed": 3.0}), 0.1, "do not fit"),
    "climb-rate-huge": (Overwrite(AT, messages=POSITION, values={"vz": 100.0}), PERIOD, "climb rate"),
    "climb-rate-wrong": (Offset(AT, messages=POSITION, values={"vz": 6.0}), 0.16, "does not fit"),
    "climb-rate-wrong-by-less": (Offset(AT, messages=POSITION, values={"vz": 1.6}), 0.4, "does not fit"),
    "flooded-with-samples": (Flood(AT, frames=frames(1, ATTITUDE_OF_OLD)), PERIOD, "standing clock"),
    "called-invalid": (Overwrite(AT, **INVALID), 1.4, "autopilot calls its attitude invalid"),
    "tenth-of-rate": (Thin(AT, messages=ATTITUDE + POSITION), 1.0, "Hz; omega_o = 50 needs 20"),
}
KEPT = {  # fault, and how far from its height the vehicle may move [m]
    "none": (None, 0.05),
    "a-third-lost": (Lose(AT, messages=ATTITUDE + POSITION, share=0.3), 0.1),
    "a-short-burst": (Lose(AT, 0.2), 0.1),
    "duplicated": (Duplicate(AT, copies=2), 0.05),
    "reordered": (Delay(AT, delay_s=0.0, jitter_s=0.05), 0.05),
    "corrupted": (Corrupt(AT, messages=ATTITUDE + POSITION, share=0.3), 0.1),
    "third-of-rate": (Thin(AT, messages=ATTITUDE + POSITION, keep_every=3), 0.1),
    "flooded-by-another-system": (Flood(AT, 0.5, frames=frames(77, ATTITUDE_OF_OLD)), 0.05),
    "flooded-with-what-nobody-needs": (Flood(AT, 0.5, frames=frames(1, IRRELEVANT)), 0.05),
    "called-invalid-for-a-moment": (Overwrite(AT, 0.8, **INVALID), 0.05),
    "acks-lost": (Lose(messages=("COMMAND_ACK",)), 0.1),
}


def assert_ends(flight, most, reason):
    assert flight.released_s is not None and flight.released_s <= AT + most + 0.021, flight.texts
    assert any(text.startswith("failsafe: ") and reason in text for text in flight.texts), flight.texts
    assert reason in flight.status_texts
    assert flight.violations == []
    last_us, last = flight.targets[-1]
    assert last_us <= flight.released_s * 1e6 + 10_001
    assert last.attitude is not None and last.attitude[:2] == (0.0, 0.0)
    until = [k for k, (time_us, _) in enumerate(flight.states) if time_us <= flight.released_s * 1e6]
    assert max(flight.tilts[: len(until)]) < 0.3
    assert max(abs(height - 5.0) for height in flight.heights[: len(until)]) < 1.0


def assert_kept(flight, most):
    assert flight.engaged_s is not None and flight.released_s is None, flight.texts
    assert flight.violations == []
    assert max(abs(height - 5.0) for height in flight.heights) < most + 0.05
    assert max(flight.tilts) < 0.1


@pytest.fixture(scope="module")
def sound(fault_flight):
    """A flight without faults to just before them: what all the others have flown by then, too."""
    flight = fault_flight().prepare().until(AT - 0.1)
    assert flight.engaged_s is not None and flight.released_s is None
    return flight


@pytest.mark.parametrize("name", ENDS)
def test_control_ends_in_time_with_the_reason_and_one_level_setpoint(sound, name):
    fault, most, reason = ENDS[name]
    flight = sound.copied(down=(fault,)).until(AT + most + 0.4)
    assert_ends(flight, most, reason)


@pytest.mark.parametrize("name", KEPT)
def test_control_is_kept_and_the_vehicle_stays(sound, fault_flight, name):
    fault, most = KEPT[name]
    down = () if fault is None else (fault,)
    early = fault is not None and fault.start_s < AT
    flight = (fault_flight(down=down).prepare() if early else sound.copied(down)).until(AT + 1.8)
    assert_kept(flight, most)


@pytest.mark.parametrize("repeats", [0, 3])
def test_a_climb_rate_that_is_wrong_by_3_m_s_in_most_samples_does_not_move_the_vehicle(
    settled_flight, repeats
):
    """It moved by 2 m. The samples are passed over, and that is said once."""
    wrong = Overwrite(0.3, 0.6, messages=POSITION, share=0.7, values={"vz": 3.0})
    flight = settled_flight("ardupilot").fly_on(2.0, (wrong, Duplicate(0.1, 0.6, share=0.7, copies=repeats)))
    assert flight.released_s is None and flight.violations == []
    assert flight.texts.count("climb rate jumps: sample passed over") == 1
    assert max(abs(flight.heights[k] - 5.0) for k in flight.held) < 0.1


@pytest.mark.parametrize("error", [1.0, 1.3, 1.6, 2.0, 6.0])
@pytest.mark.parametrize("share", [0.3, 0.7, 1.0])
def test_however_wrong_the_climb_rate_is_the_vehicle_stays_within_half_a_metre(settled_flight, error, share):
    wrong = Offset(0.1, messages=POSITION, share=share, values={"vz": error})
    flight = settled_flight("ardupilot").fly_on(2.0, (wrong,))
    assert flight.violations == []
    assert max(abs(flight.heights[k] - 5.0) for k in flight.held) < 0.5


@pytest.mark.parametrize("error", [1.5, 2.0, 3.0, 6.0])
@pytest.mark.parametrize("share", [0.3, 0.7, 1.0])
def test_however_wrong_a_body_rate_is_the_vehicle_tilts_by_less_than_0_15_rad(settled_flight, error, share):
    wrong = Offset(0.1, messages=ATTITUDE, share=share, values={"rollspeed": error})
    flight = settled_flight("px4").fly_on(1.0, (wrong,))
    assert flight.violations == []
    assert max(flight.tilts[k] for k in flight.held) < 0.15


@pytest.mark.parametrize("step", [0.15, -0.17, 0.19, -0.2, 0.25])
@pytest.mark.parametrize("load", [0.0, 5.0])
def test_however_far_an_attitude_steps_the_vehicle_tilts_by_less_than_0_3_rad(settled_flight, step, load):
    wrong = Offset(0.1, messages=ATTITUDE, values={"pitch": step})
    flight = settled_flight("px4", load).fly_on(1.0, (wrong,))
    assert flight.violations == []
    assert max(flight.tilts[k] for k in flight.held) < 0.3
    assert (flight.released_s is None) == (abs(step) < 0.18)


@pytest.mark.parametrize("name", [*ENDS, *KEPT])
def test_the_same_over_udp(fault_flight, name):
    """Two sockets each and a proxy between them; in lock-step, so that a slow machine changes nothing."""
    if name in ENDS:
        fault, most, reason = ENDS[name]
        shorter = {"seconds": AT - EARLIER + most + 0.3, "settle_s": 0.2}
        flight = fault_flight("ardupilot", down=(sooner(fault),), **shorter).fly_over_udp()
        assert_ends(flight, most - EARLIER, reason)
    else:
        fault, most = KEPT[name]
        down = () if fault is None else (sooner(fault),)
        flight = fault_flight("ardupilot", down=down, seconds=AT - EARLIER + 1.0, settle_s=0.2).fly_over_udp()
        assert_kept(flight, most)


@pytest.mark.parametrize(("down", "up"), [(0.1, 0.0), (0.0, 0.1), (0.05, 0.05)])
def test_a_link_that_becomes_slower_by_a_tenth_of_a_second_ends_control_before_the_height_swings(
    settled_flight, down, up
):
    """TIMESYNC tells within 0.5 s; without it this link made the height swing by 0.5 m."""
    flight = settled_flight("ardupilot")
    began = flight.vehicle.time_us * 1e-6 + 0.2
    flight = flight.fly_on(1.5, down=(Delay(0.2, delay_s=down),), up=(Delay(0.2, delay_s=up),))
    assert flight.released_s is not None and flight.released_s - began < 0.55, flight.texts
    assert "failsafe: latency" in " ".join(flight.texts) and flight.violations == []
    assert max(abs(flight.heights[k] - 5.0) for k in flight.held) < 0.06


def test_a_swing_on_a_slow_link_is_no_change_of_the_load_and_leaves_the_thrust_that_carries(settled_flight):
    """0.04 s more, which is just borne: the height swings by 0.17 m."""
    calm = settled_flight("ardupilot")
    flight = calm.fly_on(3.5, (Delay(0.2, delay_s=0.02), Lose(3.0)), (Delay(0.2, delay_s=0.02),))
    assert max(abs(height - 5.0) for height in flight.heights) > 0.1
    assert "failsafe: no attitude for 0.25 s" in flight.texts
    words = ("dropped", "picked", "carrying", "load of")
    assert not [text for text in flight.texts if text.startswith(words)]
    (_, before), (_, last) = flight.targets[-20], flight.targets[-1]
    assert before.attitude is None and last.attitude is not None
    assert last.thrust == pytest.approx(0.398, abs=0.04)


def test_commands_that_come_late_end_control_once_the_round_trip_shows_it(fault_flight):
    flight = fault_flight(up=(Delay(AT, delay_s=0.2),), seconds=AT + 1.5).fly()
    assert flight.released_s is not None and flight.released_s <= AT + 0.6, flight.texts
    assert "failsafe: latency" in " ".join(flight.texts)
    assert flight.violations == []


WAYS = pytest.mark.parametrize("way", ["in_process", "over_udp"])


def flown(flight, way):
    return flight.fly() if way == "in_process" else flight.fly_over_udp()


@WAYS
@pytest.mark.parametrize(
    ("personality", "act", "reason", "limit_s"),
    [
        ("px4", lambda vehicle: vehicle.firmware.set_custom_mode(3 << 16), "mode POSCTL", 0.3),
        ("ardupilot", lambda vehicle: vehicle.firmware.set_custom_mode(5), "mode LOITER", 0.3),
        ("px4", lambda vehicle: vehicle.firmware.disarm(True), "disarmed", 1.1),
    ],
)
def test_the_pilot_wins_and_not_one_setpoint_follows(fault_flight, personality, act, reason, limit_s, way):
    """Modes are told five times a second; of disarming PX4 tells with its next heartbeat, up to 1 s later."""
    flight = flown(fault_flight(personality, acts={AT: act}, seconds=AT + 1.5), way)
    assert f"control given up: {reason}" in flight.texts
    assert flight.released_s <= AT + limit_s
    said = next(
        k for k, (_, item) in enumerate(flight.heard) if isinstance(item, Announce) and reason in item.text
    )
    assert not any(isinstance(item, AttitudeTarget) for _, item in flight.heard[said:])


@WAYS
def test_an_autopilot_that_restarts_in_flight_ends_control(fault_flight, way):
    """Its clock begins anew and it is disarmed."""
    disarmed = Overwrite(AT, messages=HEARTBEAT, values={"base_mode": 81})
    down = (ShiftClock(AT, offset_s=-AT), disarmed)
    flight = flown(fault_flight(down=down, seconds=AT + 1.0), way)
    assert flight.released_s <= AT + 0.3
    assert flight.violations == []


def test_a_ground_station_that_asks_for_4_hz_on_the_same_link_does_not_end_the_flight(fault_flight):
    """MAVProxy does, when it has read the parameters, and ArduPilot obeys the last who asks."""

    def ask(vehicle):
        everything = mavlink.MAVLink_request_data_stream_message(1, 1, mavlink.MAV_DATA_STREAM_ALL, 4, 1)
        vehicle.receive(everything.pack(mavlink.MAVLink(None, 255, 190)), "daemon")

    flight = fault_flight("ardupilot", acts={AT: ask}, seconds=AT + 3.0).fly()
    assert flight.released_s is None, flight.texts
    assert "telemetry slows down: asked for it again" in flight.texts
    assert flight.violations == []
    assert max(abs(height - 5.0) for height in flight.heights) < 0.1
