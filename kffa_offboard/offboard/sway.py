"""A set point that moves without making a load swing.

A load on a rope of length L answers the hook's motion x with (g/L) / (s^2 + g/L): what is taken out of the
set point at w = sqrt(g/L) leaves no swing behind. The notch

    (s^2 + w^2) / (s + w)^2 = 1 - 2 w s / (s + w)^2

does that and is late by 2 / w. In terms of x with x'' + 2 w x' + w^2 x = w^2 r it gives r - 2 x' / w. Under
the position ring the load swings somewhat quicker (`control/pendulum.py`): in the simulation any w between
half and one and a half times this one more than halved the swing of a move, so ropes need not be known well.

Pure functions over a frozen record.
"""

from __future__ import annotations

from math import exp
from typing import TypeAlias

from msgspec import Struct

Offset: TypeAlias = tuple[float, float]


ARRIVING = 4.0
"""The set point is there, but for a hundredth of a move of 10 m, so many times 1 / w later."""


class Sway(Struct, frozen=True, gc=False):
    """The set point behind two lags of 1 / w, m, and its speed, m/s, along x and y."""

    place: Offset
    speed: Offset = (0.0, 0.0)


def without_sway(sway: Sway, frequency: float, offset: Offset, dt: float) -> tuple[Sway, Offset]:
    """The set point `offset` [m] of a step of `dt` s, without what would make a load swing.

    `frequency` is w [rad/s]; the step is exact for a set point that is held over it.
    """
    x, vx = _lagged(sway.place[0], sway.speed[0], frequency, offset[0], dt)
    y, vy = _lagged(sway.place[1], sway.speed[1], frequency, offset[1], dt)
    late = 2.0 / frequency
    return Sway((x, y), (vx, vy)), (offset[0] - late * vx, offset[1] - late * vy)


def _lagged(place: float, speed: float, frequency: float, wanted: float, dt: float) -> tuple[float, float]:
    """Place and speed `dt` s later of what follows `wanted` critically damped."""
    away = place - wanted
    drift, keep = speed + frequency * away, exp(-frequency * dt)
    return wanted + (away + drift * dt) * keep, (speed - frequency * drift * dt) * keep
