"""One line for people out of pydantic's account of what is wrong with a configuration."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

_UNITS = (
    ("_rad_s", "rad/s"),
    ("_m_s2", "m/s^2"),
    ("_m_s", "m/s"),
    ("_deg", "degrees"),
    ("_rad", "radians"),
    ("_kg", "kg"),
    ("_hz", "Hz"),
    ("_n", "newtons"),
    ("_s", "seconds"),
    ("_m", "metres"),
)


def unit_of(key: str) -> str:
    """Unit in words that a key's name ends in, or nothing."""
    return next((unit for ending, unit in _UNITS if key.endswith(ending)), "")


def describe(problem: ValidationError, model: type[BaseModel]) -> str:
    """The first problem as `key.path = value: what is wrong; remedy`."""
    detail = problem.errors()[0]
    path = _path(detail["loc"])
    what = _what(detail, model)
    if not path:
        return what
    if detail["type"] == "value_error" and isinstance(detail.get("input"), dict | BaseModel):
        # A rule about a whole section names its key itself.
        return f"{path}.{what}"
    if detail["type"] == "missing":
        return f"{path}: {what}"
    return f"{path} = {_shown(detail.get('input'))}: {what}"


def _path(location: Sequence[int | str]) -> str:
    parts = [
        f"[{part}]" if isinstance(part, int) else f".{part}" for part in location if part not in _BRANCHES
    ]
    return "".join(parts).lstrip(".")


_BRANCHES = ("float", "int")
"""Names that pydantic adds to the path for the alternatives of a union."""


def _shown(value: Any) -> str:
    text = repr(value) if isinstance(value, str) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _what(detail: ErrorDetails, model: type[BaseModel]) -> str:
    kind, context = detail["type"], detail.get("ctx", {})
    names = [part for part in detail["loc"] if isinstance(part, str) and part not in _BRANCHES]
    unit = unit_of(names[-1]) if names else ""
    in_unit = f" {unit}" if unit else ""
    if kind == "extra_forbidden":
        return _unknown(detail["loc"], model)
    if kind == "value_error":
        return str(context["error"])
    if kind == "missing":
        return f"missing; give a value{' in' + in_unit if unit else ''}"
    if kind in ("greater_than_equal", "greater_than"):
        word = "at least" if kind == "greater_than_equal" else "more than"
        return f"too small; the limit is {word} {context.get('ge', context.get('gt'))}{in_unit}"
    if kind in ("less_than_equal", "less_than"):
        return f"too large; the limit is {context.get('le', context.get('lt'))}{in_unit}"
    if kind == "finite_number":
        return f"not finite; give a number{' of' + in_unit if unit else ''}"
    if kind in ("float_type", "int_type"):
        whole = "whole number" if kind == "int_type" else "number"
        return f"not a {whole}; give a {whole}{' of' + in_unit if unit else ''}, without quotes"
    if kind == "literal_error":
        return f"not a choice; choose {context['expected']}"
    if kind == "bool_type":
        return "neither true nor false; give one of them"
    if kind in ("tuple_type", "too_short", "too_long"):
        return "not a list of the right length"
    if kind == "dict_type" or kind == "model_type":
        return "not a table; write it as [section] with keys below"
    return detail["msg"]


def _unknown(location: Sequence[int | str], model: type[BaseModel]) -> str:
    key = str(location[-1])
    known = _fields_at(location[:-1], model)
    close = difflib.get_close_matches(key, known, n=1)
    if close:
        unit = unit_of(close[0])
        return f"unknown key; did you mean {close[0]}{f' (in {unit})' if unit else ''}?"
    elsewhere = [
        f"[{section}] {name}"
        for section in model.model_fields
        for name in _fields_at([section], model)
        if name == key
    ]
    if elsewhere:
        return f"unknown key here; it belongs to {elsewhere[0]}"
    return f"unknown key; choose one of {', '.join(known)}"


def _fields_at(location: Sequence[int | str], model: type[BaseModel]) -> list[str]:
    """Names of the fields at a place of the configuration."""
    here: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        here = here.model_fields[part].annotation
        if get_args(here):
            here = get_args(here)[0]
        if not (isinstance(here, type) and issubclass(here, BaseModel)):
            return []
    return list(here.model_fields)
