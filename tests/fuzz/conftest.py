"""Bytes and messages as nobody sane would send them."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

CRC_EXTRA = {number: kind.crc_extra for number, kind in mavlink.mavlink_map.items()}


def build_frame(number, payload, ids=(1, 1), sequence=0, flags=0, tail=b"", crc_extra=None):
    """A MAVLink 2 frame with a right checksum, whatever is in it."""
    head = bytes((len(payload), flags, 0, sequence, *ids)) + number.to_bytes(3, "little") + payload
    extra = CRC_EXTRA.get(number, 0) if crc_extra is None else crc_extra
    checksum = mavlink.x25crc(head + bytes((extra,))).crc.to_bytes(2, "little")
    return b"\xfd" + head + checksum + tail


SENDERS = st.sampled_from([(1, 1), (1, 1), (1, 1), (255, 190), (245, 191), (0, 0), (1, 154), (51, 68)])

ADDRESSED = (
    "HEARTBEAT",
    "ATTITUDE",
    "LOCAL_POSITION_NED",
    "ATTITUDE_TARGET",
    "VFR_HUD",
    "EXTENDED_SYS_STATE",
    "SYS_STATUS",
    "ESTIMATOR_STATUS",
    "EKF_STATUS_REPORT",
    "COMMAND_ACK",
    "STATUSTEXT",
    "COMMAND_LONG",
    "COMMAND_INT",
    "PARAM_SET",
    "PARAM_VALUE",
    "PARAM_REQUEST_READ",
    "PARAM_REQUEST_LIST",
    "SET_ATTITUDE_TARGET",
    "SET_POSITION_TARGET_LOCAL_NED",
    "TIMESYNC",
    "PING",
    "SETUP_SIGNING",
    "TUNNEL",
    "MISSION_COUNT",
    "MISSION_ITEM_INT",
    "MISSION_REQUEST_INT",
    "FILE_TRANSFER_PROTOCOL",
    "REQUEST_DATA_STREAM",
    "AUTOPILOT_VERSION",
)
"""Messages that somebody here acts on; the others are only passed by."""

_NUMBERS = {kind.msgname: number for number, kind in mavlink.mavlink_map.items()}
known_number = st.sampled_from([_NUMBERS[name] for name in ADDRESSED]) | st.sampled_from(sorted(CRC_EXTRA))
number_bytes = st.sampled_from(
    [
        b"\x00\x00\xc0\x7f",  # float32 NaN
        b"\x00\x00\x80\x7f",  # infinity
        b"\xff\xff\x7f\x7f",  # the largest
        b"\x00\x00\x80\x3f",  # 1.0
        b"\xff\xff\xff\xff",
        b"\x00\x00\x00\x80",
        b"\x01\x01\x01\x01",
        b"\xf5\xbf\xf5\xbf",  # 245, 191
    ]
)
payloads = st.binary(max_size=60) | st.lists(number_bytes, max_size=20).map(b"".join)
frames = st.builds(build_frame, known_number, payloads, SENDERS, st.integers(0, 255))


@st.composite
def streams(draw):
    """Frames, some of them damaged, cut short, of unknown type or wrongly flagged, with rubbish between."""
    pieces = draw(st.lists(frames | st.binary(max_size=30), max_size=8))
    data = bytearray(b"".join(pieces))
    for _ in range(draw(st.integers(0, 3))):
        if data:
            at = draw(st.integers(0, len(data) - 1))
            data[at] = draw(st.integers(0, 255))
    return bytes(data[draw(st.integers(0, 3)) :])


@st.composite
def damaged(draw, original):
    """A file with some bytes changed, a stretch doubled, left out or overwritten, or its end gone."""
    data = bytearray(original)
    for _ in range(draw(st.integers(1, 6))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        length = draw(st.integers(0, 300))
        stretch = data[at : at + length]
        match draw(st.integers(0, 4)):
            case 0:
                data[at : at + 4] = draw(st.binary(min_size=1, max_size=4))
            case 1:
                data[at:at] = stretch
            case 2:
                del data[at : at + length]
            case 3:
                data[at : at + length] = bytes(len(stretch))
            case _:
                del data[at:]
    return bytes(data)


@pytest.fixture(scope="session")
def log_files(tmp_path_factory):
    """The same short flight in each format, by the writers of the tests of the readers."""
    source = Path(__file__).parents[1] / "loganalysis" / "conftest.py"
    spec = importlib.util.spec_from_file_location("log_writers", source)
    writers = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = writers  # its dataclasses look themselves up
    spec.loader.exec_module(writers)
    directory, flight = tmp_path_factory.mktemp("logs"), writers.make_flight(12)
    files = {}
    for kind in ("tlog", "dataflash", "ulog"):
        files[kind] = directory / f"flight.{kind}"
        getattr(writers, f"write_{kind}")(files[kind], flight)
    return files


def run(check, examples):
    """Hand `check` something to draw from, `examples` times; the same on every run, but for the long mode."""

    @settings(
        max_examples=examples,
        derandomize=examples < 1000,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.data())
    def body(data):
        check(data)

    body()


@pytest.fixture(scope="session")
def hostile():
    """Builders and strategies, for tests and for what they check."""
    return SimpleNamespace(
        frame=build_frame, frames=frames, streams=streams, damaged=damaged, run=run, numbers=_NUMBERS
    )


def pytest_generate_tests(metafunc):
    """Each fuzz test says how many examples CI can spare; the long mode has many more."""
    if "examples" in metafunc.fixturenames:
        few, many = metafunc.function.budget
        long = pytest.param(many, marks=[pytest.mark.long_fuzz, pytest.mark.timeout(7200)], id="long")
        metafunc.parametrize("examples", [pytest.param(few, id="short"), long])
