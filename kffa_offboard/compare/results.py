"""Trials with what was measured, and what is said about them: rows of the table, verdicts, JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from kffa_offboard.compare.estimate import EstimateFigures
from kffa_offboard.compare.flight import Flown
from kffa_offboard.compare.measure import LoadFigures, PlaceFigures, StepFigures
from kffa_offboard.compare.plan import DEFAULT_OUTPUT, HEIGHT_ENDINGS, AutopilotName, ComparePlan, Trial
from kffa_offboard.trials.metrics import Truth


@dataclass(frozen=True)
class Result:
    """One trial, flown and measured.

    `failure` says why not, and then there are no figures; `cut`: the reason is a limit of ours (`limits`).
    """

    trial: Trial
    flown: Flown | None = None
    truth: Truth | None = None
    load: LoadFigures | None = None
    place: PlaceFigures | None = None
    steps: tuple[StepFigures, ...] = ()
    estimate: EstimateFigures | None = None
    failure: str | None = None
    cut: bool = False

    @property
    def label(self) -> str:
        """The trial's, with a mark if there are no figures of it."""
        mark = "" if self.failure is None else " (cut off)" if self.cut else " (failed)"
        return self.trial.label + mark


@dataclass(frozen=True)
class Verdict:
    """One target: what was wanted, what was measured."""

    target: str
    measured: str
    holds: bool


@dataclass(frozen=True)
class Targets:
    """Of one firmware: times smaller than its own height hold with stock gains."""

    peak_ratio: float
    iae_ratio: float


TARGETS: dict[AutopilotName, Targets] = {"px4": Targets(12.0, 40.0), "ardupilot": Targets(5.0, 5.0)}
PEAK_M, RELEASE_PEAK_M = 0.05, 0.025
LEVEL_DEG, EXCURSION_DEG = 0.3, 5.0
STEP_LIMITS = {True: (0.8, 5.0), False: (1.2, 10.0)}
"""Settling time [s] and overshoot [%] of roll and pitch with the firmware's default output, and the other."""


def verdicts(plan: ComparePlan, results: Sequence[Result]) -> list[Verdict]:
    """The project's targets that these results can be held against."""
    by_name = {result.trial.name: result for result in results}
    found = _with_same_sensors(plan.autopilot, by_name, "")
    found += [
        replace(verdict, target=f"{source}: {verdict.target}")
        for source, ending in HEIGHT_ENDINGS.items()
        for verdict in _with_same_sensors(plan.autopilot, by_name, ending)
    ]
    offset = _load(by_name, "kffa-ladrc-offset")
    if offset is not None:
        found.append(
            _at_most("load 5 cm off centre: roll, pitch", offset.tilt_peak_deg, EXCURSION_DEG, "deg")
        )
    for output in ("rates", "attitude"):
        result = by_name.get(f"attitude-{output}")
        if result is not None and result.steps:
            found += _step_verdicts(output, output == DEFAULT_OUTPUT[plan.autopilot], result.steps)
    return found


def _with_same_sensors(autopilot: AutopilotName, by_name: dict[str, Result], ending: str) -> list[Verdict]:
    """Height beside the autopilot's own mode with the same sensors, and the daemon's own release."""
    found: list[Verdict] = []
    ours, stock = (_load(by_name, name + ending) for name in ("kffa-ladrc", "native-stock"))
    if ours is not None:
        found += _height_verdicts(autopilot, ours, stock)
    release = _load(by_name, f"release{ending}")
    if release is not None:
        found.append(_at_most("release by the daemon: peak", release.drop.peak_m, RELEASE_PEAK_M, "m"))
    return found


def _load(by_name: dict[str, Result], name: str) -> LoadFigures | None:
    result = by_name.get(name)
    return None if result is None else result.load


def _at_most(what: str, value: float, limit: float, unit: str) -> Verdict:
    return Verdict(f"{what} at most {limit:g} {unit}", f"{value:.3f} {unit}", value <= limit)


def _height_verdicts(autopilot: AutopilotName, ours: LoadFigures, stock: LoadFigures | None) -> list[Verdict]:
    targets = TARGETS[autopilot]
    found = [_at_most("level hover", ours.level_rms_deg, LEVEL_DEG, "deg rms")]
    for name in ("pickup", "drop"):
        mine = getattr(ours, name)
        word = {"pickup": "pick-up", "drop": "drop"}[name]
        found.append(_at_most(f"{word}: peak", mine.peak_m, PEAK_M, "m"))
        if stock is None:
            continue
        theirs = getattr(stock, name)
        for figure, value, other, least in (
            ("peak", mine.peak_m, theirs.peak_m, targets.peak_ratio),
            ("IAE", mine.iae_m_s, theirs.iae_m_s, targets.iae_ratio),
        ):
            ratio = other / value
            found.append(
                Verdict(f"{word}: {figure} {least:g} times smaller", f"{ratio:.1f} times", ratio >= least)
            )
    return found


def _step_verdicts(output: str, default: bool, steps: Sequence[StepFigures]) -> list[Verdict]:
    settling_s, overshoot = STEP_LIMITS[default]
    tilts = [step for step in steps if step.channel != "yaw"]
    yaws = [step for step in steps if step.channel == "yaw"]
    slowest = _slowest(tilts)
    highest = max(step.overshoot_percent for step in tilts)
    turns = max(step.swings for step in yaws)
    return [
        Verdict(
            f"{output}: roll and pitch within 5 % after {settling_s:g} s",
            "not while the step lasts" if slowest is None else f"{slowest:.2f} s",
            slowest is not None and slowest <= settling_s,
        ),
        Verdict(f"{output}: overshoot at most {overshoot:g} %", f"{highest:.1f} %", highest <= overshoot),
        Verdict(
            f"{output}: yaw steps without oscillation",
            f"{turns} turns, overshoot {max(step.overshoot_percent for step in yaws):.1f} %",
            turns <= 1,
        ),
    ]


def _slowest(steps: Sequence[StepFigures]) -> float | None:
    times = [step.settling_s for step in steps if step.settling_s is not None]
    return max(times) if len(times) == len(steps) else None


def as_json(plan: ComparePlan, results: Sequence[Result]) -> dict[str, Any]:
    """Everything that was measured."""
    versions = [result.flown.version for result in results if result.flown and result.flown.version]
    return {
        "autopilot": plan.autopilot,
        "firmware": _firmware(plan),
        "firmware_version": None if not versions else asdict(versions[0]),
        "trials": [
            {
                **asdict(result.trial),
                "failure": result.failure,
                "cut": result.cut,
                "remark": None if result.flown is None else result.flown.remark,
                "load": None if result.load is None else asdict(result.load),
                "place": None if result.place is None else asdict(result.place),
                "estimate": None if result.estimate is None else asdict(result.estimate),
                "steps": [asdict(step) for step in result.steps],
            }
            for result in results
        ],
        "targets": [asdict(verdict) for verdict in verdicts(plan, results)],
    }


def _firmware(plan: ComparePlan) -> str:
    if plan.join is not None:
        return f"joined on {plan.join.url}"
    return "bundled imitation" if plan.firmware is None else str(plan.firmware)
