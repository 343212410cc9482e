"""The controller's estimators over a recorded flight: nothing is controlled, everything is judged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.config import load
from kffa_offboard.config_control import ControlTable
from kffa_offboard.control import controllers
from kffa_offboard.control.design import design
from kffa_offboard.control.rotation import body_rates_to_euler_rates
from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis.identify import flying, identify
from kffa_offboard.loganalysis.link_quality import (
    StreamQuality,
    Verdict,
    loop_delays,
    stream_quality,
    verdict,
)
from kffa_offboard.loganalysis.mass import (
    MOTOR_LAG_S,
    USUAL_DELAY_S,
    MassTrack,
    steady_hover_thrust,
    track_mass,
)
from kffa_offboard.loganalysis.record import Array, FlightRecord
from kffa_offboard.offboard.settings import LimitSettings, OutputKind, TelemetrySettings

MOST_STEPS_PER_S = 100.0
"""Faster logs are thinned out to this: the daemon itself never runs faster."""


@dataclass(frozen=True)
class ShadowModel:
    """What the estimators believe of the vehicle."""

    controller: controllers.ControllerParameters
    output: OutputKind
    hover_thrust: float
    origin: str


@dataclass(frozen=True)
class Estimates:
    """Along the flight: `disturbance` ``(n, 4)`` in rad/s^2 and m/s^2, `airborne` ``(n,)``."""

    time_s: Array
    measurement: Array
    estimate: Array
    disturbance: Array
    airborne: Array


@dataclass(frozen=True)
class Shadow:
    """All that a recorded flight tells; parts that the log does not hold are None."""

    record: FlightRecord
    model: ShadowModel
    estimates: Estimates
    mass: MassTrack | None
    attitude: StreamQuality | None
    position: StreamQuality | None
    response_delays_s: dict[str, float]
    loop_delay_s: float | None
    verdict: Verdict


def shadow(record: FlightRecord, config: Path | None) -> Shadow:
    """Run the estimators over a flight.

    Raises UserError if there is no flight, or neither a configuration nor a steady hover to take the model
    from.
    """
    model = _model(record, config)
    attitude, position = stream_quality(record.attitude), stream_quality(record.position)
    delays = loop_delays(record)
    loop_delay = _loop_delay(record, delays)
    spread = max((q.delay_spread_s or 0.0 for q in (attitude, position) if q is not None), default=0.0)
    return Shadow(
        record=record,
        model=model,
        estimates=run_estimators(record, model),
        mass=track_mass(record, model.hover_thrust, USUAL_DELAY_S if loop_delay is None else loop_delay),
        attitude=attitude,
        position=position,
        response_delays_s=delays,
        loop_delay_s=loop_delay,
        verdict=_verdict(record, attitude, position, loop_delay, spread),
    )


def _verdict(
    record: FlightRecord,
    attitude: StreamQuality | None,
    position: StreamQuality | None,
    loop_delay: float | None,
    spread: float,
) -> Verdict:
    found = verdict(attitude, position, loop_delay if record.commands_sent else None, spread)
    if record.source == "tlog":
        return found
    note = "the log was written on board: rates are those of the logger, not of a telemetry link"
    return replace(found, reasons=(*found.reasons, note))


def _model(record: FlightRecord, config: Path | None) -> ShadowModel:
    if config is not None:
        service = load(config).service
        return ShadowModel(service.controller, service.output, service.hover_thrust, str(config))
    hover = steady_hover_thrust(record)
    if hover is None or not 0.05 <= hover <= 0.9:
        found = "no steady hover of 2 s with thrust" if hover is None else f"a hover thrust of {hover:.3g}"
        raise UserError(
            f"{record.path}: {found} in the log to take the model from; give the vehicle's configuration "
            "with --config"
        )
    output: OutputKind = "rates" if record.rates_setpoint or not record.attitude_setpoint else "attitude"
    table = ControlTable.model_validate({"altitude": {"hover_thrust": hover}, "output": output})
    parameters = design("kffa-ladrc", table.settings(LimitSettings()))
    return ShadowModel(parameters, output, hover, "hover thrust from the log, all else defaults")


def _loop_delay(record: FlightRecord, delays: dict[str, float]) -> float | None:
    """Largest identified delay of all but yaw; else the cross-correlation's, less a motor lag; else None."""
    found = [
        channel.delay.value for channel in identify([record]).channels if not channel.name.endswith("yaw")
    ]
    if found:
        return max(found)
    quick = [delay for name, delay in delays.items() if name != "rates.yaw"]
    return max(max(quick) - MOTOR_LAG_S, 0.0) if quick else None


def run_estimators(record: FlightRecord, model: ShadowModel) -> Estimates:
    """Observer and Kalman filter over the flight, told the commands that were applied.

    Raises UserError if there is no position, or less than a second of flight data.
    """
    if not record.position or not record.velocity:
        raise UserError(
            f"{record.path}: no position in the log; record LOCAL_POSITION_NED (.tlog), XKF1 (.BIN) or "
            "vehicle_local_position (.ulg)"
        )
    times = _steps(record)
    if len(times) < 10:
        raise UserError(f"{record.path}: less than ten samples of attitude and position; log a whole flight")
    measured, rates, commands, index = _inputs(record, model, times)
    parameters = replace(model.controller, angular=np.zeros(4, dtype=bool))  # angles are unwrapped already
    state = controllers.initial_state(parameters, measured[0], commands[0])
    estimates, disturbances = [measured[0]], [np.zeros(4)]
    for k in range(1, len(times)):
        fresh = np.array([True, True, True, index[k] != index[k - 1]])
        inputs = controllers.ControllerInput(measured[k], measured[k], fresh, rates[k])
        state, output = controllers.step(parameters, state, inputs, float(times[k] - times[k - 1]))
        state = controllers.with_applied(parameters, state, commands[k])
        estimates.append(output.estimate)
        disturbances.append(output.disturbance)
    return Estimates(times, measured, np.array(estimates), np.array(disturbances), flying(record, times))


def _steps(record: FlightRecord) -> Array:
    """Times of the attitude samples, thinned out, as long as there is position, too."""
    times = record.attitude.time_s
    times = times[(times >= record.position.time_s[0]) & (times <= record.position.time_s[-1])]
    kept = []
    latest = -np.inf
    for time_s in times:
        if time_s - latest >= 0.9 / MOST_STEPS_PER_S:
            kept.append(time_s)
            latest = time_s
    return np.array(kept)


def _inputs(
    record: FlightRecord, model: ShadowModel, times: Array
) -> tuple[Array, Array, Array, NDArray[np.intp]]:
    """Measurement, its rate and the applied command ``(n, 4)``, and which position sample each step has."""
    angles = np.unwrap(record.attitude.values, axis=0)
    held = np.searchsorted(record.attitude.time_s, times, side="right") - 1
    attitude = angles[held]
    index = np.searchsorted(record.position.time_s, times, side="right") - 1
    climb, age = record.velocity.held(times)[:, 2], times - record.position.time_s[index]
    carried = np.where(age <= TelemetrySettings().late_max_s, age * climb, 0.0)  # as `telemetry.altitude_now`
    height = record.position.values[index, 2] + carried
    body = record.body_rates.held(times) if record.body_rates else np.zeros((len(times), 3))
    rates = body_rates_to_euler_rates(attitude.T, body.T).T
    factor = np.cos(attitude[:, 0]) * np.cos(attitude[:, 1])
    thrust = record.thrust.held(times)[:, 0] if record.thrust else np.full(len(times), model.hover_thrust)
    if record.armed:
        thrust = np.where(record.armed.held(times)[:, 0] != 0.0, thrust, 0.0)
    if model.output == "rates":
        wanted = record.rates_setpoint.held(times) if record.rates_setpoint else body
        command = body_rates_to_euler_rates(attitude.T, wanted.T).T
    else:
        wanted = record.attitude_setpoint.held(times) if record.attitude_setpoint else attitude
        command = wanted - 2.0 * np.pi * np.round((wanted - attitude) / (2.0 * np.pi))
    measured = np.concatenate([attitude, height[:, None]], axis=1)
    return (
        measured,
        np.concatenate([rates, climb[:, None]], axis=1),
        np.concatenate([command, (thrust * factor)[:, None]], axis=1),
        index,
    )
