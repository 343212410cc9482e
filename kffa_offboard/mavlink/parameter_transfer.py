"""Reading and setting parameters by name over a link that loses messages; sans-I/O.

Every request is repeated until it is answered or given up. Single parameters only: a transfer of the
whole list slows all streams of ArduPilot fourfold. A name that nobody answers for does not exist in
this firmware (neither firmware answers to an unknown name), or the link is dead.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.parameters import (
    Encoding,
    decode_value,
    encode_value,
    name_of,
    read_request,
    same_value,
    set_request,
)

INTERVAL_US = 400_000
"""Between two attempts; a round trip over a slow radio takes less."""

ATTEMPTS = 4
WINDOW = 16
"""Requests under way at once; ArduPilot's queue holds 20."""


@dataclass(frozen=True, slots=True)
class RawValue:
    """PARAM_VALUE as it came: the float field and MAV_PARAM_TYPE."""

    field: float
    kind: int


@dataclass(slots=True)
class _Request:
    """One parameter under way. `wanted` is None for reading."""

    wanted: float | None
    attempts: int = 0
    due_us: int = 0


class ParameterTransfer:
    """Requests under way and everything that was read.

    Attributes
    ----------
    known : last PARAM_VALUE of each name, whoever asked for it
    unanswered : names of finished requests that were not answered, or not obeyed
    encoding : how integers are carried; may be corrected at any time

    """

    def __init__(self, route: Route, encoding: Encoding) -> None:
        self.encoding = encoding
        self.known: dict[str, RawValue] = {}
        self.unanswered: set[str] = set()
        self._route = route
        self._requests: dict[str, _Request] = {}

    @property
    def busy(self) -> bool:
        """Some request is still under way."""
        return bool(self._requests)

    def values(self) -> dict[str, float]:
        """All that is known, as numbers."""
        return {name: decode_value(raw.field, raw.kind, self.encoding) for name, raw in self.known.items()}

    def read(self, names: Iterable[str]) -> None:
        """Ask for `names`, whether or not they are known."""
        for name in names:
            self.unanswered.discard(name)
            self._requests[name] = _Request(None)

    def set(self, values: Mapping[str, float]) -> None:
        """Set parameters that were read before (their type is known)."""
        for name, value in values.items():
            self.unanswered.discard(name)
            self._requests[name] = _Request(value)

    def cancel(self) -> None:
        """Forget the requests under way. What was sent may still be obeyed: it counts as unanswered."""
        self.unanswered |= {name for name, request in self._requests.items() if request.attempts}
        self._requests.clear()

    def receive(self, message: Message) -> None:
        """Take in PARAM_VALUE or PARAM_ERROR of the vehicle."""
        name = name_of(message)
        request = self._requests.get(name)
        if message.get_type() == "PARAM_ERROR":
            if request is not None:
                self._give_up(name)
            return
        self.known[name] = RawValue(float(message.param_value), int(message.param_type))
        if request is None or request.attempts == 0:
            return
        if request.wanted is None or same_value(self.values()[name], request.wanted):
            del self._requests[name]

    def due_us(self) -> int | None:
        """When something is to be sent or given up; None if nothing is under way."""
        under_way = list(self._requests.values())[:WINDOW]
        return min((request.due_us for request in under_way), default=None)

    def run(self, time_us: int) -> list[Message]:
        """What is to be sent at `time_us`, by requests that take the place of those given up, too."""
        messages: list[Message] = []
        while due := self._due(time_us):
            for name, request in due:
                if request.attempts == ATTEMPTS:
                    self._give_up(name)
                    continue
                request.attempts += 1
                request.due_us = time_us + INTERVAL_US
                messages.append(self._message(name, request))
        return messages

    def _due(self, time_us: int) -> list[tuple[str, _Request]]:
        under_way = list(self._requests.items())[:WINDOW]
        return [(name, request) for name, request in under_way if time_us >= request.due_us]

    def _message(self, name: str, request: _Request) -> Message:
        if request.wanted is None:
            return read_request(self._route, name)
        kind = self.known[name].kind
        return set_request(self._route, name, encode_value(request.wanted, kind, self.encoding), kind)

    def _give_up(self, name: str) -> None:
        del self._requests[name]
        self.unanswered.add(name)
