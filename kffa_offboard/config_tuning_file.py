"""Where values that were changed in flight are stored: a TOML file, or its text in a flight log."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from kffa_offboard.offboard.tuning import TuningProblem, TuningStore

Key: TypeAlias = tuple[str, ...]
"""Where a number stands in a file: its tables and its key."""

MOST = 10**15
"""Whole numbers beyond it are no parameter, and some have no float."""


class TuningFile:
    """The file itself, replaced as a whole, never half written. Writing waits for the disk."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self) -> str | None:
        """See `TuningStore`."""
        try:
            return self.path.read_text(encoding="utf-8")
        except FileNotFoundError:
            return None
        except OSError as error:
            raise TuningProblem(f"cannot be read: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise TuningProblem(f"is not valid TOML: {error}") from error

    def write(self, text: str) -> None:
        """See `TuningStore`."""
        draft = self.path.with_name(self.path.name + ".part")
        try:
            with draft.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            os.replace(draft, self.path)
        except OSError as error:
            raise TuningProblem(f"cannot write {self.path}: {error.strerror}") from error


class RememberedTuning:
    """The file as it was when a flight began; what the flight stores changes only this."""

    def __init__(self, path: Path, text: str | None) -> None:
        self.path = path
        self._text = text

    def read(self) -> str | None:
        """See `TuningStore`."""
        return self._text

    def write(self, text: str) -> None:
        """See `TuningStore`."""
        self._text = text


def as_toml(values: Mapping[Key, float]) -> str:
    """Numbers as TOML, table by table."""
    lines = ["# Parameters changed in flight; read on top of the configuration that names this file."]
    tables: dict[str, list[str]] = {}
    for key, value in values.items():
        tables.setdefault(".".join(key[:-1]), []).append(f"{key[-1]} = {value!r}")
    for table, entries in tables.items():
        lines += ["", f"[{table}]", *entries]
    return "\n".join(lines) + "\n"


def read_values(store: TuningStore, keys: Mapping[str, Key]) -> dict[Key, float]:
    """Values in `store`; none if there is nothing.

    Raises TuningProblem for anything in it that is not one of `keys`, or no number.
    """
    text = store.read()
    if text is None:
        return {}
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise TuningProblem(f"is not valid TOML: {error}") from error
    except (ValueError, RecursionError) as error:  # thousands of digits, thousands of brackets
        raise TuningProblem("holds a number or a nesting that is too long") from error
    known, values = set(keys.values()), dict(_leaves(document, ()))
    for key, value in values.items():
        if key not in known:
            raise TuningProblem(f"{'.'.join(key)}: is no parameter of this configuration; remove it")
        whole = isinstance(value, int) and abs(value) < MOST
        if isinstance(value, bool) or not (whole or isinstance(value, float)):
            raise TuningProblem(f"{'.'.join(key)} = {value!r}: must be a number")
    return {key: float(value) for key, value in values.items()}


def _leaves(table: Mapping[str, Any], path: Key) -> Iterator[tuple[Key, Any]]:
    for name, value in table.items():
        if isinstance(value, dict):
            yield from _leaves(value, (*path, name))
        else:
            yield (*path, name), value
