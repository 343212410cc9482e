"""The results as rows of text, for the terminal and the page."""

from __future__ import annotations

from collections.abc import Sequence

from rich.markup import escape
from rich.table import Table

from kffa_offboard.compare.plan import ComparePlan
from kffa_offboard.compare.results import Result, Verdict

LOAD_HEADER = (
    "",
    "pick-up peak [m]",
    "IAE [m s]",
    "recovery [s]",
    "drop peak [m]",
    "IAE [m s]",
    "recovery [s]",
    "hover rms [m]",
    "level rms [deg]",
    "tilt peak [deg]",
    "estimate: IAE [m s]",
    "seen: peak [m]",
)
PLACE_HEADER = ("", "hover rms [m]", "pick-up peak [m]", "drop peak [m]")
STEP_HEADER = ("", "channel", "overshoot [%]", "settling [s]", "turns")
_DASH = "—"
_HEIGHTS = 7  # of the columns of LOAD_HEADER


def firmware_name(plan: ComparePlan, results: Sequence[Result]) -> str:
    """Name, version and commit of the firmware."""
    name = {"px4": "PX4", "ardupilot": "ArduCopter"}[plan.autopilot]
    if plan.firmware is None and plan.join is None:
        return f"the bundled imitation of {name}"
    versions = [result.flown.version for result in results if result.flown and result.flown.version]
    return f"{name} {versions[0].number} ({versions[0].commit})" if versions else name


def load_row(result: Result) -> tuple[str, ...]:
    """One row under `LOAD_HEADER`."""
    load = result.load
    if load is None:
        return (result.label, *[_DASH] * (len(LOAD_HEADER) - 1))
    return (
        result.trial.label,
        f"{load.pickup.peak_m:.3f}",
        f"{load.pickup.iae_m_s:.3f}",
        _seconds(load.pickup_recovery_s),
        f"{load.drop.peak_m:.3f}",
        f"{load.drop.iae_m_s:.3f}",
        _seconds(load.drop_recovery_s),
        f"{load.hover_rms_m:.4f}",
        f"{load.level_rms_deg:.2f}",
        f"{load.tilt_peak_deg:.1f}",
        *_estimate(result),
    )


def _estimate(result: Result) -> tuple[str, str]:
    """After pick-up and drop."""
    estimate = result.estimate
    if estimate is None:
        return _DASH, _DASH
    return (
        f"{estimate.pickup.iae_m_s:.3f}, {estimate.drop.iae_m_s:.3f}",
        f"{estimate.seen_pickup.peak_m:.3f}, {estimate.seen_drop.peak_m:.3f}",
    )


def place_row(result: Result) -> tuple[str, ...]:
    """One row under `PLACE_HEADER`, of a result that has such figures."""
    place = result.place
    assert place is not None
    figures = (place.hover_rms_m, place.pickup_peak_m, place.drop_peak_m)
    return (result.trial.label, *(f"{figure:.3f}" for figure in figures))


def step_rows(result: Result) -> list[tuple[str, ...]]:
    """Rows under `STEP_HEADER`, one for each step."""
    return [
        (
            result.trial.label,
            step.channel,
            f"{step.overshoot_percent:.1f}",
            _seconds(step.settling_s),
            str(step.swings),
        )
        for step in result.steps
    ]


def _seconds(value: float | None) -> str:
    return "> window" if value is None else f"{value:.2f}"


def tables(plan: ComparePlan, results: Sequence[Result], verdicts: Sequence[Verdict]) -> list[Table]:
    """For the terminal: heights, hover and tilt, place, steps, targets; each fits into 80 columns."""
    heights = Table(title=f"{firmware_name(plan, results)}: {plan.conditions.load_kg:g} kg on 10 kg")
    hover = Table(title="Hover, tilt, and the autopilot's estimate of height")
    place = Table(title="Horizontal distance from the place before the pick-up")
    steps = Table(title="Steps of attitude")
    targets = Table("target", "measured", "", title="Targets")
    for header, table in (
        (LOAD_HEADER[:_HEIGHTS], heights),
        (LOAD_HEADER[:1] + LOAD_HEADER[_HEIGHTS:], hover),
        (PLACE_HEADER, place),
        (STEP_HEADER, steps),
    ):
        for k, name in enumerate(header):
            unit_below = escape(name.replace(" [", "\n["))
            table.add_column(unit_below, justify="left" if k == 0 else "right")
    for result in results:
        if result.trial.course != "attitude":
            row = load_row(result)
            heights.add_row(*row[:_HEIGHTS])
            hover.add_row(row[0], *row[_HEIGHTS:])
        if result.place is not None:
            place.add_row(*place_row(result))
        for step in step_rows(result):
            steps.add_row(*step)
    for verdict in verdicts:
        targets.add_row(verdict.target, verdict.measured, "met" if verdict.holds else "not met")
    return [table for table in (heights, hover, place, steps, targets) if table.row_count]
