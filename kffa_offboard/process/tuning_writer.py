"""Storing parameters in flight: a thread of its own writes the file, so that no disk delays control."""

from __future__ import annotations

import os
import queue
import threading
from pathlib import Path

from kffa_offboard.offboard.tuning import TuningProblem, TuningStore


class TuningWriter:
    """Stands in front of a store; what is on its way to the disk is read as if it were there."""

    def __init__(self, store: TuningStore) -> None:
        self._store = store
        self._text: str | None = None
        self._trouble: str | None = None
        self._texts: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="parameters", daemon=True)
        self._thread.start()

    @property
    def path(self) -> Path:
        """The file."""
        return self._store.path

    def read(self) -> str | None:
        """What is or will be stored, None if nothing is. Raises TuningProblem if it cannot be read."""
        text = self._text
        return self._store.read() if text is None else text

    def write(self, text: str) -> None:
        """Have `text` stored. Raises TuningProblem if it cannot be, as far as that can be told at once."""
        if not os.access(self.path.parent, os.W_OK):
            raise TuningProblem(f"cannot write {self.path}: {self.path.parent} is missing or not writable")
        self._text = text
        self._texts.put(text)

    def take_trouble(self) -> str | None:
        """Why what was to be stored is not, once; else None."""
        trouble, self._trouble = self._trouble, None
        return trouble

    def close(self) -> None:
        """Wait until all is stored. May be called twice."""
        self._texts.put(None)
        self._thread.join()

    def _run(self) -> None:
        while (text := self._texts.get()) is not None:
            try:
                self._store.write(text)
            except TuningProblem as problem:
                self._trouble = f"parameters not stored: {problem}"
            if self._text is text:
                self._text = None
