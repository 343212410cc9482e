"""PX4's parameters that matter to an offboard controller.

Names, units and meaning from PX4 main 5b6e4416: modules/commander/commander_params.c,
mc_att_control_params.c, lib/mixer_module/motor_params.c, modules/payload_deliverer.
"""

from __future__ import annotations

from kffa_offboard.mavlink.parameter_check import (
    Checks,
    CheckSettings,
    Finding,
    Judge,
    gripper_enabled,
    hover_thrust,
    rate_limit,
)

SHORTEST_LOSS_S = 0.5
LONGEST_LOSS_S = 1.0
HOLD_ACTION = 5.0
_FALLING = {6: "Terminate", 7: "Disarm"}
_NEEDS_STICKS = {0: "Position", 1: "Altitude", 2: "Stabilized"}


def _loss_time(settings: CheckSettings, value: float | None) -> Finding | None:
    name = "COM_OF_LOSS_T"
    if value is None or SHORTEST_LOSS_S <= value <= LONGEST_LOSS_S:
        return None
    why = "the last setpoint flies on so long when the daemon falls silent"
    if value < SHORTEST_LOSS_S:
        why = "a short pause of the link ends offboard control"
    fix = LONGEST_LOSS_S
    return Finding(name, "warning", f"{name} {value:g} s: {why}; set {name} {fix:g}", fix)


def _loss_action(settings: CheckSettings, value: float | None) -> Finding | None:
    name = "COM_OBL_RC_ACT"
    if value is None:
        return None
    action = int(value)
    if action in _FALLING:
        text = (
            f"{name} {action} ({_FALLING[action]}) drops the vehicle if the link is lost; set {name} 5 (Hold)"
        )
        return Finding(name, "unsafe", text, HOLD_ACTION)
    if action in _NEEDS_STICKS:
        text = f"{name} {action} ({_NEEDS_STICKS[action]}): a pilot must take over if the link is lost"
        return Finding(name, "information", text)
    return None


def _thrust_curve(settings: CheckSettings, value: float | None) -> Finding | None:
    name = "THR_MDL_FAC"
    if value is None or value == 0.0:
        return None
    text = f"{name} {value:g} curves thrust: right only if it makes your motors' thrust linear"
    return Finding(name, "information", text)


def _attitude_rate_limit(name: str, axis: int) -> Judge:
    """MC_xRATE_MAX bounds what the attitude loop asks for; commanded body rates pass it by."""
    compare = rate_limit(name, axis)
    return lambda settings, value: None if settings.output == "rates" else compare(settings, value)


def _spool_time(settings: CheckSettings, value: float | None) -> Finding | None:
    name = "COM_SPOOLUP_TIME"
    if value is None or value <= settings.px4_spool_time_s:
        return None
    text = f"{name} {value:g}: thrust acts so many s after arming; set flight.px4_spool_time_s"
    return Finding(name, "warning", text)


def _stick_override(settings: CheckSettings, value: float | None) -> Finding | None:
    """Bit 1: moving a stick ends offboard control."""
    if value is None or int(value) & 2:
        return None
    text = f"COM_RC_OVERRIDE {value:g}: sticks do not end offboard control, only the mode switch does"
    return Finding("COM_RC_OVERRIDE", "information", text)


def _stick_input(settings: CheckSettings, value: float | None) -> Finding | None:
    if value is None or int(value) != 4:
        return None
    return Finding("COM_RC_IN_MODE", "information", "COM_RC_IN_MODE 4: no pilot can take over with sticks")


CHECKS: Checks = {
    "COM_OF_LOSS_T": _loss_time,
    "COM_OBL_RC_ACT": _loss_action,
    "THR_MDL_FAC": _thrust_curve,
    "MPC_THR_HOVER": hover_thrust("MPC_THR_HOVER"),
    "MC_ROLLRATE_MAX": _attitude_rate_limit("MC_ROLLRATE_MAX", 0),
    "MC_PITCHRATE_MAX": _attitude_rate_limit("MC_PITCHRATE_MAX", 1),
    "MC_YAWRATE_MAX": _attitude_rate_limit("MC_YAWRATE_MAX", 2),
    "COM_SPOOLUP_TIME": _spool_time,
    "COM_RC_OVERRIDE": _stick_override,
    "COM_RC_IN_MODE": _stick_input,
    "PD_GRIPPER_EN": gripper_enabled("PD_GRIPPER_EN"),
}
"""In the order in which they are read and reported."""
