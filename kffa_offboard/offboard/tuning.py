"""Numbers that may be changed in flight: what a parameter server asks for and what the service is told.

Which numbers these are, their names and their ranges come from the configuration; here is only the
vocabulary between it and MAVLink, and how the service goes on with other settings.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from msgspec.structs import replace

from kffa_offboard.control import vehicle
from kffa_offboard.control.retuning import retuned
from kffa_offboard.offboard.horizontal import flown_ring
from kffa_offboard.offboard.loop import LoopState
from kffa_offboard.offboard.settings import ServiceSettings


@dataclass(frozen=True, slots=True)
class Tunable:
    """One number: `name` (16 characters at most), value, plausible range (infinite: no bound) and meaning."""

    name: str
    value: float
    lower: float
    upper: float
    description: str


class TuningProblem(ValueError):
    """Why a value cannot be taken, or a file not read or written; one line."""


class TuningStore(Protocol):
    """Text that is kept under a file's name."""

    @property
    def path(self) -> Path:
        """The file."""

    def read(self) -> str | None:
        """What is stored, None if nothing is. Raises TuningProblem if it cannot be read."""

    def write(self, text: str) -> None:
        """Store `text` in place of what was there. Raises TuningProblem if it cannot be written."""


class Tuning(Protocol):
    """A set of tunables and the settings that follow from them; a value."""

    @property
    def tunables(self) -> tuple[Tunable, ...]:
        """All of them, always in the same order."""

    @property
    def settings(self) -> ServiceSettings:
        """What the service flies with."""

    def with_value(self, name: str, value: float) -> Tuning:
        """The same with another value of `name`; TuningProblem if that cannot be flown."""

    def stored(self) -> str:
        """Keep the values for the next start; says what was done. TuningProblem if it cannot be."""

    def reread(self) -> Tuning:
        """With the values that were stored last. TuningProblem if they cannot be read."""

    def original(self) -> Tuning:
        """With the values of the configuration, without those that were stored."""


def adopt(loop: LoopState | None, before: ServiceSettings, after: ServiceSettings) -> LoopState | None:
    """The loop's state for going on with `after` at the next step.

    Raises ValueError if structure, not only numbers, differs.
    """
    if before.output != after.output or (before.position is None) != (after.position is None):
        raise ValueError("what is commanded cannot be changed in flight")
    if loop is None:
        return None
    standing = vehicle.as_arrays(loop.controller)
    loop = replace(loop, controller=retuned(before.controller, after.controller, standing))
    if loop.horizontal is None or before.position is None or after.position is None:
        return loop
    flown = loop.horizontal
    rings = flown_ring(before.position, flown).controller, flown_ring(after.position, flown).controller
    return replace(loop, horizontal=replace(loop.horizontal, ring=retuned(*rings, loop.horizontal.ring)))
