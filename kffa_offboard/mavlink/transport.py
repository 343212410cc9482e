"""What every link offers, whatever it is made of: bytes in with their arrival time, bytes out."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import NamedTuple, Protocol, TypeAlias

from msgspec import Struct

Clock: TypeAlias = Callable[[], int]
"""Tells the time in integer microseconds and never goes back."""


class Datagram(Struct, frozen=True, gc=False):
    """Bytes that arrived together.

    `time_us` is the time of reading on the link's clock; `source` tells senders apart (each has its own
    stream of frames); `waited_us` is how long it was in the operating system's hands before, if known. A
    `stranger` is not who the link is locked onto: to be looked at, not listened to. `notice` is what the link
    has to say about its sender, for people.
    """

    time_us: int
    data: bytes
    source: Hashable
    stranger: bool = False
    notice: str = ""
    waited_us: int = 0


class Posting(NamedTuple):
    """What it takes to send in a link's place: its descriptor, the bytes as they go out, and where to.

    `place` is host and port; None where the descriptor knows the way.
    """

    descriptor: int
    data: bytes
    place: tuple[str, int] | None = None


class Link(Protocol):
    """A way to the vehicle. Not safe to share between threads."""

    @property
    def name(self) -> str:
        """The link's URL, with the port that was really bound."""

    @property
    def keeps_frames_whole(self) -> bool:
        """True if a frame never spans two datagrams (UDP), False for a byte stream."""

    @property
    def trouble(self) -> str:
        """Why nothing may be arriving ("connection refused"); empty if nothing is known to be wrong."""

    @property
    def descriptor(self) -> int | None:
        """What to wait for in select until there is something to receive; None while there is nothing."""

    def take_news(self) -> str | None:
        """That the device or connection is gone, or back, once; else None."""

    def receive(self, timeout_s: float) -> list[Datagram]:
        """Wait at most `timeout_s` for data, then return what is there, in order of arrival."""

    def send(self, data: bytes) -> bool:
        """Send a whole frame, several if the link keeps them whole, without waiting.

        False if they were dropped (nobody there, buffers full).
        """

    def posting(self, data: bytes) -> Posting | None:
        """How another process can send a whole frame here; None while there is nobody to send to."""

    def lock(self, source: Hashable) -> None:
        """From now on listen to `source` alone and answer it alone; a few datagrams of others are marked."""

    def close(self) -> None:
        """Give the port back. May be called twice."""
