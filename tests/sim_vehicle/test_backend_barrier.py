"""Simulated time waits at a barrier until the other side lets it go on."""

from __future__ import annotations

import socket
import struct
import threading

import pytest

from sim_vehicle.backends.barrier import Barrier, open_barrier
from sim_vehicle.errors import SimulatorError


def answer(end: socket.socket, heard: list[int], count: int) -> None:
    for _ in range(count):
        word, sender = end.recvfrom(64)
        heard.append(struct.unpack("<Q", word)[0])
        end.sendto(word, sender)


def test_each_period_asks_once_and_goes_on_with_the_answer() -> None:
    heard: list[int] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        end.settimeout(5.0)
        other = threading.Thread(target=answer, args=(end, heard, 2))
        other.start()
        with open_barrier(end.getsockname()[1], period_us=4000) as barrier:
            for time_us in range(1000, 9000, 1000):
                barrier.wait(time_us)
        other.join()
    assert heard == [4000, 8000]


def test_port_0_is_no_barrier(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[object] = []
    monkeypatch.setattr(socket, "socket", lambda *kinds: opened.append(kinds))
    with open_barrier(0, period_us=4000) as barrier:
        barrier.wait(4000)
    assert opened == [], "nobody is asked, so nobody can be waited for"


def test_an_answer_that_never_comes_is_one_line() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.connect(silent.getsockname())
            sock.settimeout(0.01)
            with pytest.raises(SimulatorError, match=r"nobody let time go on at 0\.00 s within 0\.05 s; is"):
                Barrier(sock, 4000, 0.05).wait(4000)


def test_where_nobody_listens_yet_it_asks_again_without_hurry(monkeypatch: pytest.MonkeyPatch) -> None:
    pauses: list[float] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
        end.bind(("127.0.0.1", 0))
        number = end.getsockname()[1]
    listening = threading.Event()

    def pause(seconds: float) -> None:
        pauses.append(seconds)
        if len(pauses) == 2:
            threading.Thread(target=listen).start()
            assert listening.wait(5.0)

    def listen() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as late:
            late.bind(("127.0.0.1", number))
            late.settimeout(5.0)
            listening.set()
            answer(late, [], 1)

    monkeypatch.setattr("sim_vehicle.backends.barrier.time.sleep", pause)
    with open_barrier(number, period_us=4000) as barrier:
        barrier.wait(4000)
    assert pauses == [0.05, 0.05]
