"""Bandwidths for given margins: the quickest recovery from a load that leaves the loop its margins.

The altitude channel has a search of its own (`tune_altitude`), with the Kalman filter in it. For the others:

For each ratio omega_o / omega_c of `RATIOS`, and for each of three prediction horizons (the delay, and one
and two
actuator lags more), omega_c comes down from `OMEGA_C_MOST` until the loop of `loop_model` is stable and has
all margins; among these the one is taken whose output moves least after a step disturbance (integrated size).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kffa_offboard.config_control import ControlTable
from kffa_offboard.control.controllers import ALTITUDE, CHANNELS, ControllerParameters
from kffa_offboard.control.design import design
from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis.loop_model import (
    LinearController,
    LinearSystem,
    PlantNumbers,
    closed_loop,
    frequency_response,
    is_stable,
    open_loop,
    plant,
    step_response,
)
from kffa_offboard.loganalysis.margins import Margins, Wanted, frequencies, margins
from kffa_offboard.loganalysis.tune_altitude import DROP_M_S2, AltitudeSearch, Candidate
from kffa_offboard.offboard.settings import LimitSettings

RATIOS = (4.0, 6.25, 10.0, 20.0, 40.0)
OMEGA_C_LEAST, OMEGA_C_MOST, OMEGA_C_STEPS = 0.5, 12.0, 18
OMEGA_O_MOST = 80.0
"""Beyond it the observer gains nothing that sensor noise would not take away."""
_DISTURBED_S = 4.0


@dataclass(frozen=True)
class AltitudeChoice:
    """The Kalman filter of the altitude channel as tuned, and what the altitude's loop does.

    Attributes
    ----------
    thrust_noise : rms, of full thrust
    pick_up_peak_m, drop_peak_m : when a load of half the vehicle's mass comes and goes
    """

    measurement_noise_m: float
    disturbance_intensity: float
    thrust_noise: float
    pick_up_peak_m: float
    drop_peak_m: float


@dataclass(frozen=True)
class Tuning:
    """Tuned channels; and for shares of the margins asked for, what altitude gains would give."""

    channels: tuple[TunedChannel, ...]
    trade_off: tuple[tuple[float, Candidate], ...] = ()


@dataclass(frozen=True)
class TunedChannel:
    """Bandwidths of one channel [rad/s] and what they give.

    Attributes
    ----------
    prediction_s : how far ahead of its estimate the law looks
    margins : of the loop
    loop : open loop, for drawing
    disturbance_peak, disturbance_area : of the output after a step disturbance of 1 output unit/s^2, and the
        integral of its size over 4 s
    """

    name: str
    omega_c: float
    omega_o: float
    prediction_s: float
    margins: Margins
    loop: LinearSystem
    disturbance_peak: float
    disturbance_area: float
    altitude: AltitudeChoice | None = None


def plant_numbers(parameters: ControllerParameters, channel: int) -> PlantNumbers:
    """The plant that the controller itself believes in."""
    model, acting = parameters.model, parameters.actuator
    return PlantNumbers(
        float(np.ravel(model.b0)[channel]),
        float(np.ravel(model.damping)[channel]),
        float(np.ravel(model.stiffness)[channel]),
        float(np.ravel(acting.delay)[channel]),
        float(np.ravel(acting.lag)[channel]),
    )


def parameters_of(control: ControlTable) -> ControllerParameters:
    """The controller that a `[control]` table makes, whatever name it has: Kalman filter and observer."""
    return design("kffa-ladrc", control.settings(LimitSettings()))


def _judge(
    base: LinearController, vehicle: LinearSystem, channel: int, omega_c: float, omega_o: float
) -> tuple[Margins, LinearSystem, LinearSystem] | None:
    """Margins, open and closed loop; None if it is unstable."""
    everywhere = np.ones(4)
    controller = base.with_bandwidths(omega_c * everywhere, omega_o * everywhere).system(channel)
    closed = closed_loop(controller, vehicle)
    if not is_stable(closed):
        return None
    loop = open_loop(controller, vehicle)
    omega = frequencies(vehicle.period_s)
    return margins(omega, frequency_response(loop, omega)), loop, closed


def judge(
    control: ControlTable, channel: int, period_s: float, vehicle: PlantNumbers | None = None
) -> Margins | None:
    """Margins of a channel as configured, on its own model or on another `vehicle`; None if unstable."""
    parameters = parameters_of(control)
    settings = control.settings(LimitSettings())
    base = LinearController.of(parameters, period_s)
    numbers = plant_numbers(parameters, channel) if vehicle is None else vehicle
    found = _judge(
        base,
        plant(numbers, period_s),
        channel,
        float(settings.omega_c[channel]),
        float(settings.omega_o[channel]),
    )
    return None if found is None else found[0]


def tune_channel(base: LinearController, numbers: PlantNumbers, channel: int, wanted: Wanted) -> TunedChannel:
    """Find the bandwidths of one channel.

    Raises UserError if not even the lowest bandwidth has the margins.
    """
    vehicle = plant(numbers, base.period_s)
    best: TunedChannel | None = None
    for lags in (0.0, 1.0, 2.0) if numbers.lag_s > 0.0 else (0.0,):
        ahead = base.with_prediction(channel, max(numbers.delay_s + lags * numbers.lag_s, 1e-4))
        for ratio in RATIOS:
            found = _fastest(ahead, vehicle, channel, wanted, ratio)
            if found is not None and (best is None or found.disturbance_area < best.disturbance_area):
                best = found
    if best is None:
        raise UserError(
            f"{CHANNELS[channel]}: no omega_c from {OMEGA_C_LEAST:g} rad/s on keeps {wanted.gain_db:g} dB, "
            f"{wanted.phase_deg:g} deg and {1e3 * wanted.delay_s:g} ms with a delay of "
            f"{1e3 * numbers.delay_s:.0f} ms; ask for smaller margins or shorten the delay"
        )
    return best


def _fastest(
    base: LinearController, vehicle: LinearSystem, channel: int, wanted: Wanted, ratio: float
) -> TunedChannel | None:
    """The largest omega_c with the margins at omega_o = ratio omega_c."""
    assert base.parameters.prediction is not None
    most = min(OMEGA_C_MOST, OMEGA_O_MOST / ratio)
    for omega_c in np.geomspace(most, OMEGA_C_LEAST, OMEGA_C_STEPS):
        found = _judge(base, vehicle, channel, float(omega_c), ratio * float(omega_c))
        if found is None or not found[0].meet(wanted):
            continue
        response = np.abs(step_response(found[2], _DISTURBED_S))
        return TunedChannel(
            name=CHANNELS[channel],
            omega_c=float(omega_c),
            omega_o=ratio * float(omega_c),
            prediction_s=float(base.parameters.prediction[channel]),
            margins=found[0],
            loop=found[1],
            disturbance_peak=float(response.max()),
            disturbance_area=float(response.sum() * base.period_s),
        )
    return None


def tune(
    control: ControlTable,
    channels: tuple[int, ...],
    period_s: float,
    wanted: Wanted,
    peak_m: float | None = None,
    with_trade_off: bool = False,
) -> Tuning:
    """Tune the given channels of a configuration; `period_s` is that of the telemetry.

    With `peak_m` the altitude channel gets the most margin with which a load of half the vehicle's mass
    moves it by no more. Raises UserError where a wish cannot be had.
    """
    parameters = parameters_of(control)
    base = LinearController.of(parameters, period_s)
    tuned = [tune_channel(base, plant_numbers(parameters, k), k, wanted) for k in channels if k != ALTITUDE]
    if ALTITUDE not in channels:
        return Tuning(tuple(tuned))
    if parameters.kalman is None or parameters.kalman.model != "extended":
        raise UserError('altitude: only kalman = "extended" can be tuned')
    search = AltitudeSearch(base, plant_numbers(parameters, ALTITUDE), control.altitude.hover_thrust)
    found = search.quickest(wanted) if peak_m is None else search.calmest(peak_m, wanted)
    trade_off = search.trade_off(wanted) if with_trade_off else []
    return Tuning((*tuned, _tuned_altitude(search, found)), tuple(trade_off))


def _tuned_altitude(search: AltitudeSearch, found: Candidate) -> TunedChannel:
    return TunedChannel(
        name=CHANNELS[ALTITUDE],
        omega_c=found.omega_c,
        omega_o=found.omega_o,
        prediction_s=found.prediction_s,
        margins=found.margins,
        loop=open_loop(found.controller, search.vehicle),
        disturbance_peak=found.drop_peak / DROP_M_S2,
        disturbance_area=search.area(found) / DROP_M_S2,
        altitude=AltitudeChoice(
            found.measurement_noise,
            found.disturbance_intensity,
            found.thrust_noise,
            found.pick_up_peak,
            found.drop_peak,
        ),
    )


def allowed_bandwidths(dead_time_s: float, lag_s: float, period_s: float, wanted: Wanted) -> TunedChannel:
    """Bandwidths that a link allows the altitude channel of any vehicle with motor lag `lag_s`.

    b0 cancels in the loop, so that the vehicle's mass and thrust do not matter.
    """
    table = ControlTable.model_validate(
        {"altitude": {"hover_thrust": 0.5, "delay_s": dead_time_s, "lag_s": lag_s}}
    )
    parameters = parameters_of(table)
    base = LinearController.of(parameters, period_s)
    return tune_channel(base, plant_numbers(parameters, 3), 3, wanted)
