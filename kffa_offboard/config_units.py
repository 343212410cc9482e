"""Numbers with a unit in a configuration: what is plausible, and what a wrong one may have meant.

The unit stands in the name of the key (`delay_s`, `tilt_max_deg`), except for omega_c and omega_o, which are
rad/s wherever control engineers meet. A number outside its plausible range is nearly always a number
in another unit, so the message asks.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from pydantic import BeforeValidator
from pydantic.fields import FieldInfo

UNIT_WORDS = {
    "": "",
    "s": "seconds",
    "Hz": "hertz",
    "kg": "kilograms",
    "m": "metres",
    "m/s": "metres per second",
    "m/s^2": "metres per second squared",
    "deg": "degrees",
    "deg/s": "degrees per second",
    "deg/s^2": "degrees per second squared",
    "rad": "radians",
    "rad/s": "radians per second",
    "rad/s^2": "radians per second squared",
    "1/s": "per second",
    "of full thrust": "fraction of full thrust",
    "%": "percent",
}
SMALLEST, LARGEST = 1e-30, 1e30
"""Sizes beyond are no quantities, and their squares may be 0 or infinite."""

_TOO_LARGE = {
    "s": "milliseconds",
    "m": "millimetres",
    "m/s": "centimetres per second",
    "rad": "degrees",
    "rad/s": "degrees per second",
    "rad/s^2": "degrees per second squared",
    "of full thrust": "percent",
}
_TOO_SMALL = {"deg": "radians", "deg/s": "radians per second", "deg/s^2": "radians per second squared"}
_FACTORS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "min": 60.0},
    "Hz": {"Hz": 1.0, "kHz": 1e3},
    "kg": {"kg": 1.0, "g": 1e-3, "lb": 0.45359237},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "km/h": 1.0 / 3.6},
    "m/s^2": {"m/s^2": 1.0, "m/s2": 1.0, "g": 9.80665},
    "deg": {"deg": 1.0, "°": 1.0, "rad": math.degrees(1.0)},
    "deg/s": {"deg/s": 1.0, "°/s": 1.0, "rad/s": math.degrees(1.0)},
    "rad": {"rad": 1.0, "deg": math.radians(1.0), "°": math.radians(1.0)},
    "rad/s": {"rad/s": 1.0, "Hz": 2.0 * math.pi, "deg/s": math.radians(1.0)},
    "of full thrust": {"%": 1e-2},
}
_NUMBER_AND_UNIT = re.compile(r"\s*([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)\s*(\S*)\s*")


@dataclass(frozen=True)
class Quantity:
    """Range and unit of one key; calling it checks a value and gives it back as a float.

    Attributes
    ----------
    unit : a key of `UNIT_WORDS`; empty for a plain number
    above, at_least, at_most : bounds, in that unit; None for none
    """

    unit: str
    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None

    def __call__(self, value: object) -> float:
        """Raise ValueError, to be read behind ``key = value:``, if `value` is none that can be meant."""
        if isinstance(value, str):
            raise ValueError(f"must be a number{self._of_unit()}, without quotes{self._converted(value)}")
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError(f"must be a number{self._of_unit()}")
        number = _as_float(value)
        if not math.isfinite(number):
            raise ValueError(f"must be a finite number{self._of_unit()}")
        if self.above is not None and number <= self.above:
            raise ValueError(f"must be greater than {self._bound(self.above)}")
        if self.at_least is not None and number < self.at_least:
            raise ValueError(self._too_small(number, self.at_least))
        if self.at_most is not None and number > self.at_most:
            raise ValueError(self._too_large(number, self.at_most))
        if number != 0.0 and not SMALLEST <= abs(number) <= LARGEST:
            raise ValueError(f"must have a size from {SMALLEST:g} to {LARGEST:g}")
        return number

    @property
    def words(self) -> str:
        """The unit in words; empty for a plain number."""
        return UNIT_WORDS[self.unit]

    def _of_unit(self) -> str:
        return f" ({self.words})" if self.words else ""

    def _bound(self, bound: float) -> str:
        return f"{bound:g} {self.unit}".rstrip()

    def _too_small(self, number: float, bound: float) -> str:
        meant = _TOO_SMALL.get(self.unit)
        if meant is not None and number > 0.0:
            return f"is below {self._bound(bound)}; were these {meant}?"
        return f"must be at least {self._bound(bound)}"

    def _too_large(self, number: float, bound: float) -> str:
        meant = _TOO_LARGE.get(self.unit)
        if meant is not None and number >= 2.0 * bound:
            return f"is above {self._bound(bound)}; were these {meant}?"
        return f"must be at most {self._bound(bound)}"

    def _converted(self, text: str) -> str:
        """The number that ``20 ms`` means, as a remedy."""
        match = _NUMBER_AND_UNIT.fullmatch(text)
        factors = _FACTORS.get(self.unit, {}) | {"": 1.0}
        if match is None or match[2] not in factors:
            return ""
        try:
            return f"; write {float(match[1]) * factors[match[2]]:g}"
        except ValueError:
            return ""


def _as_float(value: float) -> float:
    """The same; infinite for a whole number that has no float."""
    try:
        return float(value)
    except OverflowError:
        return math.inf


def number(
    unit: str = "", *, above: float | None = None, at_least: float | None = None, at_most: float | None = None
) -> BeforeValidator:
    """Annotation of a float field: ``Annotated[float, number("s", at_least=0.0, at_most=0.5)]``."""
    return BeforeValidator(Quantity(unit, above, at_least, at_most))


def quantity_of(field: FieldInfo) -> Quantity | None:
    """What `number` said about a field; None for a field that is no number."""
    for annotation in field.metadata:
        if isinstance(annotation, BeforeValidator) and isinstance(annotation.func, Quantity):
            return annotation.func
    return None
