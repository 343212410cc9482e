"""Flights to numbers: results.json without its claims. All on the true output; s, m, rad, % in the keys."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from kffa_offboard.control import Array
from kffa_offboard.control import tracking_differentiator as td
from kffa_offboard.control.controllers import ALTITUDE, CHANNELS, ROLL
from kffa_offboard.experiments import metrics
from kffa_offboard.experiments.examples import DISTURBANCES, LOADED_STEP, LOADS, Trace, Traces
from kffa_offboard.experiments.flights import STEP_S
from kffa_offboard.experiments.settings import PaperSettings

RECOVERED_M = 0.001  # a load change is over when the height stays within this
#: Example 4's comparisons: numerator and denominator.
RATIOS = {
    "kffa-ladrc : fa-ladrc": ("kffa-ladrc", "fa-ladrc"),
    "kffa-ladrc/even : fa-ladrc/even": ("kffa-ladrc/even", "fa-ladrc/even"),
    "kffa-ladrc/literal : fa-ladrc": ("kffa-ladrc/literal", "fa-ladrc"),
}


def evaluate(settings: PaperSettings, traces: Traces, examples: Iterable[int]) -> dict[str, Any]:
    """All numbers of the examples that were flown, nested dictionaries of floats; inf means never."""
    measured = {1: _steps, 2: _triangles, 3: _loads, 4: _noise}
    return {f"example{example}": measured[example](settings, traces) for example in examples}


def by_channel(values: Array) -> dict[str, float]:
    """Four numbers under the names of the channels."""
    return {name: float(value) for name, value in zip(CHANNELS, values, strict=True)}


def labels(traces: Traces, flight: str) -> list[str]:
    """The controllers that flew `flight`, in the order flown."""
    return [label for label, name in traces if name == flight]


def _steps(settings: PaperSettings, traces: Traces) -> dict[str, Any]:
    result: dict[str, Any] = {"controllers": {}}
    for label in labels(traces, "1/up"):
        result["controllers"][label] = {
            direction: _step(traces[label, f"1/{direction}"]) for direction in ("up", "down")
        }
    result["differentiator_alone"] = _differentiator_alone(settings)
    return result


def _step(trace: Trace) -> dict[str, Any]:
    step = trace.reference[-1]
    return {
        "settling_2_percent_s": by_channel(metrics.settling_time(trace.time, trace.output, step, 0.02)),
        "settling_01_percent_s": by_channel(metrics.settling_time(trace.time, trace.output, step, 0.001)),
        "overshoot_percent": by_channel(metrics.overshoot_percent(trace.output, step)),
        "peak_command": by_channel(np.abs(trace.command).max(axis=0)),
    }


def _differentiator_alone(settings: PaperSettings) -> dict[str, Any]:
    """How long the published TD takes by itself, whatever follows it."""
    told, step = settings.differentiator, np.array(settings.examples.step)
    parameters = td.TrackingDifferentiatorParameters(np.full(4, told.acceleration), told.filter_time_s)
    state = td.TrackingDifferentiatorState(np.zeros(4), np.zeros(4), np.zeros(4))
    positions = [state.position]
    for _ in range(round(settings.examples.step_duration_s / STEP_S)):
        state = td.step(parameters, state, step, STEP_S)
        positions.append(state.position)
    time, output = np.arange(len(positions), dtype=np.float64) * STEP_S, np.array(positions)
    return {
        "settling_2_percent_s": by_channel(metrics.settling_time(time, output, step, 0.02)),
        "settling_01_percent_s": by_channel(metrics.settling_time(time, output, step, 0.001)),
    }


def _triangles(settings: PaperSettings, traces: Traces) -> dict[str, Any]:
    result = {}
    for label in labels(traces, "2/triangle"):
        trace = traces[label, "2/triangle"]
        result[label] = {
            "lag_s": by_channel(metrics.lag(trace.time, trace.reference, trace.output)),
            "rms_error": by_channel(metrics.rms(trace.error)),
        }
    return {"controllers": result}


def _loads(settings: PaperSettings, traces: Traces) -> dict[str, Any]:
    return {
        "controllers": {
            label: {
                **{name: _load(settings, traces[label, f"3/{name}"]) for name in LOADS},
                "loaded-step": _step(traces[label, LOADED_STEP]),
            }
            for label in labels(traces, "3/load")
        }
    }


def _load(settings: PaperSettings, trace: Trace) -> dict[str, Any]:
    told = settings.examples
    result: dict[str, Any] = {}
    windows = {"pick_up": (told.load_on_s, told.load_off_s), "drop": (told.load_off_s, told.duration_s)}
    for event, (start, end) in windows.items():
        shown = (trace.time >= start - 1e-9) & (trace.time < end - 1e-9)
        time, error = trace.time[shown] - start, trace.error[shown]
        omega_c = trace.omega_c[shown]
        result[event] = {
            "peak_m": float(np.abs(error[:, ALTITUDE]).max()),
            "recovery_s": float(metrics.recovery_time(time, error[:, ALTITUDE], RECOVERED_M)),
            "peak_attitude_rad": float(np.abs(error[:, :ALTITUDE]).max()),
            "altitude_omega_c_change": _change(omega_c[:, ALTITUDE]),
            "roll_omega_c_change": _change(omega_c[:, ROLL]),
        }
    return result


def _change(omega_c: Array) -> float:
    """Largest departure of omega_c from its value at the event, rad/s."""
    return float(np.abs(omega_c - omega_c[0]).max())


def _noise(settings: PaperSettings, traces: Traces) -> dict[str, Any]:
    result: dict[str, Any] = {"controllers": {}, "ratios": {}}
    for label in labels(traces, "4/load/0"):
        result["controllers"][label] = {
            case: {
                name: by_channel(values.mean(axis=0))
                for name, values in noise_of(settings, traces, label, case).items()
            }
            for case in DISTURBANCES
        }
    for name, (upper, lower) in RATIOS.items():
        result["ratios"][name] = {
            case: _ratios(settings, traces, upper, lower, case) for case in DISTURBANCES
        }
    return result


def noise_of(settings: PaperSettings, traces: Traces, label: str, case: str) -> dict[str, Array]:
    """Example 4's numbers of one controller, ``(seeds, 4)`` each, when the step at the start is over."""
    flown = [
        trace for (flown, name), trace in traces.items() if flown == label and name.startswith(f"4/{case}/")
    ]
    measured: dict[str, list[Array]] = {"omega_c_spread": [], "rms_error": [], "mean_error": [], "effort": []}
    for trace in flown:
        shown = trace.time >= settings.examples.settled_after_s - 1e-9
        measured["omega_c_spread"].append(trace.omega_c[shown].std(axis=0))
        measured["rms_error"].append(metrics.rms(trace.error[shown]))
        measured["mean_error"].append(trace.error[shown].mean(axis=0))
        measured["effort"].append(trace.command[shown].std(axis=0))
    return {name: np.array(values) for name, values in measured.items()}


def _ratios(settings: PaperSettings, traces: Traces, upper: str, lower: str, case: str) -> dict[str, Any]:
    """One controller's mean over the seeds as a share of another's, and the worst seed's share."""
    numerator, denominator = (noise_of(settings, traces, label, case) for label in (upper, lower))
    wanted = {
        "roll_omega_c_spread": ("omega_c_spread", ROLL),
        "roll_rms_error": ("rms_error", ROLL),
        "altitude_rms_error": ("rms_error", ALTITUDE),
        "roll_effort": ("effort", ROLL),
        "altitude_effort": ("effort", ALTITUDE),
    }
    return {
        key: {
            "mean": float(numerator[name][:, channel].mean() / denominator[name][:, channel].mean()),
            "worst": float((numerator[name][:, channel] / denominator[name][:, channel]).max()),
        }
        for key, (name, channel) in wanted.items()
    }
