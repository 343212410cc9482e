"""Lock-step over real UDP and TCP sockets on loopback: the TIMESYNC barrier."""

from __future__ import annotations

import socket
import threading

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle.config import build
from sim_vehicle.endpoints import parse_endpoint
from sim_vehicle.errors import SimulatorError
from sim_vehicle.links import Links
from sim_vehicle.server import run_lockstep
from sim_vehicle.vehicle import SimulatedVehicle

HOVER = 0.3984


class Controller(threading.Thread):
    """A scripted controller: streams setpoints, engages at 0.3 s, keeps all bytes that it received."""

    def __init__(
        self, answers: int | None = None, port: int | None = None, own_port: int = 0, offset_ns: int = 0
    ) -> None:
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", own_port))
        self.offset_ns = offset_ns
        self.socket.settimeout(0.2)
        self.answers = answers
        self.vehicle_port = port
        self.codec = mavlink.MAVLink(file=None, srcSystem=245, srcComponent=191)
        self.codec.robust_parsing = True
        self.received = b""
        self.clock: list[int] = []
        self.ended = threading.Event()

    @property
    def url(self) -> str:
        return f"udpout:127.0.0.1:{self.socket.getsockname()[1]}"

    def pack(self, message) -> bytes:
        frame = bytes(message.pack(self.codec))
        self.codec.seq = (self.codec.seq + 1) % 256
        return frame

    def run(self) -> None:
        if self.vehicle_port is not None:
            heartbeat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)
            self.socket.sendto(self.pack(heartbeat), ("127.0.0.1", self.vehicle_port))
        while not self.ended.is_set():
            try:
                data, vehicle = self.socket.recvfrom(65536)
            except TimeoutError:
                continue
            for message in self.codec.parse_buffer(data) or []:
                if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                    self.answer(message.ts1, vehicle)
                else:
                    self.received += bytes(message.get_msgbuf())
        self.socket.close()

    def answer(self, time_ns: int, vehicle) -> None:
        if self.clock and time_ns == self.clock[-1]:
            return  # a repeated request
        if self.answers is not None and len(self.clock) >= self.answers:
            return
        self.clock.append(time_ns)
        target = mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 128, [1, 0, 0, 0], 0.1, 0, 0, HOVER)
        frames = self.pack(target)
        if time_ns == 300_000_000:
            mode = (mavlink.MAV_CMD_DO_SET_MODE, 0, 1, 6, 0, 0, 0, 0, 0)
            arm = (mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
            for command in (mode, arm):
                frames += self.pack(mavlink.MAVLink_command_long_message(1, 1, *command))
        self.socket.sendto(frames, vehicle)
        reply = mavlink.MAVLink_timesync_message(time_ns + 1, time_ns + self.offset_ns)
        self.socket.sendto(self.pack(reply), vehicle)

    def stop(self) -> None:
        self.ended.set()
        self.join(5.0)


def configuration(url: str, **lockstep):
    sections = {
        "vehicle": {"position_ready_s": 0.1, "attitude_ready_s": 0.1},
        "link": {"endpoints": [url]},
        "lockstep": {"enabled": True, **lockstep},
    }
    return build(sections, "test")


def fly(seconds: float, delay_s: float = 0.0) -> tuple[Controller, SimulatedVehicle]:
    controller = Controller()
    vehicle = SimulatedVehicle(configuration(controller.url))
    with Links([parse_endpoint(controller.url, False)]) as links:
        threading.Timer(delay_s, controller.start).start()
        run_lockstep(vehicle, links, seconds)
    controller.stop()
    return controller, vehicle


def test_time_goes_on_period_by_period_with_the_controllers_answers():
    controller, vehicle = fly(1.0)
    assert vehicle.time_us == 1_000_000
    assert controller.clock == [10_000_000 * n for n in range(101)]
    assert vehicle.firmware.mode_name == "OFFBOARD"
    assert vehicle.firmware.armed


def test_a_command_given_at_a_barrier_acts_exactly_one_link_delay_later():
    _, vehicle = fly(0.5)
    # 20 ms of link and 20 ms of PX4's commander after 0.300 s; noted at the end of that step
    assert vehicle.truth.time_of("armed") == pytest.approx(0.3425, abs=1e-9)


def test_two_runs_over_udp_give_the_same_bytes():
    """Also if one controller was slow at the start, so that the first request was repeated."""
    (first, one), (second, two) = fly(1.0), fly(1.0, delay_s=0.5)
    assert len(first.received) > 5000
    assert first.received == second.received
    assert one.truth.rows == two.truth.rows


def test_a_vehicle_that_waits_for_calls_takes_the_first_caller_as_controller():
    settings = configuration("udpin:127.0.0.1:0")
    vehicle = SimulatedVehicle(settings)
    with Links([parse_endpoint("udpin:127.0.0.1:0", False)]) as links:
        controller = Controller(port=int(links.addresses[0].rsplit(":", 1)[1]))
        controller.start()
        run_lockstep(vehicle, links, 0.5)
    controller.stop()
    assert controller.clock[-1] == 500_000_000


def test_a_controller_that_stops_answering_is_an_error_with_the_time_in_it():
    controller = Controller(answers=20)
    vehicle = SimulatedVehicle(configuration(controller.url, answer_timeout_s=0.3))
    with Links([parse_endpoint(controller.url, False)]) as links:
        controller.start()
        with pytest.raises(SimulatorError, match=r"stopped answering TIMESYNC at 0\.20 s .* for 0\.3 s"):
            run_lockstep(vehicle, links, 5.0)
    controller.stop()


@pytest.mark.parametrize(("url", "text"), [("udpout", "never answered"), ("udpin", "nobody called")])
def test_no_controller_at_all_is_an_error(url, text):
    silent = Controller()
    address = silent.url if url == "udpout" else "udpin:127.0.0.1:0"
    vehicle = SimulatedVehicle(configuration(address, connect_timeout_s=0.3))
    with Links([parse_endpoint(address, False)]) as links, pytest.raises(SimulatorError, match=text):
        run_lockstep(vehicle, links, 5.0)
    silent.socket.close()


def test_a_controller_that_comes_late_finds_the_first_request_repeated():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as reserved:
        reserved.bind(("127.0.0.1", 0))
        port = reserved.getsockname()[1]
    came: list[Controller] = []

    def come() -> None:
        came.append(Controller(own_port=port))
        came[0].start()

    url = f"udpout:127.0.0.1:{port}"
    vehicle = SimulatedVehicle(configuration(url, connect_timeout_s=5.0))
    with Links([parse_endpoint(url, False)]) as links:
        threading.Timer(0.3, come).start()
        run_lockstep(vehicle, links, 0.2)
    came[0].stop()
    assert came[0].clock[0] == 0
    assert came[0].clock[-1] == 200_000_000


def test_an_answer_with_another_time_does_not_count():
    controller = Controller(offset_ns=1)
    vehicle = SimulatedVehicle(configuration(controller.url, connect_timeout_s=0.5))
    with Links([parse_endpoint(controller.url, False)]) as links:
        controller.start()
        with pytest.raises(SimulatorError, match="never answered"):
            run_lockstep(vehicle, links, 1.0)
    controller.stop()
    assert vehicle.time_us == 0
