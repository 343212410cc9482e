"""The `[position]` table: the outer ring that holds the horizontal position.

The numbers are those of `control.position.PositionDesign`, degrees for the tilt; they fit the simulated
10 kg quadrotor, and any multirotor whose attitude loop is quicker.
"""

from __future__ import annotations

from math import radians, sqrt
from typing import Annotated

from pydantic import model_validator

from kffa_offboard.config_control import Bandwidth, ControlTable, Delay, OptionalDelay, Table
from kffa_offboard.config_units import number
from kffa_offboard.control.controllers import ControllerName
from kffa_offboard.control.position import PositionDesign, design_ring
from kffa_offboard.offboard.settings import PositionSettings

_RING = PositionDesign()


class PositionTable(Table):
    """`[position]`: hold the place of lift-off or engaging, and fly scenario moves.

    `delay_s` and `lag_s` describe how a roll or pitch reference becomes roll or pitch: link, tracking
    differentiator and attitude loop; `prediction_s`, how far ahead of the estimate the law looks, is their
    sum if left out. Needs LOCAL_POSITION_NED with x and y.

    Where a load swings on a rope (`payload.rope_length_m`, or it shows) the ring goes on as a PID with three
    poles at a quarter of `omega_c`, which damps the swing; with a rope that is told, set points move so
    that they start none (`offboard/sway.py`).
    """

    enabled: bool = False
    omega_c: Bandwidth = _RING.omega_c
    omega_o: Bandwidth = _RING.omega_o
    omega_c_range: Annotated[float, number("rad/s", at_least=0.0, at_most=1000.0)] = _RING.omega_c_range
    delay_s: Delay = _RING.delay
    lag_s: Delay = _RING.lag
    prediction_s: OptionalDelay = None
    reference_filter_s: Annotated[float, number("s", at_least=0.005, at_most=2.0)] = _RING.filter_time
    tilt_max_deg: Annotated[float, number("deg", at_least=3.0, at_most=60.0)] = 20.0
    error_scale_m: Annotated[float, number("m", above=0.0, at_most=100.0)] = _RING.error_scale
    error_rate_scale_m_s: Annotated[float, number("m/s", above=0.0, at_most=100.0)] = _RING.error_rate_scale
    measurement_noise_m: Annotated[float, number("m", above=0.0, at_most=10.0)] = _RING.position_noise
    velocity_noise_m_s: Annotated[float, number("m/s", above=0.0, at_most=10.0)] = 0.02
    disturbance_intensity: Annotated[float, number(above=0.0)] = _RING.disturbance_intensity
    braking_m_s2: Annotated[float, number("m/s^2", at_least=0.1, at_most=20.0)] = 1.0
    error_max_m: Annotated[float, number("m", above=0.0, at_most=1000.0)] = 5.0
    jump_m: Annotated[float, number("m", above=0.0, at_most=1000.0)] = 1.0
    speed_max_m_s: Annotated[float, number("m/s", above=0.0, at_most=100.0)] = 20.0

    @model_validator(mode="after")
    def _bandwidths_fit(self) -> PositionTable:
        if not self.omega_c_range < self.omega_c < self.omega_o:
            raise ValueError(
                f"omega_c_range = {self.omega_c_range:g}, omega_c = {self.omega_c:g}, omega_o = "
                f"{self.omega_o:g} rad/s: must rise in this order; usually omega_o is 3 times omega_c"
            )
        return self

    def settings(self, control: ControlTable, rope_length_m: float) -> PositionSettings | None:
        """What the service flies with, by the controller of `control`; None if not enabled."""
        if not self.enabled:
            return None
        numbers, damps = self.numbers(control), damping_controller(control)
        return PositionSettings(
            ring=design_ring(control.controller, numbers),
            tilt_max_rad=radians(self.tilt_max_deg),
            braking_m_s2=self.braking_m_s2,
            error_max_m=self.error_max_m,
            jump_m=self.jump_m,
            speed_max_m_s=self.speed_max_m_s,
            damping=None if damps == control.controller else design_ring(damps, numbers, follows=True),
            on_rope=rope_length_m > 0.0,
            sway_rad_s=sqrt(numbers.gravity / rope_length_m) if rope_length_m > 0.0 else 0.0,
        )

    def numbers(self, control: ControlTable) -> PositionDesign:
        """Those of the ring."""
        prediction = self.delay_s + self.lag_s if self.prediction_s is None else self.prediction_s
        return PositionDesign(
            omega_c=self.omega_c,
            omega_o=self.omega_o,
            omega_c_range=self.omega_c_range,
            tilt_max=radians(self.tilt_max_deg),
            delay=self.delay_s,
            lag=self.lag_s,
            prediction=prediction,
            filter_time=self.reference_filter_s,
            error_scale=self.error_scale_m,
            error_rate_scale=self.error_rate_scale_m_s,
            position_noise=self.measurement_noise_m,
            velocity_noise=self.velocity_noise_m_s if control.fuse_rates else None,
            disturbance_intensity=self.disturbance_intensity,
            rules=control.rules,
            literal_filter=control.kalman == "literal",
        )


def damping_controller(control: ControlTable) -> ControllerName:
    """By which controller the ring damps a load that swings: the one that flies if it does, else a PID."""
    return control.controller if control.controller in ("pid", "cascaded-pid") else "pid"
