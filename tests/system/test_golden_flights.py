"""Recorded flights that must replay to the commands in them, on every machine.

After a change of the control law or the service that is meant, fly them again and read the summary:

    python -m pytest tests/system/test_golden_flights.py --bless

The real ones were flown by unmodified PX4 and ArduCopter (tests/firmware/test_daemon_flight.py). They cannot
be flown again here: blessing keeps what the firmware said, and puts the replayed frames in the place of
those that were sent. real-flights.json has what the physics knew.
"""

import functools
import gzip
import json
import math
from pathlib import Path

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import bundled
from kffa_offboard.config_log import config_of
from kffa_offboard.flightlog.notes import is_note
from kffa_offboard.flightlog.signals import is_signals
from kffa_offboard.flightlog.tlog import TIMESTAMP, read_tlog
from kffa_offboard.mavlink.parameter_file import ParameterFile
from kffa_offboard.replay.compare import compare
from kffa_offboard.replay.engine import replay
from kffa_offboard.replay.recording import read_recording
from sim_vehicle import config as sim_config
from sim_vehicle.vehicle import SimulatedVehicle

GOLDEN = Path(__file__).parents[1] / "golden" / "flights"
ROUNDING = 1e-6
"""Another processor may round the last bit of a sine differently; nothing more is forgiven."""

SCENARIO = """[scenario]
[[scenario.segment]]
type = "takeoff"
altitude_m = 1.0
climb_rate_m_s = 1.0
[[scenario.segment]]
type = "hold"
duration_s = 4.5
[[scenario.segment]]
type = "land"
descent_rate_m_s = 0.5
"""
LOAD = [{"time_s": 2.5, "mass_kg": 5.0}, {"time_s": 4.0, "mass_kg": 0.0}]
EVENT_S = 9.0
"""When the link breaks, or the pilot takes over [s since power-up], well after lift-off; then 2 s more."""


def prepare(flight, link_lost=False, pilot_lands=False):
    """Let something happen to a flight at EVENT_S."""
    pilot = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)

    def before_slot():
        now_s = flight.vehicle.time_us * 1e-6
        if link_lost and now_s > EVENT_S and not hasattr(flight, "whole"):
            flight.whole = flight.link.receive
            flight.link.receive = lambda timeout_s: flight.whole(timeout_s)[-1:]  # the barrier alone
        if pilot_lands and EVENT_S <= now_s < EVENT_S + 0.01:
            land = mavlink.MAVLink_set_mode_message(1, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 9)
            flight.vehicle.receive(bytes(land.pack(pilot)), "pilot")

    flight.before_slot = before_slot


FLIGHTS = {
    "px4-drop": ("px4", {}),
    "ardupilot-drop": ("ardupilot", {}),
    "px4-link-loss": ("px4", {"link_lost": True}),
    "ardupilot-pilot": ("ardupilot", {"pilot_lands": True}),
}

REAL = ("real-ardupilot", "real-px4")
FIRMWARES = {"real-ardupilot": mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, "real-px4": mavlink.MAV_AUTOPILOT_PX4}


@functools.cache
def recorded(name):
    return read_recording(GOLDEN / f"{name}.tlog.gz")


@pytest.fixture
def fly(lock_step_flight, tmp_path):
    """Flies a golden flight; returns its log, without the inner signals (they are most of the bytes)."""

    def fly_one(name):
        personality, happening = FLIGHTS[name]
        text = bundled(f"demo-{personality}.toml").read_text()
        daemon = tmp_path / "daemon.toml"
        daemon.write_text(text[: text.index("[scenario]")] + SCENARIO)
        flight = lock_step_flight(personality, daemon_file=daemon)
        vehicle = bundled(f"demo-{personality}-vehicle.toml")
        flight.vehicle = SimulatedVehicle(sim_config.load(vehicle, {"payload": {"schedule": LOAD}}))
        flight.log = tmp_path / f"{name}.tlog"
        flight.check_parameters(ParameterFile(tmp_path / "changed.json"))
        prepare(flight, **happening)
        flight.fly(lambda vehicle: bool(happening) and vehicle.time_us * 1e-6 > EVENT_S + 2.0)
        return thinned(flight.log, tmp_path / f"{name}.tlog.gz")

    return fly_one


def thinned(log, path):
    parser = mavlink.MAVLink(None)
    frames = read_tlog(log).frames()
    return packed(path, [(t, f) for t, f in frames if not is_signals(parser.decode(bytearray(f)))])


def packed(path, records):
    """A compressed log that depends on nothing but its records."""
    with path.open("wb") as file, gzip.GzipFile(filename="", fileobj=file, mode="wb", mtime=0) as stream:
        for time_us, frame in records:
            stream.write(TIMESTAMP.pack(time_us) + frame)
    return path


def replayed(name):
    recording = recorded(name)
    return replay(recording, config_of(recording.header, recording.path))


def answered_anew(name, path):
    """The golden log with the frames that are sent now instead of those that were sent then."""
    return with_frames(recorded(name), replayed(name).sent, path)


def with_frames(recording, frames, path):
    """A golden log with other frames of ours."""
    golden = recording.path
    parser, ids = mavlink.MAVLink(None), config_of(recording.header, golden).link
    kept = []
    for time_us, frame in read_tlog(golden).frames():
        ours = (frame[5], frame[6]) == (ids.system_id, ids.component_id)
        note = ours and is_note(parser.decode(bytearray(frame)))
        if note or not ours:
            last = note and time_us == recording.end_us  # how the run ended
            kept.append(((time_us, 2 if last else 0), frame))
    assert kept == sorted(kept, key=lambda record: record[0])
    sent = [((t, 1), frame) for t, frame in frames]
    merged = sorted(kept + sent, key=lambda record: record[0])
    return packed(path, [(time_us, frame) for (time_us, _), frame in merged])


def thrust_of(recording):
    parser = mavlink.MAVLink(None)
    sent = [(t, parser.decode(bytearray(frame))) for t, frame in recording.sent]
    return {t: m.thrust for t, m in sent if m.get_type() == "SET_ATTITUDE_TARGET"}


def summary(before, after):
    """What a blessing changes, in a line."""
    old, new = thrust_of(before), thrust_of(after)
    shared = sorted(old.keys() & new.keys())
    gap = np.array([new[t] - old[t] for t in shared])
    if gap.size == 0:
        return "nothing in common"
    worst = shared[int(np.argmax(np.abs(gap)))] * 1e-6
    return (
        f"{len(old)} -> {len(new)} setpoints; thrust differs by {math.sqrt(float(np.mean(gap**2))):.2g} rms, "
        f"at most {np.abs(gap).max():.2g} at {worst:.2f} s"
    )


@pytest.mark.parametrize("name", [*FLIGHTS, *REAL])
def test_a_recorded_flight_replays_to_the_commands_in_it(name, fly, request, tmp_path, capsys):
    golden = GOLDEN / f"{name}.tlog.gz"
    if request.config.getoption("--bless"):
        fresh = fly(name) if name in FLIGHTS else answered_anew(name, tmp_path / golden.name)
        told = "new" if not golden.exists() else summary(read_recording(golden), read_recording(fresh))
        golden.parent.mkdir(parents=True, exist_ok=True)
        golden.write_bytes(fresh.read_bytes())
        recorded.cache_clear()
        with capsys.disabled():
            print(f"\n{name}: {told}")
    recording = recorded(name)
    comparison = compare(recording, replayed(name), ROUNDING)
    assert comparison.difference is None, "if this change is meant: see the top of this file"
    assert comparison.frames == len(recording.sent) > 200


def messages(name, kind):
    """(time [s], message) of a type that the daemon sent."""
    parser = mavlink.MAVLink(None)
    return [
        (t * 1e-6, parser.decode(bytearray(frame)))
        for t, frame in recorded(name).sent
        if int.from_bytes(frame[7:10], "little") == kind
    ]


@pytest.mark.parametrize("name", REAL)
def test_the_daemon_knew_what_happened_to_a_real_firmware(name):
    """Against what the physics knew: a load of 5 kg on 10 kg that nobody had announced."""
    known = json.loads((GOLDEN / "real-flights.json").read_text())[name]
    pick_up, drop = known["pick_up_s"], known["drop_s"]
    texts = [(t, m.text) for t, m in messages(name, mavlink.MAVLINK_MSG_ID_STATUSTEXT)]
    (picked,) = [(t, text) for t, text in texts if text.startswith("picked up")]
    (dropped,) = [(t, text) for t, text in texts if text.startswith("dropped")]
    assert 0.0 < picked[0] - pick_up < 1.0 and picked[1] == "picked up 5.0 kg"
    assert 0.0 < dropped[0] - drop < 0.3 and dropped[1] == "dropped 5.0 kg"
    reports = [
        (t, m.value)
        for t, m in messages(name, mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT)
        if m.name == "payload_kg"
    ]
    weighed = [mass for t, mass in reports if pick_up + 1.0 <= t < drop]
    assert weighed == pytest.approx([known["load_kg"]] * len(weighed), rel=0.05) and len(weighed) > 5
    thrust = [(t, m.thrust) for t, m in messages(name, mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET)]
    empty = np.mean([value for t, value in thrust if pick_up - 1.0 <= t < pick_up])
    loaded = np.mean([value for t, value in thrust if drop - 1.0 <= t < drop])
    assert loaded / empty == pytest.approx(1.5, rel=0.05)


@pytest.mark.parametrize("name", REAL)
def test_a_real_recording_is_of_that_firmware_and_small(name):
    said = [m for _, m in recorded(name).incoming if getattr(m, "get_type", str)() == "HEARTBEAT"]
    firmwares = {m.autopilot for m in said if m.get_srcComponent() == 1}
    assert firmwares == {FIRMWARES[name]}
    assert recorded(name).path.stat().st_size < 400_000


def test_blessing_a_real_flight_keeps_what_the_firmware_said(tmp_path):
    before = recorded("real-px4")
    fewer = [frame for k, frame in enumerate(before.sent) if k % 7]
    after = read_recording(with_frames(before, fewer, tmp_path / before.path.name))
    told = [[(t, getattr(m, "get_msgbuf", str)()) for t, m in log.incoming] for log in (before, after)]
    assert told[0] == told[1]
    assert (after.header, after.begin_us, after.end, after.end_us) == (
        before.header,
        before.begin_us,
        before.end,
        before.end_us,
    )
    assert after.sent == fewer


def test_the_golden_flights_hold_what_their_names_say():
    texts = {
        name: " ".join(
            m.text
            for _, m in read_tlog(GOLDEN / f"{name}.tlog.gz")
            if m.get_type() == "STATUSTEXT" and m.get_srcSystem() == 245
        )
        for name in FLIGHTS
    }
    assert "no attitude for 0.25 s" in texts["px4-link-loss"]
    assert "LAND" in texts["ardupilot-pilot"]
    for name in ("px4-drop", "ardupilot-drop"):
        thrust = thrust_of(read_recording(GOLDEN / f"{name}.tlog.gz"))
        assert max(thrust.values()) > 0.55, "it took 0.597 to carry the load"


def test_every_note_is_kept_when_a_log_is_thinned():
    log = read_tlog(GOLDEN / "px4-drop.tlog.gz")
    assert sum(is_note(message) for _, message in log) > 10
