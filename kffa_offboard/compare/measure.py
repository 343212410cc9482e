"""The figures of the comparison, all from true states.

Height: deviation from the vehicle's own mean true height in the 5 s before the pick-up. What the estimator
has wrong there (barometer, satellite fix) is no controller's doing, and all rows have the same rule. Windows
are 5 s (`trials.metrics.WINDOW_S`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.flightlog.signals import SignalTable
from kffa_offboard.trials.metrics import WINDOW_S, Deviation, FlightFailed, Truth, measure

Array = NDArray[np.float64]

RECOVERED_M = 0.03
"""A pick-up or drop is over when the vehicle stays this near."""

SETTLED = 0.05
"""Of the step."""

SWING = 0.05
"""Of the step: smaller turns of the response are noise."""

STEP_WINDOW_S = {"roll": 1.45, "pitch": 1.45, "yaw": 5.9}
"""A little less than the steps last."""

ONSET_RAD = 5e-4
REFERENCE_RISE_S = 0.5
BEFORE_STEP_S = 0.05
AIRBORNE_M = 0.05


@dataclass(frozen=True)
class LoadFigures:
    """What a pick-up and a drop did.

    Attributes
    ----------
    reference_m : mean height before the pick-up
    pickup, drop : largest and integrated deviation of height
    pickup_recovery_s, drop_recovery_s : until it stays within `RECOVERED_M`; None if not in the window
    hover_rms_m : rms deviation before the pick-up
    level_rms_deg : rms of roll and pitch before the pick-up
    tilt_peak_deg : largest roll or pitch in the windows after pick-up and drop
    pickup_s, drop_s : when, in simulated time
    """

    reference_m: float
    pickup: Deviation
    drop: Deviation
    pickup_recovery_s: float | None
    drop_recovery_s: float | None
    hover_rms_m: float
    level_rms_deg: float
    tilt_peak_deg: float
    pickup_s: float
    drop_s: float


@dataclass(frozen=True)
class PlaceFigures:
    """How well the place was held: horizontal distance from the mean place before the pick-up, m.

    Attributes
    ----------
    hover_rms_m : in the 5 s before the pick-up
    pickup_peak_m, drop_peak_m : largest, in the 5 s after each
    """

    hover_rms_m: float
    pickup_peak_m: float
    drop_peak_m: float


@dataclass(frozen=True)
class StepFigures:
    """A step of an angle, measured from the moment when the reference begins to move.

    Attributes
    ----------
    channel : "roll", "pitch" or "yaw"
    overshoot_percent : beyond the step
    settling_s : until it stays within 5 % of the step; None if it does not while the step lasts
    swings : turns of the response by more than 5 % of the step
    """

    channel: str
    overshoot_percent: float
    settling_s: float | None
    swings: int


@dataclass(frozen=True)
class FlownStep:
    """A step of the attitude course: channel, `amplitude` in rad, `after_s` the first step."""

    channel: str
    amplitude: float
    after_s: float


def measure_load(truth: Truth) -> LoadFigures:
    """Measure a flight with a pick-up and a drop. Raises FlightFailed if it was none."""
    picked_up = truth.load_mass_kg > 0.0
    if not picked_up.any():
        raise FlightFailed("nothing was picked up")
    pickup_s = float(truth.time_s[np.argmax(picked_up)])
    before = _during(truth, pickup_s - WINDOW_S, pickup_s)
    reference = float(truth.z[before].mean())
    figures = measure(truth, reference)
    tilt = np.maximum(np.abs(truth.roll), np.abs(truth.pitch))
    after = _during(truth, figures.pickup_s, figures.pickup_s + WINDOW_S)
    after |= _during(truth, figures.drop_s, figures.drop_s + WINDOW_S)
    level = np.concatenate([truth.roll[before], truth.pitch[before]])
    return LoadFigures(
        reference_m=reference,
        pickup=figures.pickup,
        drop=figures.drop,
        pickup_recovery_s=_recovery(truth, reference, figures.pickup_s),
        drop_recovery_s=_recovery(truth, reference, figures.drop_s),
        hover_rms_m=figures.hover_rms_m,
        level_rms_deg=float(np.degrees(np.sqrt(np.mean(level**2)))),
        tilt_peak_deg=float(np.degrees(tilt[after].max())),
        pickup_s=figures.pickup_s,
        drop_s=figures.drop_s,
    )


def measure_place(truth: Truth, load: LoadFigures) -> PlaceFigures:
    """Measure how the place was held in a flight whose height `load` has measured."""
    before, picked_up, dropped = (
        _during(truth, start_s, start_s + WINDOW_S)
        for start_s in (load.pickup_s - WINDOW_S, load.pickup_s, load.drop_s)
    )
    away = np.hypot(truth.x - truth.x[before].mean(), truth.y - truth.y[before].mean())
    return PlaceFigures(
        hover_rms_m=float(np.sqrt(np.mean(away[before] ** 2))),
        pickup_peak_m=float(away[picked_up].max()),
        drop_peak_m=float(away[dropped].max()),
    )


def _during(truth: Truth, start_s: float, end_s: float) -> NDArray[np.bool_]:
    return np.asarray((truth.time_s >= start_s) & (truth.time_s < end_s))


def _recovery(truth: Truth, reference: float, event_s: float) -> float | None:
    window = _during(truth, event_s, event_s + WINDOW_S)
    outside = np.flatnonzero(np.abs(truth.z[window] - reference) > RECOVERED_M)
    if not outside.size:
        return 0.0
    times = truth.time_s[window]
    return None if outside[-1] + 1 >= times.size else float(times[outside[-1] + 1] - event_s)


def measure_steps(truth: Truth, signals: SignalTable, steps: Sequence[FlownStep]) -> list[StepFigures]:
    """Measure the `steps` of a flight, in their order.

    The first is found in the daemon's reference, the others follow by the scenario's own times. Log and truth
    share the simulated time. Raises FlightFailed if the log does not hold them.
    """
    angles = {"roll": truth.roll, "pitch": truth.pitch, "yaw": np.unwrap(truth.yaw)}
    time = signals.time_us / 1e6
    first = _first_onset(time, signals.reference[:, 0], truth, steps[0].amplitude)
    figures = []
    for step in steps:
        onset = first + step.after_s
        window = STEP_WINDOW_S[step.channel]
        if truth.time_s[-1] < onset + window:
            raise FlightFailed(f"the flight ended during the {step.channel} step")
        reference = np.unwrap(signals.reference[:, ("roll", "pitch", "yaw").index(step.channel)])
        base = float(np.interp(onset - BEFORE_STEP_S, time, reference))
        shown = (truth.time_s >= onset) & (truth.time_s < onset + window)
        response = (angles[step.channel][shown] - base) / step.amplitude
        figures.append(_step_figures(step.channel, truth.time_s[shown] - onset, response))
    return figures


def _first_onset(time: Array, reference: Array, truth: Truth, amplitude: float) -> float:
    """When the roll reference first begins to go a good part of `amplitude` in the air."""
    first = int(np.searchsorted(time, truth.time_s[np.argmax(truth.z > AIRBORNE_M)]))
    gone = np.flatnonzero(np.abs(reference[first:]) > 0.3 * abs(amplitude))
    if not gone.size:
        raise FlightFailed("the flight log holds no steps")
    before = int(np.searchsorted(time, time[first + gone[0]] - REFERENCE_RISE_S))
    moved = np.flatnonzero(np.abs(reference[before:] - reference[before]) > ONSET_RAD)
    return float(time[before + moved[0]])


def _step_figures(channel: str, time: Array, response: Array) -> StepFigures:
    outside = np.flatnonzero(np.abs(response - 1.0) > SETTLED)
    last = int(outside[-1]) + 1 if outside.size else 0
    return StepFigures(
        channel,
        overshoot_percent=100.0 * max(0.0, float(response.max()) - 1.0),
        settling_s=None if last >= time.size else float(time[last]),
        swings=_swings(response),
    )


def _swings(response: Array) -> int:
    """How often the response turns back by more than `SWING`."""
    turns, rising, extreme = 0, True, float(response[0])
    for value in response.tolist():
        if (value > extreme) == rising:
            extreme = value
        elif abs(value - extreme) > SWING:
            turns, rising, extreme = turns + 1, not rising, value
    return turns
