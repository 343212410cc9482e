"""Does the load swing? Told from what the position ring's observer finds.

A load on a rope pulls to one side and the other, again and again, and to a ring by LADRC that pull is a
disturbance, which it drives (`control/pendulum.py`). Wind is one, too, but not so strong and regular: in
gusts of 4 m/s that last a second, at a drag of 1 N s/m, it turned round by so much twice in a row within
minutes.

The rope may hang from a hook below the centre of mass, and then its pull turns the vehicle, too. What holds
an angle against that pull, late as an observer is, moves the hook so that the swing grows:
`for_swinging_load`.

Pure functions over frozen records.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from msgspec import Struct

from kffa_offboard.control import Array
from kffa_offboard.offboard.settings import ServiceSettings

TURN_M_S2 = 1.5
"""From one side to the other; a load of half the vehicle's mass that swings by 9 degrees each way."""

TURNS = 5
LONGEST_TURN_S = 7.0
"""So many, none later than this after the one before: half the period of a rope of 50 m."""

_EIGHTH_TURN = 0.5**0.5


class Axis(Struct, frozen=True, gc=False):
    """The disturbance along one axis, m/s^2.

    Attributes
    ----------
    lowest, highest : since the last turn
    rose : it went up then; None before the first one
    turns, since_s : so many in a row, and s since the last one
    extreme, middle : where that was, and half way between it and the one before
    """

    lowest: float = 0.0
    highest: float = 0.0
    rose: bool | None = None
    turns: int = 0
    since_s: float = 0.0
    extreme: float = 0.0
    middle: float = 0.0


class Swing(Struct, frozen=True, gc=False):
    """What is remembered of the disturbance along x and y, and along the two directions between them."""

    x: Axis = Axis()
    y: Axis = Axis()
    between: Axis = Axis()
    across: Axis = Axis()

    @property
    def shows(self) -> bool:
        """There is one."""
        return max(self.x.turns, self.y.turns, self.between.turns, self.across.turns) >= TURNS


NO_SWING = Swing()


def watch_swing(swing: Swing, disturbance: Array, dt: float) -> Swing:
    """Take in the disturbance (2,) [m/s^2] of a step of `dt` s in the air under our setpoints."""
    x, y = disturbance.tolist()
    between, across = _turned(x, y)
    return Swing(
        _follow(swing.x, x, dt),
        _follow(swing.y, y, dt),
        _follow(swing.between, between, dt),
        _follow(swing.across, across, dt),
    )


def steady_part(swing: Swing, disturbance: Array) -> Array:
    """What of the disturbance (2,) [m/s^2] does not swing: the wind."""
    x, y = disturbance.tolist()
    if max(swing.between.turns, swing.across.turns) > max(swing.x.turns, swing.y.turns):
        between, across = _turned(x, y)
        return np.array(_turned(_middle(swing.between, between), _middle(swing.across, across)))
    return np.array([_middle(swing.x, x), _middle(swing.y, y)])


def _middle(axis: Axis, value: float) -> float:
    """Where it has turned round; else the present `value`."""
    return axis.middle if axis.turns > 1 else value


def _turned(x: float, y: float) -> tuple[float, float]:
    """Along the directions between x and y; the same leads back again."""
    return (x + y) * _EIGHTH_TURN, (x - y) * _EIGHTH_TURN


YIELDING = np.array([0.0, 0.0, 1.0, 1.0])
"""Roll and pitch meet an error with their gains alone; against a steady torque the autopilot's rate loop has
its own integral."""


def for_swinging_load(settings: ServiceSettings) -> ServiceSettings:
    """The same, but roll and pitch do not hold against what their observers find."""
    law = settings.controller.law
    if law is None or law.rejection is not None:
        return settings
    controller = replace(settings.controller, law=replace(law, rejection=YIELDING))
    return replace(settings, controller=controller)


def _follow(axis: Axis, value: float, dt: float) -> Axis:
    since_s = axis.since_s + dt
    turns = axis.turns if since_s <= LONGEST_TURN_S else 0
    fell = axis.rose is not False and value < axis.highest - TURN_M_S2
    if fell or (axis.rose is not True and value > axis.lowest + TURN_M_S2):
        extreme = axis.highest if fell else axis.lowest
        middle = 0.5 * (extreme + axis.extreme)
        return Axis(value, value, not fell, turns + 1, 0.0, extreme, middle)
    lowest, highest = min(axis.lowest, value), max(axis.highest, value)
    return Axis(lowest, highest, axis.rose, turns, since_s, axis.extreme, axis.middle)
