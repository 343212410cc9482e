"""The daemon's tuning as MAVLink parameters: listed, read, set while flying.

The parameter protocol with REAL32 values only. What a value may be is decided by the tuning, which is made
from the configuration, and in flight by the service; a refused value is answered with the unchanged one and a
STATUSTEXT with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import Message
from kffa_offboard.offboard.events import Announce, SettingsChanged, Severity
from kffa_offboard.offboard.tuning import Tunable, Tuning, TuningProblem

Reply: TypeAlias = Message | Announce
"""What goes out to whoever asked: a message, or a text for everybody."""

LIST_PERIOD_US = 50_000
LIST_AT_ONCE = 5
"""Of a list so many go out every `LIST_PERIOD_US`: 100 per second, 4 kB/s."""

CHANGE_PERIOD_US = 50_000
CHANGES_AT_ONCE = 5
"""Working out other values takes half a control period: more often than this, and after so many at once, it
is not done, as if the request had been lost."""

REAL32 = mavlink.MAV_PARAM_TYPE_REAL32


def decimal(value: float) -> float:
    """The shortest decimal number that is this float32: 8.1, not 8.100000381."""
    with np.errstate(over="ignore"):
        return float(str(np.float32(value)))


@dataclass(frozen=True, slots=True)
class _Change:
    """A change that the service is being told of.

    Attributes
    ----------
    before : the values before
    index : of the parameter that is answered, None for all together
    said, refused : what is said if it is taken, and before the reason if it is not
    refusal : why the service does not take it
    """

    before: Tuning
    index: int | None
    said: str
    refused: str
    refusal: str | None = None


class ParameterServer:
    """Answers the parameter protocol for one tuning; None has no parameters.

    Attributes
    ----------
    tuning : the present values
    """

    def __init__(self, tuning: Tuning | None) -> None:
        self.tuning = tuning
        self._next_index = self._remaining = 0
        self._due_us = self._changes_until_us = 0
        self._change: _Change | None = None

    @property
    def tunables(self) -> tuple[Tunable, ...]:
        """All parameters, by index."""
        return () if self.tuning is None else self.tuning.tunables

    def request_list(self, time_us: int) -> None:
        """Begin the list; one that is under way goes on from where it is, all around.

        So everybody who asks gets all of it, and it comes no faster however often that is.
        """
        if self._remaining == 0:
            self._next_index, self._due_us = 0, max(time_us, self._due_us)
        self._remaining = len(self.tunables)

    def next_deadline(self) -> int | None:
        """When the next part of the list is due."""
        return self._due_us if self._remaining else None

    def advance(self, time_us: int) -> list[Reply]:
        """The part of the list that is due."""
        if self._remaining == 0 or time_us < self._due_us:
            return []
        count, total = min(LIST_AT_ONCE, self._remaining), len(self.tunables)
        part: list[Reply] = [self._value((self._next_index + k) % total) for k in range(count)]
        self._next_index, self._remaining = (self._next_index + count) % total, self._remaining - count
        self._due_us += LIST_PERIOD_US
        return part

    def read(self, message: Message) -> list[Reply]:
        """Answer PARAM_REQUEST_READ: by index, or by name if the index is -1."""
        index = message.param_index if message.param_index >= 0 else self._index(message.param_id)
        if index is None or index >= len(self.tunables):
            asked = message.param_id if index is None else f"index {index}"
            return [Announce(Severity.WARNING, f"parameter {_shown(asked)}: not known")]
        return [self._value(index)]

    def unchanged(self, message: Message) -> list[Reply]:
        """Answer a PARAM_SET that is not to be done, as the protocol wants: with the present value."""
        index = self._index(message.param_id)
        return [] if index is None else [self._value(index)]

    def takes_change(self, time_us: int) -> bool:
        """True if there is time for one more change now; then it counts."""
        until_us = max(self._changes_until_us, time_us) + CHANGE_PERIOD_US
        if until_us - time_us > CHANGES_AT_ONCE * CHANGE_PERIOD_US:
            return False
        self._changes_until_us = until_us
        return True

    def set(self, time_us: int, message: Message) -> tuple[list[Reply], list[SettingsChanged]]:
        """Answer PARAM_SET; or tell the service that something is other than before, and see `conclude`.

        What comes too often is not answered: whoever sent it sends it again, or sees that it was not done.
        """
        name = message.param_id
        index = self._index(name)
        if index is None or self.tuning is None:
            return [Announce(Severity.WARNING, f"parameter {_shown(name)}: not known")], []
        value, before = decimal(message.param_value), self.tunables[index].value
        problem, tuning = None, self.tuning
        if message.param_type != REAL32:
            problem = f"type {message.param_type}: parameters are REAL32 ({REAL32})"
        elif value != decimal(before):
            if not self.takes_change(time_us):
                return [], []
            try:
                tuning = self.tuning.with_value(name, value)
            except TuningProblem as error:
                problem = f"{value:g}: {_reason(error)}"
        if problem is not None:
            return [self._value(index), Announce(Severity.WARNING, f"{name} refused: {problem}")], []
        if value == decimal(before):
            return [self._value(index)], []
        said = f"{name} {before:g} -> {value:g}"
        self._change = _Change(self.tuning, index, said, f"{name} refused: {value:g}")
        self.tuning = tuning
        return [], [SettingsChanged(tuning.settings)]

    def refuse(self, reason: str) -> None:
        """The service does not take the change that it was just told of: all is as it was."""
        if self._change is not None:
            self.tuning = self._change.before
            self._change = replace(self._change, refusal=reason)

    def conclude(self) -> list[Reply]:
        """What is answered to a change once the service was told of it."""
        change, self._change = self._change, None
        if change is None:
            return []
        said = Announce(Severity.INFO, change.said)
        if change.refusal is not None:
            said = Announce(Severity.WARNING, f"{change.refused}: {change.refusal}")
        return [said] if change.index is None else [self._value(change.index), said]

    def store(self) -> str:
        """Keep the values; says what was done. Raises TuningProblem."""
        return self._some().stored()

    def reset(self, *, stored: bool) -> list[SettingsChanged]:
        """Back to the stored values, or to the configuration's own; see `conclude`. Raises TuningProblem."""
        before = self._some()
        self.tuning = before.reread() if stored else before.original()
        changed = self.tuning.tunables != before.tunables
        said = f"parameters as in the {'file' if stored else 'configuration'}"
        self._change = _Change(before, None, said, "parameters stay")
        return [SettingsChanged(self.tuning.settings)] if changed else []

    def _some(self) -> Tuning:
        if self.tuning is None:
            raise TuningProblem("there are no parameters")
        return self.tuning

    def _index(self, name: str) -> int | None:
        return next((k for k, tunable in enumerate(self.tunables) if tunable.name == name), None)

    def _value(self, index: int) -> Message:
        tunable = self.tunables[index]
        return mavlink.MAVLink_param_value_message(
            tunable.name.encode(), tunable.value, REAL32, len(self.tunables), index
        )


def _reason(error: TuningProblem) -> str:
    """The finding without the key and value before it: both are in the text already."""
    return str(error).rpartition(": ")[2]


def _shown(text: str) -> str:
    return "".join(character if character.isprintable() else "?" for character in text)
