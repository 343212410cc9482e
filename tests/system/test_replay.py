"""A recorded flight flown again from its log: the same commands, byte for byte."""

import gc
import json
from dataclasses import replace
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink
from typer.testing import CliRunner

from kffa_offboard.cli import app
from kffa_offboard.config import bundled, load
from kffa_offboard.config_log import config_of
from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.notes import Lost, to_messages
from kffa_offboard.flightlog.tlog import TIMESTAMP, read_tlog
from kffa_offboard.frame_codec import pack
from kffa_offboard.loganalysis.read import read_log
from kffa_offboard.mavlink.parameter_file import ParameterFile
from kffa_offboard.offboard.events import GiveUpRequested, ReleaseRequested
from kffa_offboard.replay.compare import compare, what_if
from kffa_offboard.replay.engine import replay, replay_what_if
from kffa_offboard.replay.recording import is_message, read_recording
from kffa_offboard.report.read import read_flight


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    return tmp_path_factory.mktemp("flights")


@pytest.fixture
def drop(lock_step_flight, directory):
    """Log of a flight up to one second after the load was picked up, then stopped."""
    log = directory / "drop.tlog"
    if not log.exists():
        flight = lock_step_flight()
        flight.log = log
        picked = "pick-up"
        flight.fly(
            lambda vehicle: (
                (at := vehicle.truth.time_of(picked)) is not None and vehicle.time_us * 1e-6 > at + 1.0
            )
        )
    return log


def replayed(log):
    recording = read_recording(log)
    return recording, replay(recording, config_of(recording.header, log))


def test_every_command_and_every_inner_signal_is_repeated_byte_for_byte(drop):
    recording, again = replayed(drop)
    kinds = {message.get_type() for _, message in read_tlog(drop) if message.get_srcSystem() == 245}
    assert {"SET_ATTITUDE_TARGET", "COMMAND_LONG", "HEARTBEAT", "STATUSTEXT", "TIMESYNC"} <= kinds
    comparison = compare(recording, again)
    assert comparison.difference is None
    assert comparison.frames == len(recording.sent) + len(recording.signals) > 3000
    assert recording.end is not None
    assert recording.end.reason == "flown"


def test_the_request_to_stop_is_in_the_log(drop):
    recording = read_recording(drop)
    without = replace(recording, incoming=[item for item in recording.incoming if is_message(item[1])])
    assert len(without.incoming) == len(recording.incoming) - 1
    difference = compare(recording, replay(without, config_of(recording.header, drop))).difference
    assert difference is not None


def changed(log, path, kind, edit):
    """Copy of a log in which `edit` has changed the 500th message of a kind."""
    parser, count = mavlink.MAVLink(None), 0
    with path.open("wb") as file:
        for time_us, frame in read_tlog(log).frames():
            message = parser.decode(bytearray(frame))
            count += message.get_type() == kind
            if message.get_type() == kind and count == 500:
                packer = mavlink.MAVLink(
                    None, srcSystem=message.get_srcSystem(), srcComponent=message.get_srcComponent()
                )
                packer.seq = message.get_seq()
                edit(message)
                frame = bytes(message.pack(packer))
            file.write(TIMESTAMP.pack(time_us) + frame)
    return path


def test_the_first_difference_is_told_with_time_field_and_both_values(drop, tmp_path):
    def more_thrust(message):
        message.thrust = 0.75

    log = changed(drop, tmp_path / "changed.tlog", "SET_ATTITUDE_TARGET", more_thrust)
    recording, again = replayed(log)
    difference = compare(recording, again).difference
    assert difference.field == "SET_ATTITUDE_TARGET.thrust"
    assert difference.recorded == 0.75
    assert 0.3 < difference.replayed < 0.6
    result = CliRunner().invoke(app, ["replay", str(log)])
    assert result.exit_code == 1
    assert "SET_ATTITUDE_TARGET.thrust" in result.output
    assert "recorded 0.75" in result.output


def test_other_telemetry_gives_other_commands(drop, tmp_path):
    def higher(message):
        message.z -= 0.2

    recording, again = replayed(changed(drop, tmp_path / "changed.tlog", "LOCAL_POSITION_NED", higher))
    field = compare(recording, again).difference.field
    assert field.startswith(("SET_ATTITUDE_TARGET", "NAMED_VALUE_FLOAT"))


def test_a_log_that_breaks_off_is_compared_as_far_as_it_goes(drop, tmp_path):
    log = tmp_path / "cut.tlog"
    log.write_bytes(drop.read_bytes()[: drop.stat().st_size // 2 + 5])
    recording, again = replayed(log)
    assert recording.end is None
    comparison = compare(recording, again)
    assert comparison.difference is None
    assert comparison.frames > 1000
    result = CliRunner().invoke(app, ["replay", str(log)])
    assert result.exit_code == 0
    assert "breaks off" in result.output


def test_a_log_with_a_hole_is_compared_up_to_there_and_its_readers_say_so(drop, tmp_path):
    log, records = tmp_path / "hole.tlog", [*read_tlog(drop).frames()]
    first = len(records) // 2
    packer = mavlink.MAVLink(None, srcSystem=245, srcComponent=191)
    missing = [(records[first][0], bytes(message.pack(packer))) for message in to_messages(Lost(500))]
    kept = [*records[:first], *missing, *records[first + 500 :]]
    log.write_bytes(b"".join(TIMESTAMP.pack(time_us) + frame for time_us, frame in kept))
    recording, again = replayed(log)
    assert recording.lost == 500
    comparison = compare(recording, again)
    assert comparison.difference is None
    assert comparison.frames > 1000
    said = CliRunner().invoke(app, ["replay", str(log)]).output
    assert "500 records are missing after that (full disk); compared up to there" in said
    assert "breaks off" not in said
    assert any(remark.startswith("500 records are missing before ") for remark in read_flight(log).remarks)
    assert "500 records are missing (full disk)" in read_log(log).damage


def test_frames_that_the_link_did_not_take_are_told_apart_from_differences(lock_step_flight, tmp_path):
    flight = lock_step_flight()
    flight.log = tmp_path / "lossy.tlog"
    send, count = None, 0

    def lossy(data):
        nonlocal count
        count += 1
        return count % 50 != 0 and send(data)

    def before_slot():
        nonlocal send
        if send is None:
            send, flight.link.send = flight.link.send, lossy

    flight.before_slot = before_slot
    flight.fly(lambda vehicle: vehicle.time_us > 6_000_000)
    recording, again = replayed(flight.log)
    comparison = compare(recording, again)
    assert comparison.difference is None
    assert comparison.dropped == recording.end.frames_dropped > 5


def test_other_gains_tell_what_would_have_changed(drop, tmp_path):
    gains = bundled("demo-px4.toml").read_text().replace("omega_c = 8.0", "omega_c = 4.0", 1)
    config = tmp_path / "softer.toml"
    config.write_text(gains)
    result = CliRunner().invoke(app, ["replay", str(drop), "--config", str(config), "--json"])
    assert result.exit_code == 0
    changes = {(c["signal"], c["channel"]): c for c in json.loads(result.output)["changes"]}
    assert changes["omega_c", "altitude"]["rms"] == pytest.approx(4.0, abs=0.5)
    assert changes["omega_c", "roll"]["rms"] == 0.0
    assert changes["command", "altitude"]["largest"] > 0.01
    for signal in ("estimate", "disturbance"):
        told = {changes[signal, channel]["largest"] for channel in ("roll", "pitch", "yaw", "altitude")}
        assert told == {0.0}, "the same estimators saw the same samples and the same applied commands"


def test_the_table_of_changes_fits_a_terminal_of_80_columns(drop, tmp_path):
    said = CliRunner().invoke(app, ["replay", str(drop), "--config", str(bundled("demo-px4.toml"))]).output
    assert max(len(line) for line in said.splitlines()) <= 80
    assert "\N{HORIZONTAL ELLIPSIS}" not in said
    assert said.count("disturbance") == 4


def test_another_output_estimates_height_from_the_thrust_that_was_flown(drop):
    recording = read_recording(drop)
    flown = config_of(recording.header, drop)
    other = load(bundled("demo-px4.toml"), replace(flown.overrides, output="attitude"))
    result = what_if(recording, replay_what_if(recording, flown, other))
    changes = {(change.signal, change.channel): change for change in result.changes}
    assert result.steps > 500
    assert changes["disturbance", "altitude"].largest == 0.0
    assert changes["disturbance", "roll"].largest < 5.0


def test_a_configuration_that_nothing_can_be_compared_with_is_told_why(drop, tmp_path):
    other, ours = tmp_path / "other.toml", bundled("demo-px4.toml")
    other.write_text(ours.read_text().replace("[link]", "[link]\ntarget_system = 7"))
    said = CliRunner().invoke(app, ["replay", str(drop), "--config", str(other)]).output
    assert "the daemon would not have been engaged at any time that it was" in " ".join(said.split())
    golden = str(Path(__file__).parents[1] / "golden" / "flights" / "px4-drop.tlog.gz")
    said = CliRunner().invoke(app, ["replay", golden, "--config", str(ours)]).output
    assert "holds no inner signals to compare with" in " ".join(said.split())


def test_the_same_configuration_changes_nothing(drop):
    recording, again = replayed(drop)
    result = what_if(recording, again)
    assert result.states == []
    assert {change.largest for change in result.changes} == {0.0}


def test_other_peoples_logs_are_refused_with_a_way_on(tmp_path):
    log = tmp_path / "ground-station.tlog"
    packer = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    log.write_bytes(
        TIMESTAMP.pack(1) + bytes(mavlink.MAVLink_attitude_message(0, 0, 0, 0, 0, 0, 0).pack(packer))
    )
    with pytest.raises(UserError, match=r"does not begin with a kffa-offboard header.*kffa-offboard shadow"):
        read_recording(log)
    Path(tmp_path / "empty.tlog").write_bytes(b"")
    with pytest.raises(UserError, match="is empty"):
        read_recording(tmp_path / "empty.tlog")


def test_parameters_that_were_set_and_put_back_are_in_the_replay(lock_step_flight, tmp_path):
    flight = with_parameters_to_fix(lock_step_flight("ardupilot"), tmp_path)
    flight.log = tmp_path / "fixed.tlog"
    flight.fly(lambda vehicle: vehicle.time_us > 5_000_000)
    recording, again = replayed(flight.log)
    sent = [m for _, m in read_tlog(flight.log) if m.get_type() == "PARAM_SET"]
    assert [m.param_value for m in sent if m.param_id == "GUID_TIMEOUT"] == [0.5, 3.0]
    assert compare(recording, again).difference is None


def test_any_message_after_the_end_has_parameters_put_back(lock_step_flight, tmp_path):
    """One that no session looks into, too, and nobody reads in a replay otherwise."""
    flight = with_parameters_to_fix(lock_step_flight("ardupilot"), tmp_path)
    flight.log = tmp_path / "fixed.tlog"
    flight.fly(lambda vehicle: vehicle.time_us > 2_000_000)
    recording = read_recording(flight.log)
    place = next(k for k, (_, item) in enumerate(recording.incoming) if isinstance(item, ReleaseRequested))
    stopped_us = recording.incoming[place][0]
    vibration = pack(mavlink.MAVLink_vibration_message(0, 0.0, 0.0, 0.0, 0, 0, 0), 1, 1, 0)
    incoming = [*recording.incoming]
    incoming.insert(place + 1, (stopped_us + 1, vibration))
    sent = replay(replace(recording, incoming=incoming), config_of(recording.header, flight.log)).sent
    number = mavlink.MAVLINK_MSG_ID_PARAM_SET.to_bytes(3, "little")
    assert [t for t, frame in sent if frame[7:10] == number][-1] == stopped_us + 1


def test_parameters_that_are_put_back_because_nobody_lets_go_are_in_the_replay(lock_step_flight, tmp_path):
    patient = tmp_path / "patient.toml"
    patient.write_text(bundled("demo-ardupilot.toml").read_text() + "\n[sequence]\nhold_timeout_s = 10\n")
    flight = with_parameters_to_fix(lock_step_flight("ardupilot", daemon_file=patient), tmp_path)
    flight.link_to = that_loses_mode_commands_after_the_stop(flight)
    flight.log = tmp_path / "kept.tlog"
    flight.fly(lambda vehicle: vehicle.time_us > 12_000_000)
    recording, again = replayed(flight.log)
    (asked_us,) = [time_us for time_us, item in recording.incoming if isinstance(item, GiveUpRequested)]
    assert asked_us == pytest.approx(15_000_000, abs=20_000), "3 s after the stop"
    last_us, last = [(t, m) for t, m in read_tlog(flight.log) if m.get_type() == "SET_ATTITUDE_TARGET"][-1]
    assert last_us == asked_us
    assert last.type_mask & mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE, "a level attitude"
    assert flight.session.changed_parameters, "they stay while the autopilot follows our setpoints"
    assert compare(recording, again).difference is None


def with_parameters_to_fix(flight, directory):
    """Its vehicle has a GUID_TIMEOUT that is too long."""
    flight.daemon = replace(
        flight.daemon,
        autopilot=replace(flight.daemon.autopilot, fix_parameters=True),
        overrides=replace(flight.daemon.overrides, fix_parameters=True),
    )
    flight.check_parameters(ParameterFile(directory / "changed.json"), fix=True)
    flight.vehicle.firmware.parameters.set("GUID_TIMEOUT", 3.0)
    return flight


def that_loses_mode_commands_after_the_stop(flight):
    """The flight's kind of link, on which it cannot let go."""
    reader = mavlink.MAVLink(None)

    class Link(flight.link_to):
        def send(self, data):
            commands = [m.command for m in reader.parse_buffer(data) if m.get_type() == "COMMAND_LONG"]
            lost = mavlink.MAV_CMD_DO_SET_MODE in commands
            return True if lost and flight.stop.is_set() else super().send(data)

    return Link


def test_the_garbage_collector_rests_in_a_replay_has_little_to_do_after_it_and_goes_on(drop) -> None:
    recording = read_recording(drop)
    config = config_of(recording.header, drop)
    gc.collect()
    collected = []
    watch = lambda phase, about: collected.append(gc.isenabled())  # noqa: E731  # gc takes any callable
    gc.callbacks.append(watch)
    try:
        replayed = replay(recording, config)
        assert len(collected) < 10 and all(collected)  # one when it is over
    finally:
        gc.callbacks.remove(watch)
    assert gc.isenabled()
    assert gc.collect() < len(replayed.sent)
    with pytest.raises(UserError):
        read_recording(drop.with_name("missing.tlog"))
    assert gc.isenabled()
