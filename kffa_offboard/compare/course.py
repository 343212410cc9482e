"""The scenarios that the daemon flies, as segments of its configuration."""

from __future__ import annotations

import math
from typing import Any

from kffa_offboard.compare.measure import FlownStep
from kffa_offboard.compare.plan import DROP_S, END_S, HEIGHT_M, Trial

STEP_DEG, YAW_STEP_DEG = 10.0, 30.0
STEP_S, REST_S = 1.5, 3.0
YAW_STEP_S, YAW_REST_S = 6.0, 6.0

_STEPS = [
    (channel, sign * amplitude, duration, rest)
    for channel, amplitude, duration, rest in (
        ("roll", STEP_DEG, STEP_S, REST_S),
        ("pitch", STEP_DEG, STEP_S, REST_S),
        ("yaw", YAW_STEP_DEG, YAW_STEP_S, YAW_REST_S),
    )
    for sign in (1.0, -1.0)
]
"""Roll and pitch both ways, so that the vehicle comes to rest again, then yaw both ways."""


def course(trial: Trial) -> list[dict[str, Any]]:
    """The segments that the daemon flies. The load comes and goes by the physics' clock."""
    takeoff = {"type": "takeoff", "altitude_m": HEIGHT_M, "climb_rate_m_s": 1.0}
    land = {"type": "land", "descent_rate_m_s": 1.0}
    match trial.course:
        case "load":
            return [takeoff, _hold(END_S - HEIGHT_M), land]
        case "release":
            release = {"type": "gripper", "action": "release"}
            return [takeoff, _hold(DROP_S - HEIGHT_M), release, _hold(END_S - DROP_S), land]
        case "attitude":
            return [takeoff, _hold(10.0), *_steps(), land]


def _hold(duration_s: float) -> dict[str, Any]:
    return {"type": "hold", "duration_s": duration_s}


def _steps() -> list[dict[str, Any]]:
    segments: list[dict[str, Any]] = []
    for channel, amplitude, duration, rest in _STEPS:
        step = {"type": "step", "channel": channel, "amplitude_deg": amplitude, "duration_s": duration}
        segments += [step, _hold(rest)]
    return segments


def flown_steps() -> list[FlownStep]:
    """The same steps as `measure_steps` takes them."""
    after, steps = 0.0, []
    for channel, amplitude, duration, rest in _STEPS:
        steps.append(FlownStep(channel, math.radians(amplitude), after))
        after += duration + rest
    return steps
