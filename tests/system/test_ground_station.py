"""A ground station talks to the daemon in flight: parameters, commands, signals, in real MAVLink bytes."""

from __future__ import annotations

from collections.abc import Callable
from math import isnan, nan
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.offboard.events import SetGripper
from kffa_offboard.offboard.service import State

US, COMPONENT = 245, 191


class GroundStation:
    """System 255 beside the vehicle: sends when told to, and reads everything that the daemon sends."""

    def __init__(self, flight: Any) -> None:
        self._flight = flight
        self._packer = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)

    def send(self, message: Any) -> None:
        self._flight.link.from_ground.append(bytes(message.pack(self._packer)))

    def set(self, name: str, value: float, kind: int = mavlink.MAV_PARAM_TYPE_REAL32) -> None:
        self.send(mavlink.MAVLink_param_set_message(US, COMPONENT, name.encode(), value, kind))

    def command(self, command: int, *parameters: float, component: int = COMPONENT, again: int = 0) -> None:
        padded = (*parameters, *[0.0] * (7 - len(parameters)))
        self.send(mavlink.MAVLink_command_long_message(US, component, command, again, *padded))

    def heard(self, *kinds: str) -> list[Any]:
        """Everything the daemon has sent of these kinds."""
        messages = [
            message for data in self._flight.link.sent for message in mavlink.MAVLink(None).parse_buffer(data)
        ]
        return [message for message in messages if message.get_type() in kinds]

    def texts(self) -> list[str]:
        return [message.text for message in self.heard("STATUSTEXT")]


class Script:
    """Does things at times after engaging; the flight ends when the last is done."""

    def __init__(self, flight: Any, *actions: tuple[float, Callable[[], None]]) -> None:
        self._flight = flight
        self._actions = list(actions)
        self._engaged_us: int | None = None

    def __call__(self, vehicle: Any) -> bool:
        if self._flight.session.service.state is not State.ENGAGED and self._engaged_us is None:
            return False
        self._engaged_us = vehicle.time_us if self._engaged_us is None else self._engaged_us
        while self._actions and vehicle.time_us >= self._engaged_us + self._actions[0][0] * 1e6:
            self._actions.pop(0)[1]()
        return not self._actions


def nothing() -> None:
    """Only passes the time."""


@pytest.fixture
def holding(lock_step_flight, tmp_path):
    """Takes off to 3 m, holds for long, and can store parameters."""
    text = bundled("demo-px4.toml").read_text()
    head = text[: text.index("[[scenario.segment]]")]
    file = tmp_path / "mine.toml"
    file.write_text(
        head
        + '[[scenario.segment]]\ntype = "takeoff"\naltitude_m = 3.0\n'
        + '[[scenario.segment]]\ntype = "hold"\nduration_s = 60.0\n'
        + '[parameters]\nfile = "mine.tuned.toml"\n'
    )
    return lock_step_flight("px4", daemon_file=file)


def test_a_parameter_set_in_flight_acts_in_the_next_step_without_a_bump(holding):
    ground = GroundStation(holding)
    set_us: list[int] = []

    def lower() -> None:
        set_us.append(holding.vehicle.time_us)
        ground.set("ALT_OMEGA_C", 5.0)
        ground.set("ALT_OMEGA_C_RG", 0.0)

    holding.fly(Script(holding, (8.0, lower), (9.0, nothing)))
    steps = [item for item in holding.signals if item.state == "engaged"]
    before = [item for item in steps if item.time_us <= set_us[0]][-100:]
    after = [item for item in steps if item.time_us > set_us[0] + 10_000]
    assert all(item.omega_c[3] > 5.5 for item in before)
    assert all(item.omega_c[3] == pytest.approx(5.0) for item in after)
    thrust = np.array([item.command[3] for item in steps if abs(item.time_us - set_us[0]) < 1_000_000])
    # Hover noise moves the command by so much from step to step anyway.
    usual = np.abs(np.diff([item.command[3] for item in before])).max()
    assert np.abs(np.diff(thrust)).max() < 3.0 * usual
    answers = [(message.param_id, message.param_value) for message in ground.heard("PARAM_VALUE")]
    assert answers == [("ALT_OMEGA_C", 5.0), ("ALT_OMEGA_C_RG", 0.0)]
    heights = holding.truth.z[-100:]
    assert abs(heights - 3.0).max() < 0.03


def test_a_plant_parameter_set_in_flight_is_not_felt(holding):
    ground = GroundStation(holding)
    script = Script(holding, (8.0, lambda: ground.set("ALT_HOVER_THR", 0.45)), (10.0, nothing))
    holding.fly(script)
    assert holding.session.service.settings.hover_thrust == 0.45
    assert np.abs(holding.truth.z[-200:] - 3.0).max() < 0.03


def test_a_plant_far_from_the_present_one_is_refused_in_flight(holding):
    ground = GroundStation(holding)
    before = holding.daemon.service.hover_thrust
    holding.fly(Script(holding, (8.0, lambda: ground.set("ALT_HOVER_THR", 0.6 * before)), (9.0, nothing)))
    assert [message.param_value for message in ground.heard("PARAM_VALUE")] == [pytest.approx(before)]
    assert "go in steps of 1.5 times at most" in "".join(ground.texts())
    assert holding.session.service.settings.hover_thrust == before


def test_a_value_out_of_range_is_refused_with_the_unchanged_one_and_the_reason(holding):
    ground = GroundStation(holding)

    def ask() -> None:
        ground.set("ALT_OMEGA_C", 2000.0)
        ground.set("ALT_OMEGA_C", nan)
        ground.set("ALT_OMEGA_C", 7.0, mavlink.MAV_PARAM_TYPE_INT32)
        ground.set("NO_SUCH_NAME", 1.0)

    holding.fly(Script(holding, (0.0, ask), (0.1, nothing)))
    assert [message.param_value for message in ground.heard("PARAM_VALUE")] == [8.0] * 3
    said = "".join(ground.texts())
    assert "ALT_OMEGA_C refused: 2000: is above 1000 rad/s" in said
    assert "ALT_OMEGA_C refused: nan: must be a finite number" in said
    assert "type 6: parameters are REAL32" in said
    assert "parameter NO_SUCH_NAME: not known" in said
    assert holding.session.service.settings is holding.daemon.service


def test_the_list_is_complete_and_paced(holding):
    ground = GroundStation(holding)
    request = mavlink.MAVLink_param_request_list_message(US, 0)
    sent: list[int] = []

    def count() -> None:
        sent.append(len(ground.heard("PARAM_VALUE")))

    counts = [(0.01 * k, count) for k in range(1, 100)]
    holding.fly(Script(holding, (0.0, lambda: ground.send(request)), *counts, (1.0, nothing)))
    values = ground.heard("PARAM_VALUE")
    tunables = holding.daemon.tuning.tunables
    assert [(m.param_id, m.param_index, m.param_count) for m in values] == [
        (tunable.name, k, len(tunables)) for k, tunable in enumerate(tunables)
    ]
    assert [m.param_value for m in values] == [np.float32(tunable.value) for tunable in tunables]
    assert np.diff(sent).max() <= 5


def test_parameters_are_read_by_name_and_by_index(holding):
    ground = GroundStation(holding)
    name = b"LIM_TILT_DEG"

    def ask() -> None:
        ground.send(mavlink.MAVLink_param_request_read_message(US, COMPONENT, name, -1))
        ground.send(mavlink.MAVLink_param_request_read_message(US, COMPONENT, b"", 0))
        ground.send(mavlink.MAVLink_param_request_read_message(US, COMPONENT, b"", 999))
        ground.send(mavlink.MAVLink_param_request_read_message(1, 1, name, -1))  # the autopilot's

    holding.fly(Script(holding, (0.0, ask), (0.1, nothing)))
    assert [message.param_id for message in ground.heard("PARAM_VALUE")] == ["LIM_TILT_DEG", "ALT_OMEGA_C"]
    assert "parameter index 999: not known" in ground.texts()


def test_stored_parameters_fly_at_the_next_start(holding):
    ground = GroundStation(holding)
    storage = mavlink.MAV_CMD_PREFLIGHT_STORAGE

    def change() -> None:
        ground.set("ALT_OMEGA_C", 6.0)
        ground.command(storage, 1.0)
        ground.set("ALT_OMEGA_C", 5.0)
        ground.command(storage, 0.0)

    holding.fly(Script(holding, (0.0, change), (0.1, lambda: ground.command(storage, 2.0)), (0.2, nothing)))
    acks = [(ack.command, ack.result, ack.target_system) for ack in ground.heard("COMMAND_ACK")]
    assert acks == [(storage, mavlink.MAV_RESULT_ACCEPTED, 255)] * 3
    assert holding.session.service.settings.controller.law.omega_c[3] == 8.0
    assert load(holding.daemon.path, Overrides()).service.controller.law.omega_c[3] == 6.0


def test_control_is_given_back_and_taken_again_by_command(holding):
    ground = GroundStation(holding)
    switch = mavlink.MAV_CMD_NAV_GUIDED_ENABLE
    states: list[State] = []

    def look() -> None:
        states.append(holding.session.service.state)

    holding.fly(
        Script(
            holding,
            (6.0, lambda: ground.command(switch, 1.0)),  # it has control already
            (6.1, lambda: ground.command(switch, 0.0, component=0)),  # to everybody: not to us
            (6.5, look),
            (6.6, lambda: ground.command(switch, 0.0)),
            (8.6, look),
            (8.7, lambda: ground.command(switch, 2.0)),
            (8.8, lambda: ground.command(mavlink.MAV_CMD_NAV_LAND)),
            (8.9, lambda: ground.command(switch, 1.0)),
            (12.0, look),
        )
    )
    assert states == [State.ENGAGED, State.READY, State.ENGAGED]
    results = [ack.result for ack in ground.heard("COMMAND_ACK")]
    assert results == [
        mavlink.MAV_RESULT_TEMPORARILY_REJECTED,
        mavlink.MAV_RESULT_ACCEPTED,
        mavlink.MAV_RESULT_DENIED,
        mavlink.MAV_RESULT_UNSUPPORTED,
        mavlink.MAV_RESULT_ACCEPTED,
    ]
    assert np.abs(holding.truth.z[-300:] - 3.0).max() < 0.1
    assert "not engaged: already engaged" in ground.texts()
    assert "released: commanded" in ground.texts()


def test_the_gripper_works_on_command_once_for_each_command(holding):
    ground = GroundStation(holding)
    gripper = mavlink.MAV_CMD_DO_GRIPPER

    def ask() -> None:
        ground.command(gripper, 1.0, mavlink.GRIPPER_ACTION_GRAB)
        ground.command(gripper, 1.0, mavlink.GRIPPER_ACTION_GRAB, again=1)

    release = (1.0, lambda: ground.command(gripper, 1.0, mavlink.GRIPPER_ACTION_RELEASE))
    wrong = (1.1, lambda: ground.command(gripper, 1.0, nan))
    holding.fly(Script(holding, (0.0, ask), release, wrong, (1.2, nothing)))
    actions = [item.action for _, item in holding.heard if isinstance(item, SetGripper)]
    assert actions == ["grab", "release"]
    results = [ack.result for ack in ground.heard("COMMAND_ACK")]
    assert results == [mavlink.MAV_RESULT_ACCEPTED] * 3 + [mavlink.MAV_RESULT_DENIED]


def test_inner_signals_go_out_at_the_rate_that_is_asked_for(holding):
    ground = GroundStation(holding)
    interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    named, array = mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT, mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY
    counts: list[tuple[int, int]] = []

    def count() -> None:
        last = [m for m in ground.heard("NAMED_VALUE_FLOAT") if m.name == "ALT_EST"]
        counts.append((len(last), len(ground.heard("DEBUG_FLOAT_ARRAY"))))

    def change() -> None:
        count()
        ground.command(interval, named, 50_000.0)
        ground.command(interval, array, -1.0)

    holding.fly(Script(holding, (0.0, count), (2.0, change), (4.0, count)))
    (n0, a0), (n1, a1), (n2, a2) = counts
    assert (n1 - n0, a1 - a0) == (pytest.approx(20, abs=1), pytest.approx(20, abs=1))
    assert n2 - n1 == pytest.approx(40, abs=2)
    assert a2 - a1 <= 1
    last = {m.name: m for m in ground.heard("NAMED_VALUE_FLOAT")}
    assert len(last.keys() - {"payload_kg", "payload_sd"}) == 21
    assert all(len(name) <= 10 for name in last)
    step = next(item for item in holding.signals if item.time_us // 1000 == last["ALT_EST"].time_boot_ms)
    assert last["ALT_EST"].value == np.float32(step.estimate[3])
    assert last["PITCH_DIST"].value == np.float32(step.disturbance[1])
    assert last["ROLL_WC"].value == np.float32(step.omega_c[0])
    assert isnan(last["LATENCY_S"].value)  # clocks are not compared in lock-step
    assert all(message.tc1 != 0 for message in ground.heard("TIMESYNC"))


def test_one_channel_s_signals_go_out_as_numbers_with_fields_of_their_own(lock_step_flight, tmp_path):
    file = tmp_path / "vector.toml"
    file.write_text(bundled("demo-px4.toml").read_text() + '\n[signals]\nvector = "altitude"\n')
    flight = lock_step_flight("px4", daemon_file=file)
    ground = GroundStation(flight)
    off = (
        1.0,
        lambda: ground.command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAVLINK_MSG_ID_DEBUG_VECT, -1),
    )
    counts: list[int] = []

    def count() -> None:
        counts.append(len(ground.heard("DEBUG_VECT")))

    flight.fly(Script(flight, (0.0, count), (1.0, count), off, (2.0, count)))
    assert counts[1] - counts[0] == pytest.approx(10, abs=1)
    assert counts[2] - counts[1] <= 1
    last = ground.heard("DEBUG_VECT")[-1]
    step = next(item for item in flight.signals if item.time_us == last.time_usec)
    assert last.name == "ALT"
    values = step.reference[3], step.estimate[3], step.disturbance[3]
    assert (last.x, last.y, last.z) == tuple(np.float32(values))


def test_what_the_daemon_is_can_be_asked_for(holding):
    ground = GroundStation(holding)
    request = mavlink.MAV_CMD_REQUEST_MESSAGE

    def ask() -> None:
        ground.command(request, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
        ground.command(request, mavlink.MAVLINK_MSG_ID_MESSAGE_INTERVAL, 251)
        ground.command(request, 12345.0)
        ground.command(request, nan)
        ground.send(mavlink.MAVLink_ping_message(77, 5, 0, 0))
        ground.send(mavlink.MAVLink_ping_message(78, 6, 1, 1))

    holding.fly(Script(holding, (0.0, ask), (0.1, nothing)))
    (version,) = ground.heard("AUTOPILOT_VERSION")
    assert version.capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST
    (interval,) = ground.heard("MESSAGE_INTERVAL")
    assert (interval.message_id, interval.interval_us) == (251, 100_000)
    assert [ack.result for ack in ground.heard("COMMAND_ACK")] == [0, 0, 3, 3]
    assert not ground.heard("DEBUG_VECT")  # there is none without a channel for it
    (ping,) = ground.heard("PING")
    assert (ping.time_usec, ping.seq, ping.target_system, ping.target_component) == (77, 5, 255, 190)
