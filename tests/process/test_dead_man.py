"""A dead man's switch says the last words of a daemon that was killed, and nobody else's."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time

import pytest

from kffa_offboard.process.dead_man import DeadManSwitch
from kffa_offboard.process.dead_man_child import IGNORED, LATE_S

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="needs Linux")

DAEMON = """
import os, signal, socket, sys, time
from kffa_offboard.process.dead_man import DeadManSwitch
{link}
class Words:
    has_control = True
    def posting(self):
        return {posting}
words = Words()
switch = DeadManSwitch(words)
assert switch.take_trouble() is None
{then}
"""
UDP_OUT = 'link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); link.connect(("127.0.0.1", {port}))'
UDP_IN = "link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)"
KILLED = "os.kill(os.getpid(), signal.SIGKILL)"
POSTING = 'link.fileno(), b"\\n level \\n", None'


@pytest.fixture
def vehicle():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as opened:
        opened.bind(("127.0.0.1", 0))
        opened.settimeout(5.0)
        yield opened


def live(link, posting, then):
    """A daemon from its start to its end."""
    code = textwrap.dedent(DAEMON).format(link=link, posting=posting, then=then)
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30.0)


def assert_silent(vehicle):
    """Whatever was sent is there: the daemon's other half ends before its standard streams are closed."""
    vehicle.settimeout(1.0)
    with pytest.raises(TimeoutError):
        vehicle.recv(100)


@pytest.mark.parametrize("end", ["SIGKILL", "SIGSEGV", "SIGABRT"])
def test_a_daemon_that_dies_in_control_has_its_last_words_said(vehicle, end):
    port = vehicle.getsockname()[1]
    run = live(UDP_OUT.format(port=port), POSTING, f"os.kill(os.getpid(), signal.{end})")
    assert run.returncode == -getattr(signal, end)
    assert vehicle.recv(100) == b"\n level \n"


def test_where_the_descriptor_does_not_know_the_way_the_words_do(vehicle):
    port = vehicle.getsockname()[1]
    live(UDP_IN, f'link.fileno(), b"level", ("127.0.0.1", {port})', KILLED)
    assert vehicle.recv(100) == b"level"


def test_a_stream_that_was_opened_anew_is_written_to():
    ours, theirs = socket.socketpair()
    with ours, theirs:
        code = textwrap.dedent(DAEMON).format(
            link=f"link = socket.socket(fileno={theirs.fileno()}); null = open(os.devnull, 'wb')",
            posting='(link if hasattr(self, "again") else null).fileno(), b"level", None',
            then=f"words.again = True; time.sleep(0.15); assert switch.take_trouble() is None; {KILLED}",
        )
        command = [sys.executable, "-c", code]
        subprocess.run(command, pass_fds=(theirs.fileno(),), timeout=30.0, check=False)
        ours.settimeout(5.0)
        assert ours.recv(100) == b"level"


GIVEN_UP = "words.has_control = False; assert switch.take_trouble() is None; "


@pytest.mark.parametrize(
    "then",
    [GIVEN_UP + KILLED, GIVEN_UP + "time.sleep(1.0)", "switch.close()", "switch.close(); " + KILLED],
    ids=["gave control up", "gave control up and hangs", "ended well", "killed after its end"],
)
def test_nothing_is_said_for_a_daemon_that(vehicle, then):
    live(UDP_OUT.format(port=vehicle.getsockname()[1]), POSTING, then)
    assert_silent(vehicle)


@pytest.mark.parametrize("end", ["pass", KILLED], ids=["goes on", "dies"])
def test_a_daemon_that_hangs_has_them_said_once_whatever_becomes_of_it(vehicle, end):
    began = time.monotonic()
    live(UDP_OUT.format(port=vehicle.getsockname()[1]), POSTING, f"time.sleep(4 * {LATE_S}); {end}")
    assert time.monotonic() - began > 4 * LATE_S
    assert vehicle.recv(100) == b"\n level \n"
    assert_silent(vehicle)


def test_a_daemon_that_went_on_after_a_pause_has_its_new_words_said(vehicle):
    again = f"time.sleep(2 * {LATE_S}); assert switch.take_trouble() is None; {KILLED}"
    live(UDP_OUT.format(port=vehicle.getsockname()[1]), POSTING, again)
    assert [vehicle.recv(100), vehicle.recv(100)] == 2 * [b"\n level \n"]


def test_nothing_is_said_where_there_is_nothing_to_say(vehicle):
    live(UDP_OUT.format(port=vehicle.getsockname()[1]), "None", KILLED)
    assert_silent(vehicle)


class Words:
    """Of a daemon in this process."""

    has_control = True

    def __init__(self, link):
        self.asked = 0
        self._link = link

    def posting(self):
        self.asked += 1
        return self._link.fileno(), b"level", None


def test_the_words_are_brought_up_to_date_ten_times_a_second_not_at_every_turn(vehicle):
    words = Words(vehicle)
    switch = DeadManSwitch(words)
    began = time.monotonic()
    while time.monotonic() - began < 0.55:
        assert switch.take_trouble() is None
    switch.close()
    assert 4 <= words.asked <= 7


def test_that_the_switch_is_gone_is_said_once(vehicle):
    words = Words(vehicle)
    switch = DeadManSwitch(words)
    os.kill(switch._process.pid, signal.SIGKILL)
    switch._process.wait(5.0)
    said = []
    for _ in range(3):
        said.append(switch.take_trouble())
        switch._due_s = 0.0
    assert said == ["dead man's switch: broken pipe", None, None]
    switch.close()
    switch.close()


@pytest.fixture
def full(vehicle):
    """A switch whose other process has not run for long, just after control was given up."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(vehicle.getsockname())
        words = Words(link)
        switch = DeadManSwitch(words)
        os.kill(switch._process.pid, signal.SIGSTOP)
        while not switch._full:
            switch._due_s = 0.0
            assert switch.take_trouble() is None
        words.has_control = False
        yield switch
        if switch._process.poll() is None:  # the test failed
            switch._process.kill()
            switch._process.wait()


def test_that_there_is_nothing_more_to_say_is_told_until_it_is_heard(full, vehicle):
    assert full.take_trouble() is None
    assert full._told
    os.kill(full._process.pid, signal.SIGCONT)
    end = time.monotonic() + 5.0
    while full._told and time.monotonic() < end:
        assert full.take_trouble() is None
    assert not full._told
    full.close()
    assert_silent(vehicle)


def test_one_that_cannot_be_told_says_nothing_at_the_end(full, vehicle):
    """Although it runs again while its end is waited for."""

    def run_again():
        with contextlib.suppress(ProcessLookupError):
            os.kill(full._process.pid, signal.SIGCONT)

    again = threading.Timer(0.3, run_again)
    again.start()
    full.close()
    again.join()
    assert_silent(vehicle)


def test_signals_for_the_whole_group_leave_it_alone(vehicle):
    port = vehicle.getsockname()[1]
    everybody = "time.sleep(0.2); " + "; ".join(
        f"os.kill(switch._process.pid, signal.{number.name})" for number in IGNORED
    )
    live(UDP_OUT.format(port=port), POSTING, f"{everybody}; switch.take_trouble(); {KILLED}")
    assert vehicle.recv(100) == b"\n level \n"
