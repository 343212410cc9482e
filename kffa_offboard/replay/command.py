"""The command `kffa-offboard replay`."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from kffa_offboard import __version__
from kffa_offboard.config import DaemonConfig, load
from kffa_offboard.config_log import LIBRARIES, config_of, overrides_of
from kffa_offboard.flightlog.notes import Header
from kffa_offboard.flightlog.signals import STATE_NAMES
from kffa_offboard.replay.compare import Comparison, WhatIf, compare, what_if
from kffa_offboard.replay.engine import replay, replay_what_if
from kffa_offboard.replay.recording import Recording, read_recording

DIFFERS = 1


@dataclass(frozen=True)
class ReplayPlan:
    """What `kffa-offboard replay` was asked for; `config` None compares with the log itself."""

    log: Path
    config: Path | None
    json: bool


def run_replay(plan: ReplayPlan) -> int:
    """Replay a flight and tell what came of it. Returns 0, or 1 if the replay differs from the log.

    Raises UserError for a log that cannot be replayed or a configuration that cannot be flown.
    """
    recording = read_recording(plan.log)
    flown = config_of(recording.header, plan.log)
    if plan.config is not None:
        config = load(plan.config, overrides_of(recording.header))
        replayed = replay_what_if(recording, flown, config)
        return _tell_what_if(plan, recording, config, what_if(recording, replayed))
    started = time.perf_counter()
    replayed = replay(recording, flown)
    elapsed_s = time.perf_counter() - started
    return _tell_comparison(plan, recording, compare(recording, replayed), elapsed_s)


def _seconds(recording: Recording, time_us: int) -> float:
    return (time_us - recording.begin_us) / 1e6


def _tell_comparison(plan: ReplayPlan, recording: Recording, comparison: Comparison, elapsed_s: float) -> int:
    difference = comparison.difference
    flown_s = _seconds(recording, recording.end_us)
    summary: dict[str, Any] = {
        "log": str(plan.log),
        "identical": difference is None,
        "frames": comparison.frames,
        "frames_dropped_by_the_link": comparison.dropped,
        "flight_s": flown_s,
        "replay_s": elapsed_s,
        "complete": recording.end is not None,
        "records_lost": recording.lost,
        "recorded_with": _versions(recording.header),
        "difference": None if difference is None else asdict(difference),
    }
    if plan.json:
        print(json.dumps(summary, default=str))
        return 0 if difference is None else DIFFERS
    console = Console(soft_wrap=True, highlight=False)
    for line in _lines(recording, comparison, flown_s, elapsed_s):
        console.print(line, markup=False)
    return 0 if difference is None else DIFFERS


def _lines(recording: Recording, comparison: Comparison, flown_s: float, elapsed_s: float) -> list[str]:
    speed = flown_s / elapsed_s if elapsed_s > 0.0 else 0.0
    lines = [f"{flown_s:.1f} s of flight replayed in {elapsed_s:.2f} s ({speed:.0f} times real time)"]
    if recording.lost:
        lines.append(f"{recording.lost} records are missing after that (full disk); compared up to there")
    elif recording.end is None:
        lines.append("the log breaks off (the daemon was killed, or still writes it); compared up to there")
    if comparison.dropped:
        lines.append(f"{comparison.dropped} frames were not taken by the link in flight")
    difference = comparison.difference
    if difference is None:
        lines.append(f"identical: {comparison.frames} frames, byte for byte")
        return lines
    lines += [
        f"differs at {_seconds(recording, difference.time_us):.3f} s after {comparison.frames} equal frames: "
        f"{difference.field}",
        f"  recorded {difference.recorded}",
        f"  replayed {difference.replayed}",
    ]
    if (then := _versions(recording.header)) != (now := _own_versions()):
        lines.append(f"  recorded with {_together(then)}; this is {_together(now)}")
    return lines


def _versions(header: Header) -> dict[str, str]:
    return {"kffa-offboard": header.version, **header.libraries}


def _own_versions() -> dict[str, str]:
    return {"kffa-offboard": __version__, **{name: version(name) for name in LIBRARIES}}


def _together(versions: dict[str, str]) -> str:
    return ", ".join(f"{name} {number}" for name, number in versions.items())


_UNITS = {
    "command": ("rad/s", "rad/s", "rad/s", "thrust"),
    "estimate": ("rad", "rad", "rad", "m"),
    "disturbance": ("rad/s^2", "rad/s^2", "rad/s^2", "m/s^2"),
    "omega_c": ("rad/s",) * 4,
}


def _nothing_to_compare(plan: ReplayPlan, result: WhatIf) -> str:
    """Why no step is engaged in both."""
    if not len(result.recorded.time_us):
        return f"{plan.log} holds no inner signals to compare with"
    if not np.any(result.recorded.state == STATE_NAMES.index("engaged")):
        return f"the daemon was not engaged in {plan.log}"
    return (
        f"with {plan.config} the daemon would not have been engaged at any time that it was; is it for this "
        "vehicle (link.target_system)?"
    )


def _tell_what_if(plan: ReplayPlan, recording: Recording, config: DaemonConfig, result: WhatIf) -> int:
    if plan.json:
        document = {
            "log": str(plan.log),
            "config": str(plan.config),
            "engaged_steps": result.steps,
            "changes": [asdict(change) for change in result.changes],
            "states": [
                dict(zip(("time_s", "recorded", "replayed"), entry, strict=True)) for entry in result.states
            ],
        }
        print(json.dumps(document))
        return 0
    console = Console()
    if not result.steps:
        console.print(
            f"nothing to compare: {_nothing_to_compare(plan, result)}", soft_wrap=True, markup=False
        )
        return 0
    table = Table(title=f"{plan.log.name} with {plan.config}: what would have changed while engaged")
    for heading in ("signal", "channel"):
        table.add_column(heading, no_wrap=True)
    for heading in ("rms recorded", "rms of the change", "largest change", "at", "unit"):
        table.add_column(heading, justify="right")
    attitude = config.service.output == "attitude"
    for number, change in enumerate(result.changes):
        unit = _UNITS[change.signal][number % 4]
        if change.signal == "command" and attitude and number % 4 < 3:
            unit = "rad"
        table.add_row(
            change.signal,
            change.channel,
            f"{change.recorded_rms:.3g}",
            f"{change.rms:.3g}",
            f"{change.largest:.3g}",
            f"{change.largest_at_s:.2f} s",
            unit,
        )
    console.print(table)
    for time_s, before, after in result.states:
        console.print(f"at {time_s:.2f} s the service was {before}, and would have been {after}")
    console.print(
        f"{result.steps} engaged steps. The vehicle's answer to other commands is not in a log: read this as "
        "what the controller would have asked for, not as how it would have flown."
    )
    return 0
