"""Guard and encoder, fed with commands that nobody should ever want."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

import numpy as np

from kffa_offboard.faults.check import bad_frames, sudden_changes
from kffa_offboard.mavlink.commands import EncodingError, attitude_target
from kffa_offboard.mavlink.component import Component, Route
from kffa_offboard.offboard.events import AttitudeReceived, AttitudeTarget, Event, Output, Vector3
from kffa_offboard.offboard.guard import check_target
from kffa_offboard.offboard.settings import LimitSettings
from kffa_offboard.selftest.result import Row, at_most

GROUP = "guard"
COMMANDS = 20_000
DT_US = 10_000
_BAD = (float("nan"), float("inf"), -float("inf"), 1e30, -1e30)


def run_guard(commands: int = COMMANDS) -> list[Row]:
    """What passed the guard is judged frame by frame; what is no number must not pass."""
    limits, route = LimitSettings(), Route()
    component = Component(route)
    heard: list[tuple[int, Event | Output]] = []
    frames: list[tuple[int, bytes]] = []
    passed_bad = refused = 0
    previous: AttitudeTarget | None = None
    for k, (wanted, attitude) in enumerate(_wishes(commands)):
        time_us = k * DT_US
        numbers = (wanted.thrust, *(wanted.body_rates or ()), *(wanted.attitude or ()))
        checked = check_target(limits, wanted, previous, attitude, _since(heard, time_us), airborne=True)
        if checked.target is None:
            refused += 1
            continue
        passed_bad += not all(map(isfinite, numbers))
        heard.append((time_us, AttitudeReceived(time_us, attitude, (0.0, 0.0, 0.0))))
        heard.append((time_us, checked.target))
        frames.append((time_us, component.pack(attitude_target(route, checked.target, time_us))))
        previous = checked.target
    found = [*bad_frames(limits, frames, airborne=True), *sudden_changes(limits, heard)]
    return [
        at_most(GROUP, f"of {commands} bad commands, out of limits", len(found), 0, "passed"),
        at_most(GROUP, "not a number or infinite", passed_bad, 0, f"passed, {refused} refused"),
        _encoder(route),
    ]


def _since(heard: list[tuple[int, Event | Output]], time_us: int) -> float:
    return (time_us - heard[-1][0]) * 1e-6 if heard else 0.0


def _wishes(count: int) -> Iterator[tuple[AttitudeTarget, Vector3]]:
    """Rates, then attitudes: far out of limits, jumping, sometimes no numbers."""
    generator = np.random.default_rng(0)
    for k in range(count):
        numbers = (generator.normal(0.0, 3.0, 4) * 10.0 ** generator.integers(-1, 3)).tolist()
        if generator.random() < 0.05:
            numbers[int(generator.integers(0, 4))] = _BAD[int(generator.integers(0, len(_BAD)))]
        vector, attitude = (numbers[0], numbers[1], numbers[2]), generator.normal(0.0, 0.3, 3).tolist()
        rates = k < count // 2
        target = AttitudeTarget(numbers[3], vector if rates else None, None if rates else vector)
        yield target, (attitude[0], attitude[1], attitude[2])


def _encoder(route: Route) -> Row:
    """The last door: without guard, nothing that is no number becomes a message."""
    passed = 0
    for bad in _BAD[:3]:
        for target in (AttitudeTarget(bad, (0.0, 0.0, 0.0)), AttitudeTarget(0.4, (0.0, bad, 0.0))):
            try:
                message = attitude_target(route, target, 0)
            except EncodingError:
                continue
            passed += not all(map(isfinite, message.values))
    return at_most(GROUP, "the encoder alone: not a number or infinite", passed, 0, "passed")
