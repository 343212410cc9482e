"""Any mixture of faults: no command that is not fit, none after release, and control that ends in time.

Each flight is a copy of one that is engaged already, and has up to three faults towards the daemon, one
towards the vehicle, and two things that happen to the vehicle. What is judged is in
`kffa_offboard.faults.check`.
"""

from math import inf, nan

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
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
from sim_vehicle.config_faults import FaultsSection
from sim_vehicle.swing import Rope

SAMPLES = ("ATTITUDE", "LOCAL_POSITION_NED")
GROUPS = 16
SECONDS = 1.3
FAR, STEEP = 2.0, 0.3  # m, rad: how far a vehicle that is sound may get while control is kept

kinds = st.sampled_from(
    [(), ("ATTITUDE",), ("LOCAL_POSITION_NED",), SAMPLES, ("HEARTBEAT",), ("COMMAND_ACK",), ("TIMESYNC",)]
)
starts = st.sampled_from([0.0, 0.1, 0.3, 0.5])
durations = st.sampled_from([0.02, 0.1, 0.3, 0.6, inf])
shares = st.sampled_from([0.02, 0.1, 0.3, 0.7, 1.0])
bad = st.sampled_from([nan, inf, -inf, 1e30, -1e30, 3.0, -0.4, 100.0])
fields = st.one_of(
    st.tuples(st.just("ATTITUDE"), st.sampled_from(["roll", "pitch", "yaw", "rollspeed", "yawspeed"])),
    st.tuples(st.just("LOCAL_POSITION_NED"), st.sampled_from(["x", "z", "vx", "vz"])),
    st.tuples(st.just("ATTITUDE_TARGET"), st.sampled_from(["thrust", "body_roll_rate"])),
)


def frames(system, *messages):
    packer = mavlink.MAVLink(None, system, 1)
    return tuple(bytes(message.pack(packer)) for message in messages)


foreign = frames(77, mavlink.MAVLink_attitude_message(100, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
needless = frames(1, mavlink.MAVLink_raw_imu_message(0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
old = frames(1, mavlink.MAVLink_attitude_message(100, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


@st.composite
def faults(draw):
    common = {"start_s": draw(starts), "duration_s": draw(durations), "share": draw(shares)}
    when = {key: common[key] for key in ("start_s", "duration_s")}
    match draw(
        st.sampled_from(
            ["lose", "delay", "copy", "flip", "thin", "freeze", "clock", "write", "jump", "flood"]
        )
    ):
        case "lose":
            return Lose(**common, messages=draw(kinds))
        case "delay":
            late, jitter = draw(st.sampled_from([0.02, 0.06, 0.1, 0.3])), draw(st.sampled_from([0.0, 0.1]))
            return Delay(**common, messages=draw(kinds), delay_s=late, jitter_s=jitter)
        case "copy":
            return Duplicate(**common, copies=3)
        case "flip":
            return Corrupt(**common, bits=draw(st.integers(1, 20)))
        case "thin":
            return Thin(**when, messages=SAMPLES, keep_every=draw(st.integers(2, 20)))
        case "freeze":
            return Freeze(**common, messages=draw(kinds))
        case "clock":
            return ShiftClock(**common, offset_s=draw(st.sampled_from([-3.0, -0.1, 0.1, 0.3, 3.0])))
        case "write":
            message, name = draw(fields)
            return Overwrite(**common, messages=(message,), values={name: draw(bad)})
        case "flood":
            return Flood(**when, rate_hz=2000.0, frames=draw(st.sampled_from([foreign, needless, old])))
        case _:
            message, name = draw(fields)
            return Offset(**common, messages=(message,), values={name: draw(st.floats(-2.0, 2.0))})


def breaking(kind, **numbers):
    """Something breaks now."""

    def act(vehicle):
        now = vehicle.time_us * 1e-6
        vehicle.plant._faults = FaultsSection(**{kind: ({"start_s": now, **numbers},)})
        vehicle.plant._faulty = True

    return act


def hang(vehicle):
    """4 kg on 2 m of rope, swinging."""
    vehicle.plant._rope = Rope(2.0)
    vehicle.set_load(4.0)
    vehicle.plant._rope._state.velocity[0] += 1.0


def change_mode(vehicle):
    vehicle.firmware.set_custom_mode(5 if vehicle.config.vehicle.personality == "ardupilot" else 3 << 16)


SOUND = {  # what happens to a vehicle that can still be flown
    "weak motor": breaking("weak_motor", motor=2, loss=0.3),
    "battery sag": breaking("battery_sag", loss_per_s=0.1),
    "gust": breaking("gust", duration_s=0.7, velocity_m_s=(0.0, -12.0, 0.0)),
    "short of thrust": breaking("thrust_limit", duration_s=0.3, share=0.35),
    "load": lambda vehicle: vehicle.set_load(6.73),
    "drop": lambda vehicle: vehicle.set_load(0.0),
    "swinging load": hang,
}
OTHERS = {
    "no thrust": breaking("thrust_limit", duration_s=1.0, share=0.2),
    "mode": change_mode,
    "disarm": lambda vehicle: vehicle.firmware.disarm(True),
}
happenings = st.dictionaries(starts, st.sampled_from([*SOUND, *OTHERS]), max_size=2)
personalities = st.sampled_from(["px4", "ardupilot"])
loads = st.sampled_from([0.0, 5.0])
down_faults, up_faults = st.lists(faults(), max_size=3), st.lists(faults(), max_size=1)


def judge(flight, what):
    assert flight.violations == []
    if not set(what) & set(OTHERS):
        assert all(flight.tilts[k] < STEEP for k in flight.held)
        assert all(abs(flight.heights[k] - 5.0) < FAR for k in flight.held)
    if flight.released_s is not None:
        assert any(text.startswith(("failsafe: ", "control given up: ")) for text in flight.texts)
    assert len(flight.service._known.attitude_stream.arrivals) <= 1000


def budget(number, examples):
    """Seeded: the same flights every time."""
    chosen = settings(
        max_examples=examples,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
        phases=(
            Phase.generate,
        ),  # a failing flight is reported as it was found: making it smaller takes long
    )
    return lambda test: seed(number)(chosen(test))


def fly_mixtures(settled_flight, number, examples):
    @budget(number, examples)
    @given(personalities, loads, down_faults, up_faults, happenings)
    def mixtures(personality, load, down, up, what):
        acts = {at: {**SOUND, **OTHERS}[name] for at, name in what.items()}
        flight = settled_flight(personality, load).fly_on(SECONDS, tuple(down), tuple(up), acts)
        judge(flight, what.values())

    mixtures()


def fly_from_the_start(fault_flight, number, examples):
    @budget(number, examples)
    @given(personalities, down_faults, up_faults)
    def mixtures(personality, down, up):
        for fault in (*down, *up):
            fault.start_s *= 4.0  # also before engaging and while it goes on
        flight = fault_flight(personality, down=tuple(down), up=tuple(up), seconds=2.4, settle_s=0.2).fly()
        judge(flight, ())

    mixtures()


@pytest.mark.timeout(300)
@pytest.mark.parametrize("group", range(GROUPS))
def test_any_mixture_of_faults(settled_flight, group):
    fly_mixtures(settled_flight, group, 13)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("group", range(2))
def test_any_mixture_of_faults_while_engaging(fault_flight, group):
    fly_from_the_start(fault_flight, group, 15)


@pytest.mark.long_faults
@pytest.mark.timeout(0)
@pytest.mark.parametrize("group", range(100, 150))
def test_any_mixture_of_faults_for_long(settled_flight, fault_flight, group):
    fly_mixtures(settled_flight, group, 50)
    fly_from_the_start(fault_flight, group, 10)
