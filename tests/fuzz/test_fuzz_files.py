"""Configurations and flight logs with anything in them: one line for people, or they are read."""

import gzip
import json
import string
import struct
from pathlib import Path

import pytest
from hypothesis import strategies as st

from kffa_offboard.config import ConfigError, bundled, load
from kffa_offboard.config_log import config_of
from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.notes import PAYLOAD_TYPE, Header, to_messages
from kffa_offboard.flightlog.tlog import TIMESTAMP, read_signals, read_tlog
from kffa_offboard.loganalysis.read import read_log
from kffa_offboard.mavlink.signed_link import SigningSettings, sign_link
from kffa_offboard.mavlink.signing_key import read_key
from kffa_offboard.replay.engine import replay
from kffa_offboard.replay.recording import read_recording
from kffa_offboard.report.read import read_any
from sim_vehicle import config as sim_config
from sim_vehicle.errors import SimulatorError

CONFIGS = sorted(path for path in bundled("demo-px4.toml").parent.glob("*.toml"))
GOLDEN = Path(__file__).parents[1] / "golden" / "flights" / "px4-link-loss.tlog.gz"


def budget(few, many):
    """How many examples: in CI, in the long mode."""

    def mark(function):
        function.budget = (few, many)
        return function

    return mark


WORDS = [
    "nan", "inf", "-inf", "0", "-1", "1e400", "-0.0", "true", '""', '"x"', "[]", "{}", "9" * 30, "9" * 5000,
    '"udpin:0.0.0.0:1"', "1979-05-27", "[[]]", '"\\u0000"', "0x7fffffffffffffff", '["255/190", 5]',
]  # fmt: skip


@st.composite
def configurations(draw):
    """A configuration of ours in which a few things are not as they should be."""
    lines = draw(st.sampled_from(CONFIGS)).read_text().splitlines()
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(lines) - 1))
        key = lines[at].partition("=")[0]
        match draw(st.integers(0, 5)):
            case 0:
                lines[at] = f"{key} = {draw(st.sampled_from(WORDS))}"
            case 1:
                lines[at] = f"{key} = {draw(st.floats() | st.integers())}"
            case 2:
                del lines[at]
            case 3:
                lines.insert(at, lines[draw(st.integers(0, len(lines) - 1))])
            case 4:
                lines[at] = draw(st.text(string.printable, max_size=30))
            case _:
                lines.insert(at, f"[{draw(st.text(string.ascii_lowercase + '._', max_size=12))}]")
        lines = lines or [""]
    return "\n".join(lines)


def one_line_for_people(error):
    return bool(str(error)) and all(0 < len(line) < 2000 for line in str(error).splitlines())


@budget(120, 6_000)
def test_any_configuration_is_read_or_explained(hostile, tmp_path, examples):
    path = tmp_path / "any.toml"

    def check(data):
        path.write_text(data.draw(configurations()), encoding="utf-8", errors="surrogateescape")
        try:
            load(path)
        except ConfigError as error:
            assert one_line_for_people(error)
        try:
            sim_config.load(path)
        except SimulatorError as error:
            assert one_line_for_people(error)
            assert "\n" not in str(error)

    hostile.run(check, examples)


@budget(60, 6_000)
def test_any_bytes_are_no_configuration_no_key_and_no_timestamp_and_said_to_be_none(
    hostile, tmp_path, examples
):
    path, key = tmp_path / "any", tmp_path / "key"
    key.write_text("ab" * 32)
    for file in (path, key):
        file.touch(mode=0o600)
        file.chmod(0o600)

    def check(data):
        path.write_bytes(data.draw(st.binary(max_size=80) | st.text(max_size=80).map(str.encode)))
        for read, problem in ((load, ConfigError), (sim_config.load, SimulatorError), (read_key, UserError)):
            try:
                read(path)
            except problem as error:
                assert one_line_for_people(error)
        try:
            sign_link(None, SigningSettings(key, timestamp_file=path), lambda: 1_790_000_000_000_000)
        except UserError as error:
            assert one_line_for_people(error)

    hostile.run(check, examples)


@pytest.mark.parametrize("kind", ["tlog", "dataflash", "ulog"])
@budget(60, 3_000)
def test_any_damage_to_a_log_is_read_over_or_explained(hostile, log_files, tmp_path, kind, examples):
    original = log_files[kind].read_bytes()
    path = tmp_path / f"any.{kind}"
    readers = [read_log, lambda file: read_any(file, "any")]
    if kind == "tlog":
        readers += [lambda file: list(read_tlog(file)), read_signals, read_recording]

    def check(data):
        path.write_bytes(data.draw(hostile.damaged(original)))
        for read in readers:
            try:
                read(path)
            except UserError as error:
                assert one_line_for_people(error)
                assert "\n" not in str(error)

    hostile.run(check, examples)


@budget(12, 1_000)
def test_any_damage_to_our_own_log_is_replayed_or_explained(hostile, tmp_path, examples):
    """The header says how the flight is set up: damaged, it is another configuration, or none."""
    path = tmp_path / "any.tlog"
    with gzip.open(GOLDEN) as file:
        original = file.read(16_000)  # header, connection, the first telemetry

    def check(data):
        path.write_bytes(data.draw(hostile.damaged(original)))
        try:
            recording = read_recording(path)
            replay(recording, config_of(recording.header, path))
        except UserError as error:
            assert one_line_for_people(error)

    hostile.run(check, examples)


@budget(20, 2_000)
def test_any_damage_to_a_compressed_log_is_read_over_or_explained(hostile, tmp_path, examples):
    path = tmp_path / "any.tlog.gz"
    with gzip.open(GOLDEN) as file:
        original = gzip.compress(file.read(16_000), mtime=0)

    def check(data):
        path.write_bytes(data.draw(hostile.damaged(original)))
        for read in (lambda: list(read_tlog(path)), lambda: read_recording(path)):
            try:
                read()
            except UserError as error:
                assert one_line_for_people(error)

    hostile.run(check, examples)


# ------------------------------------------------------------------- logs that somebody has made up

TUNNEL = 385
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(st.text(max_size=5), inner, max_size=2),
    max_leaves=4,
)


def good_header():
    """The header of the golden flight, as a document."""
    recording = read_recording(GOLDEN)
    pieces = [
        bytes(message.payload[: message.payload_length])[4:] for message in to_messages(recording.header)
    ]
    return json.loads(b"".join(pieces))


@st.composite
def made_up_notes(draw, header):
    """A note as JSON in which a key is not what it should be, or any bytes; in any number of pieces."""
    document = dict(header)
    for _ in range(draw(st.integers(0, 2))):
        table = document
        while isinstance(table.get("configuration"), dict) and draw(st.booleans()):
            table["configuration"] = table = dict(table["configuration"])
        key = draw(st.sampled_from(sorted(table)) | st.text(max_size=6)) if table else "x"
        if draw(st.booleans()):
            table[key] = draw(json_values)
        else:
            table.pop(key, None)
    text = json.dumps(document).encode()
    if draw(st.integers(0, 3)) == 0:
        text = draw(st.binary(max_size=200) | json_values.map(lambda value: json.dumps(value).encode()))
    return [text[at : at + 124] for at in range(0, len(text), 124)] or [b""]


@st.composite
def made_up_logs(draw, hostile, header):
    """Whole frames only: notes, signals and telemetry, with any numbers and times in them."""
    frames = []
    for _ in range(draw(st.integers(1, 3))):
        pieces = draw(made_up_notes(header))
        for index, piece in enumerate(pieces):
            chunk = struct.pack("<HH", index, len(pieces)) + piece
            if draw(st.integers(0, 40)) == 0:
                chunk = draw(st.binary(max_size=8))
            length = draw(st.sampled_from([len(chunk)] * 30 + [0, 3, 255]))
            payload = struct.pack("<HBBB", PAYLOAD_TYPE, 0, 0, length) + chunk.ljust(128, b"\0")
            frames.append(hostile.frame(TUNNEL, payload, (245, 191)))
    for _ in range(draw(st.integers(0, 6))):
        numbers = draw(st.lists(st.floats(width=32), min_size=58, max_size=58))
        body = struct.pack(
            "<QH10s58f", draw(st.integers(0, 2**64 - 1)), draw(st.integers(0, 1)), b"kffa", *numbers
        )
        sender = draw(st.sampled_from([(245, 191), (1, 1)]))
        frames.append(draw(st.just(hostile.frame(350, body, sender)) | hostile.frames))
    times = st.integers(0, 2**64 - 1) | st.just(1_700_000_000_000_000)
    return b"".join(TIMESTAMP.pack(draw(times)) + frame for frame in frames)


@budget(60, 3_000)
def test_any_log_of_whole_frames_is_read_or_explained(hostile, tmp_path, examples):
    path, header = tmp_path / "any.tlog", good_header()
    assert header["format"] and Header

    def check(data):
        path.write_bytes(data.draw(made_up_logs(hostile, header)))
        for read in (read_log, lambda file: read_any(file, "any"), read_signals, replayed):
            try:
                read(path)
            except UserError as error:
                assert one_line_for_people(error)

    hostile.run(check, examples)


def replayed(path):
    recording = read_recording(path)
    return replay(recording, config_of(recording.header, path))
