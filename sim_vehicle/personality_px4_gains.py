"""Gains of the PX4 personality from its parameters, with degrees taken out."""

from __future__ import annotations

import math

from sim_vehicle.guidance import Guidance
from sim_vehicle.parameters import ParameterStore
from sim_vehicle.position_loop import HorizontalGains, VerticalGains
from sim_vehicle.rate_loop import ZERO, RateGains


def rate_gains(p: ParameterStore) -> RateGains:
    """Rate loop."""
    return RateGains(
        (p["MC_ROLLRATE_P"], p["MC_PITCHRATE_P"], p["MC_YAWRATE_P"]),
        (p["MC_ROLLRATE_I"], p["MC_PITCHRATE_I"], p["MC_YAWRATE_I"]),
        (p["MC_ROLLRATE_D"], p["MC_PITCHRATE_D"], p["MC_YAWRATE_D"]),
        (p["MC_RR_INT_LIM"], p["MC_PR_INT_LIM"], p["MC_YR_INT_LIM"]),
        derivative_on_error=False,
        derivative_cutoff_hz=p["IMU_DGYRO_CUTOFF"],
        target_cutoff_hz=ZERO,
    )


LEAST_HOVER_THRUST = 0.1
"""MPC_THR_HOVER's least value in PX4's metadata; less is not flown with."""


def guidance(p: ParameterStore, gravity: float) -> Guidance:
    """Height and position cascades."""
    vertical = VerticalGains(
        height=p["MPC_Z_P"],
        climb=p["MPC_Z_VEL_P_ACC"],
        climb_integral=p["MPC_Z_VEL_I_ACC"],
        acceleration=0.0,
        acceleration_integral=0.0,
        acceleration_cutoff_hz=20.0,
        climb_max=p["MPC_Z_VEL_MAX_UP"],
        descent_max=p["MPC_Z_VEL_MAX_DN"],
        hover_thrust=max(LEAST_HOVER_THRUST, p["MPC_THR_HOVER"]),
        thrust_min=p["MPC_THR_MIN"],
        thrust_max=p["MPC_THR_MAX"],
        gravity=gravity,
    )
    horizontal = HorizontalGains(
        position=p["MPC_XY_P"],
        velocity=p["MPC_XY_VEL_P_ACC"],
        velocity_integral=p["MPC_XY_VEL_I_ACC"],
        speed_max=p["MPC_XY_VEL_MAX"],
        tilt_max=math.radians(p["MPC_TILTMAX_AIR"]),
        gravity=gravity,
    )
    return Guidance(vertical, horizontal)
