"""The thrust that carries the vehicle: what the observer finds, or a long mean of the setpoints.

The observer's disturbance says which thrust balances the vehicle, also while it is on its way to another
height and thrust accelerates it, and it follows a load that comes or goes. While thrust swings (the link is
slow, gains are too high) anything short is whatever the phase makes it: then the long mean of
the setpoints counts.
"""

from __future__ import annotations

from math import exp

from msgspec import Struct

from kffa_offboard.control import controllers
from kffa_offboard.control.plain import Vector

BALANCE_S, SHORT_S, LONG_S = 0.1, 0.3, 2.0
SWING = 0.05
"""Share of the long mean by which the short one must leave it to be on a side of it."""

SWINGING = 1.5
"""Changes of side, fading with `LONG_S`, from which on thrust swings: a load that comes or goes makes one."""


class Carrying(Struct, frozen=True, gc=False):
    """Mean of the thrust that balances; two means of the setpoints' thrust, on which side of the long the
    short was last, and changes of side.
    """

    balance: float
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
        return self.long if self.swings else self.balance


def balancing(parameters: controllers.ControllerParameters, disturbance: Vector, thrust: float) -> float:
    """The thrust that balances the altitude channel's disturbance in a level attitude.

    For a controller that estimates none it is `thrust`, which was sent.
    """
    if parameters.observer is None:
        return thrust
    return -disturbance[controllers.ALTITUDE] / float(parameters.model.b0[controllers.ALTITUDE])


def follow(state: Carrying | None, thrust: float, balance: float, dt: float) -> Carrying:
    """The setpoint before has acted for `dt` s, and `balance` holds now; None: the first goes out."""
    if state is None:
        return Carrying(balance, thrust, thrust)
    keep = exp(-dt / LONG_S)
    short = thrust + (state.short - thrust) * exp(-dt / SHORT_S)
    long = thrust + (state.long - thrust) * keep
    side = state.side if abs(short - long) < SWING * long else 1 if short > long else -1
    return Carrying(
        balance=balance + (state.balance - balance) * exp(-dt / BALANCE_S),
        short=short,
        long=long,
        side=side,
        turns=state.turns * keep + (side * state.side < 0),
    )
