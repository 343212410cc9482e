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
from kffa_offboard.offboard.turns import NO_TURNS, Turns, follow_turns

TURN_M_S2 = 1.5
"""From one side to the other; a load of half the vehicle's mass that swings by 9 degrees each way."""

TURNS = 5
LONGEST_TURN_S = 7.0
"""So many, none later than this after the one before: half the period of a rope of 50 m."""

_EIGHTH_TURN = 0.5**0.5


class Swing(Struct, frozen=True, gc=False):
    """What is remembered of the disturbance along x and y, and along the two directions between them."""

    x: Turns = NO_TURNS
    y: Turns = NO_TURNS
    between: Turns = NO_TURNS
    across: Turns = NO_TURNS

    @property
    def shows(self) -> bool:
        """There is one."""
        return max(self.x.count, self.y.count, self.between.count, self.across.count) >= TURNS


NO_SWING = Swing()


def watch_swing(swing: Swing, disturbance: Array, dt: float) -> Swing:
    """Take in the disturbance (2,) [m/s^2] of a step of `dt` s in the air under our setpoints."""
    x, y = disturbance.tolist()
    between, across = _turned(x, y)
    return Swing(
        follow_turns(swing.x, x, dt, TURN_M_S2, LONGEST_TURN_S),
        follow_turns(swing.y, y, dt, TURN_M_S2, LONGEST_TURN_S),
        follow_turns(swing.between, between, dt, TURN_M_S2, LONGEST_TURN_S),
        follow_turns(swing.across, across, dt, TURN_M_S2, LONGEST_TURN_S),
    )


def steady_part(swing: Swing, disturbance: Array) -> Array:
    """What of the disturbance (2,) [m/s^2] does not swing: the wind."""
    x, y = disturbance.tolist()
    if max(swing.between.count, swing.across.count) > max(swing.x.count, swing.y.count):
        between, across = _turned(x, y)
        return np.array(_turned(_middle(swing.between, between), _middle(swing.across, across)))
    return np.array([_middle(swing.x, x), _middle(swing.y, y)])


def _middle(turns: Turns, value: float) -> float:
    """Where it has turned round; else the present `value`."""
    return turns.middle if turns.count > 1 else value


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
