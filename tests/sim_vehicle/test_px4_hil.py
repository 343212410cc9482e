"""The plant under PX4's HIL interface, flown by a scripted PX4."""

from __future__ import annotations

import math
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle import airframe
from sim_vehicle.backends.px4_hil import Px4Vehicle, physics_step_us
from sim_vehicle.backends.px4_sensors import Px4SensorNoise, range_finder
from sim_vehicle.config import build
from sim_vehicle.errors import SimulatorError
from sim_vehicle.frames import body_to_frd

HOVER = 98.0 / 246.0
RANGE_FINDER = {"px4_hil": {"range_finder": True}}
PARAMETERS = Path(__file__).parents[2] / "configs" / "px4-hil" / "px4-rc.params"


class ScriptedPx4:
    """PX4's side of the wire: parses what the simulator sends, packs motor outputs."""

    def __init__(self) -> None:
        self.codec = mavlink.MAVLink(file=None, srcSystem=1, srcComponent=1)
        self.codec.robust_parsing = True

    def read(self, data: bytes) -> list[Any]:
        return list(self.codec.parse_buffer(data) or [])

    def outputs(
        self, time_us: int, motors: list[float], gripper: float = 0.0, armed: bool = True, flags: int = 1
    ) -> bytes:
        controls = [*motors, gripper, *[0.0] * 11]
        mode = mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        message = mavlink.MAVLink_hil_actuator_controls_message(time_us, controls, mode | 1, flags)
        return bytes(message.pack(self.codec))


def hil(**sections: dict[str, Any]) -> Px4Vehicle:
    return Px4Vehicle(build(sections, "test"))


def fly(
    simulator: Px4Vehicle, px4: ScriptedPx4, seconds: float, motors: list[float], gripper: float = 0.0
) -> list[Any]:
    """Lock-step with constant outputs; all messages the simulator sent."""
    received = []
    for _ in range(round(seconds * 250)):
        received += px4.read(simulator.advance())
        simulator.receive(px4.outputs(simulator.time_us, motors, gripper))
    return received


def of(messages: list[Any], kind: str) -> list[Any]:
    return [message for message in messages if message.get_type() == kind]


# ------------------------------------------------------------------------------------- bounds


@pytest.mark.parametrize("height_m", [12_000.0, 50_000.0, 900_000.0])
def test_a_vehicle_that_climbs_away_still_has_sensors(height_m: float) -> None:
    simulator, rigid = hil(), np.zeros(12)
    rigid[2] = height_m
    simulator.plant.state = airframe.initial_state(rigid)
    sent = fly(simulator, ScriptedPx4(), 0.4, [1.0] * 4)
    assert of(sent, "HIL_GPS")[-1].alt == pytest.approx(1e3 * (height_m + 488.0), abs=2e3)
    assert of(sent, "HIL_SENSOR")[-1].time_usec == 400_000


@pytest.mark.parametrize(("number", "value"), [(3, math.nan), (0, -2e6), (2, math.inf), (10, 1e7)])
def test_a_state_beyond_all_bounds_is_one_line_with_the_remedy(number: int, value: float) -> None:
    simulator, rigid = hil(), np.zeros(12)
    rigid[number] = value
    simulator.plant.state = airframe.initial_state(rigid)
    with pytest.raises(SimulatorError, match=r"left all bounds \(1e\+06\) at 0\.00 s: .*stop PX4"):
        fly(simulator, ScriptedPx4(), 0.4, [0.0] * 4)


# ------------------------------------------------------------------------------------- sensors


def test_there_is_a_range_finder_only_if_asked_for() -> None:
    assert not of(fly(hil(), ScriptedPx4(), 0.5, [0.0] * 4), "DISTANCE_SENSOR")
    sent = of(fly(hil(backend=RANGE_FINDER), ScriptedPx4(), 2.0, [0.0] * 4), "DISTANCE_SENSOR")
    assert len(sent) == 41
    assert {message.orientation for message in sent} == {mavlink.MAV_SENSOR_ROTATION_PITCH_270}
    distances = [message.current_distance for message in sent]
    assert np.mean(distances) == pytest.approx(20.0, abs=2.0)
    assert np.std(distances) == pytest.approx(2.0, abs=1.0)


def test_the_other_sensors_of_a_seed_do_not_change_before_the_first_distance() -> None:
    plain, more = (
        fly(hil(**sections), ScriptedPx4(), 0.044, [0.0] * 4) for sections in ({}, {"backend": RANGE_FINDER})
    )
    assert [m.zacc for m in of(plain, "HIL_SENSOR")] == [m.zacc for m in of(more, "HIL_SENSOR")]


@pytest.mark.parametrize(
    ("roll_deg", "distance_m"), [(0.0, 5.2), (30.0, 6.004), (80.0, 29.95), (85.0, None), (120.0, None)]
)
def test_the_range_finder_measures_along_the_vehicles_own_axis(
    roll_deg: float, distance_m: float | None
) -> None:
    rigid = np.zeros(12)
    rigid[2], rigid[6] = 5.0, math.radians(roll_deg)
    state = airframe.initial_state(rigid)
    distance = range_finder(Px4SensorNoise(distance=0.0), state, np.random.default_rng(0))
    assert distance == (None if distance_m is None else pytest.approx(distance_m, abs=0.01))


def test_a_range_finder_that_sees_nothing_says_more_than_it_can_measure() -> None:
    simulator = hil(backend=RANGE_FINDER)
    rigid = np.zeros(12)
    rigid[2] = 60.0
    simulator.plant.state = airframe.initial_state(rigid)
    sent = of(fly(simulator, ScriptedPx4(), 0.2, [0.4] * 4), "DISTANCE_SENSOR")
    assert sent
    assert all(message.current_distance > message.max_distance for message in sent)


def test_sensors_come_every_four_milliseconds_and_slow_ones_every_twenty() -> None:
    sent = of(fly(hil(), ScriptedPx4(), 0.4, [0.0] * 4), "HIL_SENSOR")
    assert [message.time_usec for message in sent] == [4000 * (1 + k) for k in range(100)]
    assert all(message.fields_updated & 0x3F == 0x3F and message.id == 0 for message in sent)
    slow = [message.time_usec for message in sent if message.fields_updated == 0x3F | 0x1C0 | 0x1A00]
    assert slow == [20_000 * (1 + k) for k in range(20)]
    assert {message.fields_updated for message in sent} == {0x3F, 0x1BFF}


def test_at_rest_the_sensors_feel_gravity_the_earths_field_and_the_air_of_the_place() -> None:
    sent = of(fly(hil(), ScriptedPx4(), 2.0, [0.0] * 4), "HIL_SENSOR")
    force = np.mean([(m.xacc, m.yacc, m.zacc) for m in sent], axis=0)
    np.testing.assert_allclose(force, [0.0, 0.0, -9.8], atol=0.02)
    slow = [m for m in sent if m.fields_updated & 0x1A00]
    north, east, down = np.mean([(m.xmag, m.ymag, m.zmag) for m in slow], axis=0)
    assert math.degrees(math.atan2(east, north)) == pytest.approx(3.4, abs=0.5)
    assert math.degrees(math.atan2(down, math.hypot(north, east))) == pytest.approx(63.2, abs=0.3)
    assert math.hypot(north, east, down) == pytest.approx(0.4824, abs=0.001)
    assert np.mean([m.abs_pressure for m in slow]) == pytest.approx(955.97, abs=0.02)  # ISA at 488 m
    assert np.mean([m.pressure_alt for m in slow]) == pytest.approx(488.0, abs=0.3)


def test_no_sensor_stands_still_so_px4_never_takes_it_for_dead() -> None:
    sent = of(fly(hil(), ScriptedPx4(), 2.0, [0.0] * 4), "HIL_SENSOR")
    slow = [m for m in sent if m.fields_updated & 0x1A00]
    for values in (
        [(m.xacc, m.yacc, m.zacc) for m in sent],
        [(m.xgyro, m.ygyro, m.zgyro) for m in sent],
        [m.xmag for m in slow],
        [m.abs_pressure for m in slow],
    ):
        assert sum(now == then for then, now in pairwise(values)) <= 2  # a float's last digit


def test_satellite_fixes_come_at_ten_hertz_and_are_a_tenth_of_a_second_late() -> None:
    simulator = hil()
    north = 10.0
    simulator.plant.state = airframe.initial_state(np.array([0.0, 0.0, 50.0, north, -4.0, 0.0, *[0.0] * 6]))
    fixes = of(fly(simulator, ScriptedPx4(), 2.0, [HOVER] * 4), "HIL_GPS")
    assert [m.time_usec for m in fixes] == [200_000 + 100_000 * k for k in range(19)]
    metres = np.array([math.radians(m.lat * 1e-7 - 47.397742) * 6_371_000.0 for m in fixes])
    rows = simulator.plant.truth.rows
    then = [m.time_usec * 1e-6 - 0.1 for m in fixes]
    true = np.interp(then, [row.time_s for row in rows], [row.state[0] for row in rows])
    assert np.mean(metres - true) == pytest.approx(0.0, abs=0.08)  # 0.02 s would be 0.2 m
    # Drag has taken 1.5 % of the speed, on the mean.
    assert np.mean([m.vn for m in fixes]) == pytest.approx(985, abs=5)
    assert np.mean([m.ve for m in fixes]) == pytest.approx(394, abs=5)  # the paper's y is west
    assert np.mean([m.cog for m in fixes]) == pytest.approx(100 * math.degrees(math.atan2(4, 10)), abs=50)
    assert all(m.fix_type == 3 and m.lon > 85_455_940 for m in fixes[3:])


def test_the_true_state_goes_along_in_px4s_axes() -> None:
    simulator = hil()
    euler = [0.1, -0.2, 0.7]  # roll, pitch, yaw of the paper: pitch and yaw change sign
    simulator.plant.state = airframe.initial_state(
        np.array([0.0, 0.0, 20.0, 0.0, 0.0, 1.0, *euler, *[0.0] * 3])
    )
    first = of(fly(simulator, ScriptedPx4(), 0.008, [0.0] * 4), "HIL_STATE_QUATERNION")[0]
    w, x, y, z = first.attitude_quaternion
    assert math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)) == pytest.approx(-0.7, abs=1e-3)
    assert math.asin(2 * (w * y - z * x)) == pytest.approx(0.2, abs=1e-3)
    assert math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)) == pytest.approx(0.1, abs=1e-3)
    assert first.vz == pytest.approx(-92, abs=1)  # falling freely for 8 ms from 1 m/s upwards
    assert first.alt == pytest.approx(508_000, abs=20)


def test_the_same_seed_gives_the_same_bytes_and_another_seed_other_ones() -> None:
    def sent(seed: int) -> list[bytes]:
        simulator = hil(vehicle={"seed": seed})
        return [simulator.advance() for _ in range(60)]

    assert sent(3) == sent(3)
    assert sent(3) != sent(4)


def test_physics_runs_at_a_whole_fraction_of_the_sensor_period() -> None:
    assert [physics_step_us(wanted) for wanted in (5000, 4000, 2500, 2000, 1500, 700)] == [
        4000,
        4000,
        2000,
        2000,
        1000,
        500,
    ]


# -------------------------------------------------------------------------------------- motors


def test_px4s_rotor_parameters_describe_this_airframe() -> None:
    """Thrust and torque as PX4 computes them (ActuatorEffectivenessRotors.cpp) are the plant's."""
    lines = PARAMETERS.read_text(encoding="utf-8").splitlines()
    values = dict(re.findall(r"^param set-default (\w+) (\S+)$", "\n".join(lines), re.MULTILINE))
    body = airframe.AirframeParameters()
    up = np.array([0.0, 0.0, -1.0])
    for rotor in range(4):
        x, y, km = (float(values[f"CA_ROTOR{rotor}_{name}"]) for name in ("PX", "PY", "KM"))
        torque = np.cross([x, y, 0.0], up) - km * up
        thrust = np.zeros(4)
        thrust[rotor] = 1.0
        _, u2, u3, u4 = airframe.wrench(body, thrust).tolist()
        np.testing.assert_allclose(torque, body_to_frd(np.array([body.arm * u2, body.arm * u3, u4])))
    assert float(values["MPC_THR_HOVER"]) == pytest.approx(body.hover_thrust(), abs=0.001)
    assert float(values["THR_MDL_FAC"]) == 0.0


def test_outputs_one_to_four_are_front_left_rear_right() -> None:
    for motors, axis, sign in (
        ([HOVER, HOVER + 0.02, HOVER, HOVER - 0.02], 0, 1.0),  # left stronger: rolls right
        ([HOVER + 0.02, HOVER, HOVER - 0.02, HOVER], 1, 1.0),  # front stronger: nose up in FRD
        ([HOVER - 0.05, HOVER + 0.05, HOVER - 0.05, HOVER + 0.05], 2, 1.0),  # left and right: nose right
    ):
        simulator = hil()
        simulator.plant.state = airframe.initial_state(np.array([0.0, 0.0, 50.0, *[0.0] * 9]))
        last = of(fly(simulator, ScriptedPx4(), 0.3, motors), "HIL_SENSOR")[-1]
        assert sign * (last.xgyro, last.ygyro, last.zgyro)[axis] > 0.05


def test_motors_stand_still_while_px4_is_disarmed_and_where_an_output_is_nan() -> None:
    simulator, px4 = hil(), ScriptedPx4()
    simulator.advance()
    simulator.receive(px4.outputs(simulator.time_us, [1.0] * 4, armed=False))
    simulator.advance()
    assert float(simulator.plant.state.total_thrust) == 0.0
    simulator.receive(px4.outputs(simulator.time_us, [1.0, math.nan, 1.0, 1.0]))
    simulator.advance()
    assert simulator.plant.state.motor_thrust[1] == 0.0
    assert (simulator.plant.state.motor_thrust[[0, 2, 3]] > 1.0).all()


def test_hover_thrust_holds_the_vehicle_and_arming_is_in_the_truth() -> None:
    simulator, px4 = hil(), ScriptedPx4()
    simulator.plant.state = airframe.initial_state(np.array([0.0, 0.0, 50.0, *[0.0] * 9]))
    fly(simulator, px4, 1.0, [HOVER] * 4)
    start = simulator.plant.state.velocity[2]
    fly(simulator, px4, 1.0, [HOVER] * 4)
    assert simulator.plant.state.velocity[2] == pytest.approx(start, abs=0.05)
    assert [event.text for event in simulator.plant.truth.events] == ["armed"]
    rows = simulator.plant.truth.rows
    assert [round(row.time_s, 3) for row in rows[:4]] == [0.0, 0.01, 0.02, 0.03]
    assert rows[-1].armed and not rows[0].armed


# ------------------------------------------------------------------------------------- gripper


def test_the_gripper_follows_changes_of_its_output_only() -> None:
    simulator, px4 = hil(), ScriptedPx4()
    simulator.plant.state = airframe.initial_state(np.array([0.0, 0.0, 50.0, *[0.0] * 9]))
    loads = []
    for output in (1.0, 0.0, 1.0, -1.0, -1.0, 1.0, 0.2, 1.0, -1.0):
        fly(simulator, px4, 0.008, [HOVER] * 4, output)
        loads.append(float(np.asarray(simulator.plant.state.load_mass)))
    # PX4 closes its gripper at power-up, round nothing.
    assert loads == [0.0, 0.0, 0.0, 0.0, 0.0, 5.0, 5.0, 5.0, 0.0]


def test_a_scheduled_load_survives_arming_with_an_open_gripper_and_is_dropped_by_the_firmware() -> None:
    simulator, px4 = (
        hil(payload={"clock": "boot", "schedule": [{"time_s": 0.0, "mass_kg": 3.0}]}),
        ScriptedPx4(),
    )
    fly(simulator, px4, 0.1, [HOVER] * 4, 1.0)
    assert float(np.asarray(simulator.plant.state.load_mass)) == 3.0
    fly(simulator, px4, 0.1, [HOVER] * 4, -1.0)
    assert float(np.asarray(simulator.plant.state.load_mass)) == 0.0


# ------------------------------------------------------------------------------ lock-step, damage


def test_only_outputs_of_the_same_time_answer_a_sensor_frame() -> None:
    simulator, px4 = hil(), ScriptedPx4()
    simulator.advance()
    late = simulator.time_us
    simulator.advance()
    assert not simulator.answered and simulator.lock_step is None
    simulator.receive(px4.outputs(late, [0.5] * 4))
    assert not simulator.answered and simulator.heard_us == late and simulator.lock_step is True
    simulator.receive(px4.outputs(simulator.time_us, [0.5] * 4))
    assert simulator.answered
    simulator.advance()
    assert not simulator.answered


def test_truncated_frames_and_noise_are_skipped_and_counted() -> None:
    simulator, px4 = hil(), ScriptedPx4()
    simulator.advance()
    good = px4.outputs(simulator.time_us, [0.5] * 4)
    flipped = bytearray(good)
    flipped[20] ^= 0xFF
    simulator.receive(b"\x00\x55garbage" + bytes(flipped) + good[:40])
    assert not simulator.answered and not simulator.armed
    simulator.receive(good + good)
    assert simulator.answered and simulator.armed
    assert simulator.bad_bytes > 40


def test_a_frame_in_pieces_is_put_together() -> None:
    simulator, px4 = hil(), ScriptedPx4()
    simulator.advance()
    frame = px4.outputs(simulator.time_us, [0.5] * 4)
    for start in range(0, len(frame), 7):
        assert not simulator.answered
        simulator.receive(frame[start : start + 7])
    assert simulator.answered and simulator.bad_bytes == 0


def test_a_restarted_firmware_finds_the_vehicle_where_it_was_and_time_goes_on() -> None:
    simulator, px4 = hil(), ScriptedPx4()
    fly(simulator, px4, 2.0, [0.6] * 4)
    height = simulator.plant.state.position[2]
    assert height > 1.0
    simulator.receive(px4.outputs(simulator.time_us, [0.6] * 4)[:30])  # cut off in the middle of a frame
    before = simulator.time_us
    simulator.restart()
    assert simulator.plant.state.position[2] == height
    assert not simulator.armed and simulator.lock_step is None
    sent = of(fly(simulator, ScriptedPx4(), 2.0, [0.6] * 4), "HIL_SENSOR")
    assert sent[0].time_usec == before + 4000
    texts = [event.text for event in simulator.plant.truth.events]
    assert texts == ["armed", "firmware restarted", "armed"]
    times = [row.time_s for row in simulator.plant.truth.rows]
    assert times == sorted(set(times))
