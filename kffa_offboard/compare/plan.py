"""What the comparison flies: trials, each a pilot, a course and conditions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, TypeAlias

AutopilotName: TypeAlias = Literal["px4", "ardupilot"]
CourseName: TypeAlias = Literal["load", "release", "attitude"]
HeightSource: TypeAlias = Literal["default", "range finder", "barometer"]

HEIGHT_M = 5.0
"""Where every trial hovers."""

PICKUP_S = 18.0
DROP_S = 28.0
"""When the physics hangs the load on and lets it go, in seconds since lift-off."""

END_S = 36.0
"""When landing begins, in seconds since lift-off."""

SENSORS_OF_ARDUCOPTER_S = 50.0
SENSORS_OF_PX4_S = 25.0
"""Simulated time after which the estimator has found itself, and the daemon starts."""

SEED_SHIFT_S = 3.0
"""How much later the daemon starts with each seed.

A firmware's own simulated noise is not seeded and the same in each flight, so another stretch of it is taken.
"""

NORMAL_DELAY_S = 0.01
"""Of the link, there and back."""

HEAD_START_S: dict[AutopilotName, float] = {"px4": SENSORS_OF_PX4_S, "ardupilot": SENSORS_OF_ARDUCOPTER_S}


@dataclass(frozen=True)
class Conditions:
    """What may be made harder.

    Attributes
    ----------
    load_kg : mass that comes and goes
    offset_m : how far forward of the centre it hangs
    rate_hz : attitude and position telemetry
    delay_s : of the link between vehicle and daemon, half of it each way
    seed : of the noise of sensors; the daemon starts later with each
    height_source : what the autopilot's own estimate takes its height from: "default" is the firmware's own
        choice (PX4 the satellite fixes, ArduCopter the barometer); the others are for PX4, which is set to
        them, and a range finder is fitted where it is the source
    wind : it blows in gusts, and the daemon holds the place, too
    """

    load_kg: float = 5.0
    offset_m: float = 0.0
    rate_hz: float = 100.0
    delay_s: float = NORMAL_DELAY_S
    seed: int = 0
    height_source: HeightSource = "default"
    wind: bool = False


def head_start_s(autopilot: AutopilotName, conditions: Conditions) -> float:
    """Simulated time at which the daemon starts, s."""
    return HEAD_START_S[autopilot] + SEED_SHIFT_S * conditions.seed


@dataclass(frozen=True)
class Trial:
    """One flight.

    Attributes
    ----------
    name : of its files
    label : in tables and figures
    controller : "native" for the autopilot's own height hold, or one of the daemon's
    output : what the daemon commands beside thrust
    tuned : native with our gains instead of the stock ones
    course : "load" picks up and drops by the physics' clock, "release" has the daemon command the drop,
        "attitude" steps roll, pitch and yaw
    """

    name: str
    label: str
    controller: str
    output: str = "rates"
    tuned: bool = False
    course: CourseName = "load"
    conditions: Conditions = field(default_factory=Conditions)

    @property
    def native(self) -> bool:
        """Is it the autopilot that flies?"""
        return self.controller == "native"


@dataclass(frozen=True)
class Join:
    """A firmware that is already running.

    Attributes
    ----------
    url : where it is met, udpin:HOST:PORT or udpout:HOST:PORT
    physics_port : where it looks for its physics; None for the usual port
    truth : if its physics is running, too, the CSV of true states that it writes; None to start ours
    lockstep : that physics waits for the daemon
    """

    url: str
    physics_port: int | None = None
    truth: Path | None = None
    lockstep: bool = False


@dataclass(frozen=True)
class ComparePlan:
    """What the command line asks for; see `kffa-offboard compare --help`."""

    directory: Path
    autopilot: AutopilotName = "px4"
    firmware: Path | None = None
    conditions: Conditions = field(default_factory=Conditions)
    full: bool = False
    only: tuple[str, ...] = ()
    json: bool = False
    join: Join | None = None
    config: Path | None = None


NATIVE_MODE: dict[AutopilotName, str] = {"px4": "Hold", "ardupilot": "Guided"}
DEFAULT_OUTPUT: dict[AutopilotName, str] = {"px4": "rates", "ardupilot": "attitude"}
OTHER_OUTPUT = {"rates": "attitude", "attitude": "rates"}
HEIGHT_ENDINGS: dict[HeightSource, str] = {"range finder": "-range", "barometer": "-baro"}
"""Of the names of rows in which PX4 is set to take its height from there."""


def trials(plan: ComparePlan) -> list[Trial]:
    """The flights of `plan`, in the order of the table."""
    chosen = _standard(plan.autopilot, plan.conditions)
    if plan.full:
        chosen += _harder(plan.autopilot, plan.conditions)
    if plan.firmware is None:  # the imitation has not all of the real one's gains, and one height
        chosen = [
            trial for trial in chosen if not trial.tuned and trial.conditions.height_source == "default"
        ]
    if plan.join is not None:
        chosen = [_as_it_is(trial) for trial in chosen if _can_be_joined(plan, plan.join, trial)]
    if plan.only:
        chosen = [trial for trial in chosen if trial.name in plan.only]
    return chosen


def _can_be_joined(plan: ComparePlan, join: Join, trial: Trial) -> bool:
    """A running firmware keeps its gains, and running physics its load, seed and link."""
    same = replace(trial.conditions, rate_hz=plan.conditions.rate_hz)
    if join.truth is None:
        same = replace(same, delay_s=plan.conditions.delay_s)
    return not trial.tuned and same == plan.conditions


def _as_it_is(trial: Trial) -> Trial:
    return replace(trial, label=trial.label.replace("stock gains", "as it is"))


def _standard(autopilot: AutopilotName, conditions: Conditions) -> list[Trial]:
    output, mode = DEFAULT_OUTPUT[autopilot], NATIVE_MODE[autopilot]
    other = OTHER_OUTPUT[output]
    rows = [
        Trial("native-stock", f"{mode}, stock gains", "native"),
        Trial("native-tuned", f"{mode}, tuned gains", "native", tuned=True),
        Trial("pid", "PID", "pid", output),
        Trial("cascaded-pid", "cascaded PID", "cascaded-pid", output),
        Trial("ladrc", "LADRC", "ladrc", output),
        Trial("kffa-ladrc", "KFFA-LADRC", "kffa-ladrc", output),
        Trial(f"kffa-ladrc-{other}", f"KFFA-LADRC, {other}", "kffa-ladrc", other),
        Trial("release", "KFFA-LADRC, own release", "kffa-ladrc", output, course="release"),
        Trial("attitude-rates", "KFFA-LADRC, rates", "kffa-ladrc", "rates", course="attitude"),
        Trial("attitude-attitude", "KFFA-LADRC, attitude", "kffa-ladrc", "attitude", course="attitude"),
    ]
    return [replace(row, conditions=conditions) for row in rows]


def _harder(autopilot: AutopilotName, conditions: Conditions) -> list[Trial]:
    output, mode = DEFAULT_OUTPUT[autopilot], NATIVE_MODE[autopilot]
    harder = {
        "2kg": ("2 kg", replace(conditions, load_kg=2.0)),
        "6.73kg": ("6.73 kg", replace(conditions, load_kg=6.73)),
        "offset": ("5 cm off centre", replace(conditions, offset_m=0.05)),
        "50hz": ("50 Hz telemetry", replace(conditions, rate_hz=50.0)),
        "delay": ("60 ms link delay", replace(conditions, delay_s=0.06)),
        "wind": ("gusty wind", replace(conditions, wind=True)),
    }
    rows = [
        Trial(f"kffa-ladrc-{key}", f"KFFA-LADRC, {label}", "kffa-ladrc", output, conditions=changed)
        for key, (label, changed) in harder.items()
    ]
    rows += [
        Trial(f"native-stock-{key}", f"{mode}, stock gains, {harder[key][0]}", "native", conditions=changed)
        for key in ("2kg", "6.73kg", "offset", "wind")
        for changed in [harder[key][1]]
    ]
    if autopilot == "px4":
        for source, ending in HEIGHT_ENDINGS.items():
            rows += _with_height_from(source, ending, conditions)
    return rows


def _with_height_from(source: HeightSource, ending: str, conditions: Conditions) -> list[Trial]:
    """The main rows again, with PX4's estimate set to take its height from `source`."""
    again = ("native-stock", "native-tuned", "kffa-ladrc", "release")
    better = replace(conditions, height_source=source)
    return [
        replace(row, name=row.name + ending, label=f"{row.label}, {source}")
        for row in _standard("px4", better)
        if row.name in again
    ]
