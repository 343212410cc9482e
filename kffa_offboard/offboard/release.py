"""Releasing a load whose mass and moment are known: thrust steps when the load leaves.

The thrust that carried the load must be gone when the load goes. A step of the command acts behind delay
and lag; its centroid lies `lag` after its arrival at the motors, so the impulse of too little thrust
before the release equals that of too much after it if the load leaves at the centroid. Setpoint and
gripper command take the same link, so its delay cancels: if the gripper is quicker than the motors its
command waits, if it is slower the thrust does.
"""

from __future__ import annotations

from dataclasses import dataclass

from kffa_offboard.control import controllers, vehicle
from kffa_offboard.control.payload import GRAVITY
from kffa_offboard.offboard.loop import LoopState
from kffa_offboard.offboard.payload_settings import PayloadSettings


@dataclass(frozen=True, slots=True)
class ReleasePlan:
    """When what happens, from the moment of planning.

    Attributes
    ----------
    load : kg
    disturbance_step : m/s^2 on the altitude channel
    gripper_after_s : until the gripper's command goes out
    shows_after_s : until the release shows in the measurements
    """

    load: float
    disturbance_step: float
    gripper_after_s: float
    shows_after_s: float


def plan_release(
    settings: PayloadSettings, controller: controllers.ControllerParameters, load: float, period_s: float
) -> ReleasePlan | None:
    """Plan the release of `load` kg; the control step `period_s` from now is the first that can step thrust.

    None without `gripper_open_s`, and with a controller that estimates no disturbance.
    """
    if settings.gripper_open_s is None or controller.observer is None:
        return None
    delay = float(controller.actuator.delay[controllers.ALTITUDE])
    lag = float(controller.actuator.lag[controllers.ALTITUDE])
    gripper_after = max(0.0, period_s + lag - settings.gripper_open_s)
    return ReleasePlan(
        load=load,
        disturbance_step=GRAVITY * load / settings.estimator.vehicle_mass,
        gripper_after_s=gripper_after,
        shows_after_s=gripper_after + settings.gripper_open_s + delay,
    )


def altitude_disturbance(loop: LoopState) -> float:
    """Disturbance estimate of the altitude channel, m/s^2."""
    _, _, disturbance = vehicle.estimates(loop.controller)
    return disturbance[controllers.ALTITUDE]


def with_altitude_step(
    parameters: controllers.ControllerParameters, loop: LoopState, step: float, after_s: float = 0.0
) -> LoopState:
    """The altitude channel's disturbance changes by `step`, m/s^2, `after_s` s from now."""
    return loop.with_controller(
        vehicle.with_disturbance_step(parameters, loop.controller, (0.0, 0.0, 0.0, step), after_s)
    )
