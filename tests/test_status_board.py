"""The status lines of a run: they never hold the control loop up, whatever the terminal does."""

import os
import threading
import time

import pytest
from rich.text import Text

from kffa_offboard import cli_status
from kffa_offboard.cli_status import StatusBoard, StatusConsole
from kffa_offboard.offboard.events import Announce, HeartbeatReceived, ModeKind, Severity, StepTiming
from kffa_offboard.process.notify import ServiceManager


class Manager(ServiceManager):
    """Listens to the status."""

    present = True

    def __init__(self):
        super().__init__({})
        self.texts = []

    def status(self, text):
        self.texts.append(text)


class Terminal:
    """Does not take a byte until it is released."""

    encoding = "utf-8"

    def __init__(self):
        self.released = threading.Event()
        self.text = ""

    def write(self, text):
        self.released.wait()
        self.text += text

    def flush(self):
        pass

    def isatty(self):
        return False


@pytest.fixture
def console():
    return StatusConsole()


def test_a_terminal_that_does_not_read_holds_nobody_up(console, monkeypatch):
    console.file = terminal = Terminal()
    monkeypatch.setattr(cli_status, "END_LIMIT_S", 0.05)
    with StatusBoard(console, ServiceManager({})) as board:
        vehicle = board.vehicle()
        for n in range(5000):
            vehicle(n, Announce(Severity.INFO, str(n)))
    terminal.released.set()
    board._thread.join()
    assert "4999" in terminal.text


def test_a_terminal_that_is_gone_is_no_reason_to_end(console):
    reader, writer = os.pipe()
    manager = Manager()
    with os.fdopen(writer, "w") as console.file:
        os.close(reader)
        console.tell("nobody sees this")
        with StatusBoard(console, manager) as board:
            vehicle = board.vehicle()
            vehicle(0, Announce(Severity.INFO, "nor this"))
            vehicle(0, HeartbeatReceived("px4", ModeKind.OFFBOARD, "OFFBOARD", 0, True))
            vehicle(0, StepTiming(100, 2, 1, 0.01))
            deadline = time.monotonic() + 10.0
            while not any("px4 OFFBOARD armed, 3 late steps" in text for text in manager.texts):
                board.say(Text(""))
                assert time.monotonic() < deadline
                board._thread.join(0.001)
        with open(os.devnull, "w") as console.file:  # closing the pipe would complain, too
            pass
        console.file = open(os.devnull, "w")  # noqa: SIM115
        os.dup2(console.file.fileno(), writer)


def test_vehicles_of_one_process_are_told_apart(console, capsys):
    with StatusBoard(console, manager := Manager()) as board:
        for name in ("north", "south"):
            board.vehicle(name)(0, Announce(Severity.NOTICE, "engaged"))
    said = capsys.readouterr().err
    assert "north: engaged" in said
    assert "south: engaged" in said
    assert manager.texts[-1].count("waiting, no vehicle yet") == 2
