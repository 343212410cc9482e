"""Recorded flights that must replay to the commands in them, on every machine.

After a change of the control law or the service that is meant, fly them again and read the summary:

    python -m pytest tests/system/test_golden_flights.py --bless
"""

import gzip
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
    with path.open("wb") as file, gzip.GzipFile(filename="", fileobj=file, mode="wb", mtime=0) as packed:
        for time_us, frame in read_tlog(log).frames():
            if not is_signals(parser.decode(bytearray(frame))):
                packed.write(TIMESTAMP.pack(time_us) + frame)
    return path


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


@pytest.mark.parametrize("name", FLIGHTS)
def test_a_recorded_flight_replays_to_the_commands_in_it(name, fly, request, capsys):
    golden = GOLDEN / f"{name}.tlog.gz"
    if request.config.getoption("--bless"):
        fresh = fly(name)
        told = "new" if not golden.exists() else summary(read_recording(golden), read_recording(fresh))
        golden.parent.mkdir(parents=True, exist_ok=True)
        golden.write_bytes(fresh.read_bytes())
        with capsys.disabled():
            print(f"\n{name}: {told}")
    recording = read_recording(golden)
    comparison = compare(recording, replay(recording, config_of(recording.header, golden)), ROUNDING)
    assert comparison.difference is None, "if this change is meant: see the top of this file"
    assert comparison.frames == len(recording.sent) > 200


def reason(name):
    return read_recording(GOLDEN / f"{name}.tlog.gz").end


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
