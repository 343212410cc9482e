"""Nothing listens where another machine could reach it, unless a configuration asks for that expressly."""

import contextlib
import ipaddress
import socket
import tomllib
from types import SimpleNamespace

import pytest

from kffa_offboard.config import bundled, load
from kffa_offboard.config_link import LinkTable
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.address import parse_url, resolve
from kffa_offboard.mavlink.link import open_link
from sim_vehicle import config as sim_config
from sim_vehicle.endpoints import is_loopback, parse_endpoint
from sim_vehicle.errors import SimulatorError
from sim_vehicle.links import Links

CONFIGS = sorted(bundled("demo-px4.toml").parent.glob("*.toml"))


def kind_of(path):
    document = tomllib.loads(path.read_text())
    if "random" in document:
        return "other"  # a campaign flies in this process alone
    if "vehicle" in document or "backend" in document:
        return "vehicle"
    return "daemon" if "control" in document and "link" in document else "other"


@pytest.fixture
def bound(monkeypatch):
    """Addresses that sockets of this process were bound to."""
    addresses = []
    bind = socket.socket.bind

    def watching(opened, address):
        bind(opened, address)
        addresses.append(opened.getsockname()[0])

    monkeypatch.setattr(socket, "socket", type("Watched", (socket.socket,), {"bind": watching}))
    return addresses


@pytest.mark.parametrize(
    "path", [path for path in CONFIGS if kind_of(path) == "daemon"], ids=lambda path: path.stem
)
def test_every_daemon_configuration_stays_on_this_machine(path):
    link = load(path).link
    address = parse_url(link.url)
    assert not link.allow_remote
    if getattr(address, "listens", False):
        assert ipaddress.ip_address(resolve(address)[1][0]).is_loopback


@pytest.mark.parametrize(
    "path", [path for path in CONFIGS if kind_of(path) == "vehicle"], ids=lambda path: path.stem
)
def test_every_vehicle_configuration_stays_on_this_machine(path):
    config = sim_config.load(path)
    assert not config.link.allow_remote
    hosts = [parse_endpoint(url, allow_remote=True).host for url in config.link.endpoints]
    hosts += [config.backend.ardupilot_json.host, config.backend.px4_hil.host]
    assert all(is_loopback(host) for host in hosts)


def test_without_a_word_remote_addresses_are_not_allowed():
    assert LinkTable(url="udpin:127.0.0.1:14540").allow_remote is False
    assert sim_config.build({}, "test").link.allow_remote is False
    assert all(
        is_loopback(parse_endpoint(url, allow_remote=True).host)
        for url in sim_config.build({}, "test").link.endpoints
    )


@pytest.mark.parametrize("kind", ["udpin", "tcpin"])
@pytest.mark.parametrize("host", ["0.0.0.0", "[::]", "192.0.2.7"])
def test_both_programs_refuse_to_listen_for_other_machines_without_being_told(kind, host):
    with pytest.raises(UserError, match="allow_remote = true"):
        open_link(f"{kind}:{host}:0", lambda: 0)
    with pytest.raises(SimulatorError, match="allow_remote = true"):
        sim_config.build({"link": {"endpoints": [f"{kind}:{host}:0"]}}, "test")


def test_what_is_opened_is_bound_to_loopback(bound):
    """Also where the program only calls: else anybody could send to its port."""
    with socket.socket() as server, contextlib.ExitStack() as stack:
        socket.socket.bind(server, ("127.0.0.1", 0))
        server.listen()
        place = f"127.0.0.1:{server.getsockname()[1]}"
        for url in ("udpin:127.0.0.1:0", "tcpin:127.0.0.1:0"):
            link = open_link(url, lambda: 0)
            stack.callback(link.close)
        urls = ("udpin:127.0.0.1:0", "tcpin:127.0.0.1:0", f"udpout:{place}", f"tcp:{place}")
        links = stack.enter_context(Links([parse_endpoint(url, allow_remote=False) for url in urls]))
        caller = open_link(f"udpout:{place}", lambda: 0)
        stack.callback(caller.close)
        local = [opened.getsockname()[0] for link in links._links for opened in link.sockets()]
        local.append(caller._socket.getsockname()[0])
    assert len(bound) == 5
    assert set(bound + local) == {"127.0.0.1"}


def test_a_simulated_vehicle_that_calls_hears_only_whom_it_called():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as called, contextlib.ExitStack() as stack:
        called.bind(("127.0.0.1", 0))
        stranger = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        url = f"udpout:127.0.0.1:{called.getsockname()[1]}"
        links = stack.enter_context(Links([parse_endpoint(url, allow_remote=False)]))
        (peer,) = links.peers()
        links.send(peer, b"telemetry")
        _, vehicle = called.recvfrom(100)
        stranger.sendto(b"lies", vehicle)
        called.sendto(b"command", vehicle)
        assert links.receive(5.0) == [(peer, b"command")]


def test_a_called_place_where_nobody_is_does_not_stop_the_vehicle():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
        gone.bind(("127.0.0.1", 0))
        found = SimpleNamespace(port=gone.getsockname()[1])
    with Links([parse_endpoint(f"udpout:127.0.0.1:{found.port}", allow_remote=False)]) as links:
        for _ in range(5):
            links.send(None, b"telemetry")
            assert links.receive(0.01) == []
