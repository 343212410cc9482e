"""The `[payload]` table: what the empty vehicle weighs, what it may carry, and how quick its gripper is."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import model_validator

from kffa_offboard.config_control import ControlTable, Table
from kffa_offboard.config_units import number
from kffa_offboard.control.actuator import ActuatorParameters
from kffa_offboard.control.payload import PayloadParameters
from kffa_offboard.offboard.payload_settings import PayloadSettings

Mass = Annotated[float | None, number("kg", above=0.0, at_most=10000.0)]
Duration = Annotated[float, number("s", above=0.0, at_most=30.0)]
Rope = Annotated[float, number("m", at_least=0.0, at_most=1000.0)]


class PayloadTable(Table):
    """`[payload]`: the mass of the load, estimated from thrust and climb rate.

    Needs `vehicle_mass_kg`, the mass that `control.altitude.hover_thrust` carries; without it loads are
    a disturbance and nothing is reported. `gripper_open_s`, from the gripper's command at the autopilot
    to the load's leaving, lets a commanded release step the thrust at once: measure it, a guess that is
    0.1 s wrong is no better than none.

    `rope_length_m` is the length of the rope on which loads swing, weighed or not; 0 for loads that are held
    rigidly. The position ring is another one then, which damps the swing (`control/pendulum.py`). The
    stiffness of the whole rope, if it is known, tells whether the height loop would make a load bounce on it.
    """

    enabled: bool = True
    rope_length_m: Rope = 0.0
    rope_stiffness_n_m: Annotated[float | None, number("N/m", above=0.0)] = None
    vehicle_mass_kg: Mass = None
    max_load_kg: Mass = None
    hover_thrust_uncertainty: Annotated[float, number(at_least=0.0, at_most=0.5)] = 0.01
    report_hz: Annotated[float, number("Hz", above=0.0, at_most=50.0)] = 5.0
    gripper_open_s: Annotated[float | None, number("s", at_least=0.0, at_most=5.0)] = None
    release_timeout_s: Duration = 1.0

    @model_validator(mode="after")
    def _mass_is_known(self) -> PayloadTable:
        for key in ("max_load_kg", "gripper_open_s", "rope_stiffness_n_m"):
            if self.enabled and self.vehicle_mass_kg is None and getattr(self, key) is not None:
                raise ValueError(f"{key} needs vehicle_mass_kg: set it to the mass that hover_thrust carries")
        return self

    def settings(self, control: ControlTable) -> PayloadSettings | None:
        """What the service watches loads with; None if not enabled or without a mass."""
        if not self.enabled or self.vehicle_mass_kg is None:
            return None
        altitude = control.altitude
        return PayloadSettings(
            estimator=PayloadParameters(
                vehicle_mass=self.vehicle_mass_kg,
                hover_thrust=altitude.hover_thrust,
                actuator=ActuatorParameters(np.array([altitude.delay_s]), np.array([altitude.lag_s])),
                rate_variance=altitude.climb_rate_noise_m_s**2,
                hover_thrust_uncertainty=self.hover_thrust_uncertainty,
            ),
            max_load_kg=self.max_load_kg,
            report_hz=self.report_hz,
            gripper_open_s=self.gripper_open_s,
            release_timeout_s=self.release_timeout_s,
        )
