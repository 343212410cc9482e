"""Writing results: one place for directories that cannot be made and files that cannot be written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis.read import is_flight_log


def make_directory(path: Path) -> Path:
    """Make `path` and its parents. Raises UserError if that cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"--out {path}: {error.strerror}; choose another directory") from error
    return path


def refuse_inputs(out: Path, inputs: Sequence[Path]) -> None:
    """Raises UserError if writing `out` would destroy one of the files that are read, or any flight log."""
    if any(out.resolve() == path.resolve() for path in inputs):
        raise UserError(f"--out {out}: is what is to be read, which would be lost; name another file")
    if out.is_file() and is_flight_log(out):
        raise UserError(f"--out {out}: is a flight log, which would be lost; name another file")


def write_text(path: Path, text: str) -> None:
    """Write a file. Raises UserError if that cannot be."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"--out {path}: {error.strerror}; choose another place") from error
