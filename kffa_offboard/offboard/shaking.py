"""Thrust that shakes: from one end to the other and back, several times a second.

A loop that is too quick for its link or for what it carries ends so: a load on a rope that stretches
(nylon) bounces under a height loop of 8 rad/s with 20 to 40 rad/s, and thrust goes from limit to limit five
to eight times a second, while the height stays within 0.2 m and nothing else would end it. The autopilot's
own hold is slower.

Pure functions over a frozen record.
"""

from __future__ import annotations

from kffa_offboard.offboard.settings import LimitSettings
from kffa_offboard.offboard.turns import Turns, follow_turns

SHARE = 0.5
"""Of the range that `[limits]` leaves to thrust, from one side to the other."""

COUNT, LONGEST_S = 10, 0.2
"""So many turns, none later than this after the one before. A height that swings on a link that is just borne
turns after 0.3 s."""


def watch_thrust(shaking: Turns, limits: LimitSettings, thrust: float, dt: float) -> tuple[Turns, str | None]:
    """Take in the thrust of a setpoint to a vehicle in the air, `dt` s after the last; names a fault."""
    size = SHARE * (limits.thrust_max - limits.thrust_min)
    shaking = follow_turns(shaking, thrust, dt, size, LONGEST_S)
    return shaking, "thrust shakes from end to end" if shaking.count >= COUNT else None
