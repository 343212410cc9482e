"""What the command line needs to know of an autopilot and the plant that it flies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, TypeAlias

from sim_vehicle.plant import Plant

Progress: TypeAlias = Callable[[], None]
Say: TypeAlias = Callable[[str], None]
"""Takes one line for people."""


class Backend(Protocol):
    """An autopilot, connected and ready to fly.

    To add one: a kind in `config_backend`, a module here, and a line in `choose.open_backend`.
    """

    @property
    def plant(self) -> Plant:
        """The flying body."""

    @property
    def announcement(self) -> str:
        """One line: what flies and where it is reached."""

    @property
    def autopilot(self) -> str:
        """A few words: what the autopilot does at present."""

    def run(self, duration_s: float | None, progress: Progress) -> None:
        """Fly until `duration_s` of simulated time have passed, or for ever if None.

        `progress` is called a few times in a second. Raises SimulatorError if flying cannot go on.
        """
