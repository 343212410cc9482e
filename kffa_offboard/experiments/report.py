"""report.html: one self-contained page with every claim beside what was measured."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

from kffa_offboard.control.controllers import ALTITUDE, CHANNELS
from kffa_offboard.experiments.claims import BANDS, FAILS, HOLDS, OTHER, TABLE_4, Claim
from kffa_offboard.experiments.examples import POSITION, Example
from kffa_offboard.experiments.figures import Drawn

_TITLES: dict[Example, str] = {
    1: "Example 1: steps",
    2: "Example 2: triangle wave",
    3: "Example 3: load",
    4: "Example 4: noise",
    POSITION: "Position ring",
}
_CLASSES = {HOLDS: "holds", OTHER: "other", FAILS: "fails"}
# The paper's order of columns.
_COLUMNS = (CHANNELS[ALTITUDE], *CHANNELS[:ALTITUDE])

_STYLE = """
:root { --ink: #1d232b; --soft: #5b6673; --line: #dfe3e8; --paper: #ffffff; --tint: #f6f7f9; }
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--tint); color: var(--ink); font: 16px/1.55 Georgia, 'Times New Roman', serif;
}
main { max-width: 1060px; margin: 0 auto; background: var(--paper); padding: 2.5rem 3rem 4rem; }
h1, h2, h3, th, .verdict, nav, .note, figcaption { font-family: 'Helvetica Neue', Arial, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 .4rem; }
h2 { font-size: 1.3rem; margin: 3rem 0 .8rem; padding-top: .8rem; border-top: 2px solid var(--ink); }
h3 { font-size: 1rem; margin: 2rem 0 .6rem; }
p { max-width: 47rem; }
table { border-collapse: collapse; width: 100%; font-size: .9rem; margin: .5rem 0 1rem; }
th, td {
  text-align: left; vertical-align: top; padding: .45rem .7rem .45rem 0;
  border-bottom: 1px solid var(--line);
}
th { font-size: .78rem; color: var(--soft); font-weight: 600; }
td.number, th.number { text-align: right; white-space: nowrap; font-variant-numeric: tabular-nums; }
td:first-child { padding-right: 1rem; }
.claims td:nth-child(1) { width: 31%; } .claims td:nth-child(3) { width: 13rem; padding-right: 0; }
.verdict {
  display: inline-block; font-size: .76rem; font-weight: 600; padding: .12rem .5rem; white-space: nowrap;
  border-radius: .25rem;
}
.holds { background: #dcefe2; color: #17603a; } .other { background: #fbeecb; color: #7a5200; }
.fails { background: #f8dcdc; color: #8d1d28; }
.published { color: var(--soft); }
figure { margin: 1.5rem 0 2rem; } img { width: 100%; height: auto; display: block; }
figcaption, .note { font-size: .85rem; color: var(--soft); max-width: none; }
figcaption b { color: var(--ink); }
nav a { margin-right: 1.2rem; color: #1f5fa8; text-decoration: none; font-size: .9rem; }
@media (max-width: 700px) { main { padding: 1.2rem; } }
@media print {
  body { background: none; } main { padding: 0; }
  h2 { break-before: page; } figure { break-inside: avoid; }
}
"""


def report(
    results: dict[str, Any], claims: Sequence[Claim], drawn: Sequence[Drawn], examples: Sequence[Example]
) -> str:
    """The page as HTML."""
    parts = [_head(results, claims, examples)]
    tables = {1: _table_4, 2: _triangle_table, 3: _load_table, 4: _noise_table, POSITION: _position_tables}
    for example in examples:
        parts.append(f'<h2 id="{_anchor(example)}">{_TITLES[example]}</h2>')
        parts.append(_claims_table([claim for claim in claims if claim.example == example]))
        parts.append(tables[example](results[_anchor(example)]))
        parts += [_figure(figure) for figure in drawn if figure.example == example]
    parts.append(_method(results))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>KFFA-LADRC: the simulation section, reproduced</title><style>{_STYLE}</style></head>\n"
        f"<body><main>{''.join(parts)}</main></body></html>\n"
    )


def _anchor(example: Example) -> str:
    """Name in results.json and on the page."""
    return f"example{example}" if isinstance(example, int) else example


def _head(results: dict[str, Any], claims: Sequence[Claim], examples: Sequence[Example]) -> str:
    counts = {verdict: sum(claim.verdict == verdict for claim in claims) for verdict in _CLASSES}
    summary = ", ".join(
        f'<span class="verdict {_CLASSES[verdict]}">{number} '
        f"{verdict.replace('holds', 'hold').replace('does not', 'do not')}</span>"
        for verdict, number in counts.items()
    )
    links = "".join(f'<a href="#{_anchor(example)}">{_TITLES[example]}</a>' for example in examples)
    return (
        "<h1>KFFA-LADRC for a quadrotor with a load: the simulation section, reproduced</h1>"
        "<p>“Fuzzy Adaptive Linear Active Disturbance Rejection Control for Quadrotor Load UAV Based on "
        "Kalman Filter”, "
        "Examples 1 to 4: eq 15 with ideal actuators, h = 0.005 s, Tables 1 and 3. Everything is measured "
        "on the true state. "
        "Settling is the first time after which the output stays within 2 % (or 0.1 %) of the step.</p>"
        f'<p>Of {len(claims)} claims {summary}.</p><nav>{links}<a href="#method">Method</a></nav>'
    )


def _claims_table(claims: Iterable[Claim]) -> str:
    rows = "".join(
        f"<tr><td>{escape(claim.claim)}</td><td>{escape(claim.measured)}</td>"
        f'<td><span class="verdict {_CLASSES[claim.verdict]}">{claim.verdict}</span></td></tr>'
        for claim in claims
    )
    return f'<table class="claims"><tr><th>Claim</th><th>Measured</th><th>Verdict</th></tr>{rows}</table>'


def _figure(drawn: Drawn) -> str:
    picture = base64.b64encode(drawn.path.read_bytes()).decode("ascii")
    return (
        f'<figure><img alt="{escape(drawn.title)}" src="data:image/png;base64,{picture}">'
        f"<figcaption><b>{escape(drawn.title)}.</b> {escape(drawn.caption)}</figcaption></figure>"
    )


def number(value: float | None, digits: int = 3) -> str:
    """A number for a table; a dash for what never happens."""
    return "—" if value is None or value == float("inf") else f"{value:.{digits}f}"


def _table(title: str, header: Sequence[str], rows: Iterable[Sequence[str]], note: str = "") -> str:
    head = "".join(f"<th{'' if i == 0 else ' class=number'}>{name}</th>" for i, name in enumerate(header))
    body = "".join(
        "<tr>"
        + "".join(f"<td{'' if i == 0 else ' class=number'}>{cell}</td>" for i, cell in enumerate(row))
        + "</tr>"
        for row in rows
    )
    below = f'<p class="note">{note}</p>' if note else ""
    return f"<h3>{title}</h3><table><tr>{head}</tr>{body}</table>{below}"


def _table_4(example: dict[str, Any]) -> str:
    header = ["Controller", *(f"{channel}<br>published" for channel in _COLUMNS)]
    header += [f"{channel}<br>2 % · 0.1 %" for channel in _COLUMNS] + ["largest<br>overshoot"]
    rows = []
    for label, flown in example["controllers"].items():
        published = TABLE_4.get(label, {})
        step = flown["up"]
        rows.append(
            [
                label,
                *(f'<span class="published">{_published(published, channel)}</span>' for channel in _COLUMNS),
                *(" · ".join(number(step[band][channel], 2) for band in BANDS) for channel in _COLUMNS),
                number(max(step["overshoot_percent"].values()), 1) + " %",
            ]
        )
    down = [
        [label, *(" · ".join(number(flown["down"][band][channel]) for band in BANDS) for channel in _COLUMNS)]
        for label, flown in example["controllers"].items()
        if label.startswith(("fa-", "kffa-", "ladrc")) and not label.endswith(("td", "literal"))
    ]
    return _table(
        "Table 4, published and measured: settling times of a step up, s",
        header,
        rows,
        "/td: with the published tracking differentiator. /even: rules applied alike up and down. "
        "/literal: the two-state Kalman filter. "
        "/no-integral: a PD tuned for this step alone. A published dash: not before 1.2 s.",
    ) + _table("A step down: settling times, s (2 % · 0.1 %)", ["Controller", *_COLUMNS], down)


def _published(row: dict[str, float | None], channel: str) -> str:
    return number(row[channel], 2) if channel in row else ""


def _triangle_table(example: dict[str, Any]) -> str:
    header = [
        "Controller",
        *(f"{c}<br>lag, s" for c in _COLUMNS),
        *(f"{c}<br>rms, m{'' if c == 'altitude' else 'rad'}" for c in _COLUMNS),
    ]
    scale = {channel: 1.0 if channel == "altitude" else 1000.0 for channel in CHANNELS}
    rows = [
        [
            label,
            *(number(found["lag_s"][c]) for c in _COLUMNS),
            *(number(scale[c] * found["rms_error"][c], 3 if c == "altitude" else 2) for c in _COLUMNS),
        ]
        for label, found in example["controllers"].items()
    ]
    return _table("Lag and rms error", header, rows)


def _load_table(example: dict[str, Any]) -> str:
    rows = []
    for label, flown in example["controllers"].items():
        row = [label]
        for name in ("load", "limit", "limit-inertia"):
            for event in ("pick_up", "drop"):
                found = flown[name][event]
                row.append(f"{1000 * found['peak_m']:.2f} · {number(found['recovery_s'], 2)}")
        rows.append(row)
    loads = ("5 kg", "6.73 kg", "6.73 kg,<br>with inertia")
    header = ["Controller", *(f"{load}<br>{event}" for load in loads for event in ("pick-up", "drop"))]
    return _table(
        "Height: peak, mm · time until it stays within 1 mm, s", header, rows,
        "The angles stay at rest (below 1e-5 rad) in all of these. 5 kg with the load's inertia is in "
        "results.json: it is the same as without.",
    )  # fmt: skip


def _noise_table(example: dict[str, Any]) -> str:
    rows = []
    for label, cases in example["controllers"].items():
        for case, found in cases.items():
            rows.append(
                [
                    f"{label}, {case}",
                    number(found["omega_c_spread"]["roll"], 2),
                    number(1000 * found["rms_error"]["roll"], 1),
                    number(1000 * found["mean_error"]["roll"], 1),
                    number(1000 * found["rms_error"]["altitude"], 1),
                    number(found["effort"]["roll"], 0),
                    number(found["effort"]["altitude"], 0),
                ]
            )
    header = [
        "Controller, disturbance",
        "spread of ω_c<br>on roll, rad/s",
        "roll rms<br>mrad",
        "roll mean<br>mrad",
    ]
    header += ["height rms<br>mm", "effort U2<br>N", "effort U1<br>N"]
    return _table(
        "Means over the seeds, from 1 s on", header, rows,
        "Effort: standard deviation of the command. These forces are the paper profile's: no aircraft has "
        "them.",
    )  # fmt: skip


def _position_tables(found: dict[str, Any]) -> str:
    columns = (
        ("hover", "rms_m", "hover rms", 1000.0), ("hover", "pick_up_m", "pick-up", 1000.0),
        ("hover", "drop_m", "drop", 1000.0), ("hover", "height_rms_m", "height: hover rms", 1000.0),
        ("hover", "pick_up_height_m", "height: pick-up", 1000.0),
        ("hover", "drop_height_m", "height: drop", 1000.0),
    )  # fmt: skip
    moving = (
        ("step", "settling_2_percent_s", "step: 2 %, s", 2), ("step", "overshoot_percent", "overshoot, %", 1),
        ("loaded-step", "settling_2_percent_s", "with 5 kg: 2 %, s", 2),
        ("loaded-step", "overshoot_percent", "overshoot, %", 1),
        ("square", "off_the_line_m", "square: off the line, m", 3), ("square", "behind_m", "behind, m", 2),
    )  # fmt: skip

    def cell(value: dict[str, float], scale: float, digits: int) -> str:
        return f"{number(scale * value['mean'], digits)} · {number(scale * value['worst'], digits)}"

    flown = found["controllers"].items()
    seeds = f"Mean · worst of {found['seeds']} seed{'' if found['seeds'] == 1 else 's'}. "
    return _table(
        "Place and height held, mm",
        ["Controller", *(title.replace(": ", ":<br>") for _, _, title, _ in columns)],
        [
            [label, *(cell(one[flight][key], scale, 0) for flight, key, _, scale in columns)]
            for label, one in flown
        ],
        seeds
        + "Pick-up and drop: largest distance in the 5 s after it. cascaded-pid: PX4's cascade and gains.",
    ) + _table(
        "Step and square",
        ["Controller", *(title.replace(": ", ":<br>") for _, _, title, _ in moving)],
        [
            [label, *(cell(one[flight][key], 1.0, digits) for flight, key, _, digits in moving)]
            for label, one in flown
        ],
        "A dash: not within 8 s. The LADRCs' reference passes the tracking differentiator, the cascade's "
        "does not.",
    )


def _method(results: dict[str, Any]) -> str:
    return (
        '<h2 id="method">Method</h2>'
        "<p>Slips in the paper are put right as docs/control-law.md lists them (fhan, the missing h in eq "
        "17, the observer discretised exactly because "
        "forward Euler diverges at h = 0.005 with ω_o = 240, Table 2 restored, the signs of eq 12 in eq 15). "
        "All controllers start in a hover at the origin and know the hover thrust. The law is eq 25 as "
        "printed, "
        "without acceleration feed-forward. The KFFA-LADRC of the tables has the extended filter (output, "
        "rate, disturbance; eq 19) with the published R.</p>"
        "<p>The gains that the paper does not state (PID, WB-LADRC, fuzzy scaling, intensity of the "
        "disturbance) stand in configs/paper.toml, "
        f"each with a line saying how it was chosen. Example 4 was flown with {results['seeds']} "
        f"seed{'' if results['seeds'] == 1 else 's'}. "
        "All series are in csv/, all numbers in results.json.</p>"
        "<p>The position ring flies in another profile: 246 N on four motors with 50 ms of lag, 20 ms of "
        "link delay "
        "each way, telemetry with noise at 100 Hz, air drag of 0.6 N s/m, a load with inertia held 0.3 m "
        "below, and a "
        "body-rate loop like PX4's for an autopilot. Controllers and ring are those that the daemon "
        "makes of "
        "configs/demo-px4-position.toml; <code>kffa-offboard demo --position</code> flies them over "
        "MAVLink.</p>"
    )
