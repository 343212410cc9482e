"""ArduPilot's DataFlash container (.BIN): self-describing records, read into numpy arrays.

Layout and format letters from ArduPilot libraries/AP_Logger/LogStructure.h. Written here rather than taken
from
pymavlink's DFReader because that one loops for ever on a damaged record of length 0 and reads a field at a
time; the tests compare the two. Damaged stretches are skipped to the next record header and counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.errors import UserError

HEADER = b"\xa3\x95"
FORMAT_TYPE = 0x80
FORMAT_LENGTH = 89
_HEADER_SIZE = 3

#: Format letter -> numpy type and the factor that makes the stored integer the value.
LETTERS: dict[str, tuple[str, float]] = {
    "a": ("<i2", 1.0),  # 32 of them
    "b": ("i1", 1.0),
    "B": ("u1", 1.0),
    "h": ("<i2", 1.0),
    "H": ("<u2", 1.0),
    "i": ("<i4", 1.0),
    "I": ("<u4", 1.0),
    "f": ("<f4", 1.0),
    "d": ("<f8", 1.0),
    "g": ("<f2", 1.0),
    "n": ("S4", 1.0),
    "N": ("S16", 1.0),
    "Z": ("S64", 1.0),
    "c": ("<i2", 0.01),
    "C": ("<u2", 0.01),
    "e": ("<i4", 0.01),
    "E": ("<u4", 0.01),
    "L": ("<i4", 1e-7),
    "M": ("u1", 1.0),
    "q": ("<i8", 1.0),
    "Q": ("<u8", 1.0),
}


@dataclass(frozen=True)
class _Format:
    name: str
    dtype: np.dtype[np.void]
    factors: dict[str, float]


@dataclass(frozen=True)
class DataFlash:
    """A whole log.

    Attributes
    ----------
    tables : by message name, then column; each ``(n,)``, scaled by the format letter as the units in FMTU say
    skipped_bytes : how many were no part of a record
    end_cut : the last record is incomplete
    """

    tables: dict[str, dict[str, NDArray[np.generic]]]
    skipped_bytes: int
    end_cut: bool


def _format(body: bytes) -> tuple[int, int, _Format] | None:
    """Type, length and layout that an FMT record declares; None if it cannot be one."""
    kind, length = body[0], body[1]
    name = body[2:6].rstrip(b"\0").decode("ascii", "replace")
    letters = body[6:22].rstrip(b"\0").decode("ascii", "replace")
    columns = body[22:86].rstrip(b"\0").decode("ascii", "replace").split(",")
    if len(columns) != len(letters) or len(set(columns)) != len(columns) or not all(columns):
        return None
    if not all(letter in LETTERS for letter in letters):
        return None
    fields = [
        (column, LETTERS[letter][0], (32,)) if letter == "a" else (column, LETTERS[letter][0])
        for column, letter in zip(columns, letters, strict=True)
    ]
    dtype: np.dtype[np.void] = np.dtype(fields)
    if dtype.itemsize + _HEADER_SIZE != length:
        return None
    factors = {column: LETTERS[letter][1] for column, letter in zip(columns, letters, strict=True)}
    return kind, length, _Format(name, dtype, factors)


def _is_unknown(body: bytes) -> bool:
    """True for the declaration of a record with letters that are not known: its length is."""
    name, letters, columns = (body[a:b].rstrip(b"\0") for a, b in ((2, 6), (6, 22), (22, 86)))
    whole = name.isalnum() and letters.isascii() and columns.replace(b",", b"").replace(b"_", b"").isalnum()
    return whole and body[0] != FORMAT_TYPE and body[1] > _HEADER_SIZE and len(letters) > 0


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"cannot read {path}: {error.strerror}; check the path") from error


def read(path: Path, names: frozenset[str]) -> DataFlash:
    """Read the messages `names` of a log.

    Raises UserError if the file cannot be read or holds no format records.
    """
    data = _bytes(path)
    formats: dict[int, _Format] = {}
    lengths: dict[int, int] = {FORMAT_TYPE: FORMAT_LENGTH}
    offsets: dict[int, list[int]] = {}
    offset, skipped, end_cut = 0, 0, False
    size = len(data)
    while offset + _HEADER_SIZE <= size:
        kind = data[offset + 2]
        length = lengths.get(kind)
        if data[offset : offset + 2] != HEADER or length is None:
            following = data.find(HEADER, offset + 1)
            end = size if following < 0 else following
            skipped += end - offset if any(data[offset:end]) else 0  # flash pages are padded with zeros
            offset = end
            continue
        if offset + length > size:
            end_cut = True
            break
        if kind == FORMAT_TYPE:
            body = data[offset + _HEADER_SIZE : offset + length]
            declared = _format(body)
            if declared is not None and declared[0] != FORMAT_TYPE and declared[0] not in formats:
                lengths[declared[0]] = declared[1]
                formats[declared[0]] = declared[2]
            elif declared is None and _is_unknown(body):
                lengths.setdefault(body[0], body[1])
        elif kind in formats:
            offsets.setdefault(kind, []).append(offset)
        offset += length
    if not formats:
        raise UserError(
            f"{path}: no DataFlash records; give the .BIN file of an ArduPilot vehicle as it was downloaded"
        )
    tables = {
        layout.name: _table(data, layout, offsets[kind])
        for kind, layout in formats.items()
        if layout.name in names and kind in offsets
    }
    return DataFlash(tables, skipped, end_cut)


def _table(data: bytes, layout: _Format, offsets: list[int]) -> dict[str, NDArray[np.generic]]:
    """Columns of one message type."""
    width = layout.dtype.itemsize
    body = b"".join(data[offset + _HEADER_SIZE : offset + _HEADER_SIZE + width] for offset in offsets)
    rows = np.frombuffer(body, dtype=layout.dtype)
    return {
        column: rows[column] if rows[column].dtype.kind == "S" else rows[column].astype(float) * factor
        for column, factor in layout.factors.items()
    }
