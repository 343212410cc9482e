"""ArduPilot's JSON interface, against a firmware that does what libraries/SITL/SIM_JSON.cpp does."""

from __future__ import annotations

import json
import math
import re
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_vehicle.backends.ardupilot_json import (
    ServoPacket,
    encode_answer,
    encode_servo_packet,
    parse_servo_packet,
)
from sim_vehicle.backends.ardupilot_vehicle import ArdupilotVehicle
from sim_vehicle.backends.sensors import ImuSample, Pose
from sim_vehicle.config import build
from sim_vehicle.errors import SimulatorError

RATE_HZ = 400
STEP_US = 2500
STOP = 1000
HOVER = 1398
VECTOR = r"\[(-?[\d.e+-]+), ?(-?[\d.e+-]+), ?(-?[\d.e+-]+)\]"


class FakeFirmware:
    """Sends servo packets and reads the answers as literally as the real one's sscanf does."""

    def __init__(self, vehicle: ArdupilotVehicle, peer: object = "firmware", channels: int = 16) -> None:
        self.vehicle = vehicle
        self.peer = peer
        self.frame_count = 0
        self.time_s = 0.0
        self.pwm = [0] * channels
        self.heard: dict[str, list[float]] = {}

    def packet(self) -> bytes:
        return encode_servo_packet(ServoPacket(RATE_HZ, self.frame_count, tuple(self.pwm)))

    def frame(self) -> None:
        """One packet out, one answer in."""
        answer = self.vehicle.receive([(self.peer, self.packet())])
        assert answer is not None and answer.peer == self.peer
        self.take(answer.data)

    def take(self, data: bytes) -> None:
        text = data.decode("ascii")
        assert text[0] == text[-1] == "\n" and text.count("\n") == 2
        for key, pattern in (
            ("gyro", VECTOR),
            ("accel_body", VECTOR),
            ("position", VECTOR),
            ("velocity", VECTOR),
        ):
            found = re.search(f'"{key}":{pattern}', text)
            assert found, f"Failed to find key {key}"
            self.heard[key] = [float(part) for part in found.groups()]
        self.heard["quaternion"] = json.loads(text)["quaternion"]
        assert re.search(r'"no_time_sync":[01][,}]', text)
        timestamp = float(text.split('"timestamp":')[1].split(",")[0])
        assert 0.0 <= timestamp - self.heard.get("timestamp", [0.0])[0] < 0.1
        self.heard["timestamp"] = [timestamp]
        self.frame_count += 1

    def run(self, seconds: float, pwm: dict[int, int] | None = None) -> None:
        """Fly with outputs by channel (from 1)."""
        for channel, width in (pwm or {}).items():
            self.pwm[channel - 1] = width
        for _ in range(round(seconds * RATE_HZ)):
            self.frame()

    def motors(self, right: int, left: int, front: int, rear: int) -> dict[int, int]:
        """Outputs of ArduCopter's motors 1 to 4 (FRAME_CLASS 1, FRAME_TYPE 0)."""
        return dict(enumerate((right, left, front, rear), start=1))


def vehicle(**sections) -> ArdupilotVehicle:
    backend = {"kind": "ardupilot-json", "accel_noise_m_s2": 0.0, "gyro_noise_rad_s": 0.0}
    backend.update(sections.pop("backend", {}))
    sections.setdefault("vehicle", {"physics_dt_s": STEP_US * 1e-6})
    return ArdupilotVehicle(build({"backend": backend, **sections}, "test"))


def flying(**sections) -> FakeFirmware:
    """In the air, hovering without a controller."""
    firmware = FakeFirmware(vehicle(**sections))
    firmware.run(0.6, {**firmware.motors(STOP, STOP, STOP, STOP), 9: 1500})
    firmware.run(0.7, firmware.motors(1600, 1600, 1600, 1600))
    firmware.run(0.3, firmware.motors(HOVER, HOVER, HOVER, HOVER))
    assert firmware.vehicle.plant.state.rigid[2] > 0.3
    return firmware


# ------------------------------------------------------------------------------------- the wire


@pytest.mark.parametrize(("magic", "channels"), [(18458, 16), (29569, 32)])
def test_servo_packet_is_little_endian_with_rate_count_and_widths(magic, channels):
    widths = [1000 + n for n in range(channels)]
    data = struct.pack(f"<HHI{channels}H", magic, 400, 70000, *widths)
    assert parse_servo_packet(data) == ServoPacket(400, 70000, tuple(widths))


@given(st.integers(0, 65535), st.integers(0, 2**32 - 1), st.sampled_from([16, 32]), st.integers(0, 65535))
def test_servo_packet_there_and_back(rate, count, channels, width):
    packet = ServoPacket(rate, count, (width,) * channels)
    assert parse_servo_packet(encode_servo_packet(packet)) == packet


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "0 bytes are too few"),
        (b"\x1a\x48", "2 bytes are too few"),
        (struct.pack("<HHI16H", 4711, 400, 0, *[0] * 16), "magic 4711 is neither 18458"),
        (struct.pack("<HHI16H", 18458, 400, 0, *[0] * 16)[:-1], "39 bytes where 16 channels take 40"),
        (struct.pack("<HHI16H", 29569, 400, 0, *[0] * 16), "40 bytes where 32 channels take 72"),
    ],
)
def test_what_is_no_servo_packet_is_named(data, reason):
    with pytest.raises(ValueError, match=re.escape(reason)):
        parse_servo_packet(data)


@given(st.binary(max_size=100))
def test_no_datagram_breaks_the_vehicle(data):
    flown = vehicle()
    flown.receive([("x", data)])
    assert flown.plant.time_us <= 90_000


def test_answer_that_is_not_finite_is_refused():
    still = np.zeros(3)
    pose = Pose(still, np.array([0.0, math.nan, 0.0]), np.array([1.0, 0.0, 0.0, 0.0]))
    with pytest.raises(ValueError):
        encode_answer(1.0, ImuSample(still, still), pose, False)


def test_on_the_ground_the_firmware_feels_its_weight_and_nothing_else():
    firmware = FakeFirmware(vehicle())
    firmware.run(0.1)
    assert firmware.heard["accel_body"] == pytest.approx([0.0, 0.0, -9.8])
    assert firmware.heard["position"] == firmware.heard["velocity"] == [0.0, 0.0, 0.0]
    assert firmware.heard["quaternion"] == [1.0, 0.0, 0.0, 0.0]
    assert firmware.heard["timestamp"] == pytest.approx([0.1])


# --------------------------------------------------------------------------------------- motors


@pytest.mark.parametrize(
    ("right", "left", "front", "rear", "axis", "sign"),
    [
        (-40, 40, 0, 0, 0, +1),  # left up: rolls to the right
        (0, 0, 40, -40, 1, +1),  # front up: nose up
        (40, 40, -40, -40, 2, +1),  # right and left turn counter-clockwise: nose to the right
    ],
)
def test_outputs_turn_the_vehicle_as_arducopter_means_it(right, left, front, rear, axis, sign):
    firmware = flying()
    firmware.run(0.1, firmware.motors(HOVER + right, HOVER + left, HOVER + front, HOVER + rear))
    gyro = firmware.heard["gyro"]
    assert sign * gyro[axis] > 0.02
    assert all(abs(rate) < 1e-6 for n, rate in enumerate(gyro) if n != axis)


def test_pulse_widths_of_the_configured_range_are_thrust_from_nothing_to_all():
    firmware = FakeFirmware(
        vehicle(backend={"ardupilot_json": {"motor_pwm_min_us": 1100, "motor_pwm_max_us": 1900}})
    )
    for width, share in ((0, 0.0), (1100, 0.0), (1500, 0.5), (1900, 1.0), (2100, 1.0)):
        firmware.run(1.0, firmware.motors(width, width, width, width))
        assert float(firmware.vehicle.plant.state.total_thrust) == pytest.approx(share * 246.0, abs=1e-3)


def test_thrust_above_weight_lifts_off_and_the_truth_says_when_the_motors_turned():
    firmware = flying()
    assert firmware.heard["position"][2] == pytest.approx(-firmware.vehicle.plant.state.rigid[2])
    truth = firmware.vehicle.plant.truth
    assert truth.time_of("motors on") == pytest.approx(0.6)
    assert [row.armed for row in truth.rows if row.time_s > 0.61] == [True] * sum(
        r.time_s > 0.61 for r in truth.rows
    )
    firmware.run(0.05, firmware.motors(STOP, STOP, STOP, STOP))
    assert not firmware.vehicle.armed
    assert truth.events[-1].text == "motors off"


# ------------------------------------------------------------------------------ time and packets


@pytest.mark.parametrize(
    ("frame_rate", "step_us"), [(1200, 1250), (800, 1250), (400, 2500), (50, 20000), (1, 90000), (0, 1250)]
)
def test_time_goes_on_by_the_firmwares_frame_in_whole_steps(frame_rate, step_us):
    flown = vehicle(vehicle={})
    answer = flown.receive([("firmware", encode_servo_packet(ServoPacket(frame_rate, 0, (0,) * 16)))])
    assert flown.plant.time_us == answer.time_us == step_us


def test_a_packet_that_comes_again_gets_the_same_answer_and_moves_nothing():
    firmware = flying()
    packet = firmware.packet()
    first = firmware.vehicle.receive([("firmware", packet)])
    again = firmware.vehicle.receive([("firmware", packet)])
    assert again == first
    assert firmware.vehicle.plant.time_us == first.time_us
    assert firmware.vehicle.counters.repeated == 1


def test_packets_that_piled_up_get_one_answer_to_the_newest():
    firmware = flying()
    old = firmware.packet()
    firmware.frame_count += 1
    before = firmware.vehicle.plant.time_us
    answer = firmware.vehicle.receive([("firmware", old), ("firmware", old), ("firmware", firmware.packet())])
    assert answer.time_us == before + STEP_US
    firmware.take(answer.data)
    firmware.run(0.1)
    assert firmware.vehicle.counters.restarts == 0


def test_an_older_packet_that_comes_late_is_no_restart_and_hides_no_newer_one():
    firmware = flying()
    old = firmware.packet()
    firmware.frame()
    before = firmware.vehicle.plant.time_us
    newest = firmware.packet()
    firmware.take(firmware.vehicle.receive([("firmware", newest), ("firmware", old)]).data)
    assert firmware.vehicle.plant.time_us == before + STEP_US
    assert firmware.vehicle.receive([("firmware", old)]) is None
    firmware.run(0.1)
    assert firmware.vehicle.counters.restarts == 0


def test_a_count_that_jumps_ahead_is_one_frame():
    firmware = flying()
    before = firmware.vehicle.plant.time_us
    firmware.frame_count += 1000
    firmware.frame()
    assert firmware.vehicle.plant.time_us == before + STEP_US


def test_motor_outputs_that_the_firmware_does_not_drive_are_named_once():
    section = {"ardupilot_json": {"motor_channels": [3, 2, 4, 5]}}
    firmware = FakeFirmware(vehicle(backend=section))
    firmware.vehicle.notices.clear()
    firmware.run(4.9, dict.fromkeys((1, 2, 3, 4), 1500))
    assert not any("no pulses" in line for line in firmware.vehicle.notices)
    firmware.run(1.0)
    (line,) = [line for line in firmware.vehicle.notices if "no pulses" in line]
    assert "no pulses at output 5 of backend.ardupilot_json.motor_channels" in line
    assert "drives 1, 2, 3, 4; give the outputs of its SERVOn_FUNCTION 35, 34, 36, 33" in line
    quiet = flying()
    quiet.run(6.0)
    assert not any("no pulses" in line for line in quiet.vehicle.notices)


def test_bad_packets_are_ignored_counted_and_named_once_for_each_sender():
    firmware = flying()
    before = firmware.vehicle.plant.time_us
    firmware.vehicle.notices.clear()
    for _ in range(3):
        assert firmware.vehicle.receive([((0, ("127.0.0.1", 5000)), b"hello")]) is None
    assert firmware.vehicle.plant.time_us == before
    assert firmware.vehicle.counters.bad == 3
    (line,) = firmware.vehicle.notices
    assert line.startswith("ardupilot-json: packet from 127.0.0.1:5000 ignored: 5 bytes are too few")
    firmware.run(0.1)


@pytest.mark.parametrize("new_peer", ["firmware", "another port"])
def test_a_restarted_firmware_finds_the_vehicle_where_it_was_and_its_own_time_at_zero(new_peer):
    firmware = flying()
    height, now = firmware.vehicle.plant.state.rigid[2], firmware.vehicle.plant.time_us
    successor = FakeFirmware(firmware.vehicle, new_peer)
    successor.frame()
    assert successor.heard["timestamp"] == [0.0025]
    assert successor.heard["position"][2] == pytest.approx(-height, abs=0.01)
    assert firmware.vehicle.plant.time_us == now + STEP_US
    assert firmware.vehicle.plant.truth.time_of("firmware restarted") == pytest.approx(now * 1e-6)
    assert "firmware restarted at" in firmware.vehicle.notices[-1]
    successor.run(3.0)
    assert successor.heard["position"][2] == 0.0  # nobody drove the motors: it came down
    assert firmware.vehicle.counters.restarts == 1


def test_a_firmware_that_was_replaced_is_not_answered_any_more():
    first = flying()
    second = FakeFirmware(first.vehicle, "second")
    second.frame()
    assert first.vehicle.receive([("firmware", first.packet())]) is None
    assert first.vehicle.notices[-1].endswith("another firmware has taken over; stop one of them")
    second.run(0.1)
    assert first.vehicle.counters.restarts == 1


def test_of_three_firmwares_at_one_port_the_newest_flies_and_the_others_do_not_take_turns():
    first = flying()
    second, third = (FakeFirmware(first.vehicle, name) for name in ("second", "third"))
    second.frame()
    third.frame()
    for _ in range(3):
        assert first.vehicle.receive([("firmware", first.packet()), ("second", second.packet())]) is None
        third.frame()
    assert first.vehicle.counters.restarts == 2


def test_physics_that_comes_late_takes_the_count_as_it_is():
    firmware = FakeFirmware(vehicle())
    firmware.frame_count = 12345
    firmware.run(0.1)
    assert firmware.vehicle.counters.restarts == 0


def test_an_output_beyond_the_firmwares_channels_is_an_error_with_the_remedy():
    section = {"ardupilot_json": {"gripper_channel": 20}}
    FakeFirmware(vehicle(backend=section), channels=32).frame()
    with pytest.raises(
        SimulatorError, match="output 20 is configured and the firmware sends 16; set its SERVO_32_"
    ):
        FakeFirmware(vehicle(backend=section)).frame()


def test_a_state_that_is_not_finite_is_an_error_and_not_an_answer():
    firmware = flying()
    firmware.vehicle.plant.state.rigid[3] = math.nan
    with pytest.raises(SimulatorError, match="not finite any more at"):
        firmware.frame()


def test_physics_too_slow_for_arming_is_said_at_connection():
    slow = FakeFirmware(vehicle())
    slow.frame()
    assert "physics at 400 Hz" in slow.vehicle.notices[0]
    assert slow.vehicle.notices[1].endswith("arms from 720 Hz on; set vehicle.physics_dt_s = 0.00125")
    fast = FakeFirmware(vehicle(vehicle={}))
    fast.frame()
    assert len(fast.vehicle.notices) == 1


def test_the_same_packets_give_the_same_bytes():
    def flight() -> list[bytes]:
        flown = vehicle(
            backend={"accel_noise_m_s2": 0.1, "gyro_noise_rad_s": 0.01}, wind={"gust_std_m_s": 1.0}
        )
        packets = [ServoPacket(400, n, (1450,) * 16) for n in range(200)]
        answers = [flown.receive([("firmware", encode_servo_packet(packet))]) for packet in packets]
        return [answer.data for answer in answers if answer is not None]

    assert flight() == flight()


# -------------------------------------------------------------------------------------- the load


def test_the_gripper_output_picks_up_and_drops_the_configured_load():
    firmware = flying(payload={"gripper_mass_kg": 2.0})
    firmware.run(0.05, {9: 1900})
    assert firmware.vehicle.plant.state.load_mass == 2.0
    firmware.run(0.05, {9: 1500})
    assert firmware.vehicle.plant.state.load_mass == 2.0
    firmware.run(0.05, {9: 1100})
    assert firmware.vehicle.plant.state.load_mass == 0.0
    events = [event.text for event in firmware.vehicle.plant.truth.events]
    assert events[-2:] == ["pick-up 2 kg", "drop 2 kg"]


@pytest.mark.parametrize("parked", [1100, 1500, 1900])
def test_where_the_firmware_parks_the_gripper_at_boot_is_no_command(parked):
    firmware = FakeFirmware(vehicle())
    firmware.run(0.2, {9: 0})
    firmware.run(0.2, {9: 1000})
    firmware.run(1.0, {9: parked})
    assert firmware.vehicle.plant.state.load_mass == 0.0
    assert firmware.vehicle.plant.truth.events == []


def test_a_restart_neither_grabs_nor_drops():
    firmware = flying()
    firmware.run(0.1, {9: 1900})
    successor = FakeFirmware(firmware.vehicle, "again")
    successor.run(1.0, {9: 1100})
    assert firmware.vehicle.plant.state.load_mass == 5.0
    successor.run(0.1, {9: 1500})
    successor.run(0.1, {9: 1100})
    assert firmware.vehicle.plant.state.load_mass == 0.0


def test_the_schedule_works_under_real_firmware_too():
    firmware = flying(payload={"schedule": [{"time_s": 0.5, "mass_kg": 3.0}]})
    firmware.run(0.5)
    assert firmware.vehicle.plant.state.load_mass == 3.0
    assert firmware.vehicle.plant.truth.time_of("pick-up 3 kg") is not None


def test_without_a_gripper_channel_no_output_moves_the_load():
    firmware = flying(backend={"ardupilot_json": {"gripper_channel": 0}})
    firmware.run(1.0, dict.fromkeys(range(5, 17), 1900))
    assert firmware.vehicle.plant.state.load_mass == 0.0
