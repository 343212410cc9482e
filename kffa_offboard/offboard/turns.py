"""How often a signal has turned round: swings and shakes are told by that.

Pure functions over a frozen record.
"""

from __future__ import annotations

from msgspec import Struct


class Turns(Struct, frozen=True, gc=False):
    """A signal's turns, in its own unit.

    Attributes
    ----------
    lowest, highest : since the last turn
    rose : it went up then; None before the first one
    count, since_s : so many in a row, and s since the last one
    extreme, middle : where that was, and half way between it and the one before
    """

    lowest: float = 0.0
    highest: float = 0.0
    rose: bool | None = None
    count: int = 0
    since_s: float = 0.0
    extreme: float = 0.0
    middle: float = 0.0


NO_TURNS = Turns()


def follow_turns(turns: Turns, value: float, dt: float, size: float, longest_s: float) -> Turns:
    """Take in the value of a step of `dt` s; a turn has `size`, and counts within `longest_s` of the last."""
    since_s = turns.since_s + dt
    count = turns.count if since_s <= longest_s else 0
    fell = turns.rose is not False and value < turns.highest - size
    if fell or (turns.rose is not True and value > turns.lowest + size):
        extreme = turns.highest if fell else turns.lowest
        return Turns(value, value, not fell, count + 1, 0.0, extreme, 0.5 * (extreme + turns.extreme))
    lowest = value if value < turns.lowest else turns.lowest
    highest = value if value > turns.highest else turns.highest
    return Turns(lowest, highest, turns.rose, count, since_s, turns.extreme, turns.middle)
