"""The file that remembers what `--fix-params` changed, so that not even a crash loses the old values.

It is written and flushed to disk before the first parameter is changed, and removed when all are back.
"""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

from kffa_offboard.errors import UserError
from kffa_offboard.offboard.events import Firmware


@dataclass(frozen=True, slots=True)
class ChangedParameter:
    """One parameter that the daemon set: name, value before, value set."""

    name: str
    old: float
    new: float


class ChangeRecord(Protocol):
    """Where changes are remembered."""

    def load(self, firmware: Firmware) -> tuple[ChangedParameter, ...]:
        """What an earlier run changed on a vehicle with `firmware` and did not put back."""

    def save(self, firmware: Firmware, changes: tuple[ChangedParameter, ...]) -> None:
        """Remember `changes` for good, or, if there are none, forget everything."""


class ParameterFile:
    """A JSON file. Raises UserError, one line, if it cannot be read or written."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def text(self) -> str | None:
        """What is in the file, None if there is none."""
        try:
            return self.path.read_text(encoding="utf-8")
        except (FileNotFoundError, NotADirectoryError):
            return None
        except (OSError, ValueError) as error:
            raise self._unreadable(error) from error

    def load(self, firmware: Firmware) -> tuple[ChangedParameter, ...]:
        """See `ChangeRecord`."""
        text = self.text()
        return () if text is None else self._changes(text, firmware)

    def _unreadable(self, error: Exception) -> UserError:
        return UserError(
            f"{self.path}: cannot read the old parameters of an earlier run ({error}); "
            "put them back by hand, then remove the file"
        )

    def _changes(self, text: str, firmware: Firmware) -> tuple[ChangedParameter, ...]:
        try:
            document = json.loads(text)
            if document["firmware"] != firmware:
                raise UserError(
                    f"{self.path}: holds old parameters of a vehicle with {document['firmware']}, but this "
                    f"one runs {firmware}; move the file away if they are of no use"
                )
            changes = [(str(c["name"]), float(c["old"]), float(c["new"])) for c in document["changed"]]
        except (ValueError, KeyError, TypeError) as error:
            raise self._unreadable(error) from error
        return tuple(ChangedParameter(*change) for change in changes)

    def save(self, firmware: Firmware, changes: tuple[ChangedParameter, ...]) -> None:
        """See `ChangeRecord`."""
        try:
            if not changes:
                self.path.unlink(missing_ok=True)
                return
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._write(json.dumps({"firmware": firmware, "changed": [asdict(c) for c in changes]}, indent=1))
        except OSError as error:
            raise UserError(
                f"{self.path}: cannot keep the old parameters ({error.strerror}), so none is changed; "
                "choose another log directory"
            ) from error

    def _write(self, text: str) -> None:
        """All or nothing, and on disk when it returns."""
        waiting = self.path.with_name(self.path.name + ".new")
        with waiting.open("w", encoding="utf-8") as file:
            file.write(text + "\n")
            file.flush()
            os.fsync(file.fileno())
        waiting.replace(self.path)
        directory = os.open(self.path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


class RememberedChanges(ParameterFile):
    """The text of such a file in a flight log: read as it was, and never written."""

    def __init__(self, log: Path, text: str | None) -> None:
        super().__init__(log)
        self._text = text

    def text(self) -> str | None:
        """See `ParameterFile`."""
        return self._text

    def save(self, firmware: Firmware, changes: tuple[ChangedParameter, ...]) -> None:
        """The log tells what came of it."""
