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
from kffa_offboard.offboard.events import Vector3
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.turns import NO_PLANE_TURNS, PlaneTurns, follow_in_plane

TURN_M_S2 = 1.5
"""From one side to the other; a load of half the vehicle's mass that swings by 9 degrees each way."""

TURNS = 5
LONGEST_TURN_S = 7.0
"""So many, none later than this after the one before: half the period of a rope of 50 m."""

QUICK_TURN_M_S2, QUICK_TURNS, LONGEST_QUICK_TURN_S = 0.8, 4, 0.8
"""The same for what turns quickly: on a metre of rope and less a swing doubles with every turn, and an
observer of 6 rad/s shows a third to a half of its pull. Gusts turn so once."""

WHIRL_M_S, WHIRL_TURNS, LONGEST_WHIRL_TURN_S = 3.0, 8, 0.7
"""Of the vehicle's own speed: a load that circles it with several times its weight, which whatever answers
late drives on. Setpoints hardly do that: it takes 24 degrees of tilt, by turns to one side and the other."""


class Swing(Struct, frozen=True, gc=False):
    """What is remembered of the disturbance: its turns, and those that are quick."""

    slow: PlaneTurns = NO_PLANE_TURNS
    quick: PlaneTurns = NO_PLANE_TURNS

    @property
    def shows(self) -> bool:
        """There is one."""
        return self.slow.count >= TURNS or self.quick.count >= QUICK_TURNS


NO_SWING = Swing()


def watch_swing(swing: Swing, disturbance: Array, dt: float) -> Swing:
    """Take in the disturbance (2,) [m/s^2] of a step of `dt` s in the air under our setpoints."""
    x, y = disturbance.tolist()
    return Swing(
        follow_in_plane(swing.slow, x, y, dt, TURN_M_S2, LONGEST_TURN_S),
        follow_in_plane(swing.quick, x, y, dt, QUICK_TURN_M_S2, LONGEST_QUICK_TURN_S),
    )


def steady_part(swing: Swing, disturbance: Array) -> Array:
    """What of the disturbance (2,) [m/s^2] does not swing: the wind."""
    turns = swing.quick if swing.quick.count >= QUICK_TURNS else swing.slow
    return np.array(turns.middle(*disturbance.tolist()))


def watch_whirl(whirl: PlaneTurns, velocity: Vector3, dt: float) -> PlaneTurns:
    """Take in the measured velocity [m/s] of a step of `dt` s in the air under our setpoints."""
    return follow_in_plane(whirl, velocity[0], velocity[1], dt, WHIRL_M_S, LONGEST_WHIRL_TURN_S)


def whirls(whirl: PlaneTurns) -> bool:
    """The load throws the vehicle to and fro, and nothing here will stop it."""
    return whirl.count >= WHIRL_TURNS


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
