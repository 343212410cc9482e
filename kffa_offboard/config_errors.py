"""What is wrong with a configuration, one line for each problem, with the remedy.

pydantic finds the problems; this turns its list into lines like
``control.altitude.delay_ms = 20: unknown key; did you mean delay_s (seconds)?``.
"""

from __future__ import annotations

import difflib
import types
from collections.abc import Iterator
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from kffa_offboard.config_units import quantity_of

Location = tuple[int | str, ...]

# Longest first, so that rate_rad_s is not taken for a "rate_rad" in seconds.
_UNIT_SUFFIXES = sorted(
    (
        *("s", "ms", "us", "sec", "seconds", "hz", "m", "mm", "cm", "m_s", "m_s2", "deg", "degrees", "deg_s"),
        *("deg_s2", "rad", "radians", "rad_s", "rad_s2", "per_s", "percent", "pct", "kg", "n"),
    ),
    key=len,
    reverse=True,
)


def explain(error: ValidationError, model: type[BaseModel]) -> list[str]:
    """One line for each problem in `error`, which validating `model` raised."""
    return [_line(detail, model) for detail in error.errors(include_url=False)]


def toml_value(value: object) -> str:
    """`value` as it is written in TOML, shortened to what fits on a line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        text = '"' + value + '"'
    elif isinstance(value, dict):
        text = "{...}"
    else:
        text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _line(detail: ErrorDetails, model: type[BaseModel]) -> str:
    location, value = detail["loc"], detail["input"]
    path = key_path(location, model)
    match detail["type"]:
        case "extra_forbidden":
            table = table_at(model, location[:-1])
            kind = "table" if isinstance(value, dict) else "key"
            shown = path if isinstance(value, (dict, list)) else f"{path} = {toml_value(value)}"
            return f"{shown}: unknown {kind}; {_did_you_mean(str(location[-1]), table, model)}"
        case "missing":
            return f"{path}: missing; {_wanted(model, location)}"
        case "union_tag_not_found":
            return f"{path}: type is missing; write type = one of {_tags(model, location)}"
        case "union_tag_invalid":
            wrong = value.get("type") if isinstance(value, dict) else value
            return f"{path}: type = {toml_value(wrong)}: must be one of {_tags(model, location)}"
        case "value_error" if not location or isinstance(value, dict):
            return f"{path + ': ' if path else ''}{finding(detail)}"
        case _:
            return f"{path} = {toml_value(value)}: {finding(detail)}"


def finding(detail: ErrorDetails) -> str:
    """What pydantic found, in words that need no knowledge of pydantic."""
    match detail["type"]:
        case "value_error":
            return str(detail["ctx"]["error"])
        case "literal_error":
            choices = detail["ctx"]["expected"].replace(" or ", ", ").replace("'", '"')
            return f"must be one of {choices}"
        case "string_type":
            return "must be text in quotes"
        case "bool_type" | "bool_parsing":
            return "must be true or false"
        case "int_type" | "int_parsing" | "int_from_float":
            return "must be a whole number"
        case "float_type" | "float_parsing":
            return "must be a number"
        case "greater_than_equal":
            return f"must be at least {detail['ctx']['ge']}"
        case "less_than_equal":
            return f"must be at most {detail['ctx']['le']}"
        case "model_type" | "model_attributes_type" | "dict_type":
            return "must be a table, with keys of its own"
        case "list_type" | "tuple_type":
            return "must be a list in square brackets"
        case "too_short" | "too_long":
            return f"must have {detail['ctx'].get('min_length', detail['ctx'].get('max_length'))} entries"
        case _:
            return detail["msg"][:1].lower() + detail["msg"][1:]


def key_path(location: Location, model: type[BaseModel]) -> str:
    """``control.altitude.omega_c``; list entries count from 1: ``scenario.segment 2 (step).amplitude_m``."""
    path = ""
    for k, part in enumerate(location):
        if isinstance(part, int):
            path += f" {part + 1}"
        elif k > 0 and isinstance(location[k - 1], int) and part in _tag_names(model, location[: k - 1]):
            path += f" ({part})"
        else:
            path += f".{part}" if path else part
    return path


def _unwrap(annotation: Any) -> Any:
    """The type behind Annotated and Optional."""
    while True:
        if get_origin(annotation) is Annotated:
            annotation = get_args(annotation)[0]
        elif get_origin(annotation) in (Union, types.UnionType) and type(None) in get_args(annotation):
            annotation = next(kind for kind in get_args(annotation) if kind is not type(None))
        else:
            return annotation


def _is_table(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, BaseModel)


def table_at(model: type[BaseModel], location: Location) -> type[BaseModel] | None:
    """The table that stands at `location`; None if none does."""
    current: Any = model
    for part in location:
        current = _unwrap(current)
        if _is_table(current):
            if part not in current.model_fields:
                return None
            current = current.model_fields[str(part)].annotation
        elif get_origin(current) in (list, tuple) and isinstance(part, int):
            current = get_args(current)[0]
        elif get_origin(current) in (Union, types.UnionType):
            current = next((kind for kind in get_args(current) if part == _tag(kind)), None)
    current = _unwrap(current)
    return current if _is_table(current) else None


def _tag(kind: Any) -> str | None:
    """The one value of the `type` key of a table in a list of several kinds."""
    field = kind.model_fields.get("type") if _is_table(kind) else None
    return (
        None
        if field is None or get_origin(field.annotation) is not Literal
        else get_args(field.annotation)[0]
    )


def _tag_names(model: type[BaseModel], location: Location) -> list[str]:
    """Tags of the kinds of table in the list at `location`."""
    table = table_at(model, location[:-1])
    if table is None or location[-1] not in table.model_fields:
        return []
    listed = _unwrap(table.model_fields[str(location[-1])].annotation)
    kinds = get_args(_unwrap(get_args(listed)[0])) if get_args(listed) else ()
    return [tag for tag in map(_tag, kinds) if tag is not None]


def _tags(model: type[BaseModel], location: Location) -> str:
    return ", ".join(f'"{tag}"' for tag in _tag_names(model, location[:-1]))


def _wanted(model: type[BaseModel], location: Location) -> str:
    """What a missing key is, from its description."""
    table = table_at(model, location[:-1])
    field = table.model_fields.get(str(location[-1])) if table is not None else None
    return f"give {field.description}" if field is not None and field.description else "it must be given"


def stem(key: str) -> str:
    """The key without its unit: delay for delay_ms."""
    for suffix in _UNIT_SUFFIXES:
        if key.endswith("_" + suffix):
            return key.removesuffix("_" + suffix)
    return key


def _with_unit(table: type[BaseModel], key: str) -> str:
    quantity = quantity_of(table.model_fields[key])
    return f"{key} ({quantity.words})" if quantity is not None and quantity.words else key


def _did_you_mean(key: str, table: type[BaseModel] | None, model: type[BaseModel]) -> str:
    """The nearest known key here, the same key in another table, or all the keys that are known here."""
    if table is None:
        return "remove it"
    known = list(table.model_fields)
    same_stem = [name for name in known if stem(name) == stem(key)]
    close = same_stem or difflib.get_close_matches(key, known, n=1, cutoff=0.7)
    if close:
        return f"did you mean {' or '.join(_with_unit(table, name) for name in close)}?"
    elsewhere = [path for path in _all_keys(model, "") if path.rpartition(".")[2] == key]
    if elsewhere:
        return f"did you mean {' or '.join(elsewhere[:3])}?"
    by_stem = {stem(name): name for name in known}
    near = difflib.get_close_matches(stem(key), list(by_stem), n=1, cutoff=0.6)
    if near:
        return f"did you mean {_with_unit(table, by_stem[near[0]])}?"
    return f"known here: {', '.join(known)}"


def _all_keys(table: type[BaseModel], prefix: str) -> Iterator[str]:
    for name, field in table.model_fields.items():
        yield prefix + name
        kind = _unwrap(field.annotation)
        if _is_table(kind):
            yield from _all_keys(kind, f"{prefix}{name}.")
