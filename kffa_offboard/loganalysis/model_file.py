"""MODEL.toml: identified channels as tables of a daemon's configuration, and merged into one."""

from __future__ import annotations

from typing import Any

from kffa_offboard.loganalysis.identify import Identification, kind_of

_DIGITS = 4


def model_tables(found: Identification, link_delay_s: float) -> dict[str, Any]:
    """The `[control]` tables of the identified channels.

    `delay_s` counts from the sample: the identified delay, the age of the sample, and `link_delay_s` where
    the log was written on board and has not seen the link.
    """
    control: dict[str, Any] = {}
    for channel in found.channels:
        table = {name: round(estimate.value, _DIGITS) for name, estimate in channel.parameters.items()}
        added = 0.0 if found.whole_loop else link_delay_s
        table["delay_s"] = round(channel.delay.value + channel.sample_age_s + added, _DIGITS)
        kind, _, axis = channel.name.partition(".")
        if kind_of(channel.name) == "altitude":
            control["altitude"] = table
        else:
            control.setdefault(kind, {})[axis] = table
    return {"control": control}


def merged(base: dict[str, Any], changes: dict[str, Any]) -> dict[str, Any]:
    """`base` with the tables of `changes` put in, key by key."""
    result = dict(base)
    for key, value in changes.items():
        before = result.get(key)
        result[key] = merged(before, value) if isinstance(value, dict) and isinstance(before, dict) else value
    return result


def as_toml(tables: dict[str, Any], comments: dict[str, list[str]] | None = None, head: str = "") -> str:
    """Nested tables of numbers and texts as TOML; `comments` stand above the tables that they name."""
    lines = [f"# {line}" for line in head.splitlines()]

    def write(prefix: str, table: dict[str, Any]) -> None:
        values = {key: value for key, value in table.items() if not isinstance(value, dict)}
        if values:
            lines.append("")
            lines.extend(f"# {comment}" for comment in (comments or {}).get(prefix, []))
            lines.append(f"[{prefix}]")
            lines.extend(f"{key} = {_literal(value)}" for key, value in values.items())
        for key, value in table.items():
            if isinstance(value, dict):
                write(f"{prefix}.{key}" if prefix else key, value)

    write("", tables)
    return "\n".join([*lines, ""])


def _literal(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else repr(value)
