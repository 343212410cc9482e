"""One line of the self-test: what was measured, what it must be, and whether it is."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Row:
    """A result.

    Attributes
    ----------
    group, name : what was tested
    measured, limit : with units, for people
    passed : None for what is only told
    value : the measured number in SI units, None if there is none
    """

    group: str
    name: str
    measured: str
    limit: str
    passed: bool | None
    value: float | None = None


def at_most(group: str, name: str, value: float, limit: float, unit: str) -> Row:
    """A number that must not exceed its limit (one that is not a number does)."""
    return Row(group, name, f"{value:.3g} {unit}", f"{limit:g} {unit}", bool(value <= limit), float(value))
