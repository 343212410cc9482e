"""What the service manager hears, on a socket of our own."""

import os
import socket

import pytest

from kffa_offboard.process.notify import ServiceManager


@pytest.fixture
def manager(tmp_path):
    """A listening manager, and the environment that it gives to its service."""
    path = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(path)
        listener.setblocking(False)
        yield listener, {"NOTIFY_SOCKET": path, "WATCHDOG_USEC": "3000000", "WATCHDOG_PID": str(os.getpid())}


def heard(listener):
    texts = []
    while True:
        try:
            texts.append(listener.recv(4096).decode())
        except BlockingIOError:
            return texts


def test_ready_status_and_stopping_are_datagrams_of_the_protocol(manager):
    listener, environment = manager
    daemon = ServiceManager(environment)
    daemon.ready()
    daemon.status("engaged,\npx4")
    daemon.status("engaged,\npx4")
    daemon.stopping()
    assert heard(listener) == ["READY=1", "STATUS=engaged, px4", "STOPPING=1"]


def test_the_watchdog_is_fed_three_times_in_its_timeout_and_only_by_turns_of_the_loop(manager):
    listener, environment = manager
    daemon = ServiceManager(environment)
    for now_us in range(0, 3_000_000, 10_000):
        daemon.turned(now_us)
    assert heard(listener) == ["WATCHDOG=1"] * 3


@pytest.mark.parametrize("change", [{"WATCHDOG_USEC": ""}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_PID": "1"}])
def test_nobody_is_pinged_who_does_not_wait_for_us(manager, change):
    listener, environment = manager
    daemon = ServiceManager({**environment, **change})
    daemon.turned(0)
    assert heard(listener) == []


def test_an_abstract_socket_is_understood():
    name = f"kffa-offboard-test-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(f"\0{name}")
        listener.setblocking(False)
        ServiceManager({"NOTIFY_SOCKET": f"@{name}"}).ready()
        assert heard(listener) == ["READY=1"]


def test_without_a_manager_or_with_one_that_is_gone_nothing_happens(tmp_path):
    for environment in ({}, {"NOTIFY_SOCKET": str(tmp_path / "gone"), "WATCHDOG_USEC": "1000000"}):
        daemon = ServiceManager(environment)
        daemon.ready()
        daemon.turned(0)
        daemon.close()
        daemon.close()
        daemon.stopping()


def test_what_did_not_get_through_to_a_manager_that_did_not_read_is_said_again(manager):
    """Without READY=1 it would take the daemon for one that did not start, and end it."""
    listener, environment = manager
    daemon = ServiceManager(environment)
    for n in range(5000):
        daemon.status(str(n))
    daemon.ready()
    daemon.turned(0)
    daemon.status("engaged")
    assert "READY=1" not in heard(listener)
    daemon.turned(10_000)
    daemon.status("engaged")
    daemon.status("engaged")
    assert heard(listener) == ["READY=1", "WATCHDOG=1", "STATUS=engaged"]


def test_a_manager_that_does_not_read_does_not_make_us_wait(manager):
    _, environment = manager
    daemon = ServiceManager(environment)
    for n in range(5000):
        daemon.status(str(n))
