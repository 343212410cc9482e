"""Tables as TOML text: the configurations that the comparison writes for its child processes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def toml_text(document: Mapping[str, Any]) -> str:
    """TOML of nested tables with text, numbers, booleans and arrays.

    Every key of the top level becomes one line, `key = value`, with tables inline.
    """
    return "".join(f"{json.dumps(key)} = {_value(value)}\n" for key, value in document.items())


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with `changes` on top, table by table; arrays are replaced."""
    result = dict(base)
    for key, value in changes.items():
        below = result.get(key)
        result[key] = (
            merged(below, value) if isinstance(below, Mapping) and isinstance(value, Mapping) else value
        )
    return result


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{json.dumps(key)} = {_value(entry)}" for key, entry in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(entry) for entry in value) + "]"
    return json.dumps(value)
