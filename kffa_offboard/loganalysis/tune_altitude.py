"""The altitude channel's gains: a search over everything that shapes its answer to a load.

omega_c, omega_o and prediction as in `tune`, and the Kalman filter with them: how much the height counts
beside the climb rate (`measurement_noise_m`) and how fast the disturbance may come
(`disturbance_intensity`). Beside the margins the noise of the commanded thrust is bounded: without that
bound the quickest loops shake the motors. Differential evolution (R. Storn and K. Price, J. Global
Optimization 11, 1997) with a fixed seed.

One number stands for all margins: `score`, the least of the three margins over what is wanted of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import differential_evolution

from kffa_offboard.control.controllers import ALTITUDE
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
from kffa_offboard.loganalysis.record import Array

GRAVITY = 9.80665
LOAD = 0.5
"""The load that comes and goes, as a share of the empty vehicle's mass."""
LOADED_GAIN = 1.0 / (1.0 + LOAD)
"""What thrust does to the loaded vehicle, as a share of what it does to the empty one."""
DROP_M_S2, PICK_UP_M_S2 = LOAD * GRAVITY, LOADED_GAIN * LOAD * GRAVITY
"""What the load's going does to the empty vehicle, and its coming to the loaded one."""
THRUST_NOISE_SHARE = 0.1
"""Largest rms noise of the commanded thrust, as a share of hover thrust."""

_LOWER = np.array([np.log(0.5), np.log(2.5), 0.0, 0.0, np.log(1.0)])
_UPPER = np.array([np.log(12.0), np.log(60.0), 2.5, np.log(10.0), np.log(10_000.0)])
OMEGA_O_MOST = 250.0
_PEAK_S, _DISTURBED_S = 1.5, 4.0
_GENERATIONS, _POPULATION = 14, 5
_UNUSABLE = 100.0
_SCALES = (1.0, 0.85, 0.7, 0.55, 0.4)
"""Shares of the wanted margins for the trade-off curve."""


@dataclass(frozen=True)
class Candidate:
    """Gains of the altitude channel and what they give.

    Attributes
    ----------
    margins : of the empty vehicle's loop; the loaded one's is stable
    pick_up_peak, drop_peak : m, after a load of half the vehicle's mass comes and goes
    thrust_noise : rms of the commanded thrust, of full thrust, with the sensor noise of the configuration
    """

    omega_c: float
    omega_o: float
    prediction_s: float
    measurement_noise: float
    disturbance_intensity: float
    margins: Margins
    pick_up_peak: float
    drop_peak: float
    thrust_noise: float
    controller: LinearSystem = field(repr=False)

    @property
    def peak(self) -> float:
        """The larger of the two."""
        return max(self.pick_up_peak, self.drop_peak)

    def score(self, wanted: Wanted) -> float:
        """1 if every margin is as wanted, or more; less in the proportion in which the worst one is less."""
        found = self.margins
        return min(
            found.gain_db / wanted.gain_db,
            found.phase_deg / wanted.phase_deg,
            found.delay_s / wanted.delay_s if wanted.delay_s > 0.0 else np.inf,
        )


class AltitudeSearch:
    """Looks for gains on one vehicle; remembers every candidate that it met.

    Parameters
    ----------
    base : the controller as configured
    numbers : the vehicle
    hover_thrust : bounds the noise of the thrust
    """

    def __init__(self, base: LinearController, numbers: PlantNumbers, hover_thrust: float) -> None:
        self.vehicle = plant(numbers, base.period_s)
        self._loaded = plant(replace(numbers, b0=LOADED_GAIN * numbers.b0), base.period_s)
        self.met: list[Candidate] = []
        self._base, self._numbers = base, numbers
        self._noise_most = THRUST_NOISE_SHARE * hover_thrust
        filtering = base.parameters.kalman
        assert filtering is not None
        self._height_noise = float(np.sqrt(filtering.measurement_variance[ALTITUDE]))
        rate = filtering.rate_variance
        self._sensors = np.array(
            [self._height_noise**2, 0.0 if rate is None else float(np.ravel(rate)[ALTITUDE])]
        )
        self._omega = frequencies(base.period_s)

    def quickest(self, wanted: Wanted) -> Candidate:
        """The least peak with the margins. Raises UserError if nothing has them."""

        def cost(found: Candidate) -> float:
            return found.peak + 0.5 * max(0.0, 1.0 - found.score(wanted))

        self._search(cost)
        fitting = [found for found in self._calm() if found.score(wanted) >= 1.0]
        if not fitting:
            raise UserError(
                f"altitude: nothing keeps {wanted.gain_db:g} dB, {wanted.phase_deg:g} deg and "
                f"{1e3 * wanted.delay_s:g} ms with a delay of {1e3 * self._numbers.delay_s:.0f} ms; ask for "
                "smaller margins or shorten the delay"
            )
        return min(fitting, key=lambda found: found.peak)

    def calmest(self, peak: float, wanted: Wanted) -> Candidate:
        """The most margin, in the proportions of `wanted`, with a peak of at most `peak` m.

        Raises UserError if nothing has it.
        """

        def cost(found: Candidate) -> float:
            return -0.1 * min(found.score(wanted), 3.0) + 5.0 * max(0.0, found.peak / peak - 1.0)

        self._search(cost)
        fitting = [found for found in self._calm() if found.peak <= peak]
        if not fitting:
            least = min((found.peak for found in self._calm()), default=np.inf)
            raise UserError(
                f"altitude: no loop keeps the peak below {peak:g} m; the least found is "
                f"{least:.3f} m. Shorten the delay, or let the daemon command the drop"
            )
        return max(fitting, key=lambda found: found.score(wanted))

    def trade_off(self, wanted: Wanted) -> list[tuple[float, Candidate]]:
        """For falling shares of the wanted margins: the least peak (share, candidate); what is impossible
        is left out.
        """
        rows = []
        for share in _SCALES:
            part = Wanted(share * wanted.gain_db, share * wanted.phase_deg, share * wanted.delay_s)
            try:
                rows.append((share, self.quickest(part)))
            except UserError:
                continue
        return [
            (share, min((one for other, one in rows if other >= share), key=lambda one: one.peak))
            for share, _ in rows
        ]

    def _calm(self) -> list[Candidate]:
        return [found for found in self.met if found.thrust_noise <= self._noise_most]

    def _search(self, cost: Callable[[Candidate], float]) -> None:
        def judged(point: Array) -> float:
            found = self._candidate(point)
            if found is None:
                return _UNUSABLE
            self.met.append(found)
            return cost(found) + 0.3 * max(0.0, float(np.log(found.thrust_noise / self._noise_most)))

        differential_evolution(
            judged,
            list(zip(_LOWER, _UPPER, strict=True)),
            popsize=_POPULATION,
            maxiter=_GENERATIONS,
            init="sobol",
            tol=0.0,
            polish=False,
            rng=0,
        )

    def _candidate(self, point: Array) -> Candidate | None:
        """None for an unstable loop."""
        omega_c, omega_o = float(np.exp(point[0])), float(min(np.exp(point[0] + point[1]), OMEGA_O_MOST))
        numbers = self._numbers
        prediction = max(numbers.delay_s + float(point[2]) * numbers.lag_s, 1e-4)
        noise, intensity = self._height_noise * float(np.exp(point[3])), float(np.exp(point[4]))
        everywhere = np.ones(4)
        controller = (
            self._base.with_filter(ALTITUDE, noise**2, intensity)
            .with_prediction(ALTITUDE, prediction)
            .with_bandwidths(omega_c * everywhere, omega_o * everywhere)
            .system(ALTITUDE)
        )
        closed = closed_loop(controller, self.vehicle)
        loaded = closed_loop(controller, self._loaded)
        if not (is_stable(closed) and is_stable(loaded)):
            return None
        response = frequency_response(open_loop(controller, self.vehicle), self._omega)
        return Candidate(
            omega_c=omega_c,
            omega_o=omega_o,
            prediction_s=prediction,
            measurement_noise=noise,
            disturbance_intensity=intensity,
            margins=margins(self._omega, response),
            pick_up_peak=PICK_UP_M_S2 * float(np.abs(step_response(loaded, _PEAK_S)).max()),
            drop_peak=DROP_M_S2 * float(np.abs(step_response(closed, _PEAK_S)).max()),
            thrust_noise=command_noise(controller, self.vehicle, closed, self._sensors),
            controller=controller,
        )

    def area(self, found: Candidate) -> float:
        """Integrated size of the deviation after the drop, m s."""
        closed = closed_loop(found.controller, self.vehicle)
        response = np.abs(step_response(closed, _DISTURBED_S))
        return DROP_M_S2 * float(response.sum()) * self._base.period_s


def command_noise(
    controller: LinearSystem, vehicle: LinearSystem, closed: LinearSystem, variances: Array
) -> float:
    """Rms of the command when output and rate are measured with white noise of `variances` ``(2,)``."""
    sensors = np.diag(variances)
    inward = np.concatenate([vehicle.b[:, :1] @ controller.d, controller.b])
    spread = solve_discrete_lyapunov(closed.a, inward @ sensors @ inward.T)
    outward = np.concatenate([controller.d @ vehicle.c, controller.c], axis=1)
    variance = outward @ spread @ outward.T + controller.d @ sensors @ controller.d.T
    return float(np.sqrt(variance[0, 0]))
