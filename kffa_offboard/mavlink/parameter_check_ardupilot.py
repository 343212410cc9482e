"""ArduCopter's parameters that matter to an offboard controller.

Names, units and meaning from ArduCopter 4.7-dev: ArduCopter/Parameters.cpp, mode_guided.cpp,
AC_AttitudeControl.cpp, AP_MotorsMulticopter.cpp.
"""

from __future__ import annotations

from math import radians

from kffa_offboard.mavlink.parameter_check import (
    Checks,
    CheckSettings,
    Finding,
    Judge,
    gripper_enabled,
    hover_thrust,
    must_be,
    no_opinion,
    rate_limit,
)

THRUST_AS_THRUST = 8
"""GUID_OPTIONS bit 3."""

LOW_OUTPUT_S = 2.0
"""Outputs stay low so long after arming; MOT_SPOOL_TIME follows."""

LONGEST_TIMEOUT_S = 0.5
SLOWEST_SPIN_UP_S = 0.5


def thrust_is_climb_rate(options: float) -> bool:
    """GUID_OPTIONS makes the thrust field of SET_ATTITUDE_TARGET a climb rate."""
    return not int(options) & THRUST_AS_THRUST


def _guided_options(settings: CheckSettings, value: float | None) -> Finding | None:
    name = "GUID_OPTIONS"
    if value is None:
        text = f"{name} not reported: thrust may be read as climb rate; update ArduCopter or check the link"
        return Finding(name, "unsafe", text)
    if not thrust_is_climb_rate(value):
        return None
    fix = float(int(value) | THRUST_AS_THRUST)
    text = f"{name} bit 3 is off: thrust would be read as climb rate; set {name} {fix:g}"
    return Finding(name, "unsafe", text, fix)


def _guided_timeout(settings: CheckSettings, value: float | None) -> Finding | None:
    """Longer than the pause between two setpoints, and no longer than stale rates may fly."""
    name = "GUID_TIMEOUT"
    if value is None or 1.5 * settings.resend_s <= value <= LONGEST_TIMEOUT_S:
        return None
    why = "the last setpoint flies on so long when the daemon falls silent"
    if value < LONGEST_TIMEOUT_S:
        why = f"shorter than pauses between setpoints ({settings.resend_s:g} s) may last"
    return Finding(
        name,
        "warning",
        f"{name} {value:g} s: {why}; set {name} {LONGEST_TIMEOUT_S:g}",
        LONGEST_TIMEOUT_S,
    )


def _rate_feed_forward(settings: CheckSettings, value: float | None) -> Finding | None:
    name = "ATC_RATE_FF_ENAB"
    if value is None or value >= 1.0 or settings.output != "rates":
        return None
    text = f'{name} 0: body rates are followed late with output = "rates"; set {name} 1'
    return Finding(name, "unsafe", text, 1.0)


def _acceleration_limit(axis: int) -> Judge:
    """ATC_ACCEL_x_MAX [cdeg/s^2], 0 for none: how long until our greatest body rate is reached."""
    letter = "RPY"[axis]
    name = f"ATC_ACCEL_{letter}_MAX"

    def judge(settings: CheckSettings, value: float | None) -> Finding | None:
        if value is None or value <= 0.0:
            return None
        rate = settings.limits.body_rate_max_rad_s[axis]
        needed = rate / radians(value / 100.0)
        if needed <= SLOWEST_SPIN_UP_S:
            return None
        text = (
            f"{name} {value:g}: {needed:.1f} s to reach limits' {rate:.1f} rad/s; raise it, or set 0 for none"
        )
        return Finding(name, "warning", text)

    return judge


def _spool_time(settings: CheckSettings, value: float | None) -> Finding | None:
    name, ours = "MOT_SPOOL_TIME", settings.ardupilot_spool_time_s
    if value is None or LOW_OUTPUT_S + value <= ours:
        return None
    needed = LOW_OUTPUT_S + value
    text = f"{name} {value:g}: thrust acts {needed:.1f} s after arming; set flight.ardupilot_spool_time_s"
    return Finding(name, "warning", text)


def _thrust_curve(settings: CheckSettings, value: float | None) -> Finding | None:
    name = "MOT_THST_EXPO"
    if value is None or value == 0.0:
        return None
    text = f"{name} {value:g} curves thrust: right only if it makes your motors' thrust linear"
    return Finding(name, "information", text)


def _radio_failsafe(settings: CheckSettings, value: float | None) -> Finding | None:
    if value is None or value > 0.0:
        return None
    return Finding("FS_THR_ENABLE", "information", "FS_THR_ENABLE 0: nothing happens if the radio is lost")


def _estimator_failsafe(settings: CheckSettings, value: float | None) -> Finding | None:
    if value is None or value > 0.0:
        return None
    return Finding("FS_EKF_ACTION", "information", "FS_EKF_ACTION 0: nothing happens if the EKF fails")


CHECKS: Checks = {
    "GUID_OPTIONS": _guided_options,
    "GUID_TIMEOUT": _guided_timeout,
    "ATC_ANGLE_BOOST": must_be("ATC_ANGLE_BOOST", 0.0, "warning", "tilt is compensated twice"),
    "PILOT_THR_FILT": must_be("PILOT_THR_FILT", 0.0, "warning", "thrust is delayed by a filter"),
    "ATC_RATE_FF_ENAB": _rate_feed_forward,
    "SCHED_LOOP_RATE": no_opinion,
    "ATC_RATE_R_MAX": rate_limit("ATC_RATE_R_MAX", 0),
    "ATC_RATE_P_MAX": rate_limit("ATC_RATE_P_MAX", 1),
    "ATC_RATE_Y_MAX": rate_limit("ATC_RATE_Y_MAX", 2),
    "ATC_ACCEL_R_MAX": _acceleration_limit(0),
    "ATC_ACCEL_P_MAX": _acceleration_limit(1),
    "ATC_ACCEL_Y_MAX": _acceleration_limit(2),
    "MOT_THST_HOVER": hover_thrust("MOT_THST_HOVER"),
    "MOT_THST_EXPO": _thrust_curve,
    "MOT_SPOOL_TIME": _spool_time,
    "FS_THR_ENABLE": _radio_failsafe,
    "FS_EKF_ACTION": _estimator_failsafe,
    "GRIP_ENABLE": gripper_enabled("GRIP_ENABLE"),
}
"""In the order in which they are read and reported."""
