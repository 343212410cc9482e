"""Full thrust that lifts nothing: something holds the vehicle, or it carries more than it can.

A rope that has caught on the ground does so: the law asks for all there is, the vehicle stands still in the
air, and nothing else would end it while the motors heat up and the rope gets ready to part. The autopilot's
own hold is content where the vehicle is, and asks for no more.

A vehicle that is short of thrust falls, and one that climbs has what it needs; neither strains.

A pure function over the time.
"""

from __future__ import annotations

from kffa_offboard.offboard.settings import LimitSettings

LONGEST_S = 3.0
STILL_M_S = 0.1
_FULL = 1e-3  # of thrust


def watch_strain(
    strained_s: float, limits: LimitSettings, thrust: float, climb_rate: float, dt: float
) -> tuple[float, str | None]:
    """Take in thrust and climb rate [m/s] of a vehicle in the air, at a setpoint `dt` s after the last.

    How long it has strained, s, and a fault when that is too long.
    """
    strains = thrust > limits.thrust_max - _FULL and abs(climb_rate) < STILL_M_S
    strained_s = strained_s + dt if strains else 0.0
    return strained_s, f"full thrust lifts nothing for {LONGEST_S:g} s" if strained_s > LONGEST_S else None
