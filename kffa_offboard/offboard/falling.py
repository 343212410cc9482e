"""A vehicle that falls although thrust is asked for: its motors are stopped.

A kill switch, an emergency stop, a battery that cuts out. The law goes on: it catches a vehicle whose motors
come back in the air. But it asks for all the thrust that there is, and the observer takes the fall for a
load, so that what it finds is no thrust for a last setpoint: motors that are let again after the impact would
get it beside the pilot who has gone there. That is then the thrust that carried before the fall.
"""

from __future__ import annotations

from msgspec import Struct

from kffa_offboard.offboard.carrying import Carrying
from kffa_offboard.offboard.events import PositionReceived

STEEP_M_S2 = 7.35
"""Three quarters of free fall. 6.73 kg that are picked up at once by 10 kg make 3.9."""

ASKED_SHARE = 0.7
"""Of the empty vehicle's hover thrust; with less the vehicle may be meant to sink as fast."""

SHOWS_S, GAP_S = 0.1, 0.15
"""How long until it shows; and longest time between two samples of it."""

NOISE_M_S = 0.15


class Fall(Struct, frozen=True, gc=False):
    """What may be a fall.

    Attributes
    ----------
    since_us, climb_rate : sample time and climb rate [m/s] at its beginning; None for no fall
    last_us : sample time of the last position
    carrying : what carried the vehicle at the beginning
    """

    since_us: int | None = None
    climb_rate: float = 0.0
    last_us: int = 0
    carrying: Carrying | None = None


NO_FALL = Fall()


def watch_fall(
    fall: Fall, event: PositionReceived, thrust: float, hover_thrust: float, carrying: Carrying | None
) -> Fall:
    """Take in a position of a vehicle in the air under our setpoints.

    Parameters
    ----------
    thrust, hover_thrust : asked for last, and of the empty vehicle, 0..1
    carrying : what carries it, as far as is known
    """
    now_us, climb_rate = event.sample_time_us, event.velocity[2]
    if thrust < ASKED_SHARE * hover_thrust:
        return NO_FALL
    if fall.since_us is not None and (now_us - fall.last_us) * 1e-6 <= GAP_S:
        falling_s = (now_us - fall.since_us) * 1e-6
        if climb_rate - fall.climb_rate <= NOISE_M_S - STEEP_M_S2 * falling_s:
            return Fall(fall.since_us, fall.climb_rate, now_us, fall.carrying)
    return Fall(now_us, climb_rate, now_us, carrying)


def shows(fall: Fall) -> bool:
    """It is one."""
    return fall.since_us is not None and (fall.last_us - fall.since_us) * 1e-6 >= SHOWS_S


def carried_before(fall: Fall, carrying: Carrying | None) -> Carrying | None:
    """What carries the vehicle: in what shows to be a fall, what did before it."""
    return fall.carrying if shows(fall) else carrying
