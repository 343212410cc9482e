"""The shell that flies PX4: lock-step, its fallback, restarts and the clock, on a scripted wire and clock."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle.backends.px4_backend import FALLBACK_FACTOR, Px4HilBackend
from sim_vehicle.backends.px4_port import Px4Port
from sim_vehicle.config import SimConfig, build
from sim_vehicle.errors import SimulatorError

HOVER = 98.0 / 246.0


class ScriptedWire(Px4Port):
    """PX4 without a socket: boots for some sensor frames, then answers each. Time passes only in waiting.

    Attributes
    ----------
    now : wall time [s]
    frames : sensor frames of the present session
    silent : the frame numbers (in the session) that get no answer
    deaf : sending waits in vain until this wall time
    dies_at : the frame at which PX4 closes its link
    chatter_from : from this frame on outputs of the time 77 us come without end
    """

    def __init__(self, boot_frames: int = 5, silent: range = range(0), flags: int = 1) -> None:
        self.now = 100.0
        self.frames = 0
        self.silent = silent
        self.deaf = 0.0
        self.dies_at = -1
        self.away_s = 0.0
        self.sessions = 0
        self.chatter_from = -1
        self._boot_frames = boot_frames
        self._flags = flags
        self._stream: Any = None
        self._answer = b""
        self._codec: Any = mavlink.MAVLink(file=None, srcSystem=1, srcComponent=1)

    @property
    def address(self) -> str:
        return "127.0.0.1:4560"

    @property
    def connected(self) -> bool:
        return self._stream is not None

    def accept(self, timeout_s: float) -> bool:
        self.now += timeout_s
        if self.now - 100.0 < self.away_s:
            return False
        self._stream, self.frames, self._answer = object(), 0, b""
        self.sessions += 1
        return True

    def receive(self, timeout_s: float) -> bytes:
        if self.frames == self.dies_at:
            self.dies_at, self._stream = -1, None
            return b""
        if 0 <= self.chatter_from <= self.frames:
            self._answer = self._outputs(77)
        answer, self._answer = self._answer, b""
        self.now += 0.0002 if answer else max(timeout_s, 0.0)
        return answer

    def send(self, data: bytes, timeout_s: float) -> bytes:
        if self.now < self.deaf:
            self.now += timeout_s
            return data
        for message in self._codec.parse_buffer(data):
            if message.get_type() == "HIL_SENSOR":
                self.frames += 1
                self._reply(message.time_usec)
        return b""

    def _reply(self, time_us: int) -> None:
        if self.frames <= self._boot_frames or self.frames in self.silent:
            return
        self._answer += self._outputs(time_us)

    def _outputs(self, time_us: int) -> bytes:
        controls = [*[HOVER] * 4, *[0.0] * 12]
        message = mavlink.MAVLink_hil_actuator_controls_message(time_us, controls, 129, self._flags)
        return bytes(message.pack(self._codec))


def fly(
    wire: ScriptedWire, seconds: float, factor: float = 0.0, **backend: Any
) -> tuple[Px4HilBackend, list[str]]:
    lines: list[str] = []
    flown = Px4HilBackend(settings(factor, **backend), wire, lines.append, lambda: wire.now)
    flown.run(seconds, lambda: None)
    return flown, lines


def settings(factor: float = 0.0, **backend: Any) -> SimConfig:
    return build({"backend": {"kind": "px4-hil", "real_time_factor": factor, **backend}}, "test")


def events(backend: Px4HilBackend) -> list[str]:
    return [event.text for event in backend.plant.truth.events]


def test_the_flight_ends_after_its_duration_in_lock_step_as_fast_as_px4_answers() -> None:
    wire = ScriptedWire()
    backend, lines = fly(wire, 1.0)
    assert backend.plant.time_us == 1_000_000 and wire.frames == 250
    assert [line.split(": ", 2)[2] for line in lines] == ["PX4 connected", "in lock-step with PX4"]
    assert wire.now - 100.2 == pytest.approx(5 * 0.004 + 245 * 0.0002, abs=0.002)  # boots in real time


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_simulated_time_keeps_to_its_multiple_of_the_walls(factor: float) -> None:
    wire = ScriptedWire()
    fly(wire, 1.0, factor)
    assert wire.now - 100.2 == pytest.approx(1.0 / factor, abs=0.02)


def test_outputs_that_stay_away_do_not_stop_time_and_lock_step_comes_back() -> None:
    wire = ScriptedWire(silent=range(100, 110))
    backend, lines = fly(wire, 0.6)
    assert wire.frames == 150
    assert "0.40 s: no motor outputs for 1 s; going on slowly" in lines[2]
    assert lines[3] == "px4-hil: 0.44 s: in lock-step with PX4 again"
    silence = 1.0 + 10 * 0.004 / FALLBACK_FACTOR
    assert wire.now - 100.2 == pytest.approx(silence, abs=0.4)
    assert events(backend) == ["armed"]  # the last outputs held


def test_a_px4_that_stays_silent_is_reported_again_and_again_and_given_up_if_wanted() -> None:
    wire = ScriptedWire(silent=range(100, 10_000))
    lines: list[str] = []
    backend = Px4HilBackend(settings(stall_timeout_s=30.0), wire, lines.append, lambda: wire.now)
    with pytest.raises(SimulatorError, match=r"px4-hil: no motor output for 30 s at .* is PX4 stopped"):
        backend.run(60.0, lambda: None)
    assert lines[3].startswith("px4-hil: no motor output for 5 s") and "still waiting" in lines[3]
    assert backend.plant.time_us < 1_200_000


def test_outputs_of_another_time_without_end_do_not_hold_time_up() -> None:
    wire = ScriptedWire()
    wire.chatter_from = 100
    backend, lines = fly(wire, 0.5)
    assert backend.plant.time_us == 500_000
    assert "0.40 s: no motor outputs for 1 s; going on slowly" in lines[2]
    assert lines[3].startswith("px4-hil: no motor output for 5 s at 0.4"), lines[3:]
    assert len(lines) == 4


def test_a_px4_that_does_not_read_is_reported_and_time_waits_for_it() -> None:
    wire = ScriptedWire()
    lines: list[str] = []
    backend = Px4HilBackend(settings(), wire, lines.append, lambda: wire.now)
    backend.run(1.0, lambda: None)
    wire.deaf = wire.now + 12.0
    backend.run(1.1, lambda: None)
    assert backend.plant.time_us == 1_100_000 and wire.sessions == 1
    assert ["no motor output for 5 s" in lines[2], "for 10 s" in lines[3]] == [True, True]
    assert "motor outputs are coming again after 12" in lines[4]


def test_a_missing_px4_is_asked_for_with_the_way_to_start_it() -> None:
    wire = ScriptedWire()
    wire.away_s = 8.0
    _, lines = fly(wire, 0.1)
    assert "no connection for 5 s" in lines[0] and "PX4_SYS_AUTOSTART=10016" in lines[0]
    with pytest.raises(SimulatorError, match="no connection for 3 s"):
        absent = ScriptedWire()
        absent.away_s = 1e9
        fly(absent, 0.1, stall_timeout_s=3.0)


def test_a_restarted_px4_is_flown_on_with_and_boots_again_in_real_time() -> None:
    wire = ScriptedWire()
    wire.dies_at = 100
    backend, lines = fly(wire, 0.8)
    assert wire.sessions == 2 and wire.frames == 100
    assert [line.split(": ", 2)[2] for line in lines[2:]] == [
        "PX4 closed its link; waiting for it to come back",
        "PX4 is back, the vehicle is where it was",
        "in lock-step with PX4",
    ]
    assert events(backend) == ["armed", "firmware restarted", "armed"]
    assert backend.plant.time_us == 800_000


def test_a_px4_without_lock_step_is_flown_in_real_time() -> None:
    wire = ScriptedWire(flags=0)
    _, lines = fly(wire, 1.0, 0.0)
    assert [line.split(": ", 2)[2] for line in lines[1:]] == [
        "this PX4 was built without lock-step: flying in real time"
    ]
    assert wire.now - 100.2 == pytest.approx(1.0, abs=0.05)


# -------------------------------------------------------------------------------- real sockets


@pytest.fixture
def port() -> Iterator[Px4Port]:
    with Px4Port("127.0.0.1", 0) as opened:
        yield opened


def test_px4_connects_sends_broken_frames_dies_and_comes_back_over_tcp(port: Px4Port) -> None:
    host, number = port.address.split(":")

    def live(frames: float, spoil: Callable[[bytes], bytes]) -> None:
        codec: Any = mavlink.MAVLink(file=None, srcSystem=1, srcComponent=1)
        codec.robust_parsing = True
        with socket.create_connection((host, int(number))) as stream:
            answered = 0
            while answered < frames and (data := stream.recv(65536)):
                for message in codec.parse_buffer(data) or []:
                    if message.get_type() == "HIL_SENSOR":
                        outputs = mavlink.MAVLink_hil_actuator_controls_message(
                            message.time_usec, [HOVER] * 16, 129, 1
                        )
                        stream.sendall(spoil(outputs.pack(codec)))
                        answered += 1

    def two_lives() -> None:
        live(50, lambda frame: b"\xfd\x05junk" + frame)
        live(math.inf, lambda frame: frame)

    px4 = threading.Thread(target=two_lives, daemon=True)
    px4.start()
    lines: list[str] = []
    backend = Px4HilBackend(settings(), port, lines.append)
    backend.run(0.4, lambda: None)
    port.__exit__()
    px4.join(5.0)
    assert not px4.is_alive()
    assert backend.plant.time_us == 400_000
    said = " | ".join(lines)
    for expected in ("no MAVLink frame", "closed its link", "PX4 is back", "in lock-step"):
        assert expected in said
    assert events(backend).count("firmware restarted") == 1


def test_who_knocks_while_px4_flies_is_turned_away_and_named(port: Px4Port) -> None:
    host, number = port.address.split(":")
    strangers: list[str] = []

    def live() -> None:
        codec: Any = mavlink.MAVLink(file=None, srcSystem=1, srcComponent=1)
        with (
            contextlib.suppress(ConnectionError),  # the end, with sensors unread
            socket.create_connection((host, int(number))) as stream,
        ):
            while data := stream.recv(65536):
                for message in codec.parse_buffer(data) or []:
                    if message.get_type() == "HIL_SENSOR" and message.time_usec == 200_000:
                        with socket.create_connection((host, int(number))) as knock:
                            strangers.append(f"127.0.0.1:{knock.getsockname()[1]}")
                            assert knock.recv(1) == b""
                    if message.get_type() == "HIL_SENSOR":
                        outputs = mavlink.MAVLink_hil_actuator_controls_message(
                            message.time_usec, [HOVER] * 16, 129, 1
                        )
                        stream.sendall(outputs.pack(codec))

    px4 = threading.Thread(target=live, daemon=True)
    px4.start()
    lines: list[str] = []
    backend = Px4HilBackend(settings(px4_hil={"outputs_timeout_s": 20.0}), port, lines.append)
    backend.run(0.4, lambda: None)
    port.__exit__()
    px4.join(5.0)
    assert not px4.is_alive()
    assert events(backend) == ["armed"]
    (line,) = [line for line in lines if "turned away" in line]
    assert port.turned_away == strangers[0]
    assert f": {strangers[0]} wanted this port, too, and was turned away; end this PX4 first" in line


def test_the_next_px4_hears_nothing_of_who_was_turned_away_before(port: Px4Port) -> None:
    host, number = port.address.split(":")
    with socket.create_connection((host, int(number))):
        assert port.accept(5.0)
        with socket.create_connection((host, int(number))):
            port.receive(5.0)
        assert port.turned_away
    with socket.create_connection((host, int(number))):
        assert port.accept(5.0)
        assert port.turned_away == ""


def test_a_newer_px4_takes_the_place_of_one_that_died_with_bytes_unread(port: Px4Port) -> None:
    host, number = port.address.split(":")
    with socket.create_connection((host, int(number))) as dead:
        assert port.accept(5.0)
        dead.sendall(b"last words")
    with socket.create_connection((host, int(number))):
        assert port.receive(5.0) == b""
        assert not port.connected
        assert port.accept(5.0)
    assert port.turned_away == ""


def test_a_port_in_use_and_a_port_of_another_machine_are_refused_with_the_remedy(port: Px4Port) -> None:
    number = int(port.address.split(":")[1])
    with pytest.raises(SimulatorError, match=rf"port {number} is in use; stop the program"):
        Px4Port("127.0.0.1", number)
    with pytest.raises(SimulatorError, match=r"not this machine; use 127\.0\.0\.1"):
        Px4Port("0.0.0.0", 0)


def test_sensors_a_stopped_px4_does_not_take_come_back_unsent(port: Px4Port) -> None:
    host, number = port.address.split(":")
    with socket.create_connection((host, int(number))):
        assert port.accept(5.0)
        left = port.send(b"x" * 10_000_000, 0.0)
        assert 0 < len(left) < 10_000_000
    assert port.send(left, 1.0) == b""
    assert not port.connected
