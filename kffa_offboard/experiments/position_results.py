"""The position ring's flights to numbers and verdicts: what the paper claims of it and does not show."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from kffa_offboard.control import Array
from kffa_offboard.control.controllers import ControllerName
from kffa_offboard.experiments import metrics
from kffa_offboard.experiments.claims import FAILS, HOLDS, OTHER, Claim, Verdict
from kffa_offboard.experiments.examples import POSITION
from kffa_offboard.experiments.position_flights import CORNERS, PositionTrace, PositionTraces
from kffa_offboard.experiments.settings import PaperSettings, PositionRing
from kffa_offboard.trials.metrics import distance_from_path

HOVER_RMS_M, EXCURSION_M, OVERSHOOT_PERCENT = 0.15, 0.30, 5.0
OURS: ControllerName = "kffa-ladrc"


def evaluate_position(settings: PaperSettings, traces: PositionTraces) -> dict[str, Any]:
    """All numbers of the position ring: of each, mean and worst over the seeds (``inf``: never)."""
    told = settings.position
    measures: dict[str, Callable[[PositionRing, PositionTrace], dict[str, float]]] = {
        "hover": _hover,
        "step": _step,
        "loaded-step": _step,
        "square": _square,
    }
    result: dict[str, Any] = {}
    for label in dict.fromkeys(label for label, _, _ in traces):
        result[label] = {}
        for flight, measure in measures.items():
            found = [
                measure(told, trace)
                for (flown, name, _), trace in traces.items()
                if (flown, name) == (label, flight)
            ]
            result[label][flight] = {key: _over_seeds(one[key] for one in found) for key in found[0]}
    return {"seeds": len({seed for _, _, seed in traces}), "controllers": result}


def _over_seeds(values: Iterable[float]) -> dict[str, float]:
    found = np.array(list(values))
    return {"mean": float(found.mean()), "worst": float(found.max())}


def _horizontal(trace: PositionTrace) -> Array:
    """Distance from the set point (T,), m."""
    return np.asarray(np.hypot(*(trace.place[:, :2] - trace.target).T))


def _within(trace: PositionTrace, start_s: float, end_s: float = np.inf) -> Any:
    return (trace.time >= start_s - 1e-9) & (trace.time < end_s - 1e-9)


def _hover(told: PositionRing, trace: PositionTrace) -> dict[str, float]:
    away, height = _horizontal(trace), np.abs(trace.place[:, 2] - told.altitude_m)
    before = _within(trace, told.lead_s, told.pick_up_s)
    carrying, after = _within(trace, told.pick_up_s, told.drop_s), _within(trace, told.drop_s)
    return {
        "rms_m": float(metrics.rms(away[before])),
        "peak_m": float(away[before].max()),
        "height_rms_m": float(metrics.rms(height[before])),
        "pick_up_m": float(away[carrying].max()),
        "pick_up_height_m": float(height[carrying].max()),
        "drop_m": float(away[after].max()),
        "drop_height_m": float(height[after].max()),
    }


def _step(told: PositionRing, trace: PositionTrace) -> dict[str, float]:
    shown = _within(trace, told.lead_s)
    time, place = trace.time[shown] - told.lead_s, trace.place[shown]
    step = np.array([told.step_m])
    return {
        "settling_2_percent_s": float(metrics.settling_time(time, place[:, :1], step, 0.02)[0]),
        "overshoot_percent": float(metrics.overshoot_percent(place[:, :1], step)[0]),
        "sideways_m": float(np.abs(place[:, 1]).max()),
        "tilt_deg": float(np.degrees(_tilt(trace.attitude[shown]).max())),
    }


def _tilt(attitude: Array) -> Array:
    """Angle (T,) between body z and the vertical, rad."""
    return np.asarray(np.arccos(np.cos(attitude[:, 0]) * np.cos(attitude[:, 1])))


def _square(told: PositionRing, trace: PositionTrace) -> dict[str, float]:
    shown = _within(trace, told.lead_s)
    after = _within(trace, told.square_drop_s)
    away = distance_from_path(trace.place[:, :2], told.step_m * np.array(CORNERS))
    return {
        "off_the_line_m": float(away[shown].max()),
        "off_the_line_rms_m": float(metrics.rms(away[shown])),
        "behind_m": float(_horizontal(trace)[shown].max()),
        "drop_height_m": float(np.abs(trace.place[after, 2] - told.altitude_m).max()),
    }


def judge_position(results: dict[str, Any]) -> list[Claim]:
    """The ring's claims, judged on KFFA-LADRC's worst seed; the comparison only if others have flown, too."""
    found = results[POSITION]["controllers"]
    judged = [judge(found[OURS]) for judge in (_hovering, _dropping, _stepping, _square_flown)]
    if len(found) > 1:
        judged.append(_compared(found))
    return [Claim(POSITION, *one) for one in judged]


Judged = tuple[str, str, Verdict]


def _shown(value: dict[str, float], digits: int = 3) -> str:
    return f"{value['mean']:.{digits}f} (worst seed {value['worst']:.{digits}f})"


def _hovering(found: dict[str, Any]) -> Judged:
    hover = found["hover"]
    return (
        "The position ring, too, is KFFA-LADRC (Fig 2, no results): it holds a point in gusty wind of 5 m/s "
        f"(target: {HOVER_RMS_M:g} m rms).",
        f"{_shown(hover['rms_m'])} m rms horizontally, height {_shown(hover['height_rms_m'])} m rms.",
        HOLDS if hover["rms_m"]["worst"] <= HOVER_RMS_M else FAILS,
    )


def _dropping(found: dict[str, Any]) -> Judged:
    hover = found["hover"]
    return (
        f"A load of 5 kg comes and goes, the place stays (target: {EXCURSION_M:g} m horizontally at the "
        "drop).",
        f"Drop: {_shown(hover['drop_m'])} m horizontally, {_shown(hover['drop_height_m'])} m in height; "
        f"pick-up: {_shown(hover['pick_up_m'])} m and {_shown(hover['pick_up_height_m'])} m. In the hover "
        "before, the "
        f"gusts alone move it {_shown(hover['peak_m'])} m: a load below the centre pushes straight down.",
        HOLDS if max(hover[key]["worst"] for key in ("drop_m", "pick_up_m")) <= EXCURSION_M else FAILS,
    )


def _stepping(found: dict[str, Any]) -> Judged:
    empty, loaded = found["step"], found["loaded-step"]
    largest = max(flight["overshoot_percent"]["worst"] for flight in (empty, loaded))
    return (
        f"A step of 5 m, empty and with 5 kg (target: at most {OVERSHOOT_PERCENT:g} % overshoot).",
        f"Overshoot {_shown(empty['overshoot_percent'], 1)} % empty, "
        f"{_shown(loaded['overshoot_percent'], 1)} % "
        f"loaded; within 2 % after {_shown(empty['settling_2_percent_s'], 2)} s and "
        f"{_shown(loaded['settling_2_percent_s'], 2)} s, tilt up to {loaded['tilt_deg']['worst']:.0f} "
        "degrees. Here "
        "the TD stands in front: without it the step would ask for more tilt than there is.",
        HOLDS if largest <= OVERSHOOT_PERCENT else FAILS,
    )


def _square_flown(found: dict[str, Any]) -> Judged:
    square = found["square"]
    return (
        f"A square of 5 m, the load dropped on its second side (target: within {EXCURSION_M:g} m of the "
        "line).",
        f"Off the line at most {_shown(square['off_the_line_m'])} m, rms "
        f"{_shown(square['off_the_line_rms_m'])} m; "
        f"height at the drop {_shown(square['drop_height_m'])} m. Along the line it is up to "
        f"{square['behind_m']['worst']:.1f} m behind the moving set point: the TD's delay.",
        HOLDS if square["off_the_line_m"]["worst"] <= EXCURSION_M else FAILS,
    )


def _compared(found: dict[str, Any]) -> Judged:
    keys = ("rms_m", "drop_m", "drop_height_m")
    means = {label: [flown["hover"][key]["mean"] for key in keys] for label, flown in found.items()}
    others = [label for label in means if label != OURS]
    beaten = [all(np.less(means[OURS], means[label])) for label in others]
    shown = "; ".join(
        f"{label} {', '.join(f'{1000 * value:.0f}' for value in values)} mm"
        for label, values in means.items()
    )
    return (
        "KFFA-LADRC holds place and height better than the others.",
        f"Hover rms, drop horizontally, drop in height: {shown}. Two things to bear in mind: all fly the "
        "bandwidths that were chosen for KFFA-LADRC, and of the LADRCs only this one has a filter that takes "
        "the velocity that the autopilot sends.",
        OTHER if all(beaten) else FAILS,
    )
