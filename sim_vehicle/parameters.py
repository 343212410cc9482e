"""Firmware parameters: names, types, values, and how each personality puts them on the wire.

MAVLink carries every parameter in one float field. PX4 puts the *bytes* of an integer there
(MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE), ArduPilot the *number*
(MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST).
"""

from __future__ import annotations

import difflib
import math
import struct
import zlib
from collections.abc import Iterable, Mapping
from typing import Literal, NamedTuple, TypeAlias

Encoding: TypeAlias = Literal["bytewise", "c-cast"]
Kind: TypeAlias = Literal["int8", "int16", "int32", "real32"]

WIRE_TYPE: Mapping[Kind, int] = {"int8": 2, "int16": 4, "int32": 6, "real32": 9}
"""MAV_PARAM_TYPE of each kind."""

_LARGEST_REAL32 = (2.0 - 2.0**-23) * 2.0**127
_RANGE: Mapping[str, int] = {"int8": 1 << 7, "int16": 1 << 15, "int32": 1 << 31}


class Parameter(NamedTuple):
    """One parameter: name of at most 16 characters, default and kind."""

    name: str
    default: float
    kind: Kind


class ParameterStore:
    """The parameters of one vehicle. `revision` counts changes, so that users can cache what they derive."""

    def __init__(self, table: Iterable[Parameter], encoding: Encoding) -> None:
        self.encoding = encoding
        self.revision = 0
        ordered = sorted(table)
        self.names: tuple[str, ...] = tuple(parameter.name for parameter in ordered)
        self._kinds: dict[str, Kind] = {parameter.name: parameter.kind for parameter in ordered}
        self._values: dict[str, float] = {parameter.name: parameter.default for parameter in ordered}

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __getitem__(self, name: str) -> float:
        """Value of a parameter; KeyError if there is none of that name."""
        return self._values[name]

    def kind(self, name: str) -> Kind:
        """Kind of a parameter; KeyError if there is none of that name."""
        return self._kinds[name]

    def set(self, name: str, value: float) -> None:
        """Change a parameter.

        Raises ValueError, with a line for people, if the name is unknown, the value is not finite, or
        an integer parameter is given a fraction or a number that does not fit.
        """
        if name not in self._values:
            close = difflib.get_close_matches(name, self.names, n=1)
            hint = f"did you mean {close[0]}?" if close else "this personality has no such parameter"
            raise ValueError(f"unknown parameter; {hint}")
        if not math.isfinite(value):
            raise ValueError(f"{value} is not a number; give a finite one")
        kind = self._kinds[name]
        if abs(value) > _LARGEST_REAL32:
            raise ValueError(f"{value:g} does not fit {kind}; the limit is {_LARGEST_REAL32:.7g}")
        if kind != "real32":
            if value != int(value):
                raise ValueError(f"{value:g} is not a whole number; {name} is an integer parameter")
            if not -_RANGE[kind] <= value < _RANGE[kind]:
                raise ValueError(f"{value:g} does not fit {kind}; the limit is {_RANGE[kind] - 1}")
        self._values[name] = value
        self.revision += 1

    def checksum(self) -> int:
        """PX4's `_HASH_CHECK`: CRC-32, without its inversions, of names and 4-byte values in order."""
        inverted = 0xFFFFFFFF
        for name in self.names:
            code = "f" if self._kinds[name] == "real32" else "i"
            value = self._values[name] if code == "f" else int(self._values[name])
            inverted = zlib.crc32(name.encode() + struct.pack(f"<{code}", value), inverted)
        return inverted ^ 0xFFFFFFFF

    def to_wire(self, name: str) -> float:
        """What the float field of PARAM_VALUE must hold."""
        value, kind = self._values[name], self._kinds[name]
        if self.encoding == "bytewise" and kind != "real32":
            return float(struct.unpack("<f", struct.pack("<i", int(value)))[0])
        return value

    def from_wire(self, name: str, field: float, wire_type: int) -> float:
        """Number meant by the float field of PARAM_SET.

        Raises ValueError if the name is unknown or, bytewise, the type sent is not the parameter's own.
        """
        if name not in self._values:
            raise ValueError("unknown parameter")
        kind = self._kinds[name]
        if self.encoding == "c-cast":
            return field if kind == "real32" or not math.isfinite(field) else float(round(field))
        if wire_type != WIRE_TYPE[kind]:
            raise ValueError(f"type {wire_type} sent for {name}, which has type {WIRE_TYPE[kind]}")
        if kind == "real32":
            return field
        return float(struct.unpack("<i", struct.pack("<f", field))[0])
