"""`[position]` and `type = "move"` in a configuration file."""

from __future__ import annotations

from math import radians
from pathlib import Path

import numpy as np
import pytest

from kffa_offboard.config import ConfigError, bundled, load
from kffa_offboard.control.position import STANDARD_GRAVITY
from kffa_offboard.offboard.segments import Move

MINIMAL = """
[link]
url = "udpin:127.0.0.1:14540"
[control.altitude]
hover_thrust = 0.4
"""
MOVE = '[[scenario.segment]]\ntype = "move"\nnorth_m = 3\nduration_s = 5\n'


def written(tmp_path: Path, text: str) -> Path:
    file = tmp_path / "vehicle.toml"
    file.write_text(MINIMAL + text)
    return file


def test_without_the_table_there_is_no_ring(tmp_path: Path) -> None:
    assert load(written(tmp_path, "")).service.position is None
    assert load(written(tmp_path, "[position]\nomega_c = 1.5\n")).service.position is None


def test_the_numbers_reach_the_ring(tmp_path: Path) -> None:
    text = "[position]\nenabled = true\nomega_c = 1.5\nomega_o = 5\ntilt_max_deg = 15\ndelay_s = 0.05\n"
    position = load(written(tmp_path, text)).service.position
    assert position is not None
    ring = position.ring.controller
    assert ring.name == "kffa-ladrc" and ring.law is not None and ring.prediction is not None
    assert ring.law.omega_c.tolist() == [1.5, 1.5]
    assert ring.actuator.delay.tolist() == [0.05, 0.05]
    assert ring.prediction == pytest.approx(0.05 + 0.12)  # delay and lag
    assert position.tilt_max_rad == pytest.approx(radians(15.0))
    assert position.ring.acceleration_max == pytest.approx(STANDARD_GRAVITY * np.tan(radians(15.0)))


ROPE = "[position]\nenabled = true\nomega_c = 1.5\n[payload]\nrope_length_m = 4\n"


def test_a_rope_brings_a_ring_that_damps_and_roll_and_pitch_that_yield(tmp_path: Path) -> None:
    told = load(written(tmp_path, ROPE)).service
    assert told.position is not None and told.position.on_rope and told.position.damping is not None
    assert told.position.ring.controller.name == "kffa-ladrc"  # it observes until setpoints act
    damping = told.position.damping.controller.pid
    assert damping is not None and damping.kd.tolist() == pytest.approx([3 * 0.375] * 2)
    assert damping.follow  # a set point that moves
    assert told.position.sway_rad_s == pytest.approx((9.80665 / 4.0) ** 0.5)
    assert told.controller.law is not None and told.controller.law.rejection is not None
    assert told.controller.law.rejection.tolist() == [0.0, 0.0, 1.0, 1.0]


def test_without_one_both_are_ready_for_a_swing_that_shows(tmp_path: Path) -> None:
    service = load(written(tmp_path, "[position]\nenabled = true\n")).service
    assert service.position is not None and service.position.damping is not None
    assert not service.position.on_rope
    assert service.controller.law is not None and service.controller.law.rejection is None


@pytest.mark.parametrize("name", ["pid", "cascaded-pid"])
def test_a_ring_by_pid_damps_by_itself(tmp_path: Path, name: str) -> None:
    text = f'[control]\ncontroller = "{name}"\n' + ROPE
    service = load(written(tmp_path, text)).service
    assert service.position is not None and service.position.ring.controller.pid is not None
    assert service.position.damping is None and service.controller.law is None


def test_without_the_ring_a_rope_makes_roll_and_pitch_yield(tmp_path: Path) -> None:
    service = load(written(tmp_path, "[payload]\nrope_length_m = 0.2\n")).service
    assert service.position is None
    assert service.controller.law is not None and service.controller.law.rejection is not None


def test_a_move_becomes_a_segment(tmp_path: Path) -> None:
    service = load(written(tmp_path, "[position]\nenabled = true\n" + MOVE)).service
    assert service.scenario == (Move(3.0, 0.0, 5.0, 2.0),)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MOVE, "scenario segment 1 (move): needs the position ring; set [position] enabled = true"),
        (
            "[position]\ntilt_max_rad = 0.3\n",
            "position.tilt_max_rad = 0.3: unknown key; did you mean tilt_max_deg",
        ),
        (
            "[position]\ntilt_max_deg = 0.35\n",
            "position.tilt_max_deg = 0.35: is below 3 deg; were these radians?",
        ),
        ("[position]\nomega_o = 1.0\n", "must rise in this order"),
        (
            f"[position]\nenabled = true\n[payload]\nrope_length_m = 10\n{MOVE}",
            "duration_s = 5 is too short at speed_m_s = 2 and flight.acceleration_m_s2 = 1 on that rope; "
            "give at least 7.6",
        ),
        ("[position]\nenabled = true\ntilt_max_deg = 40\n", "is above limits.tilt_max_deg = 30"),
    ],
)
def test_what_cannot_be_flown_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError) as error:
        load(written(tmp_path, text))
    assert "\n" not in str(error.value)
    assert message in str(error.value)


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_the_position_demonstration_flies_the_demonstrations_controller(personality: str) -> None:
    plain = load(bundled(f"demo-{personality}.toml")).service
    ring = load(bundled(f"demo-{personality}-position.toml")).service
    assert ring.position is not None and plain.position is None
    assert repr(ring.controller) == repr(plain.controller)
