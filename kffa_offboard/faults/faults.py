"""What can be wrong with a link, each as a transformation of the frames that pass.

A fault takes one frame with its arrival time and gives back what arrives instead: nothing, the same, another,
or several, at once or later. Faults are put in a row (`line.FaultLine`), each works on what the one before
lets through. They hold what they remember and draw from the generator that they are given: a seed repeats
them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from kffa_offboard.faults.edit import edited, message_id, number_of, set_fields


class Frame(NamedTuple):
    """A frame and when it arrives [us]."""

    time_us: int
    data: bytes


@dataclass
class Fault(ABC):
    """A fault that is there from `start_s` for `duration_s` (for good if infinite).

    Attributes
    ----------
    start_s, duration_s : s, on the clock of the line
    messages : names of the messages that it concerns; empty: all
    share : of the frames that it touches, 0..1
    """

    start_s: float = 0.0
    duration_s: float = math.inf
    messages: tuple[str, ...] = ()
    share: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.share <= 1.0:
            raise ValueError(f"share = {self.share}: must be in 0..1")
        self._numbers = frozenset(number_of(name) for name in self.messages)

    def active(self, time_us: int) -> bool:
        """Is it there at `time_us`?"""
        return self.start_s <= time_us * 1e-6 < self.start_s + self.duration_s

    def concerns(self, frame: Frame, generator: np.random.Generator) -> bool:
        """Does it touch this frame? Draws from `generator` only if not all are touched."""
        if not self.active(frame.time_us):
            return False
        if self._numbers and message_id(frame.data) not in self._numbers:
            return False
        return self.share >= 1.0 or float(generator.random()) < self.share

    def passing(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """What arrives instead of `frame`."""
        self.watch(frame)
        return self.change(frame, generator) if self.concerns(frame, generator) else [frame]

    def watch(self, frame: Frame) -> None:  # noqa: B027
        """See a frame go by, touched or not."""

    @abstractmethod
    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """What arrives instead of a frame that is touched."""

    def extra(self, since_us: int, until_us: int) -> list[Frame]:
        """Frames that nobody sent, in that time."""
        return []


@dataclass
class Lose(Fault):
    """Frames are lost: a `share` of them, or for a while all."""

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""
        return []


@dataclass
class Delay(Fault):
    """Frames come `delay_s` later, and up to `jitter_s` more; with jitter they overtake each other."""

    delay_s: float = 0.1
    jitter_s: float = 0.0

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""
        late_s = self.delay_s + (self.jitter_s * float(generator.random()) if self.jitter_s > 0.0 else 0.0)
        return [Frame(frame.time_us + round(late_s * 1e6), frame.data)]


@dataclass
class Duplicate(Fault):
    """Frames arrive `copies` times more."""

    copies: int = 1

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""
        return [frame] * (1 + self.copies)


@dataclass
class Corrupt(Fault):
    """`bits` bits of a frame are flipped; its checksum then tells."""

    bits: int = 1

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""
        data = bytearray(frame.data)
        for bit in generator.integers(0, 8 * len(data), self.bits).tolist():
            data[bit // 8] ^= 1 << bit % 8
        return [Frame(frame.time_us, bytes(data))]


@dataclass
class Thin(Fault):
    """Of each kind of message only every `keep_every`-th passes: the rate drops."""

    keep_every: int = 10
    _seen: dict[int, int] = field(default_factory=dict, init=False)

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""
        number = message_id(frame.data)
        self._seen[number] = self._seen.get(number, -1) + 1
        return [frame] if self._seen[number] % self.keep_every == 0 else []


@dataclass
class Freeze(Fault):
    """Values stay what they were before the fault, only the time goes on: an estimator that hangs."""

    _last: dict[int, bytes] = field(default_factory=dict, init=False)

    def watch(self, frame: Frame) -> None:
        """See `Fault`."""
        if not self.active(frame.time_us):
            self._last[message_id(frame.data)] = frame.data

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""
        old = self._last.setdefault(message_id(frame.data), frame.data)

        def take_time(message: Any, source: Any) -> None:
            if "time_boot_ms" in message.get_fieldnames():
                message.time_boot_ms = source.time_boot_ms

        times: list[Any] = []
        edited(frame.data, times.append)
        if not times:
            return [frame]
        return [Frame(frame.time_us, edited(old, lambda message: take_time(message, times[0])))]


@dataclass
class ShiftClock(Fault):
    """The autopilot's clock is off by `offset_s`: a jump, or time that goes back."""

    offset_s: float = -1.0

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""

        def shift(message: Any) -> None:
            if "time_boot_ms" in message.get_fieldnames():
                message.time_boot_ms = (message.time_boot_ms + round(self.offset_s * 1e3)) % 2**32

        return [Frame(frame.time_us, edited(frame.data, shift))]


@dataclass
class Overwrite(Fault):
    """Fields have these values: not a number, infinity, nonsense, or a heartbeat that tells another story."""

    values: Mapping[str, Any] = field(default_factory=dict)

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""
        return [Frame(frame.time_us, edited(frame.data, lambda message: set_fields(message, self.values)))]


@dataclass
class Offset(Fault):
    """Fields are wrong by so much: an impossible jump."""

    values: Mapping[str, float] = field(default_factory=dict)

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""

        def shift(message: Any) -> None:
            set_fields(message, {name: getattr(message, name) + by for name, by in self.values.items()})

        return [Frame(frame.time_us, edited(frame.data, shift))]


@dataclass
class Flood(Fault):
    """Somebody sends `rate_hz` frames a second of `frames`, in turn."""

    rate_hz: float = 20_000.0
    frames: tuple[bytes, ...] = ()
    _count: int = field(default=0, init=False)

    def change(self, frame: Frame, generator: np.random.Generator) -> list[Frame]:
        """See `Fault`."""
        return [frame]

    def extra(self, since_us: int, until_us: int) -> list[Frame]:
        """See `Fault`."""
        begin = max(since_us, round(self.start_s * 1e6))
        end = min(float(until_us), (self.start_s + self.duration_s) * 1e6)
        count = max(0, math.floor((end - begin) * 1e-6 * self.rate_hz))
        self._count += count
        first = self._count - count
        return [Frame(until_us, self.frames[(first + k) % len(self.frames)]) for k in range(count)]
