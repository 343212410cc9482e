"""UDP links on loopback with a scripted peer. Delivery on loopback is immediate: nothing waits."""

import contextlib
import itertools
import socket

import pytest

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.udp import DATAGRAMS_AT_ONCE


@pytest.fixture
def clock():
    return itertools.count(1000).__next__


@pytest.fixture
def peer():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(5.0)
        yield opened


@pytest.fixture
def listening(clock):
    with contextlib.closing(open_link("udpin:127.0.0.1:0", clock)) as link:
        yield link


def place(link):
    return ("127.0.0.1", int(link.name.rpartition(":")[2]))


def test_the_name_tells_the_port_that_was_really_bound(listening):
    assert listening.name.startswith("udpin:127.0.0.1:")
    assert place(listening)[1] != 0


def test_datagrams_arrive_in_order_each_with_its_arrival_time(listening, peer):
    for data in (b"one", b"two", b"three"):
        peer.sendto(data, place(listening))
    received = listening.receive(5.0)
    assert [datagram.data for datagram in received] == [b"one", b"two", b"three"]
    assert [datagram.time_us for datagram in received] == [1000, 1001, 1002]
    assert {datagram.source for datagram in received} == {peer.getsockname()}


def test_silence_returns_nothing_after_the_timeout(listening):
    assert listening.receive(0.0) == []


def test_a_listening_link_answers_the_sender_it_was_locked_onto(listening, peer):
    assert not listening.send(b"anybody there?")
    peer.sendto(b"hello", place(listening))
    (datagram,) = listening.receive(5.0)
    listening.lock(datagram.source)
    assert listening.send(b"answer")
    assert peer.recv(100) == b"answer"


def test_after_locking_nobody_else_is_heard(listening, peer):
    listening.lock(peer.getsockname())
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for _ in range(5):
            stranger.sendto(b"I am the vehicle", place(listening))
        peer.sendto(b"no, I am", place(listening))
        received = listening.receive(5.0)
    assert [datagram.data for datagram in received if not datagram.stranger] == [b"no, I am"]
    assert [datagram.data for datagram in received if datagram.stranger] == [b"I am the vehicle"]


def test_a_flood_is_read_in_portions_so_that_control_keeps_running(listening, peer):
    for _ in range(DATAGRAMS_AT_ONCE + 10):
        peer.sendto(b"x", place(listening))
    assert len(listening.receive(5.0)) == DATAGRAMS_AT_ONCE
    assert len(listening.receive(5.0)) == 10


def test_a_calling_link_sends_at_once_and_hears_the_one_it_called(clock, peer):
    with contextlib.closing(open_link(f"udpout:127.0.0.1:{peer.getsockname()[1]}", clock)) as link:
        assert link.send(b"hello")
        data, source = peer.recvfrom(100)
        assert data == b"hello"
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(b"stranger", source)
        peer.sendto(b"vehicle", source)
        assert [datagram.data for datagram in link.receive(5.0)] == [b"vehicle"]


def test_calling_a_vehicle_that_is_not_there_yet_is_no_error_but_is_remembered(clock, peer):
    port = peer.getsockname()[1]
    peer.close()
    with contextlib.closing(open_link(f"udpout:127.0.0.1:{port}", clock)) as link:
        link.send(b"hello")
        assert link.receive(5.0) == []  # the refusal ends the wait
        assert link.trouble == "connection refused"
        link.send(b"hello")


def test_a_busy_port_is_explained(clock, listening):
    port = place(listening)[1]
    with pytest.raises(UserError, match=f"port {port} is busy: another program listens there") as info:
        open_link(f"udpin:127.0.0.1:{port}", clock)
    assert "\n" not in str(info.value)


def test_an_address_of_another_machine_is_explained(clock):
    with pytest.raises(UserError, match="not an address of this machine"):
        open_link("udpin:192.0.2.1:14540", clock, allow_remote=True)


def test_closing_twice_is_harmless(clock):
    link = open_link("udpin:127.0.0.1:0", clock)
    port = int(link.name.rpartition(":")[2])
    link.close()
    link.close()
    again = open_link(f"udpin:127.0.0.1:{port}", clock)  # and the port is free again
    assert again.name == link.name
    again.close()
