"""Real time over loopback sockets: UDP and TCP, several peers, busy ports."""

from __future__ import annotations

import socket
import threading
import time

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle.config import build
from sim_vehicle.endpoints import parse_endpoint
from sim_vehicle.errors import SimulatorError
from sim_vehicle.links import Links
from sim_vehicle.server import run_real_time
from sim_vehicle.vehicle import SimulatedVehicle

SECONDS = 0.6


def links_of(*urls: str) -> Links:
    return Links([parse_endpoint(url, False) for url in urls])


def port_of(links: Links, index: int = 0) -> int:
    return int(links.addresses[index].rsplit(":", 1)[1])


def request() -> bytes:
    codec = mavlink.MAVLink(file=None, srcSystem=255, srcComponent=190)
    number = mavlink.MAV_CMD_REQUEST_MESSAGE
    wanted = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    message = mavlink.MAVLink_command_long_message(1, 1, number, 0, wanted, 0, 0, 0, 0, 0, 0)
    return bytes(message.pack(codec))


def kinds_in(data: bytes) -> set[str]:
    codec = mavlink.MAVLink(file=None)
    codec.robust_parsing = True
    return {message.get_type() for message in codec.parse_buffer(data) or []}


def drain(receiver: socket.socket) -> bytes:
    """Everything that waits in a socket."""
    receiver.setblocking(False)
    data = b""
    while True:
        try:
            piece = receiver.recv(65536)
        except BlockingIOError:
            return data
        if not piece:
            return data
        data += piece


def flying(links: Links, seconds: float = SECONDS) -> tuple[SimulatedVehicle, threading.Thread]:
    vehicle = SimulatedVehicle(build({}, "test"))
    thread = threading.Thread(target=run_real_time, args=(vehicle, links, seconds), daemon=True)
    thread.start()
    return vehicle, thread


def test_simulated_time_follows_the_wall_clock():
    with links_of("udpin:127.0.0.1:0") as links:
        began = time.monotonic()
        vehicle, thread = flying(links)
        thread.join(20.0)
        assert vehicle.time_us == round(SECONDS * 1e6)
        assert time.monotonic() - began >= SECONDS - 0.01


def test_a_listener_on_udpout_hears_telemetry_without_having_said_anything():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        with links_of(f"udpout:127.0.0.1:{listener.getsockname()[1]}") as links:
            flying(links)[1].join(20.0)
        assert "ATTITUDE" in kinds_in(drain(listener))


@pytest.mark.parametrize("scheme", ["udpin", "tcpin"])
def test_a_client_that_calls_is_answered(scheme):
    kind = socket.SOCK_DGRAM if scheme == "udpin" else socket.SOCK_STREAM
    with links_of(f"{scheme}:127.0.0.1:0") as links, socket.socket(socket.AF_INET, kind) as client:
        client.connect(("127.0.0.1", port_of(links)))
        _, thread = flying(links)
        client.sendall(request())
        thread.join(20.0)
        assert {"AUTOPILOT_VERSION", "COMMAND_ACK", "ATTITUDE"} <= kinds_in(drain(client))


def test_two_links_are_served_at_once():
    with (
        links_of("udpin:127.0.0.1:0", "tcpin:127.0.0.1:0") as links,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as over_udp,
        socket.socket(socket.AF_INET, socket.SOCK_STREAM) as over_tcp,
    ):
        over_udp.connect(("127.0.0.1", port_of(links)))
        over_tcp.connect(("127.0.0.1", port_of(links, 1)))
        _, thread = flying(links)
        over_udp.sendall(request())
        thread.join(20.0)
        assert "AUTOPILOT_VERSION" in kinds_in(drain(over_udp))
        assert "ATTITUDE" in kinds_in(drain(over_tcp))


def test_a_tcp_client_that_leaves_does_not_disturb_the_flight():
    with links_of("tcpin:127.0.0.1:0") as links:
        client = socket.create_connection(("127.0.0.1", port_of(links)))
        vehicle, thread = flying(links)
        client.sendall(request())
        client.close()
        thread.join(20.0)
        assert vehicle.time_us == round(SECONDS * 1e6)
        assert links.peers() == []


@pytest.mark.parametrize("scheme", ["udpin", "tcpin"])
def test_a_busy_port_is_named_in_one_line(scheme):
    with links_of(f"{scheme}:127.0.0.1:0") as links:
        port = port_of(links)
        with pytest.raises(SimulatorError, match=f"{scheme}:127.0.0.1:{port}: port {port} is in use; "):
            links_of(f"{scheme}:127.0.0.1:{port}")


def test_a_tcp_server_that_is_not_there_is_named():
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as reserved:
        reserved.bind(("127.0.0.1", 0))
        port = reserved.getsockname()[1]
        with pytest.raises(SimulatorError, match="nothing listens"):
            links_of(f"tcp:127.0.0.1:{port}")
