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


class PlaneTurns(Struct, frozen=True, gc=False):
    """The turns of a vector in the plane: along x and y, and along the two directions between them."""

    x: Turns = NO_TURNS
    y: Turns = NO_TURNS
    between: Turns = NO_TURNS
    across: Turns = NO_TURNS

    @property
    def count(self) -> int:
        """In a row, along the direction with the most."""
        return max(self.x.count, self.y.count, self.between.count, self.across.count)

    def middle(self, x: float, y: float) -> tuple[float, float]:
        """Where the vector turns about; along a direction in which it does not turn, where it is now."""
        if max(self.between.count, self.across.count) > max(self.x.count, self.y.count):
            between, across = _between(x, y)
            return _between(_middle(self.between, between), _middle(self.across, across))
        return _middle(self.x, x), _middle(self.y, y)


NO_PLANE_TURNS = PlaneTurns()

_EIGHTH_TURN = 0.5**0.5


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


def follow_in_plane(
    turns: PlaneTurns, x: float, y: float, dt: float, size: float, longest_s: float
) -> PlaneTurns:
    """`follow_turns` along the four directions."""
    between, across = _between(x, y)
    return PlaneTurns(
        follow_turns(turns.x, x, dt, size, longest_s),
        follow_turns(turns.y, y, dt, size, longest_s),
        follow_turns(turns.between, between, dt, size, longest_s),
        follow_turns(turns.across, across, dt, size, longest_s),
    )


def _middle(turns: Turns, value: float) -> float:
    """Where it has turned round; else the present `value`."""
    return turns.middle if turns.count > 1 else value


def _between(x: float, y: float) -> tuple[float, float]:
    """Along the directions between x and y; the same leads back again."""
    return (x + y) * _EIGHTH_TURN, (x - y) * _EIGHTH_TURN
