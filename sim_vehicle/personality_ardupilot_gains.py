"""Gains of the ArduCopter personality from its parameters, with their units taken out (cm, centidegrees)."""

from __future__ import annotations

import math
from typing import NamedTuple

from sim_vehicle.attitude_loop import Vector3
from sim_vehicle.guidance import Guidance
from sim_vehicle.parameters import ParameterStore
from sim_vehicle.position_loop import HorizontalGains, VerticalGains
from sim_vehicle.rate_loop import RateGains

ACCELERATION_SCALE = 0.1
"""PSC_ACCZ_P and _I give thousandths of full thrust for an error in cm/s^2: 0.1 of it for one in m/s^2."""


class AttitudeGains(NamedTuple):
    """Attitude loop and input shaping; axes roll, pitch, yaw."""

    gain: Vector3  # 1/s, ATC_ANG_x_P
    input_gain: float  # 1/s, of ATC_INPUT_TC
    acceleration: Vector3  # rad/s^2, ATC_ACCEL_x_MAX; 0 = no shaping
    rate_max: Vector3  # rad/s, ATC_RATE_x_MAX; 0 = no limit
    feed_forward: bool  # ATC_RATE_FF_ENAB


def attitude_gains(p: ParameterStore) -> AttitudeGains:
    """Attitude loop."""
    return AttitudeGains(
        gain=(p["ATC_ANG_RLL_P"], p["ATC_ANG_PIT_P"], p["ATC_ANG_YAW_P"]),
        input_gain=1.0 / max(0.01, p["ATC_INPUT_TC"]),
        acceleration=(
            math.radians(0.01 * p["ATC_ACCEL_R_MAX"]),
            math.radians(0.01 * p["ATC_ACCEL_P_MAX"]),
            math.radians(0.01 * p["ATC_ACCEL_Y_MAX"]),
        ),
        rate_max=(
            math.radians(p["ATC_RATE_R_MAX"]),
            math.radians(p["ATC_RATE_P_MAX"]),
            math.radians(p["ATC_RATE_Y_MAX"]),
        ),
        feed_forward=p["ATC_RATE_FF_ENAB"] >= 1,
    )


def rate_gains(p: ParameterStore) -> RateGains:
    """Rate loop."""
    axes = ("RLL", "PIT", "YAW")

    def gains(name: str) -> Vector3:
        roll, pitch, yaw = (p[f"ATC_RAT_{axis}_{name}"] for axis in axes)
        return roll, pitch, yaw

    return RateGains(
        proportional=gains("P"),
        integral=gains("I"),
        derivative=gains("D"),
        integral_limit=gains("IMAX"),
        derivative_on_error=True,
        derivative_cutoff_hz=p["ATC_RAT_RLL_FLTD"],
        target_cutoff_hz=gains("FLTT"),
    )


def guidance(p: ParameterStore, gravity: float) -> Guidance:
    """Height and position cascades."""
    hover = p["MOT_THST_HOVER"]
    per_acceleration = ACCELERATION_SCALE * gravity / hover
    vertical = VerticalGains(
        height=p["PSC_POSZ_P"],
        climb=p["PSC_VELZ_P"],
        climb_integral=p["PSC_VELZ_I"],
        acceleration=p["PSC_ACCZ_P"] * per_acceleration,
        acceleration_integral=p["PSC_ACCZ_I"] * per_acceleration,
        acceleration_cutoff_hz=p["PSC_ACCZ_FLTE"],
        climb_max=0.01 * p["WPNAV_SPEED_UP"],
        descent_max=0.01 * p["WPNAV_SPEED_DN"],
        hover_thrust=hover,
        thrust_min=0.0,
        thrust_max=1.0,
        gravity=gravity,
    )
    horizontal = HorizontalGains(
        position=p["PSC_POSXY_P"],
        velocity=p["PSC_VELXY_P"],
        velocity_integral=p["PSC_VELXY_I"],
        speed_max=0.01 * p["WPNAV_SPEED"],
        tilt_max=math.radians(0.01 * p["ANGLE_MAX"]),
        gravity=gravity,
    )
    return Guidance(vertical, horizontal)
