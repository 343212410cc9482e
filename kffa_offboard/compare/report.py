# ruff: noqa: E501 - sentences of the page
"""report.html: one self-contained page for people who maintain an autopilot and doubt all this."""

from __future__ import annotations

import base64
import math
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from kffa_offboard import __version__
from kffa_offboard.compare.firmware import HEIGHT_FILES, PARAMETER_FILES, TUNED_FILES
from kffa_offboard.compare.measure import RECOVERED_M, LoadFigures
from kffa_offboard.compare.plan import (
    DEFAULT_OUTPUT,
    DROP_S,
    HEIGHT_M,
    NATIVE_MODE,
    PICKUP_S,
    ComparePlan,
    Conditions,
)
from kffa_offboard.compare.results import Result, Verdict
from kffa_offboard.compare.simulation import WINDY
from kffa_offboard.compare.table import (
    LOAD_HEADER,
    PLACE_HEADER,
    STEP_HEADER,
    firmware_name,
    load_row,
    place_row,
    step_rows,
)
from kffa_offboard.config import bundled, read_toml

_STYLE = """
:root { --ink: #1d232b; --soft: #5b6673; --line: #dfe3e8; --tint: #f6f7f9; }
* { box-sizing: border-box; }
body { margin: 0; background: var(--tint); color: var(--ink);
  font: 16px/1.55 'Helvetica Neue', Arial, sans-serif; }
main { max-width: 1240px; margin: 0 auto; background: #fff; padding: 2.2rem 3rem 4rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 .6rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .7rem; padding-top: .7rem; border-top: 2px solid var(--ink); }
p, li { max-width: 50rem; }
table { border-collapse: collapse; width: 100%; font-size: .88rem; margin: .5rem 0 1rem; }
th, td { text-align: left; padding: .4rem .7rem .4rem 0; border-bottom: 1px solid var(--line); }
th { font-size: .78rem; color: var(--soft); vertical-align: bottom; }
.wide { overflow-x: auto; } .wide td:first-child { min-width: 8rem; }
.number { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
tr.ours td { font-weight: 600; background: #eef4fb; }
.holds, .fails { font-size: .76rem; font-weight: 600; padding: .1rem .5rem; border-radius: .25rem; }
.holds { background: #dcefe2; color: #17603a; } .fails { background: #f8dcdc; color: #8d1d28; }
figure { margin: 1.2rem 0 1.6rem; } img { width: 100%; height: auto; display: block; }
figcaption, .note { font-size: .85rem; color: var(--soft); max-width: none; }
pre { background: var(--tint); border: 1px solid var(--line); padding: .8rem 1rem; overflow-x: auto;
  font-size: .8rem; line-height: 1.4; }
summary { cursor: pointer; color: #1f5fa8; }
@media (max-width: 700px) { main { padding: 1.2rem; } }
"""


@dataclass(frozen=True)
class Drawing:
    """A figure of the page."""

    path: Path
    caption: str


def report(
    plan: ComparePlan, results: Sequence[Result], verdicts: Sequence[Verdict], drawings: Sequence[Drawing]
) -> str:
    """The page as HTML."""
    parts = [_head(plan, results), "<h2>Pick-up and drop</h2>", _load_table(results)]
    parts += [_figure(drawing) for drawing in drawings[:1]]
    if any(result.place is not None for result in results):
        parts += ["<h2>Place in a gusty wind</h2>", _place_table(results)]
    if any(result.steps for result in results):
        parts += ["<h2>Steps of attitude</h2>", _step_table(results)]
    parts += [_figure(drawing) for drawing in drawings[1:]]
    parts += ["<h2>Targets</h2>", _verdict_table(verdicts), "<h2>Set-up</h2>", _setup(plan, results)]
    parts += ["<h2>Parameters</h2>", _parameters(plan), "<h2>Repeat it</h2>", _repeat(plan)]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>KFFA-LADRC beside {_name(plan)}'s own height hold</title><style>{_STYLE}</style></head>\n"
        f"<body><main>{''.join(parts)}</main></body></html>\n"
    )


def _name(plan: ComparePlan) -> str:
    return {"px4": "PX4", "ardupilot": "ArduCopter"}[plan.autopilot]


def _real(plan: ComparePlan) -> bool:
    return plan.firmware is not None or plan.join is not None


def _head(plan: ComparePlan, results: Sequence[Result]) -> str:
    by_name = {result.trial.name: result.load for result in results}
    ours, stock = by_name.get("kffa-ladrc"), by_name.get("native-stock")
    tuned = by_name.get("native-tuned")
    load = plan.conditions.load_kg
    said = ""
    if ours is not None and stock is not None:
        said = f"<p>{load:g} kg picked up by a 10 kg quadrotor move it {_cm(stock)} in {NATIVE_MODE[plan.autopilot]} mode"
        said += f" with stock gains, {_cm(tuned)} with tuned gains" if tuned is not None else ""
        said += f", and {_cm(ours)} under the KFFA-LADRC controller of a companion computer.</p>"
    return (
        f"<h1>KFFA-LADRC beside {_name(plan)}’s own height hold, with a load that comes and goes</h1>"
        f"<p>Flown by {escape(firmware_name(plan, results))}{', unmodified' if _real(plan) else ''}, with kffa-offboard "
        f"{__version__}. Same vehicle, same load, "
        "same moment, every figure from the simulator’s true states.</p>" + said
    )


def _cm(load: LoadFigures) -> str:
    return f"{100 * load.pickup.peak_m:.1f} cm"


def _table(header: Iterable[str], rows: Iterable[tuple[str, Sequence[str]]]) -> str:
    head = "".join(
        f"<th{'' if k == 0 else ' class=number'}>{escape(name)}</th>" for k, name in enumerate(header)
    )
    body = "".join(
        f"<tr{kind}>"
        + "".join(
            f"<td{'' if k == 0 else ' class=number'}>{escape(cell)}</td>" for k, cell in enumerate(cells)
        )
        + "</tr>"
        for kind, cells in rows
    )
    return f"<div class=wide><table><tr>{head}</tr>{body}</table></div>"


def _load_table(results: Sequence[Result]) -> str:
    rows = [
        (" class=ours" if result.trial.name == "kffa-ladrc" else "", load_row(result))
        for result in results
        if result.trial.course != "attitude"
    ]
    note = (
        '<p class="note">Peak and IAE (integral of the absolute error): deviation of true height, in the 5 s after '
        "the event, from the mean of the 5 s before the pick-up. Recovery: until it stays within "
        f"{100 * RECOVERED_M:g} cm. Hover and level: rms in the 5 s before the pick-up. Tilt: largest roll or "
        "pitch in the 5 s after either event. Times of the events are the simulator’s, not told to anybody, except "
        "in “own release”, where the daemon commands the drop. Estimate: IAE of the error of the autopilot’s own estimate of "
        "height in the same windows, which a controller that holds this estimate cannot avoid. Seen: largest deviation of that "
        "estimate, all that the controller can see.</p>"
    )
    return _table(LOAD_HEADER, rows) + note


def _place_table(results: Sequence[Result]) -> str:
    rows = [("", place_row(result)) for result in results if result.place is not None]
    wind = read_toml(bundled(WINDY))["wind"]
    note = (
        '<p class="note">Horizontal distance of the true place from its mean in the 5 s before the pick-up, in these 5 s and in the '
        f"5 s after each event. The wind blows with {math.hypot(*wind['mean_m_s']):g} m/s and gusts of "
        f"{wind['gust_std_m_s']:g} m/s (standard deviation of each axis). The daemon has its [position] on.</p>"
    )
    return _table(PLACE_HEADER, rows) + note


def _step_table(results: Sequence[Result]) -> str:
    rows = [("", cells) for result in results if result.steps for cells in step_rows(result)]
    note = (
        '<p class="note">Steps of 10° (roll, pitch) and 30° (yaw), each both ways; settling is into 5 % of the step '
        "and counts from the moment when the reference begins to move. Turns: how often the response turns back "
        "by more than 5 % of the step.</p>"
    )
    return _table(STEP_HEADER, rows) + note


def _figure(drawing: Drawing) -> str:
    picture = base64.b64encode(drawing.path.read_bytes()).decode("ascii")
    caption = escape(drawing.caption)
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{picture}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _verdict_table(verdicts: Sequence[Verdict]) -> str:
    rows = "".join(
        f"<tr><td>{escape(verdict.target)}</td><td class=number>{escape(verdict.measured)}</td>"
        f'<td class=number><span class="{"holds" if verdict.holds else "fails"}">'
        f"{'met' if verdict.holds else 'not met'}</span></td></tr>"
        for verdict in verdicts
    )
    return f"<table><tr><th>Target</th><th class=number>Measured</th><th></th></tr>{rows}</table>"


def _setup(plan: ComparePlan, results: Sequence[Result]) -> str:
    conditions = plan.conditions
    interface = {"px4": "HIL interface", "ardupilot": "JSON interface"}[plan.autopilot]
    if not _real(plan):
        where = (
            "the simulator’s bundled imitation of the firmware: these figures say nothing about the real one"
        )
    else:
        where = f"its own software-in-the-loop build over its {interface}, in lock-step with the physics"
    if plan.join is not None:
        where = f"already running, with whatever parameters it had, met on {escape(plan.join.url)}"
    items = [
        f"Autopilot: {escape(firmware_name(plan, results))}, {where}.",
        "Vehicle: 10 kg quadrotor, full thrust 246 N, motors lag by 50 ms, arm 0.44 m; the load hangs rigidly 0.3 m "
        f"below the centre{'' if not conditions.offset_m else f', {100 * conditions.offset_m:g} cm forward'}. It is there "
        f"{PICKUP_S:g} s after lift-off and gone {DROP_S:g} s after lift-off.",
        f"Height {HEIGHT_M:g} m. Native rows: a scripted ground station arms, sends NAV_TAKEOFF and leaves the vehicle "
        f"to {NATIVE_MODE[plan.autopilot]} mode. The other rows: the daemon arms, takes off and holds, with "
        "SET_ATTITUDE_TARGET (body rates or attitude, and thrust).",
        _time(plan),
        "PID is a single loop with the gains of the configuration, cascaded PID has PX4’s structure and default "
        "gains, LADRC is the same law without fuzzy rules and Kalman filter. All of them know delay and lag where "
        "they can use them. "
        f"Output {DEFAULT_OUTPUT[plan.autopilot]} unless the row says otherwise.",
    ]
    items += [
        f"{escape(result.trial.label)}: {escape(result.flown.remark)}."
        for result in results
        if result.flown is not None and result.flown.remark is not None
    ]
    items += [
        f"No figures of {escape(result.label)}: {escape(result.failure)}."
        for result in results
        if result.failure
    ]
    return "<ul>" + "".join(f"<li>{item}</li>" for item in items) + "</ul>"


def _time(plan: ComparePlan) -> str:
    join = plan.join
    if join is not None and join.truth is not None and not join.lockstep:
        return "The physics was running, too, and kept its own time, telemetry and link."
    return (
        f"Telemetry {plan.conditions.rate_hz:g} Hz; link delay {1000 * plan.conditions.delay_s:g} ms there and back, in "
        "simulated time. Firmware, physics and daemon wait for each other (lock-step), so the figures do not depend on "
        "the computer."
    )


def _parameters(plan: ComparePlan) -> str:
    if plan.join is not None:
        return "<p>Those of the firmware as it was found.</p>"
    if plan.firmware is None:
        return "<p>The bundled firmware’s defaults.</p>"
    parts = []
    rows = [
        ("All rows: what this airframe needs; gains are stock", PARAMETER_FILES[plan.autopilot]),
        ("The row with tuned gains: these beside", TUNED_FILES[plan.autopilot]),
        ("The daemon", f"compare-{plan.autopilot}.toml"),
    ]
    if plan.autopilot == "px4":
        rows += [(f"Rows “{source}”: these beside", name) for source, name in HEIGHT_FILES.items()]
    for title, name in rows:
        text = bundled(name).read_text(encoding="utf-8")
        parts.append(f"<details><summary>{title}: {name}</summary><pre>{escape(text)}</pre></details>")
    return "".join(parts)


def _repeat(plan: ComparePlan) -> str:
    path = {"px4": "PX4-Autopilot/build/px4_sitl_default", "ardupilot": "ardupilot/build/sitl/bin/arducopter"}
    normal, flown, join = Conditions(), plan.conditions, plan.join
    options = {
        "--firmware": None if plan.firmware is None else path[plan.autopilot],
        "--join": join and join.url,
        "--physics-port": join and join.physics_port,
        "--truth": join and join.truth,
        "--config": plan.config,
        "--load": f"{flown.load_kg:g}",
        "--offset": None if flown.offset_m == normal.offset_m else f"{flown.offset_m:g}",
        "--rate": None if flown.rate_hz == normal.rate_hz else f"{flown.rate_hz:g}",
        "--delay": None if flown.delay_s == normal.delay_s else f"{flown.delay_s:g}",
        "--seed": flown.seed or None,
    }
    words = ["kffa-offboard", "compare", "--autopilot", plan.autopilot]
    words += [word for name, value in options.items() if value is not None for word in (name, str(value))]
    words += ["--lockstep"] if join is not None and join.lockstep else []
    words += ["--full"] if plan.full else []
    words += [word for name in plan.only for word in ("--only", name)]
    return (
        f"<pre>{escape(shlex.join([*words, '--out', 'compare-out']))}</pre>"
        "<p>Configurations, logs (.tlog) and true states (CSV) of every row are in the output directory.</p>"
    )
