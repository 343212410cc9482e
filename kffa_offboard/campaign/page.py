"""report.html of a campaign: one page with its tables and figure inside."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

from kffa_offboard import __version__
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.campaign.summary import MEASURES, PERCENTILES, percent_failed

_SHOWN_FAILURES = 200

_STYLE = """
:root { --ink: #1d232b; --soft: #5b6673; --line: #dfe3e8; --tint: #f6f7f9; }
body { margin: 0; background: var(--tint); color: var(--ink);
  font: 16px/1.55 'Helvetica Neue', Arial, sans-serif; }
main { max-width: 1060px; margin: 0 auto; background: #fff; padding: 2.2rem 3rem 4rem; }
h1 { font-size: 1.6rem; margin: 0 0 .6rem; }
h2 { font-size: 1.2rem; margin: 2.4rem 0 .7rem; padding-top: .7rem; border-top: 2px solid var(--ink); }
table { border-collapse: collapse; width: 100%; font-size: .88rem; margin: .5rem 0 1rem; }
th, td { text-align: right; padding: .4rem 0 .4rem .7rem; border-bottom: 1px solid var(--line);
  font-variant-numeric: tabular-nums; }
th { font-size: .78rem; color: var(--soft); }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
figure { margin: 1.2rem 0; } img { width: 100%; height: auto; display: block; }
.note, figcaption { font-size: .85rem; color: var(--soft); }
@media (max-width: 700px) { main { padding: 1.2rem; } }
"""


def page(campaign: Campaign, summaries: dict[str, dict[str, Any]], figure: Path) -> str:
    """The page as HTML."""
    flights = max(summary["flights"] for summary in summaries.values())
    picture = base64.b64encode(figure.read_bytes()).decode("ascii")
    parts = [
        f"<h1>{flights:,} random flights with {escape(', '.join(summaries))}</h1>",
        f"<p>Seed {campaign.file.campaign.seed}, kffa-offboard {__version__}. "
        "Every controller flies the same flights. Figures are from true states; percentiles are over all "
        "flights, failed ones until they failed.</p>",
        "<h2>Failed flights</h2>",
        _failures(summaries),
        "<h2>Percentiles</h2>",
        *(_percentiles(name, summary) for name, summary in summaries.items()),
        f'<figure><img alt="Distribution of peaks, and failures by condition" '
        f'src="data:image/png;base64,{picture}"></figure>',
        "<h2>Fly one of them alone</h2>",
        *(_numbers(name, summary) for name, summary in summaries.items()),
        "<h2>Conditions</h2>",
        _settings(campaign),
    ]
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Campaign of {flights:,} flights</title><style>{_STYLE}</style></head>\n"
        f"<body><main>{''.join(parts)}</main></body></html>\n"
    )


def _table(header: Iterable[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _failures(summaries: dict[str, dict[str, Any]]) -> str:
    reasons = next(iter(summaries.values()))["failures"]
    rows = [
        (name, f"{summary['flights']:,}", percent_failed(summary),
         *(f"{summary['failures'][reason]:,}" for reason in reasons))
        for name, summary in summaries.items()
    ]  # fmt: skip
    return _table(("controller", "flights", "failed", *reasons), rows)


def _percentiles(name: str, summary: dict[str, Any]) -> str:
    header = (
        name,
        *("median" if share == 50 else "worst" if share == 100 else f"{share} %" for share in PERCENTILES),
    )
    rows = [
        (label, *(f"{summary['percentiles'][measure][f'p{share}']:.3f}" for share in PERCENTILES))
        for measure, label in MEASURES.items()
    ]
    return _table(header, rows)


def _numbers(name: str, summary: dict[str, Any]) -> str:
    failed = summary["failed_flights"]
    worst = ", ".join(f"{column}: {number}" for column, number in summary["worst_flights"].items())
    shown = ", ".join(map(str, failed[:_SHOWN_FAILURES])) or "none"
    more = f" and {len(failed) - _SHOWN_FAILURES:,} more" if len(failed) > _SHOWN_FAILURES else ""
    return (
        f"<p><b>{escape(name)}</b> failed: {shown}{more}. Worst: {escape(worst)}. "
        "<code>kffa-offboard campaign FILE --flight NUMBER</code></p>"
    )


def _settings(campaign: Campaign) -> str:
    rows = [
        (f"{table}.{key}", f"{value[0]:g} .. {value[1]:g}" if isinstance(value, list | tuple) else str(value))
        for table, keys in campaign.file.model_dump(mode="json").items()
        for key, value in keys.items()
    ]
    return _table(("key", "value"), rows)
