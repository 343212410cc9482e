"""Daemon and vehicle with signing on: they fly as without, the log is clean, and the key is nowhere."""

import base64
import contextlib
import json
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import bundled
from kffa_offboard.config_log import config_of
from kffa_offboard.flightlog.tlog import read_tlog
from kffa_offboard.mavlink.signed_link import SignedLink
from kffa_offboard.mavlink.signing import Signer, Verdict, timestamp_at
from kffa_offboard.mavlink.signing_key import SigningKey
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import Announce
from kffa_offboard.replay.compare import compare
from kffa_offboard.replay.engine import replay
from kffa_offboard.replay.recording import read_recording
from sim_vehicle import config as sim_config
from sim_vehicle.signing import Signing
from sim_vehicle.vehicle import SimulatedVehicle

SECRET = bytes(range(101, 133))
SHOWN = [SECRET, SECRET.hex().encode(), base64.b64encode(SECRET), repr(SECRET).encode(), b"101, 102, 103"]
NOW_US = 1_790_000_000_000_000
SET_ATTITUDE_TARGET = mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "vehicle.key"
    path.write_text(SECRET.hex())
    path.chmod(0o600)
    return path


ENOUGH_US = 6_000_000
"""In the air, climbing."""


def lies(datagrams):
    """The vehicle's datagrams with those of an attacker between them, who has no key, and some again."""
    forger = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    forger.signing.secret_key, forger.signing.sign_outgoing = bytes(32 * [5]), True
    forger.signing.timestamp = timestamp_at(NOW_US) + 1_000_000
    lies = (
        mavlink.MAVLink_attitude_message(1, 2.0, 2.0, 2.0, 0, 0, 0),
        mavlink.MAVLink_command_long_message(245, 191, 92, 0, 0, 0, 0, 0, 0, 0, 0),
        mavlink.MAVLink_param_set_message(245, 191, b"ALT_OMEGA_C", 0.1, 9),
    )
    first = datagrams[0]
    forged = [Datagram(first.time_us, bytes(lie.pack(forger)), first.source) for lie in lies]
    return [*forged, *datagrams, *datagrams[:2]]


@pytest.fixture
def flights(lock_step_flight, tmp_path):
    """Recordings of a flight, unsigned, and signed with an attacker on the link; and the second flight."""
    link_type = lock_step_flight().link_to

    class AttackedLink(link_type):
        def receive(self, timeout_s):
            return lies(super().receive(timeout_s))

    def link_to(vehicle, before_slot):
        key = SigningKey(SECRET)
        return SignedLink(AttackedLink(vehicle, before_slot), Signer(key), Signer(key), lambda: NOW_US)

    plain, signed = lock_step_flight(), lock_step_flight()
    config = sim_config.load(bundled("demo-px4-vehicle.toml"), {"vehicle": {"seed": 0}})
    signed.vehicle = SimulatedVehicle(config, Signing(SECRET, lambda: NOW_US))
    signed.link_to = link_to
    for name, flight in (("plain", plain), ("signed", signed)):
        flight.log = tmp_path / f"{name}.tlog"
        flight.fly(lambda vehicle: vehicle.time_us >= ENOUGH_US)
    return read_recording(plain.log), read_recording(signed.log), signed


def test_a_signed_flight_under_attack_is_the_unsigned_one_and_replays_without_the_key(flights):
    plain, signed, flight = flights

    def setpoints(recording):
        return [
            (time_us, frame[10:-2]) for time_us, frame in recording.sent if frame[7] == SET_ATTITUDE_TARGET
        ]

    assert len(setpoints(signed)) > 200
    assert setpoints(signed) == setpoints(plain)
    refused = {verdict for verdict, _ in flight.link.refused}
    assert refused == {Verdict.FORGED, Verdict.REPLAYED}
    said = {item.text for _, item in flight.heard if isinstance(item, Announce)}
    assert "refusing 1/1: wrong signature" in said

    comparison = compare(signed, replay(signed, config_of(signed.header, flight.log)))
    assert comparison.difference is None

    frames = [frame for _, frame in read_tlog(flight.log).frames()]
    assert not any(frame[2] & mavlink.MAVLINK_IFLAG_SIGNED for frame in frames)
    content = flight.log.read_bytes()
    assert not any(shown in content for shown in SHOWN)

    vehicle = SimulatedVehicle(flight.vehicle.config, Signing(SECRET, lambda: NOW_US))
    peer = vehicle.server.add_peer("attacker")  # who has got hold of the log, and sends what is in it
    assert all(peer.parse(frame) == [] for _, frame in signed.sent[:500])


# ----------------------------------------------------------------------------- processes


@contextlib.contextmanager
def signing_vehicle(directory, key_file, *options):
    """`sim-vehicle run` with signing, in real time, on a free port; yields HOST:PORT and what it printed."""
    config = directory / "vehicle.toml"
    config.write_text(f'[signing]\nkey_file = "{key_file.name}"\n[link]\nendpoints = ["udpin:127.0.0.1:0"]\n')
    command = [sys.executable, "-m", "sim_vehicle", "run", "--config", str(config), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as vehicle:
        try:
            announced = vehicle.stdout.readline()
            found = SimpleNamespace(place=f"127.0.0.1:{announced.strip().rpartition(':')[2]}", said=announced)
            yield found
            vehicle.terminate()
            out, error = vehicle.communicate(timeout=30.0)
            found.said += out + error
        finally:
            vehicle.kill()


def daemon_config(directory, key_name):
    """The demonstration's configuration, observing, with signing."""
    text = bundled("px4-udp.toml").read_text()
    signing = f'[signing]\nkey_file = "{key_name}"\ntimestamp_file = "stamp"\n' if key_name else ""
    path = directory / "daemon.toml"
    path.write_text(signing + text)
    return path


def run_daemon(directory, place, key_name):
    """Fly for two seconds, however long starting takes; what it said."""
    config = daemon_config(directory, key_name)
    command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config)]
    command += ["--link", f"udpout:{place}", "--shadow", "--json", "--log", str(directory / "flight.tlog")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as daemon:
        try:
            error = daemon.stderr.readline()  # "waiting for a vehicle on ..."
            with contextlib.suppress(subprocess.TimeoutExpired):
                daemon.wait(2.0)
            daemon.terminate()
            out, rest = daemon.communicate(timeout=30.0)
        finally:
            daemon.kill()
    return out, error + rest


def test_two_signing_processes_understand_each_other_and_the_key_is_written_nowhere(tmp_path, key_file):
    with signing_vehicle(tmp_path, key_file, "--truth", str(tmp_path / "truth.csv")) as vehicle:
        out, error = run_daemon(tmp_path, vehicle.place, key_file.name)
    assert json.loads(out)["telemetry_received"] > 50
    assert "refus" not in error
    key_file.unlink()
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert {path.name for path in written} >= {"flight.tlog", "stamp", "truth.csv", "daemon.toml"}
    everything = [path.read_bytes() for path in written] + [(out + error + vehicle.said).encode()]
    assert not any(shown in content for content in everything for shown in SHOWN)


def test_a_daemon_without_the_key_hears_nothing_it_may_take_and_says_why(tmp_path, key_file):
    other = tmp_path / "other.key"
    other.write_text(bytes(32 * [3]).hex())
    other.chmod(0o600)
    with signing_vehicle(tmp_path, key_file) as vehicle:
        config = daemon_config(tmp_path, other.name)
        config.write_text(config.read_text().replace("[telemetry]", "[telemetry]\nconnect_timeout_s = 2.0"))
        command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config), "--shadow"]
        done = subprocess.run(
            [*command, "--link", f"udpout:{vehicle.place}"], capture_output=True, text=True, timeout=60
        )
    assert done.returncode == 2
    last = done.stderr.strip().splitlines()[-1]
    assert "no vehicle answered" in last
    assert "from 1/1 refused: wrong signature" in last


@pytest.mark.parametrize("signed", [True, False], ids=["with the key", "unsigned"])
def test_mavutil_is_answered_if_it_signs_and_ignored_if_not(tmp_path, key_file, signed, monkeypatch):
    monkeypatch.setenv("MAVLINK20", "1")
    with signing_vehicle(tmp_path, key_file) as vehicle:
        client = mavutil.mavlink_connection(
            f"udpout:{vehicle.place}", source_system=255, dialect="ardupilotmega"
        )
        if signed:
            client.setup_signing(SECRET)
        answer = None
        deadline = time.monotonic() + (20.0 if signed else 2.0)
        while answer is None and time.monotonic() < deadline:
            client.mav.heartbeat_send(6, 8, 0, 0, 4)
            client.mav.param_request_read_send(1, 1, b"MPC_THR_HOVER", -1)
            answer = client.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.5)
        client.close()
    assert (answer is not None) == signed
