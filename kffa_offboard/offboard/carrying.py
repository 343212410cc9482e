"""The thrust that carries the vehicle, from the setpoints that were sent: a mean over as long as it needs.

A short mean follows a load that comes or goes. While thrust swings (the link is slow, gains are too high) a
short mean is whatever the phase makes it: then the long one counts.
"""

from __future__ import annotations

from math import exp
from typing import NamedTuple

SHORT_S, LONG_S = 0.3, 2.0
SWING = 0.05
"""Share of the long mean by which the short one must leave it to be on a side of it."""

SWINGING = 1.5
"""Changes of side, fading with `LONG_S`, from which on thrust swings: a load that comes or goes makes one."""


class Carrying(NamedTuple):
    """Two means of the setpoints' thrust; on which side of the long the short was last; changes of side."""

    short: float
    long: float
    side: int = 0
    turns: float = 0.0

    @property
    def swings(self) -> bool:
        """Thrust swings about its mean."""
        return self.turns > SWINGING

    @property
    def thrust(self) -> float:
        """Normalised collective thrust that carries the vehicle."""
        return self.long if self.swings else self.short


def follow(state: Carrying | None, thrust: float, dt: float) -> Carrying:
    """Take in a setpoint `dt` s after the last one; None: the first of an engagement."""
    if state is None:
        return Carrying(thrust, thrust)
    keep = exp(-dt / LONG_S)
    short = thrust + (state.short - thrust) * exp(-dt / SHORT_S)
    long = thrust + (state.long - thrust) * keep
    side = state.side if abs(short - long) < SWING * long else 1 if short > long else -1
    return Carrying(
        short=short,
        long=long,
        side=side,
        turns=state.turns * keep + (side * state.side < 0),
    )
