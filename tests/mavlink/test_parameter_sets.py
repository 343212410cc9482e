"""Parameters set and read as no ground station should: the old value stays, and it is said why."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import bundled, load
from kffa_offboard.mavlink.parameter_server import ParameterServer
from kffa_offboard.offboard.events import Announce

CONFIG = load(bundled("demo-px4.toml"))
REAL32 = mavlink.MAV_PARAM_TYPE_REAL32


@pytest.fixture
def server():
    return ParameterServer(CONFIG.tuning)


@pytest.fixture
def ask(server, scripted):
    """Set something: what goes out, and what the service is told."""
    ground = scripted(255, 190)

    def ask(name, value, kind=REAL32):
        message = mavlink.MAVLink_param_set_message(245, 191, name, value, kind)
        return server.set(0, ground.over_the_wire(message))

    return ask


def values_of(server):
    return [tunable.value for tunable in server.tunables]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 3.4e38, -1.0, 0.0, 1e-40])
def test_values_that_cannot_be_are_refused_for_every_gain(server, ask, value):
    before = values_of(server)
    for name in (b"ALT_OMEGA_C", b"ROLL_OMEGA_O", b"LIM_TILT_DEG"):
        replies, told = ask(name, value)
        assert told == []
        answered, said = replies
        assert answered.get_type() == "PARAM_VALUE"
        assert math.isfinite(answered.param_value)
        assert isinstance(said, Announce)
        assert said.text.startswith(f"{name.decode()} refused: ")
    assert values_of(server) == before


@pytest.mark.parametrize("kind", [0, 1, 6, 8, 10, 255])
def test_another_type_than_real32_is_refused(server, ask, kind):
    before = values_of(server)
    replies, told = ask(b"ALT_OMEGA_C", 5.0, kind)
    assert told == []
    assert f"type {kind}" in replies[1].text
    assert values_of(server) == before


@pytest.mark.parametrize(
    "name", [b"", b"NO_SUCH", b"alt_omega_c", b"ALT_OMEGA_C ", b"\xff\xfe\x01\n", b"X" * 16]
)
def test_an_unknown_name_is_said_and_not_answered_with_a_value(server, ask, name):
    before = values_of(server)
    replies, told = ask(name, 5.0)
    assert told == []
    assert [type(reply) for reply in replies] == [Announce]
    assert replies[0].text.endswith("not known")
    assert replies[0].text.isprintable()
    assert values_of(server) == before


@pytest.mark.parametrize("index", [1000, 32767])
def test_an_index_that_is_none_is_said(server, scripted, index):
    message = mavlink.MAVLink_param_request_read_message(245, 191, b"", index)
    (said,) = server.read(scripted(255, 190).over_the_wire(message))
    assert said.text == f"parameter index {index}: not known"


def test_a_negative_index_means_the_name(server, scripted):
    for index in (-1, -32768):
        message = mavlink.MAVLink_param_request_read_message(245, 191, b"ALT_OMEGA_C", index)
        (answered,) = server.read(scripted(255, 190).over_the_wire(message))
        assert answered.param_id == "ALT_OMEGA_C"


@given(st.data())
def test_whatever_is_set_every_value_stays_one_that_the_configuration_allows(data):
    server = ParameterServer(CONFIG.tuning)
    names = [tunable.name for tunable in server.tunables]
    for _ in range(data.draw(st.integers(1, 3))):
        name, value = data.draw(st.sampled_from(names)), data.draw(st.floats(width=32))
        message = mavlink.MAVLink_param_set_message(245, 191, name.encode(), value, REAL32)
        codec = mavlink.MAVLink(None, 255, 190)
        server.set(0, mavlink.MAVLink(None).decode(bytearray(message.pack(codec))))
    assert all(math.isfinite(tunable.value) for tunable in server.tunables)
    assert server.tuning.with_value(names[0], server.tunables[0].value) is not None  # the checks still hold
