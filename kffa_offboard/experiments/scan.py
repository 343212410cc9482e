"""``python -m kffa_offboard.experiments.scan``: how much the results depend on the numbers that we chose.

Prints the two tables of docs/paper.md as Markdown: the intensity of the Kalman filter's disturbance, and the
fuzzy scaling. ``--seeds`` replaces their number of seeds (5 and 3).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kffa_offboard.control import Array
from kffa_offboard.control.controllers import ALTITUDE, ROLL
from kffa_offboard.experiments import examples, metrics
from kffa_offboard.experiments.evaluate import noise_of
from kffa_offboard.experiments.examples import LOADED_STEP, Trace, Traces
from kffa_offboard.experiments.settings import MAIN, PaperSettings, load

INTENSITIES = (100.0, 300.0, 1000.0, 10_000.0, 100_000.0)
#: Error [rad], its rate [rad/s] and range [rad/s]; the height's error and rate stay in proportion.
SCALINGS = (
    (0.2, 15.0, 4.0), (0.05, 15.0, 4.0), (1.0, 15.0, 4.0), (0.2, 5.0, 4.0), (0.2, 50.0, 4.0), (4.0, 4.0, 4.0),
    (0.2, 15.0, 8.0),
)  # fmt: skip
_FLOWN = ("1/up", "3/load", LOADED_STEP, "4/load/")
_FA, _KFFA = "fa-ladrc", "kffa-ladrc"


@dataclass(frozen=True)
class Sensitivity:
    """What one choice of numbers gives; roll steps to 2 %, the ratios are KFFA- to FA-LADRC's (load case).

    `load_peak_m` is KFFA-LADRC's largest height error after 5 kg are picked up, `loaded_overshoot_percent`
    that of its roll step under 6.73 kg with inertia, `constant_error_rad` FA-LADRC's mean roll error under
    noise.
    """

    fa_roll_step_s: float
    kffa_roll_step_s: float
    load_peak_m: float
    loaded_overshoot_percent: float
    constant_error_rad: float
    omega_c_spread: float
    roll_error: float
    height_error: float
    effort: float


def with_intensity(settings: PaperSettings, intensity: float) -> PaperSettings:
    """The same with one intensity of the disturbance on all channels."""
    kalman = settings.kalman.model_copy(update={"disturbance_intensity": 4 * (intensity,)})
    return settings.model_copy(update={"kalman": kalman})


def with_scaling(settings: PaperSettings, error: float, rate: float, span: float) -> PaperSettings:
    """The same with another fuzzy scaling of the angles, the height's in proportion."""
    chosen = settings.fuzzy
    height = error / chosen.error_scale[ROLL] * chosen.error_scale[ALTITUDE]
    climb = rate / chosen.error_rate_scale[ROLL] * chosen.error_rate_scale[ALTITUDE]
    update = {
        "error_scale": (error, error, error, height),
        "error_rate_scale": (rate, rate, rate, climb),
        "omega_c_range_rad_s": 4 * (span,),
    }
    return settings.model_copy(update={"fuzzy": chosen.model_copy(update=update)})


def sensitivity(settings: PaperSettings, seeds: int) -> Sensitivity:
    """Fly what the tables need with FA- and KFFA-LADRC, and measure it."""
    planned = [
        (variant, [flight for flight in flights if flight.name.startswith(_FLOWN)])
        for variant, flights in examples.plan(settings, (1, 3, 4), seeds)
        if variant in MAIN and variant.name in (_FA, _KFFA)
    ]
    traces = examples.fly_all(settings, planned)
    noisy = {label: noise_of(settings, traces, label, "load") for label in (_FA, _KFFA)}

    def ratio(key: str, channel: int) -> float:
        ours, theirs = (noisy[label][key][:, channel].mean() for label in (_KFFA, _FA))
        return float(ours / theirs)

    loaded = traces[_KFFA, LOADED_STEP]
    return Sensitivity(
        fa_roll_step_s=_roll_step(traces, _FA),
        kffa_roll_step_s=_roll_step(traces, _KFFA),
        load_peak_m=_load_peak(settings, traces[_KFFA, "3/load"]),
        loaded_overshoot_percent=float(_overshoot(loaded)[ROLL]),
        constant_error_rad=float(np.abs(noisy[_FA]["mean_error"][:, ROLL]).mean()),
        omega_c_spread=ratio("omega_c_spread", ROLL),
        roll_error=ratio("rms_error", ROLL),
        height_error=ratio("rms_error", ALTITUDE),
        effort=ratio("effort", ROLL),
    )


def _roll_step(traces: Traces, label: str) -> float:
    trace = traces[label, "1/up"]
    return float(metrics.settling_time(trace.time, trace.output, trace.reference[-1], 0.02)[ROLL])


def _overshoot(trace: Trace) -> Array:
    return metrics.overshoot_percent(trace.output, trace.reference[-1])


def _load_peak(settings: PaperSettings, trace: Trace) -> float:
    carried = trace.time >= settings.examples.load_on_s - 1e-9
    return float(np.abs(trace.error[carried, ALTITUDE]).max())


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        prog="python -m kffa_offboard.experiments.scan", description="Sensitivity tables of docs/paper.md."
    )
    parser.add_argument("--seeds", type=int, help="noise seeds of each row, instead of 5 and 3")
    seeds = parser.parse_args(arguments).seeds
    if seeds is not None and seeds < 1:
        parser.error(f"--seeds {seeds}: must be 1 or more")
    settings = load()
    _row("intensity", "roll step, s", "load peak, mm", "overshoot of the loaded roll step, %",
         "spread of omega_c", "roll error", "height error", "effort")  # fmt: skip
    _row(*8 * ["---"])
    for intensity in INTENSITIES:
        found = sensitivity(with_intensity(settings, intensity), seeds or 5)
        _row(f"{intensity:,.0f}", f"{found.kffa_roll_step_s:.2f}", f"{1000 * found.load_peak_m:.1f}",
             f"{found.loaded_overshoot_percent:.0f}", *_ratios(found), f"{found.effort:.2f}")  # fmt: skip
    print()
    _row("error, rad", "its rate, rad/s", "range, rad/s", "FA-LADRC's roll step, s",
         "its constant error under noise, mrad", "spread of omega_c", "roll error",
         "height error")  # fmt: skip
    _row(*8 * ["---"])
    for scaling in SCALINGS:
        found = sensitivity(with_scaling(settings, *scaling), seeds or 3)
        _row(*(f"{value:g}" for value in scaling), f"{found.fa_roll_step_s:.3f}",
             f"{1000 * found.constant_error_rad:.0f}", *_ratios(found))  # fmt: skip
    return 0


def _ratios(found: Sensitivity) -> list[str]:
    return [f"{value:.2f}" for value in (found.omega_c_spread, found.roll_error, found.height_error)]


def _row(*cells: str) -> None:
    print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
