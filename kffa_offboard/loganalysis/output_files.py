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


def refuse_others(out: Path, inputs: Sequence[Path], begins: str) -> None:
    """Raises UserError if writing `out` would destroy a file that is read, a flight log or what is of others.

    What a command writes begins with `begins`; earlier results may be written over.
    """
    if any(out.resolve() == path.resolve() for path in inputs):
        raise UserError(f"--out {out}: is what is to be read, which would be lost; name another file")
    if out.is_file() and is_flight_log(out):
        raise UserError(f"--out {out}: is a flight log, which would be lost; name another file")
    try:
        with out.open("rb") as file:
            found = file.read(len(begins.encode())) if out.is_file() else b""
    except OSError:
        return  # whoever opens it for writing says why
    if found and found != begins.encode():
        raise UserError(
            f"--out {out}: is there and begins with {_shown(found)}, not with {begins!r} as what this "
            "command writes; it would be lost; name another file"
        )


def _shown(begin: bytes) -> str:
    return repr(begin.decode(errors="replace").splitlines()[0])


def write_text(path: Path, text: str) -> None:
    """Write a file. Raises UserError if that cannot be."""
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"--out {path}: {error.strerror}; choose another place") from error
