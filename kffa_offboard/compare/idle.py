"""Has a process nothing left to do? From Linux's /proc, without its help.

PX4's lock-step waits for its motor outputs, not for all of its threads: on a busy computer its estimator may
not have had its turn yet, and once behind the sensors it stays behind (its inertial samples queue up, and one
leaves for each that comes). Threads that all sleep have had their turn.
"""

from __future__ import annotations

import os
import time
from pathlib import Path

PAUSE_S = 1e-4
SLEEPING = b"S"


class Threads:
    """The threads of process `pid`, seen from outside."""

    def __init__(self, pid: int) -> None:
        self._directory = Path(f"/proc/{pid}/task")
        self._open: dict[str, tuple[int, int]] = {}

    @staticmethod
    def can_be_seen() -> bool:
        """Does this system tell?"""
        return Path("/proc/self/task/").is_dir() and Path("/proc/self/schedstat").is_file()

    def wait_until_idle(self, limit_s: float) -> bool:
        """Wait until all threads sleep, or the process has ended; False if not within `limit_s` of wall."""
        give_up = time.monotonic() + limit_s
        while not self._idle():
            if not self._directory.exists():
                return True
            if time.monotonic() > give_up:
                return False
            time.sleep(PAUSE_S)
        return True

    def close(self) -> None:
        """Look no more."""
        for pair in self._open.values():
            for file in pair:
                os.close(file)
        self._open.clear()

    def _idle(self) -> bool:
        """All sleep, and none has run while they were looked at."""
        try:
            self._find()
            before = [os.pread(turns, 256, 0) for _, turns in self._open.values()]
            for state, _ in self._open.values():
                if os.pread(state, 512, 0).rpartition(b") ")[2][:1] != SLEEPING:
                    return False
            return bool(before) and before == [os.pread(turns, 256, 0) for _, turns in self._open.values()]
        except (FileNotFoundError, ProcessLookupError):  # a thread has ended
            self.close()
            return False

    def _find(self) -> None:
        tasks = os.listdir(self._directory)
        if len(tasks) == len(self._open) and all(task in self._open for task in tasks):
            return
        self.close()
        for task in tasks:
            state, turns = (
                os.open(self._directory / task / name, os.O_RDONLY) for name in ("stat", "schedstat")
            )
            self._open[task] = (state, turns)
