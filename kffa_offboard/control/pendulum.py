"""A load on a rope under the position ring: does the ring damp its swing, or drive it?

Vehicle M, load m = mu M on a rope of length L from the vehicle's centre, small angles, offset q of the load
from below the vehicle. Thrust carries both, so that tilting for the acceleration a moves the vehicle alone
by more:

    x'' = (1 + mu) a + mu (g / L) q        q'' = -(g / L) q - x''

    x / a = (1 + mu) (s^2 + g/L) / (s^2 (s^2 + (1 + mu) g/L))

Under a ring that is slow beside it the load swings with sqrt((1 + mu) g / L), under one that holds the
vehicle still with sqrt(g / L). A ring a = -C(s) x does the work Re(a v*) on what swings with the frequency
w: with v = j w x it takes energy out if Im C(j w) > 0, if its answer *leads* the position. An integral lags
where the rope is long, and so does, where it is short, an attitude that comes late.

An observer lags at both ends: to it the pull of the rope is a disturbance, and what it holds against that
comes after it. With omega_c = 2 and omega_o = 6 rad/s and an attitude that is 0.22 s late the position ring
by (KFFA-)LADRC drives half the vehicle's mass on ropes below 1.5 m and above 7 m; on short ones it ends
circling the vehicle. A PID with three poles at omega_c / 4 damps it from 0.3 m on
(`tests/control/test_pendulum.py`). On an unmodified PX4 in gusts, 5 kg on 1 m went up to 92 degrees under
the first and stayed within 2 under the second.

Not in the paper, whose load is held rigidly.
"""

from __future__ import annotations

from math import radians

import numpy as np

from kffa_offboard.control import Array

LEAD = radians(20.0)
"""The least by which a ring's answer is to lead: it is sampled, and delays are not known exactly."""

_FREQUENCIES = np.geomspace(0.02, 60.0, 4000)


def lead_of(gains: tuple[float, float, float], delay: float, lag: float, frequency: Array) -> Array:
    """Phase [rad] of a PID's answer to a displacement, behind attitude loop and link; not wrapped.

    Parameters
    ----------
    gains : kp [1/s^2], ki [1/s^3], kd [1/s], of an acceleration
    delay, lag : s, from a roll or pitch reference to the angle
    frequency : rad/s, any shape
    """
    kp, ki, kd = gains
    lead = np.arctan2(kd * frequency - ki / frequency, kp)
    return np.asarray(lead - delay * frequency - np.arctan(lag * frequency))


def damped_frequencies(
    gains: tuple[float, float, float], delay: float, lag: float
) -> tuple[float, float] | None:
    """Lowest and highest frequency [rad/s] of a swing that such a ring damps; None if there is none."""
    damps = np.flatnonzero(lead_of(gains, delay, lag, _FREQUENCIES) > LEAD)
    if not damps.size:
        return None
    gaps = np.flatnonzero(np.diff(damps) > 1)
    last = damps[gaps[0]] if gaps.size else damps[-1]
    return float(_FREQUENCIES[damps[0]]), float(_FREQUENCIES[last])


def damped_ropes(
    gains: tuple[float, float, float], delay: float, lag: float, load_ratio: float, gravity: float
) -> tuple[float, float] | None:
    """Shortest and longest rope [m] whose load, `load_ratio` times the vehicle's mass at most, is damped."""
    band = damped_frequencies(gains, delay, lag)
    if band is None:
        return None
    shortest, longest = (1.0 + load_ratio) * gravity / band[1] ** 2, gravity / band[0] ** 2
    return (shortest, longest) if shortest < longest else None
