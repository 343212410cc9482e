"""Pick-up and drop on the bundled vehicle in lock-step, and the replay of what was just recorded."""

from __future__ import annotations

from pathlib import Path

from kffa_offboard.config_log import config_of
from kffa_offboard.demo.processes import FlightPlan, fly
from kffa_offboard.replay.compare import compare
from kffa_offboard.replay.engine import replay
from kffa_offboard.replay.recording import read_recording
from kffa_offboard.selftest.result import Row, at_most
from kffa_offboard.trials.metrics import FlightFailed, measure, read_truth

HEIGHT_M = 5.0
PEAK_M, HOVER_RMS_M = 0.15, 0.02


def run_flight(personality: str, directory: Path) -> list[Row]:
    """Fly the demonstration: 5 kg come and go at 5 m, the daemon is not told."""
    plan = FlightPlan(
        directory / f"flight-{personality}", personality, "rates", "kffa-ladrc", 0, lockstep=True
    )
    group = f"flight, {personality}"
    try:
        fly(plan, lambda _flown, _latest: None)
        metrics = measure(read_truth(plan.truth), HEIGHT_M)
    except FlightFailed as problem:
        return [Row(group, "pick up and drop 5 kg", str(problem), "flown", False)]
    return [
        at_most(group, "pick-up of 5 kg, farthest from 5 m", metrics.pickup.peak_m, PEAK_M, "m"),
        at_most(group, "drop of 5 kg, farthest from 5 m", metrics.drop.peak_m, PEAK_M, "m"),
        at_most(group, "hover, rms of height", metrics.hover_rms_m, HOVER_RMS_M, "m"),
        _replayed(group, plan.log),
    ]


def _replayed(group: str, log: Path) -> Row:
    """Every frame again, byte for byte."""
    recording = read_recording(log)
    comparison = compare(recording, replay(recording, config_of(recording.header, log)))
    difference = comparison.difference
    measured = f"{comparison.frames} frames equal" if difference is None else f"differs: {difference.field}"
    return Row(group, "replay of its log", measured, "byte for byte", difference is None, comparison.frames)
