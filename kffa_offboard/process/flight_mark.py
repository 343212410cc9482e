"""What a run leaves behind for the next one: that control was taken in a flight which may still go on.

A file is made when control is taken of an armed vehicle, and removed when the vehicle is seen disarmed. A run
that finds it was started again in flight: after a crash, by a service manager, or by a person.
"""

from __future__ import annotations

import json
import os
import queue
import threading
from pathlib import Path

from kffa_offboard.offboard.events import AttitudeTarget, HeartbeatReceived


class FlightMark:
    """Give it to a session as observer. A thread of its own writes, so that no disk delays control.

    Attributes
    ----------
    path : the file
    found : it was there at the start

    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.found = path.exists()
        self._armed = False
        self._there: bool | None = self.found
        self._trouble: str | None = None
        self._orders: queue.SimpleQueue[bool | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="flight mark", daemon=True)
        self._thread.start()

    def obstacle(self) -> str | None:
        """Why the file could not be made, as far as that can be told beforehand; None if it could."""
        directory = self.path.parent
        while not directory.exists() and directory != directory.parent:
            directory = directory.parent
        if directory.is_dir() and os.access(directory, os.W_OK):
            return None
        return f"cannot write in {self.path.parent}, so a restart in flight could not be told from a start"

    def __call__(self, time_us: int, item: object) -> None:
        """Take note of an event or output of the service."""
        if isinstance(item, HeartbeatReceived):
            self._armed = item.armed
            if not item.armed:
                self._want(False)
        elif isinstance(item, AttitudeTarget) and self._armed:
            self._want(True)

    def take_trouble(self) -> str | None:
        """What went wrong with the file, once; else None."""
        trouble, self._trouble = self._trouble, None
        return trouble

    def close(self) -> None:
        """Wait for the file to be as it should. May be called twice."""
        self._orders.put(None)
        self._thread.join()

    def _want(self, there: bool) -> None:
        if there != self._there:
            self._there = there
            self._orders.put(there)

    def _run(self) -> None:
        while (there := self._orders.get()) is not None:
            try:
                if there:
                    self._write()
                else:
                    self.path.unlink(missing_ok=True)
            except OSError as error:
                self._trouble = f"restart mark: {error.strerror or error}"

    def _write(self) -> None:
        """On the disk itself: the computer may lose power while the autopilot flies on."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w", encoding="utf-8") as file:
            json.dump({"process": os.getpid()}, file)
            file.flush()
            os.fsync(file.fileno())
