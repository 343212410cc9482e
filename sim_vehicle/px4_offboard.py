"""PX4's setpoints in OFFBOARD, and which of them count.

SET_ATTITUDE_TARGET sets an attitude, body rates or both (mavlink_receiver.cpp). Which of the two is flown is
in vehicle_control_mode, which the commander works out when mode or arming change, and else twice a second
(Commander.cpp, updateControlMode): a setpoint of the other kind has no effect until then. While attitudes
count, mc_att_control writes its own rates over those that come.
"""

from __future__ import annotations

import math

from sim_vehicle import attitude_loop
from sim_vehicle.attitude_mask import ATTITUDE_IGNORE, RATES_IGNORE, THROTTLE_IGNORE
from sim_vehicle.firmware import AttitudeSetpoint, RateDemand

CONTROL_MODE_PERIOD_US = 500_000


class OffboardSetpoints:
    """What was set last.

    Attributes
    ----------
    came_us : when the last one came; None before the first
    attitude, rates : the last of each kind
    attitude_counts : attitudes are flown, not rates
    """

    def __init__(self) -> None:
        self.came_us: int | None = None
        self.attitude: AttitudeSetpoint | None = None
        self.rates: RateDemand | None = None
        self.attitude_counts = False
        self._last_is_attitude = False
        self._looked_up_us = 0

    def accept(self, time_us: int, setpoint: AttitudeSetpoint) -> None:
        """Take in a setpoint; one without attitude and without all three rates, or not finite, is refused.

        A setpoint whose throttle is ignored has zero thrust.
        """
        mask = setpoint.type_mask
        has_attitude, has_rates = not mask & ATTITUDE_IGNORE, not mask & RATES_IGNORE
        if not (has_attitude or has_rates):
            return
        values = setpoint.attitude if has_attitude else setpoint.body_rates
        if not all(math.isfinite(value) for value in values):
            return
        thrust = 0.0 if mask & THROTTLE_IGNORE or math.isnan(setpoint.thrust) else setpoint.thrust
        if has_attitude:
            if math.hypot(*setpoint.attitude) < 1e-6:
                return
            attitude = attitude_loop.normalised(setpoint.attitude)
            self.attitude = setpoint._replace(attitude=attitude, thrust=thrust)
        if has_rates and all(math.isfinite(rate) for rate in setpoint.body_rates):
            self.rates = RateDemand(setpoint.body_rates, thrust)
        self._last_is_attitude, self.came_us = has_attitude, time_us

    def look_up(self, time_us: int, *, now: bool = False) -> None:
        """What counts from here on: looked up twice a second, or `now`."""
        if now or time_us - self._looked_up_us >= CONTROL_MODE_PERIOD_US:
            self.attitude_counts, self._looked_up_us = self._last_is_attitude, time_us
