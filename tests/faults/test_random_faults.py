"""Any mixture of faults: no command that is not fit, none after release, and control that ends in time.

Each flight is a copy of one that is engaged already, and has up to three faults towards the daemon, one
towards the vehicle, and two things that happen to the vehicle. What is judged is in
`kffa_offboard.faults.check`.
"""

from math import inf, nan
from random import Random

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
from sim_vehicle.config_faults import FaultsSection
from sim_vehicle.swing import Rope

SAMPLES = ("ATTITUDE", "LOCAL_POSITION_NED")
GROUPS = 16
PERSONALITIES = ["px4", "ardupilot"]
SECONDS = 1.3
FAR, STEEP = 2.0, 0.3  # m, rad: how far a vehicle that is sound may get while control is kept

KINDS = [(), ("ATTITUDE",), ("LOCAL_POSITION_NED",), SAMPLES, ("HEARTBEAT",), ("COMMAND_ACK",), ("TIMESYNC",)]
STARTS = [0.0, 0.1, 0.3, 0.5]
DURATIONS = [0.02, 0.1, 0.3, 0.6, inf]
SHARES = [0.02, 0.1, 0.3, 0.7, 1.0]
BAD = [nan, inf, -inf, 1e30, -1e30, 3.0, -0.4, 100.0]
FIELDS = [
    *(("ATTITUDE", name) for name in ("roll", "pitch", "yaw", "rollspeed", "yawspeed")),
    *(("LOCAL_POSITION_NED", name) for name in ("x", "z", "vx", "vz")),
    *(("ATTITUDE_TARGET", name) for name in ("thrust", "body_roll_rate")),
]
FAULTS = ["lose", "delay", "copy", "flip", "thin", "freeze", "clock", "write", "jump", "flood"]


def frames(system, *messages):
    packer = mavlink.MAVLink(None, system, 1)
    return tuple(bytes(message.pack(packer)) for message in messages)


foreign = frames(77, mavlink.MAVLink_attitude_message(100, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
needless = frames(1, mavlink.MAVLink_raw_imu_message(0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
old = frames(1, mavlink.MAVLink_attitude_message(100, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


def fault(draw):
    when = {"start_s": draw.choice(STARTS), "duration_s": draw.choice(DURATIONS)}
    common = {**when, "share": draw.choice(SHARES)}
    message, name = draw.choice(FIELDS)
    match draw.choice(FAULTS):
        case "lose":
            return Lose(**common, messages=draw.choice(KINDS))
        case "delay":
            late, jitter = draw.choice([0.02, 0.06, 0.1, 0.3]), draw.choice([0.0, 0.1])
            return Delay(**common, messages=draw.choice(KINDS), delay_s=late, jitter_s=jitter)
        case "copy":
            return Duplicate(**common, copies=3)
        case "flip":
            return Corrupt(**common, bits=draw.randint(1, 20))
        case "thin":
            return Thin(**when, messages=SAMPLES, keep_every=draw.randint(2, 20))
        case "freeze":
            return Freeze(**common, messages=draw.choice(KINDS))
        case "clock":
            return ShiftClock(**common, offset_s=draw.choice([-3.0, -0.1, 0.1, 0.3, 3.0]))
        case "write":
            return Overwrite(**common, messages=(message,), values={name: draw.choice(BAD)})
        case "flood":
            return Flood(**when, rate_hz=2000.0, frames=draw.choice([foreign, needless, old]))
        case _:
            return Offset(**common, messages=(message,), values={name: draw.uniform(-2.0, 2.0) ** 3 / 4.0})


def some(draw, most):
    return tuple(fault(draw) for _ in range(draw.randint(0, most)))


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


TORQUE_LESS = {"weak motor", "short of thrust"}
"""Together: while all motors are at their limit there is no torque against what the weak one has begun."""


def judge(flight, what, mixture):
    assert flight.violations == [], mixture
    if not set(what) & set(OTHERS) and not set(what) >= TORQUE_LESS:
        assert all(flight.tilts[k] < STEEP for k in flight.held), mixture
        assert all(abs(flight.heights[k] - 5.0) < FAR for k in flight.held), mixture
    if flight.released_s is not None:
        assert any(text.startswith(("failsafe: ", "control given up: ")) for text in flight.texts), mixture
    assert len(flight.service._known.attitude_stream.arrivals) <= 1000, mixture


def fly_mixtures(settled_flight, number, flights):
    """Seeded: the same flights every time, whatever else is tested."""
    draw = Random(number)
    for _ in range(flights):
        personality, load = draw.choice(PERSONALITIES), draw.choice([0.0, 5.0])
        down, up = some(draw, 3), some(draw, 1)
        what = {draw.choice(STARTS): draw.choice([*SOUND, *OTHERS]) for _ in range(draw.randint(0, 2))}
        acts = {at: {**SOUND, **OTHERS}[name] for at, name in what.items()}
        flight = settled_flight(personality, load).fly_on(SECONDS, down, up, acts)
        judge(flight, what.values(), (personality, load, down, up, what))


def fly_from_the_start(fault_flight, number, flights):
    """The same, also before engaging and while it goes on."""
    draw = Random(number)
    for _ in range(flights):
        personality, down, up = draw.choice(PERSONALITIES), some(draw, 3), some(draw, 1)
        for each in (*down, *up):
            each.start_s *= 4.0
        flight = fault_flight(personality, down=down, up=up, seconds=2.4, settle_s=0.2).fly()
        judge(flight, (), (personality, down, up))


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
