"""The further files of a flight (`log.file_size_max_mb`): FLIGHT.tlog, FLIGHT-2.tlog, FLIGHT-3.tlog, ..."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.notes import Header, NoteReader, is_note
from kffa_offboard.flightlog.tlog import read_tlog


def part_path(path: Path, part: int) -> Path:
    """File of a part of a flight: FLIGHT.tlog, FLIGHT-2.tlog, FLIGHT-3.tlog, ... (or .tlog.gz)."""
    if part == 1:
        return path
    stem, ending = _stem_and_ending(path)
    return path.with_name(f"{stem}-{part}{ending}")


def following_parts(path: Path) -> Iterator[Path]:
    """The further files of a flight that are there, in order; `path` need not be a telemetry log.

    A file that is only called like one, and is another flight, is none. Raises UserError if one in between is
    missing.
    """
    part = 2
    while (following := part_path(path, part)).is_file():
        if not _continues(path, following, part):
            return
        yield following
        part += 1
    for number in _later_numbers(path, part):
        if _continues(path, later := part_path(path, number), number):
            raise UserError(
                f"{following}: is missing, and {later.name} is there; put it back, or take {path.name} to "
                "another directory to see it alone"
            )


def without_parts(logs: Sequence[Path]) -> list[Path]:
    """The logs without repetitions and without further parts (FLIGHT-2.tlog) of another one among them."""
    parts = {part.resolve() for log in logs for part in following_parts(log)}
    unique = {log.resolve(): log for log in reversed(logs)}
    return [log for log in logs if unique.get(log.resolve()) is log and log.resolve() not in parts]


def _stem_and_ending(path: Path) -> tuple[str, str]:
    ending = "".join(suffix for suffix in path.suffixes[-2:] if suffix in (".tlog", ".gz")) or path.suffix
    return path.name.removesuffix(ending), ending


def _later_numbers(path: Path, least: int) -> Iterator[int]:
    """Numbers of the files that are called as parts from `least` on, in order."""
    stem, ending = _stem_and_ending(path)
    try:
        names = [each.name for each in path.parent.iterdir()]
    except OSError:  # a directory that may be entered and not listed
        names = []
    middles = [
        name[len(stem) + 1 : len(name) - len(ending)]
        for name in names
        if name.startswith(f"{stem}-") and name.endswith(ending)
    ]
    yield from sorted(int(middle) for middle in middles if middle.isdecimal() and int(middle) >= least)


def _continues(path: Path, following: Path, part: int) -> bool:
    """True if `following` says that it is that part of the flight that begins with `path`."""
    first, header = _header(path), _header(following)
    if first is None or header is None or header.part != part:
        return False
    return header.begin_us is None or header.begin_us == first.begin_us


def _header(path: Path) -> Header | None:
    """The header that a file begins with; None if it begins with none."""
    reader = NoteReader()
    try:
        for _, message in read_tlog(path):
            if not is_note(message):
                return None
            note = reader.take(message)
            if note is not None:
                return note if isinstance(note, Header) else None
    except (UserError, ValueError):  # no log, or a damaged one: whoever reads it says so
        return None
    return None
