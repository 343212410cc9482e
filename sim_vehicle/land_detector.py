"""Is the vehicle on the ground? What an autopilot without a contact switch can tell.

Low thrust without motion for a while means landed (PX4 src/modules/land_detector, ArduCopter
land_detector.cpp); height gained since means flying. Units: m, s, m/s, normalised thrust.
"""

from __future__ import annotations

from typing import NamedTuple

TRIGGER_TIME = 1.0
"""How long [s] thrust must be low and the vehicle still (ArduCopter's LAND_DETECTOR_TRIGGER_SEC)."""

CLIMB_RATE_LIMIT = 0.3
SPEED_LIMIT = 0.8
TAKEOFF_HEIGHT = 0.1
TAKEOFF_CLIMB_RATE = 0.3


class LandState(NamedTuple):
    """landed; height of the ground as measured while standing on it; how long it looks like landed."""

    landed: bool = True
    ground_height: float = 0.0
    still_time: float = 0.0


def step(
    state: LandState,
    thrust: float,
    low_thrust: float,
    height: float,
    climb_rate: float,
    speed: float,
    dt: float,
) -> LandState:
    """Land detector after `dt` seconds with `thrust` commanded; below `low_thrust` counts as low."""
    if state.landed:
        share = min(1.0, dt)  # one second: the ground does not move, the sensor is noisy
        rising = height - state.ground_height > TAKEOFF_HEIGHT
        if thrust > low_thrust and (rising or climb_rate > TAKEOFF_CLIMB_RATE):
            return LandState(False, state.ground_height, 0.0)
        ground = state.ground_height + share * (height - state.ground_height)
        return LandState(True, ground, 0.0)
    still = abs(climb_rate) < CLIMB_RATE_LIMIT and speed < SPEED_LIMIT and thrust < low_thrust
    still_time = state.still_time + dt if still else 0.0
    if still_time >= TRIGGER_TIME:
        return LandState(True, height, 0.0)
    return LandState(False, state.ground_height, still_time)
