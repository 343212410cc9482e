"""Between the controller's channels (roll, pitch, yaw, vertical thrust) and what goes to and comes from the
vehicle: attitudes, body rates and collective thrust.

The channels' commands are Euler rates or angles, by `output`, and the vertical part of the normalised thrust.
"""

from __future__ import annotations

import numpy as np

from kffa_offboard.control import vehicle
from kffa_offboard.control.plain import Vector
from kffa_offboard.control.rotation import body_rates_of, euler_rates_of, wrap_angle
from kffa_offboard.offboard.events import AttitudeTarget, Vector3
from kffa_offboard.offboard.guard import tilt_factor
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.telemetry import Telemetry, altitude_now, reported_target, reported_thrust


def measurement(settings: ServiceSettings, known: Telemetry) -> Vector:
    """The sample in hand: attitude, and the altitude at its time."""
    assert known.attitude is not None
    return (*known.attitude.attitude, altitude_now(settings.telemetry, known))


def measured_rate(known: Telemetry) -> Vector:
    """The same of its rates: Euler rates and climb rate."""
    assert known.attitude is not None and known.position is not None
    rates = euler_rates_of(known.attitude.attitude, known.attitude.body_rates)
    return (*rates, known.position.velocity[2])


def autopilot_command(settings: ServiceSettings, known: Telemetry, time_us: int, near: Vector) -> Vector:
    """What the autopilot itself commands, in the controller's channels.

    Thrust: reported target, else throttle, else hover thrust; zero while disarmed. Attitude: reported
    target, else what is measured. Angles are given in the turn of `near`.
    """
    assert known.attitude is not None
    attitude = known.attitude.attitude
    target = reported_target(settings.telemetry, known, time_us)
    thrust = reported_thrust(settings.telemetry, known, time_us)
    if thrust is None:
        thrust = settings.hover_thrust
    if known.heartbeat is not None and not known.heartbeat.armed:
        thrust = 0.0
    if settings.output == "rates":
        wanted = target.body_rates if target is not None else None
        return command_of(
            settings, attitude, AttitudeTarget(thrust, wanted or known.attitude.body_rates), near
        )
    wanted = target.attitude if target is not None else None
    return command_of(settings, attitude, AttitudeTarget(thrust, attitude=wanted or attitude), near)


def as_measured(settings: ServiceSettings, known: Telemetry, near: Vector) -> Vector:
    """The command that asks for what the vehicle does anyway, hovering."""
    assert known.attitude is not None
    rates, attitude = known.attitude.body_rates, known.attitude.attitude
    target = AttitudeTarget(settings.hover_thrust, body_rates=rates)
    if settings.output == "attitude":
        target = AttitudeTarget(settings.hover_thrust, attitude=attitude)
    return command_of(settings, attitude, target, near)


def command_of(settings: ServiceSettings, attitude: Vector3, target: AttitudeTarget, near: Vector) -> Vector:
    """A setpoint in the controller's channels; angles in the turn of `near`."""
    vertical = target.thrust * tilt_factor(settings.limits, attitude)
    if target.body_rates is not None:
        rates = euler_rates_of(attitude, target.body_rates)
        return (*rates, vertical)
    assert target.attitude is not None
    return vehicle.wrap_near((*target.attitude, vertical), near, settings.controller)


def target_of(settings: ServiceSettings, attitude: Vector3, command: Vector) -> AttitudeTarget:
    """The setpoint for a command in the controller's channels."""
    roll, pitch, yaw, vertical = command
    thrust = vertical / tilt_factor(settings.limits, attitude)
    if settings.output == "rates":
        return AttitudeTarget(thrust, body_rates=body_rates_of(attitude, (roll, pitch, yaw)))
    return AttitudeTarget(thrust, attitude=(roll, pitch, float(wrap_angle(np.array(yaw)))))


def level_target(settings: ServiceSettings, yaw: float, thrust: float) -> AttitudeTarget:
    """No rotation (or level attitude with heading `yaw`) with a given collective thrust."""
    if settings.output == "rates":
        return AttitudeTarget(thrust, body_rates=(0.0, 0.0, 0.0))
    return AttitudeTarget(thrust, attitude=(0.0, 0.0, float(wrap_angle(np.array(yaw)))))
