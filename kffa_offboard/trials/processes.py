"""Child processes of a trial flight: started, listened to, and ended whatever happens."""

from __future__ import annotations

import contextlib
import signal
import socket
import subprocess
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import IO, Any

END_LIMIT_S = 5.0
"""How long a process may take to end when asked."""


def free_port() -> int:
    """A UDP port on loopback that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextlib.contextmanager
def process(
    command: Sequence[str], *, patience_s: float = END_LIMIT_S, **options: Any
) -> Iterator[subprocess.Popen[str]]:
    """A process that has ended when the block is left, whatever happens in it.

    It is asked to end, and killed after `patience_s`. Further options are those of `subprocess.Popen`.
    """
    child = subprocess.Popen(command, stdin=subprocess.DEVNULL, text=True, **options)
    try:
        yield child
    finally:
        child.terminate()
        try:
            child.wait(patience_s)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()


@contextlib.contextmanager
def terminate_as_interrupt() -> Iterator[None]:
    """SIGTERM ends a command as Ctrl-C does, with everything that it started."""

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


class Listener:
    """Reads what the daemon says about the flight, into a file and for the progress display."""

    def __init__(self, stream: IO[str] | None, path: Path) -> None:
        assert stream is not None
        self.lines: list[str] = []
        self._stream = stream
        self._path = path
        self._thread = threading.Thread(target=self._read, name="daemon output", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        with self._path.open("w", encoding="utf-8") as file:
            for line in self._stream:
                file.write(line)
                file.flush()
                self.lines.append(line.rstrip())

    def join(self) -> None:
        """Wait until everything was read."""
        self._thread.join(END_LIMIT_S)

    @property
    def latest(self) -> str:
        """The latest announcement, without its time."""
        return self.lines[-1].partition(" s  ")[2] or self.lines[-1] if self.lines else "starting"

    @property
    def reason(self) -> str:
        """What the daemon said last, best its error."""
        errors = [line.removeprefix("error: ") for line in self.lines if line.startswith("error: ")]
        return errors[-1] if errors else self.latest


def last_line(path: Path) -> str:
    """The last line of a log, best without "error: "."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    return lines[-1].removeprefix("error: ") if lines else "without a word"


def flown_s(truth: Path) -> float:
    """Simulated time of the last whole line of a growing file of true states, s."""
    try:
        with truth.open("rb") as file:
            file.seek(max(0, file.seek(0, 2) - 1000))
            lines = file.read().split(b"\n")
    except FileNotFoundError:
        return 0.0
    try:
        return float(lines[-2].partition(b",")[0]) if len(lines) > 2 else 0.0
    except ValueError:  # the head of the file
        return 0.0
