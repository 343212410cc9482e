"""TCP on loopback and serial over a pseudo-terminal, with scripted peers."""

import contextlib
import errno
import fcntl
import itertools
import os
import socket
import struct
import termios
import tty

import pytest
import serial
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink import serial_port, tcp
from kffa_offboard.mavlink.component import FrameParser
from kffa_offboard.mavlink.link import open_link


@pytest.fixture
def clock():
    return itertools.count(0, 1000).__next__


@pytest.fixture
def listener():
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(5.0)
        yield server


@pytest.fixture
def client(listener, clock):
    link = open_link(f"tcp:127.0.0.1:{listener.getsockname()[1]}", clock)
    with contextlib.closing(link):
        yield link


@pytest.fixture
def connected(client, listener):
    """A connected tcp link and the vehicle's end."""
    client.receive(0.01)
    vehicle, _ = listener.accept()
    vehicle.settimeout(5.0)
    with vehicle:
        yield client, vehicle


def test_bytes_go_both_ways(connected):
    link, vehicle = connected
    vehicle.sendall(b"telemetry")
    assert [datagram.data for datagram in link.receive(5.0)] == [b"telemetry"]
    assert link.send(b"command")
    assert vehicle.recv(100) == b"command"


def test_a_frame_that_arrives_in_pieces_is_one_message(connected, autopilot):
    link, vehicle = connected
    parser = FrameParser(link.keeps_frames_whole)
    frame = autopilot.pack(autopilot.attitude(77))
    found = []
    for byte in frame:
        vehicle.sendall(bytes([byte]))
        for datagram in link.receive(5.0):
            found += parser.parse(datagram)
    assert [message.time_boot_ms for message in found] == [77]
    assert parser.damaged_bytes == 0


def test_a_vehicle_that_is_not_up_yet_is_tried_again(clock):
    with socket.create_server(("127.0.0.1", 0)) as server:
        place = server.getsockname()
    with contextlib.closing(open_link(f"tcp:127.0.0.1:{place[1]}", clock)) as link:
        assert link.receive(0.001) == []
        assert link.trouble == "connection refused"
        assert not link.send(b"x")
        with socket.create_server(place) as server:
            link.receive(1.0)
            server.settimeout(5.0)
            vehicle, _ = server.accept()
            with vehicle:
                vehicle.sendall(b"up")
                assert [datagram.data for datagram in link.receive(5.0)] == [b"up"]


def test_a_closed_connection_is_said_and_made_again(connected, listener):
    link, vehicle = connected
    vehicle.sendall(b"before")
    (before,) = link.receive(5.0)
    vehicle.close()
    assert link.receive(5.0) == []
    assert link.take_news() == "link lost: closed by the other side"
    assert link.take_news() is None
    assert "is the vehicle still running?" in link.trouble
    assert link.descriptor is None
    assert not link.send(b"nobody hears this")
    while link.take_news() != "link is back":
        assert link.receive(0.001) == []
    again, _ = listener.accept()
    with again:
        again.sendall(b"after")
        (after,) = link.receive(5.0)
        assert (before.data, after.data) == (b"before", b"after")
        assert before.source != after.source, "half a frame from before is not continued"
        assert link.send(b"command") and again.recv(100) == b"command"
        assert link.trouble == ""


def test_a_vehicle_that_is_gone_is_called_again_in_growing_pauses(listener, monkeypatch):
    now_us, called = [0], []
    with contextlib.closing(
        open_link(f"tcp:127.0.0.1:{listener.getsockname()[1]}", lambda: now_us[0])
    ) as link:
        link.receive(5.0)
        vehicle, _ = listener.accept()
        vehicle.close()
        listener.close()
        link.receive(5.0)
        monkeypatch.setattr(tcp.select, "select", lambda *_: ([], [], []))
        connect = socket.socket.connect
        monkeypatch.setattr(
            socket.socket, "connect", lambda *place: called.append(now_us[0] * 1e-6) or connect(*place)
        )
        for now_us[0] in range(0, 9_000_000, 10_000):
            assert link.receive(0.001) == []
    pauses = [later - earlier for earlier, later in itertools.pairwise([0.0, *called])]
    assert pauses == pytest.approx([0.2, 0.4, 0.8, 1.6, 2.0, 2.0])
    assert link.trouble == "connection refused"


def test_a_connection_on_which_nobody_answers_any_more_is_lost(connected):
    """No cable, no power: nobody closes it. The kernel gives it up, and what was not sent, after 1 s."""
    link, _ = connected
    ours = link._socket
    assert ours.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 1000


def test_a_vehicle_that_does_not_read_costs_frames_and_never_time(connected, autopilot):
    link, _ = connected
    frame = autopilot.pack(autopilot.attitude())
    sent = 0
    while link.send(frame):
        sent += 1
        assert sent < 100_000
    assert not link.send(frame)
    assert "too slow" in link.trouble


def test_what_did_not_fit_follows_when_there_is_room_and_frames_stay_whole(connected, autopilot):
    link, vehicle = connected
    frame = autopilot.pack(autopilot.attitude())
    sent = 0
    while link.send(frame):
        sent += 1
    received = bytearray()
    while len(received) < sent * len(frame):
        received += vehicle.recv(1 << 16)
        link.receive(0.0)
    assert bytes(received) == frame * sent


def setpoint(time_ms):
    quaternion = (1.0, 0.0, 0.0, 0.0)
    return mavlink.MAVLink_set_attitude_target_message(time_ms, 1, 1, 128, quaternion, 0.0, 0.0, 0.0, 0.4)


def after_a_stall(link, autopilot, read_some):
    """The peer reads nothing while 5000 setpoints are sent; those that it then gets."""
    for k in range(5000):
        link.send(autopilot.pack(setpoint(k)))
    parser, times_ms, idle = mavlink.MAVLink(None), [], 0
    while idle < 1000 and times_ms[-1:] != [4999]:
        link.receive(0.0)
        idle += 1
        with contextlib.suppress(BlockingIOError):
            times_ms += [message.time_boot_ms for message in parser.parse_buffer(read_some()) or []]
            idle = 0
    return times_ms


def test_after_a_stall_a_tcp_peer_gets_the_last_setpoint_and_not_those_before(connected, autopilot):
    link, vehicle = connected
    vehicle.setblocking(False)
    *before, last = after_a_stall(link, autopilot, lambda: vehicle.recv(1 << 16))
    assert last == 4999
    assert before == sorted(before) and len(before) < 4900, "what the kernel took; of those that waited none"


def test_signals_for_graphs_do_not_keep_setpoints_from_a_vehicle_on_a_slow_line(connected, autopilot):
    """A ground station asked for more of them than the line can take."""
    link, vehicle = connected
    vehicle.setblocking(False)
    signal = autopilot.pack(mavlink.MAVLink_named_value_float_message(0, b"ALT_EST", 1.0))
    while link.send(signal):
        pass
    assert link.send(autopilot.pack(setpoint(7)))
    parser, found = mavlink.MAVLink(None), []
    for _ in range(1000):
        link.receive(0.0)
        with contextlib.suppress(BlockingIOError):
            found += parser.parse_buffer(vehicle.recv(1 << 16)) or []
    assert found[-1].get_type() == "SET_ATTITUDE_TARGET" and found[-1].time_boot_ms == 7


def test_the_kernel_holds_less_than_two_kilobytes_for_a_peer_that_does_not_read(connected, autopilot):
    link, _ = connected
    frame = autopilot.pack(autopilot.attitude())
    for _ in range(100_000):
        if not link.send(frame):
            break
    unsent = struct.unpack("i", fcntl.ioctl(link._socket, termios.TIOCOUTQ, b"0000"))[0]
    assert unsent <= 2048


@pytest.fixture
def server_link(clock):
    with contextlib.closing(open_link("tcpin:127.0.0.1:0", clock)) as link:
        yield link


def call(link):
    return socket.create_connection(("127.0.0.1", int(link.name.rpartition(":")[2])), timeout=5.0)


def test_a_listening_link_answers_whoever_connected(server_link):
    assert server_link.receive(0.0) == []
    assert not server_link.send(b"x")
    with call(server_link) as vehicle:
        vehicle.sendall(b"hello")
        assert server_link.receive(5.0) == []  # connects
        assert [datagram.data for datagram in server_link.receive(5.0)] == [b"hello"]
        assert server_link.send(b"answer")
        assert vehicle.recv(100) == b"answer"


def test_a_caller_that_was_not_the_vehicle_may_leave_and_the_next_one_starts_afresh(server_link):
    with call(server_link) as stranger:
        stranger.sendall(b"x")
        assert server_link.receive(5.0) == []  # connects
        (first,) = server_link.receive(5.0)
    assert server_link.receive(5.0) == []
    with call(server_link) as vehicle:
        vehicle.sendall(b"y")
        assert server_link.receive(5.0) == []
        (second,) = server_link.receive(5.0)
    assert first.source != second.source


def test_a_vehicle_that_is_lost_on_a_listening_link_may_call_again(server_link):
    with call(server_link) as vehicle:
        vehicle.sendall(b"x")
        assert server_link.receive(5.0) == []  # connects
        (before,) = server_link.receive(5.0)
        server_link.lock(before.source)
    assert server_link.receive(5.0) == []
    assert server_link.take_news() == "link lost: closed by the other side"
    with call(server_link) as vehicle:
        vehicle.sendall(b"y")
        assert server_link.receive(5.0) == []
        assert server_link.take_news() == "link is back"
        (after,) = server_link.receive(5.0)
        assert after.data == b"y" and before.source != after.source


def test_a_busy_tcp_port_is_explained(listener, clock):
    port = listener.getsockname()[1]
    with pytest.raises(UserError, match=f"port {port} is busy"):
        open_link(f"tcpin:127.0.0.1:{port}", clock)


# ---------------------------------------------------------------------- serial


@pytest.fixture
def terminal():
    """A pseudo-terminal: our end as the autopilot, and the name of the serial device."""
    master, slave = os.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    yield master, name
    for descriptor in (master, slave):
        with contextlib.suppress(OSError):
            os.close(descriptor)


@pytest.fixture
def serial_link(terminal, clock):
    with contextlib.closing(open_link(f"serial:{terminal[1]}:57600", clock)) as link:
        yield link


def test_after_a_stall_a_serial_peer_gets_the_last_setpoint_and_not_those_before(
    serial_link, terminal, autopilot
):
    master, _ = terminal
    os.set_blocking(master, False)
    *before, last = after_a_stall(serial_link, autopilot, lambda: os.read(master, 1 << 16))
    assert last == 4999
    assert before == sorted(before) and len(before) < 4900, "what the kernel took; of those that waited none"


def test_serial_bytes_go_both_ways(serial_link, terminal):
    master, _ = terminal
    os.write(master, b"\xfd\x00\x11telemetry")
    assert b"".join(d.data for d in serial_link.receive(5.0)) == b"\xfd\x00\x11telemetry"
    assert serial_link.send(b"\xfd\x00\x11command")
    assert os.read(master, 100) == b"\xfd\x00\x11command"
    assert serial_link.receive(0.0) == []


@pytest.fixture
def cable(tmp_path):
    """A serial device under a name of its own that can be unplugged and plugged in again."""
    device, ends = tmp_path / "usb-autopilot", []

    class Cable:
        name = str(device)

        def plug_in(self):
            master, slave = os.openpty()
            tty.setraw(slave)
            ends[:] = [master, slave]
            device.symlink_to(os.ttyname(slave))

        def unplug(self):
            device.unlink(missing_ok=True)
            for descriptor in ends:
                os.close(descriptor)
            ends.clear()

        def write(self, data):
            os.write(ends[0], data)

        def read(self):
            return os.read(ends[0], 4096)

    ours = Cable()
    ours.plug_in()
    yield ours
    ours.unplug()


def test_a_serial_device_that_is_unplugged_is_said_and_taken_again_when_it_returns(cable):
    now_us = itertools.count(0, 10_000)
    with contextlib.closing(open_link(f"serial:{cable.name}:57600", lambda: next(now_us))) as link:
        cable.write(b"before")
        (before,) = link.receive(5.0)
        assert link.take_news() is None
        cable.unplug()
        assert link.receive(5.0) == []
        assert link.take_news() == "serial device lost; unplugged?"
        assert link.take_news() is None
        assert f"{cable.name} stopped answering" in link.trouble
        assert not link.send(b"nobody hears this")
        assert link.receive(0.0) == []
        cable.plug_in()
        while link.take_news() != "serial device is back":
            assert link.receive(0.001) == []
        cable.write(b"after")
        (after,) = link.receive(5.0)
        assert (before.data, after.data) == (b"before", b"after")
        assert before.source != after.source, "half a frame from before is not continued"
        assert link.send(b"command")
        assert cable.read() == b"command"


def test_a_serial_device_is_looked_for_a_few_times_a_second_and_no_more(cable, monkeypatch):
    now_us, looked = [0], []
    with contextlib.closing(open_link(f"serial:{cable.name}:57600", lambda: now_us[0])) as link:
        cable.unplug()
        link.receive(5.0)
        monkeypatch.setattr(type(link), "_reopen", lambda self: looked.append(now_us[0]) or False)
        monkeypatch.setattr(serial_port.select, "select", lambda *_: ([], [], []))
        for now_us[0] in range(0, 1_000_000, 1_000):
            link.receive(0.001)
    assert 4 <= len(looked) <= 6


def test_a_device_that_is_not_ready_when_it_returns_is_tried_again(cable, clock, monkeypatch):
    with contextlib.closing(open_link(f"serial:{cable.name}:57600", clock)) as link:
        cable.unplug()
        link.receive(5.0)
        cable.plug_in()
        with monkeypatch.context() as patched:

            def refuse(**options):
                raise serial.SerialException(errno.EACCES, "could not open port: Permission denied")

            patched.setattr(serial, "Serial", refuse)
            while "cannot open" not in link.trouble:
                link.receive(0.001)
        while link.take_news() != "serial device is back":
            link.receive(0.001)


def test_a_missing_device_is_named(clock):
    with pytest.raises(UserError, match="no such device '/dev/no-such-port'; is it plugged in"):
        open_link("serial:/dev/no-such-port:57600", clock)


def test_something_that_is_no_serial_device_is_refused(clock):
    with pytest.raises(UserError, match="cannot open '/dev/null': it is not a serial device"):
        open_link("serial:/dev/null:57600", clock)


def test_a_device_in_use_is_refused(serial_link, terminal, clock):
    with pytest.raises(UserError, match="another program has it open"):
        open_link(f"serial:{terminal[1]}:57600", clock)


@pytest.mark.parametrize(
    ("number", "reason", "remedy"),
    [
        (errno.EACCES, "not allowed to open it, which belongs to group", "sudo usermod -aG"),
        (errno.EBUSY, "it is busy", "ModemManager"),
    ],
)
def test_a_device_that_the_system_withholds_is_explained(
    terminal, clock, monkeypatch, number, reason, remedy
):
    def refuse(**options):
        raise serial.SerialException(number, f"could not open port: {os.strerror(number)}")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(UserError) as caught:
        open_link(f"serial:{terminal[1]}:57600", clock)
    assert f"cannot open '{terminal[1]}': {reason}" in str(caught.value)
    assert remedy in str(caught.value)
    assert "\n" not in str(caught.value)
