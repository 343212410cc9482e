"""What fuzzing found, one test each, so that it stays mended."""

import struct

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import ConfigError, load
from kffa_offboard.config_tuning_file import RememberedTuning, read_values
from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.notes import PAYLOAD_TYPE, Header, to_messages
from kffa_offboard.flightlog.tlog import TIMESTAMP, read_signals, read_tlog
from kffa_offboard.loganalysis import dataflash
from kffa_offboard.mavlink.address import parse_url
from kffa_offboard.offboard.events import EngageRequested
from kffa_offboard.offboard.tuning import TuningProblem
from kffa_offboard.replay.recording import read_recording
from kffa_offboard.report.read import read_any
from sim_vehicle import config as sim_config
from sim_vehicle.endpoints import parse_endpoint
from sim_vehicle.errors import SimulatorError

BEGIN_US = 1_700_000_000_000_000
LONG = "9" * 5000


@pytest.mark.parametrize("text", [f"seed = {LONG}", f"a = {'[' * 5000}"], ids=["digits", "brackets"])
def test_a_number_or_a_nesting_of_thousands_is_explained(tmp_path, text):
    path = tmp_path / "any.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"too long; shorten it|not valid TOML"):
        load(path)
    with pytest.raises(SimulatorError, match=r"too long; shorten it|not valid TOML"):
        sim_config.load(path)
    with pytest.raises(TuningProblem, match=r"too long|not valid TOML"):
        read_values(RememberedTuning(path, text), {})


def test_a_stored_parameter_that_no_float_can_hold_is_explained(tmp_path):
    store = RememberedTuning(tmp_path / "tuned.toml", f"omega_c = {'9' * 400}")
    with pytest.raises(TuningProblem, match="must be a number"):
        read_values(store, {"OMEGA_C": ("omega_c",)})


@pytest.mark.parametrize("number", [LONG, "²", "٣"])
def test_a_port_that_is_no_number_in_digits_is_explained(number):
    for url in (f"udpin:127.0.0.1:{number}", f"serial:/dev/ttyACM0:{number}"):
        with pytest.raises(UserError, match="is not a"):
            parse_url(url)
    with pytest.raises(ValueError, match="with a port of 0 to 65535"):
        parse_endpoint(f"udpin:127.0.0.1:{number}", allow_remote=False)


def tlog(path, *records):
    path.write_bytes(b"".join(TIMESTAMP.pack(time_us) + frame for time_us, frame in records))
    return path


def frame(message, ids=(1, 1)):
    return bytes(message.pack(mavlink.MAVLink(None, *ids)))


ATTITUDE = frame(mavlink.MAVLink_attitude_message(10_000, 0.1, 0, 0, 0, 0, 0))
HEARTBEAT = frame(mavlink.MAVLink_heartbeat_message(2, 12, 128, 0, 4, 3))


def test_a_time_that_64_bits_with_a_sign_cannot_hold_is_damage(tmp_path):
    path = tlog(tmp_path / "any.tlog", (BEGIN_US, HEARTBEAT), (1 << 63, ATTITUDE), (BEGIN_US + 1, ATTITUDE))
    log = read_tlog(path)
    assert [time_us for time_us, _ in log] == [BEGIN_US, BEGIN_US + 1]
    assert log.damaged == 1
    assert read_any(path, "any").duration_s == pytest.approx(1e-6)


@pytest.mark.parametrize("state", [np.nan, -1.0, 6.0, np.inf])
def test_signals_in_a_state_that_there_is_not_are_none(tmp_path, state):
    data = [0.0] * 58
    data[36] = float(state)
    message = mavlink.MAVLink_debug_float_array_message(BEGIN_US, b"kffa", 0, data)
    path = tlog(tmp_path / "any.tlog", (BEGIN_US, frame(message, (245, 191))))
    assert len(read_signals(path).time_us) == 0


def test_a_dataflash_column_without_a_name_makes_the_format_none(tmp_path):
    def declared(kind, name, letters, columns):
        size = sum(np.dtype(dataflash.LETTERS[letter][0]).itemsize for letter in letters.decode()) + 3
        return b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", kind, size, name, letters, columns)

    path = tmp_path / "any.BIN"
    good = declared(131, b"RATE", b"Qf", b"TimeUS,R") + b"\xa3\x95\x83" + struct.pack("<Qf", 1, 2.0)
    path.write_bytes(declared(130, b"ATT", b"Qff", b"TimeUS,,Roll") + good)
    tables = dataflash.read(path, frozenset({"ATT", "RATE"})).tables
    assert set(tables) == {"RATE"}


# ------------------------------------------------------------------------- notes that are none


def tunnel(text, *, index=0, count=1, ids=(245, 191), length=None):
    body = struct.pack("<HH", index, count) + text
    size = len(body) if length is None else length
    message = mavlink.MAVLink_tunnel_message(0, 0, PAYLOAD_TYPE, size, list(body.ljust(128, b"\0")))
    return frame(message, ids)


@pytest.mark.parametrize(
    "note",
    [
        tunnel(b"", length=0),
        tunnel(b"{}", count=0),
        tunnel(b"[]"),
        tunnel(b"[" * 100),
        tunnel(b'{"note": "header", "format": 1}'),
        tunnel(b'{"note": "header", "format": 1, "version": 5, "configuration": [], "options": {}}'),
        tunnel(b'{"note": "end", "reason": null}'),
        tunnel(b'{"note": "request", "what": "intrusion", "text": "x", "consequence": "lands"}'),
        tunnel(b"\xff\xfe"),
    ],
)
def test_a_note_that_is_none_is_explained_in_a_line(tmp_path, note):
    path = tlog(tmp_path / "any.tlog", (BEGIN_US, note), (BEGIN_US, HEARTBEAT), (BEGIN_US + 1, ATTITUDE))
    with pytest.raises(UserError, match="cannot be replayed") as refused:
        read_recording(path)
    assert "\n" not in str(refused.value)
    assert any("could not be read" in remark for remark in read_any(path, "any").remarks)


def header(part=1):
    notes = to_messages(Header("0.1.0", {"link": {"url": "udpin:127.0.0.1:0"}}, {}, part=part))
    return [(BEGIN_US, frame(message, (245, 191))) for message in notes]


def test_what_somebody_else_sends_in_the_form_of_a_note_is_none(tmp_path):
    """It was on the wire, so it is in the log; a replayed flight must not engage by it."""
    forged = tunnel(b'{"note": "request", "what": "engage"}', ids=(255, 190))
    own = tunnel(b'{"note": "request", "what": "engage"}')
    recording = read_recording(tlog(tmp_path / "a.tlog", *header(), (BEGIN_US + 5, forged)))
    assert [item.get_type() for _, item in recording.incoming] == ["TUNNEL"]
    recording = read_recording(tlog(tmp_path / "b.tlog", *header(), (BEGIN_US + 5, own)))
    assert [item for _, item in recording.incoming] == [EngageRequested()]


@pytest.mark.parametrize("later_us", [-1, 90_000_000_000])
def test_a_log_in_which_time_goes_back_or_jumps_by_days_is_not_replayed(tmp_path, later_us):
    records = [*header(), (BEGIN_US + 10, HEARTBEAT), (BEGIN_US + 10 + later_us, ATTITUDE)]
    with pytest.raises(UserError, match=r"time goes from .* cannot be replayed"):
        read_recording(tlog(tmp_path / "any.tlog", *records))


def test_a_further_part_alone_is_not_replayed_as_if_it_were_a_flight(tmp_path):
    path = tlog(tmp_path / "flight-2.tlog", *header(part=2), (BEGIN_US + 5, HEARTBEAT))
    with pytest.raises(UserError, match="is part 2 of a flight; name its first file; it cannot be replayed"):
        read_recording(path)
