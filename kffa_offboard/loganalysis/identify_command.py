"""``kffa-offboard identify``: read, fit, tell, write MODEL.toml."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from kffa_offboard.errors import UserError
from kffa_offboard.flightlog.parts import following_parts, without_parts
from kffa_offboard.loganalysis.fit import Estimate
from kffa_offboard.loganalysis.identify import Identification, identify
from kffa_offboard.loganalysis.mass import USUAL_DELAY_S, steady_hover_thrust, track_mass
from kffa_offboard.loganalysis.model_file import as_toml, model_tables
from kffa_offboard.loganalysis.output_files import refuse_others, write_text
from kffa_offboard.loganalysis.read import read_log
from kffa_offboard.loganalysis.record import FlightRecord

HEAD = "Identified by kffa-offboard"
"""With which the comment at the head of a model begins."""


def run_identify(logs: list[Path], out: Path | None, link_delay_s: float, as_json: bool) -> int:
    """Do it; exit status 0 if a channel was identified, 1 if none was."""
    if out is not None:
        read = [part for log in logs for part in (log, *following_parts(log))]
        refuse_others(out, read, begins=f"# {HEAD}")
    records = [read_log(log) for log in without_parts(logs)]
    if len({record.commands_sent for record in records}) > 1:
        raise UserError(
            "telemetry logs of a companion computer and logs written on board do not mix: their "
            "delays differ; "
            "identify them one kind at a time"
        )
    found = identify(records)
    warnings = [warning for record in records for warning in _loads(record)]
    if out is not None and found.channels:
        tables = model_tables(found, link_delay_s)
        write_text(out, as_toml(tables, _comments(found), _head(logs, found, link_delay_s, warnings)))
    if as_json:
        print(json.dumps(_as_json(found) | {"warnings": warnings}), flush=True)
    else:
        _tell(found, out, Console())
        for warning in warnings:
            Console().print(f"warning: {warning}", soft_wrap=True, highlight=False)
        for record in records:
            for problem in record.damage:
                Console().print(f"PARTIAL: {record.path}: {problem}", soft_wrap=True, highlight=False)
            for remark in record.remarks:
                Console().print(f"{record.path}: {remark}", soft_wrap=True, highlight=False)
    return 0 if found.channels else 1


def _loads(record: FlightRecord) -> list[str]:
    """A line if a load came or went in the flight, as `shadow` finds it."""
    hover = steady_hover_thrust(record)
    track = track_mass(record, hover, USUAL_DELAY_S) if hover is not None and hover > 0.0 else None
    if track is None or not track.changes:
        return []
    times = ", ".join(f"{change.time_s:.1f} s" for change in track.changes)
    return [
        f"{record.path.name}: a load came or went at {times}; the figures mix two vehicles and are less "
        "certain than they say: identify flights in which nothing changes"
    ]


def _head(logs: list[Path], found: Identification, link_delay_s: float, warnings: list[str]) -> str:
    if found.whole_loop:
        delay = "delay_s is that of the whole loop, from the sample to the actuator."
    else:
        delay = (
            f"delay_s is that of the vehicle alone plus {link_delay_s:g} s for the link (--link-delay-ms)."
        )
    return f"{HEAD} from {', '.join(log.name for log in logs)}.\n" + "\n".join([delay, *warnings])


def _span(estimate: Estimate) -> str:
    return f"{estimate.value:.4g} ({estimate.low:.4g} .. {estimate.high:.4g})"


def _comments(found: Identification) -> dict[str, list[str]]:
    comments = {}
    for channel in found.channels:
        parts = [f"b0 = {_span(channel.b0)}"]
        parts += [f"{name} = {_span(estimate)}" for name, estimate in channel.parameters.items()]
        lines = [f"95 %: {', '.join(parts)}"]
        if channel.sample_age_s > 0.0:
            lines.append(
                f"delay_s below has {channel.sample_age_s:.3f} s more: the sample is that old when "
                f"it is used."
            )
        comments[f"control.{channel.name}"] = lines
    return comments


def _as_json(found: Identification) -> dict[str, Any]:
    def span(estimate: Estimate) -> dict[str, float]:
        return {"value": estimate.value, "low": estimate.low, "high": estimate.high}

    return {
        "whole_loop": found.whole_loop,
        "channels": {
            channel.name: {
                "b0": span(channel.b0),
                **{name: span(estimate) for name, estimate in channel.parameters.items()},
                "sample_age_s": channel.sample_age_s,
                "explained": channel.explained,
                "excited_s": channel.excited_s,
            }
            for channel in found.channels
        },
        "not_identified": {channel.name: channel.reason for channel in found.missing},
    }


def _tell(found: Identification, out: Path | None, console: Console) -> None:
    if found.channels:
        table = Table("channel", "b0", "lag s", "delay s", "other", "explained", "flown s")
        for channel in found.channels:
            rest = dict(channel.parameters)
            delay = rest.pop("delay_s")
            lag = rest.pop("lag_s", None) or rest.pop("rate_time_constant_s", None)
            table.add_row(
                channel.name,
                _span(channel.b0),
                "-" if lag is None else _span(lag),
                _span(delay),
                "\n".join(f"{name} {_span(estimate)}" for name, estimate in rest.items()),
                f"{100.0 * channel.explained:.0f} %",
                f"{channel.excited_s:.0f}",
            )
        console.print(table)
        console.print("Values with their 95 % confidence intervals.")
    for missing in found.missing:
        console.print(f"{missing.name}: not identified: {missing.reason}", soft_wrap=True, highlight=False)
    if out is not None and found.channels:
        console.print(f"Written: {out}", soft_wrap=True, highlight=False)
