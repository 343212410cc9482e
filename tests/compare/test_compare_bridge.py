"""The bridge between firmware, physics and daemon: who waits for whom, and how late a frame arrives."""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Iterator

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.bridge import Bridge, bridge
from kffa_offboard.compare.idle import Threads
from kffa_offboard.mavlink.component import Component, FrameParser, Message, Route
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.trials.processes import process

DELAY_S, PERIOD_US = 0.008, 4000
FIRMWARE = Component(Route(own_system=7, own_component=1))
DAEMON = Component(Route())


def udp() -> socket.socket:
    end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    end.bind(("127.0.0.1", 0))
    end.settimeout(5.0)
    return end


class Ends:
    """Firmware, physics and daemon, played by the test."""

    def __init__(self, link: Bridge) -> None:
        self.link = link
        self.firmware, self.physics, self.daemon = udp(), udp(), udp()
        self.time_us = 0

    def close(self) -> None:
        for end in (self.firmware, self.physics, self.daemon):
            end.close()

    def say(self, message: Message) -> None:
        self.firmware.sendto(FIRMWARE.pack(message), ("127.0.0.1", self.link.firmware_port))

    def command(self, message: Message) -> None:
        self.daemon.sendto(DAEMON.pack(message), ("127.0.0.1", self.link.daemon_port))

    def come_to_barrier(self) -> None:
        self.time_us += PERIOD_US
        self.physics.sendto(struct.pack("<Q", self.time_us), ("127.0.0.1", self.link.physics_port))

    def let_go(self) -> bool:
        self.physics.settimeout(5.0)
        return struct.unpack("<Q", self.physics.recv(64))[0] == self.time_us

    def turn(self) -> list[Message]:
        """What the daemon hears up to its barrier, which it answers."""
        heard: list[Message] = []
        while True:
            data = self.daemon.recv(65535)
            for message in FrameParser(keeps_frames_whole=True).parse(Datagram(0, data, None)):
                if message.get_type() == "TIMESYNC":
                    assert message.get_srcSystem() == 7
                    assert message.ts1 == self.time_us * 1000
                    self.command(mavlink.MAVLink_timesync_message(message.ts1, message.ts1))
                    return heard
                heard.append(message)


@pytest.fixture
def ends() -> Iterator[Ends]:
    with bridge(target_system=7, delay_s=DELAY_S) as link:
        found = Ends(link)
        yield found
        found.close()


def heartbeat() -> Message:
    return mavlink.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)


def attitude(number: int) -> Message:
    return mavlink.MAVLink_attitude_message(number, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_time_goes_on_at_once_while_there_is_no_daemon(ends: Ends) -> None:
    for _ in range(3):
        ends.come_to_barrier()
        assert ends.let_go()


def test_time_stands_still_until_the_daemon_has_answered(ends: Ends) -> None:
    ends.command(heartbeat())
    ends.come_to_barrier()
    ends.physics.settimeout(0.2)
    with pytest.raises(TimeoutError):
        ends.physics.recv(64)
    assert ends.turn() == []
    assert ends.let_go()


def test_telemetry_arrives_after_the_links_delay_in_simulated_time(ends: Ends) -> None:
    ends.command(heartbeat())
    ends.say(attitude(1))
    heard = []
    for _ in range(4):
        ends.come_to_barrier()
        heard.append(len(ends.turn()))
        assert ends.let_go()
    assert heard == [0, 0, 1, 0]


def test_a_command_arrives_after_the_links_delay_in_simulated_time(ends: Ends) -> None:
    ends.say(heartbeat())  # the bridge learns where the firmware is
    ends.command(heartbeat())
    ends.come_to_barrier()
    ends.turn()
    assert ends.let_go()
    ends.come_to_barrier()
    ends.command(attitude(2))
    ends.turn()
    assert ends.let_go()
    ends.firmware.settimeout(0.1)
    arrived = []
    for _ in range(3):
        ends.come_to_barrier()
        ends.turn()
        assert ends.let_go()
        try:
            arrived.append(len(ends.firmware.recv(65535)) > 0)
        except TimeoutError:
            arrived.append(False)
    assert arrived == [False, True, False]


@pytest.mark.skipif(not Threads.can_be_seen(), reason="this system has no /proc with schedstat")
def test_time_stands_still_while_a_thread_of_the_firmware_is_busy(ends: Ends) -> None:
    with process([sys.executable, "-c", "while True: pass"]) as child:
        ends.link.watch(child.pid)
        ends.come_to_barrier()
        ends.physics.settimeout(0.5)
        with pytest.raises(TimeoutError):
            ends.physics.recv(64)
        child.kill()
        child.wait()
        assert ends.let_go()


def test_the_firmwares_own_timesync_is_no_barrier(ends: Ends) -> None:
    ends.command(heartbeat())
    ends.say(mavlink.MAVLink_timesync_message(0, 123))
    for _ in range(4):
        ends.come_to_barrier()
        assert ends.turn() == []
        assert ends.let_go()


def test_nobody_waits_for_a_daemon_that_has_ended(ends: Ends) -> None:
    ends.command(heartbeat())
    ends.come_to_barrier()
    ends.link.let_go()
    assert ends.let_go()
    ends.come_to_barrier()
    assert ends.let_go()


def test_the_next_daemon_is_waited_for_again(ends: Ends) -> None:
    ends.command(heartbeat())
    ends.come_to_barrier()
    assert ends.turn() == []
    assert ends.let_go()
    ends.link.let_go()
    ends.command(heartbeat())  # last words of the first daemon
    ends.link.welcome(7, DELAY_S)
    ends.come_to_barrier()
    assert ends.let_go()
    ends.command(heartbeat())
    ends.come_to_barrier()
    assert ends.turn() == []
    assert ends.let_go()


def test_a_daemon_is_met_at_its_time_and_waited_for() -> None:
    with bridge(target_system=7, delay_s=DELAY_S, meeting_s=2 * PERIOD_US * 1e-6) as link:
        ends = Ends(link)
        ends.command(heartbeat())
        ends.come_to_barrier()
        assert ends.let_go()  # too early: it has no turn
        ends.come_to_barrier()
        assert ends.turn() == []
        assert ends.let_go()
        ends.close()


def test_time_stands_still_until_the_daemon_has_come() -> None:
    with bridge(target_system=7, delay_s=DELAY_S, meeting_s=PERIOD_US * 1e-6) as link:
        ends = Ends(link)
        ends.come_to_barrier()
        ends.physics.settimeout(0.2)
        with pytest.raises(TimeoutError):
            ends.physics.recv(64)
        assert link.time_s == pytest.approx(PERIOD_US * 1e-6)
        ends.command(heartbeat())
        assert ends.turn() == []
        assert ends.let_go()
        ends.close()


def test_time_goes_on_when_the_firmware_says_that_it_has_its_commands() -> None:
    with bridge(target_system=7, delay_s=0.0, answers=True) as link:
        ends = Ends(link)
        ends.say(heartbeat())  # the bridge learns where the firmware is
        ends.command(heartbeat())
        ends.come_to_barrier()
        ends.turn()
        assert ends.let_go()
        ends.come_to_barrier()
        ends.command(attitude(2))
        ends.turn()
        codec = mavlink.MAVLink(file=None, srcSystem=7, srcComponent=1)
        heard: list[Message] = []
        ends.firmware.settimeout(5.0)
        while not heard or heard[-1].get_type() != "TIMESYNC":
            heard += codec.parse_buffer(ends.firmware.recv(65535)) or []
        assert [message.get_type() for message in heard] == ["ATTITUDE", "TIMESYNC"]
        ends.physics.settimeout(0.1)
        with pytest.raises(TimeoutError):
            ends.physics.recv(64)
        ends.say(mavlink.MAVLink_timesync_message(1, heard[-1].ts1))
        assert ends.let_go()
        ends.close()
