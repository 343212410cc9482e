"""Autopilot parameters that change what a setpoint means: how they are judged, and what to set.

The tables are in `parameter_check_ardupilot.py` and `parameter_check_px4.py`. A parameter that the
firmware does not have is judged with value None.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from kffa_offboard.offboard.events import ParameterProblem, ParameterSeverity
from kffa_offboard.offboard.segments import Gripper
from kffa_offboard.offboard.settings import LimitSettings, OutputKind, ServiceSettings

HOVER_TOLERANCE = 0.2
"""Relative difference between the autopilot's hover thrust and ours that is worth a warning."""

GRIPPER_PARAMETERS = ("GRIP_ENABLE", "PD_GRIPPER_EN")


@dataclass(frozen=True, slots=True)
class CheckSettings:
    """What the parameters are judged against.

    Attributes
    ----------
    output : what roll, pitch and yaw of the controller command
    hover_thrust : normalised thrust that carries the empty vehicle
    limits : of setpoints
    gripper : the scenario works the gripper
    resend_s : longest pause between two setpoints
    px4_spool_time_s, ardupilot_spool_time_s : assumed time from arming until thrust acts
    """

    output: OutputKind
    hover_thrust: float
    limits: LimitSettings
    gripper: bool
    resend_s: float
    px4_spool_time_s: float
    ardupilot_spool_time_s: float

    @classmethod
    def of(cls, settings: ServiceSettings) -> CheckSettings:
        """What the service is going to do with the vehicle."""
        return cls(
            output=settings.output,
            hover_thrust=settings.hover_thrust,
            limits=settings.limits,
            gripper=any(isinstance(segment, Gripper) for segment in settings.scenario),
            resend_s=settings.sequence.resend_s,
            px4_spool_time_s=settings.flight.px4_spool_time_s,
            ardupilot_spool_time_s=settings.flight.ardupilot_spool_time_s,
        )


@dataclass(frozen=True, slots=True)
class Finding:
    """What is wrong with one parameter. `fix` is the right value, None if a person must decide."""

    name: str
    severity: ParameterSeverity
    text: str
    fix: float | None = None

    @property
    def problem(self) -> ParameterProblem:
        """The finding as the service is told."""
        return ParameterProblem(self.name, self.severity, self.text)


Judge: TypeAlias = Callable[[CheckSettings, float | None], Finding | None]
Checks: TypeAlias = Mapping[str, Judge]


def judge_all(checks: Checks, settings: CheckSettings, values: Mapping[str, float]) -> tuple[Finding, ...]:
    """Findings in the order of the table; a name that `values` lacks was not reported."""
    judged = (judge(settings, values.get(name)) for name, judge in checks.items())
    return tuple(finding for finding in judged if finding is not None)


def relevant(checks: Checks, settings: CheckSettings) -> Checks:
    """Without those of a gripper that is not used."""
    return {
        name: judge for name, judge in checks.items() if settings.gripper or name not in GRIPPER_PARAMETERS
    }


def gripper_enabled(name: str) -> Judge:
    """The gripper that the scenario works must be enabled; the autopilots read that when they start."""

    def judge(settings: CheckSettings, value: float | None) -> Finding | None:
        if value is not None and value >= 1.0:
            return None
        seen = f"{name} not reported" if value is None else f"{name} {value:g}"
        return Finding(name, "warning", f"{seen}: the gripper will not work; set {name} 1 and restart")

    return judge


def no_opinion(settings: CheckSettings, value: float | None) -> Finding | None:
    """For parameters that are only read."""
    return None


def must_be(name: str, wanted: float, severity: ParameterSeverity, why: str) -> Judge:
    """A parameter with one right value."""

    def judge(settings: CheckSettings, value: float | None) -> Finding | None:
        if value is None or value == wanted:
            return None
        return Finding(name, severity, f"{name} {value:g}: {why}; set {name} {wanted:g}", wanted)

    return judge


def hover_thrust(name: str) -> Judge:
    """The autopilot's own hover thrust against the configured one."""

    def judge(settings: CheckSettings, value: float | None) -> Finding | None:
        ours = settings.hover_thrust
        if value is None or abs(value - ours) <= HOVER_TOLERANCE * ours:
            return None
        text = f"{name} {value:.3g}, but hover_thrust is {ours:.3g}; weigh it again, or correct hover_thrust"
        return Finding(name, "warning", text)

    return judge


def rate_limit(name: str, axis: int) -> Judge:
    """A limit of body rate [deg/s], 0 for none, against ours."""

    def judge(settings: CheckSettings, value: float | None) -> Finding | None:
        key = f"{('roll', 'pitch', 'yaw')[axis]}_rate_max_deg_s"
        ours = settings.limits.body_rate_max_rad_s[axis] * 57.29577951308232
        if value is None or value <= 0.0 or value >= 0.999 * ours:
            return None
        text = f"{name} {value:g} deg/s cuts limits.{key} {ours:.0f}; lower {key}, or raise {name}"
        return Finding(name, "warning", text)

    return judge
