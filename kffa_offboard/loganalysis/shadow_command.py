"""``kffa-offboard shadow``: read, estimate, tell."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from kffa_offboard.control.controllers import CHANNELS
from kffa_offboard.loganalysis.link_quality import StreamQuality
from kffa_offboard.loganalysis.output_files import make_directory, refuse_others, write_text
from kffa_offboard.loganalysis.read import read_log
from kffa_offboard.loganalysis.shadow import Shadow, shadow


def run_shadow(
    log: Path, config: Path | None, vehicle_mass_kg: float | None, as_json: bool, out: Path | None
) -> int:
    """Do it and return the exit status, 0."""
    if out is not None:
        refuse_others(out / "shadow.csv", [log], begins="time_s,")
    found = shadow(read_log(log), config)
    if out is not None:
        make_directory(out)
        write_text(out / "shadow.csv", _csv(found))
        from kffa_offboard.loganalysis.shadow_figure import draw  # matplotlib is slow to import

        draw(out / "shadow.png", found, vehicle_mass_kg)
    summary = summarize(found, vehicle_mass_kg)
    if as_json:
        print(json.dumps(summary), flush=True)
    else:
        _tell(found, summary, Console())
    return 0


def _rounded(value: float, digits: int = 4) -> float | None:
    return round(float(value), digits) if np.isfinite(value) else None


def summarize(found: Shadow, vehicle_mass_kg: float | None) -> dict[str, Any]:
    """Everything as JSON values; what cannot be told is null."""
    record, verdict = found.record, found.verdict
    air = found.estimates.airborne != 0.0
    disturbance: dict[str, Any] = {}
    for k, name in enumerate(CHANNELS):
        values = found.estimates.disturbance[air, k]
        if len(values):
            disturbance[name] = {
                "mean": _rounded(values.mean()),
                "std": _rounded(values.std()),
                "peak": _rounded(np.abs(values).max()),
            }
    return {
        "log": str(record.path),
        "kind": record.source,
        "autopilot": record.autopilot or None,
        "partial": record.partial,
        "damage": list(record.damage),
        "remarks": list(record.remarks),
        "duration_s": _rounded(record.duration_s, 3),
        "airborne_s": _rounded(float(np.sum(np.diff(found.estimates.time_s)[air[1:]])), 3),
        "model": {"hover_thrust": _rounded(found.model.hover_thrust), "origin": found.model.origin},
        "disturbance": disturbance,
        "payload": _payload(found, vehicle_mass_kg),
        "telemetry": {
            name: asdict(quality) if quality is not None else None
            for name, quality in (("attitude", found.attitude), ("position", found.position))
        },
        "response_delay_s": found.response_delays_s,
        "loop_delay_s": found.loop_delay_s,
        "verdict": {**asdict(verdict), "dead_time_s": _rounded(verdict.dead_time_s)},
    }


def _payload(found: Shadow, vehicle_mass_kg: float | None) -> dict[str, Any] | None:
    if found.mass is None:
        return None
    flown = np.isfinite(found.mass.mass_ratio)
    changes = []
    for change in found.mass.changes:
        entry: dict[str, Any] = {
            "time_s": round(change.time_s, 3),
            "event": "pick-up" if change.share > 0.0 else "drop",
            "share_of_empty_mass": round(change.share, 4),
        }
        if vehicle_mass_kg is not None:
            entry["mass_kg"] = round(change.share * vehicle_mass_kg, 3)
        changes.append(entry)
    return {
        "mass_ratio_median": _rounded(np.median(found.mass.mass_ratio[flown])) if flown.any() else None,
        "mass_ratio_max": _rounded(np.max(found.mass.mass_ratio[flown])) if flown.any() else None,
        "changes": changes,
    }


def _stream(name: str, quality: StreamQuality | None) -> list[str]:
    if quality is None:
        return [name, "-", "-", "-", "-"]
    return [
        name,
        f"{quality.rate_hz:.1f}",
        f"{1e3 * quality.jitter_s:.1f}",
        str(quality.gaps),
        f"{quality.longest_gap_s:.3f}",
    ]


def _tell(found: Shadow, summary: dict[str, Any], console: Console) -> None:
    record = found.record
    console.print(
        f"{record.path}: {record.source}, {record.autopilot or 'autopilot unknown'}, "
        f"{record.duration_s:.1f} s, {summary['airborne_s']} s in the air",
        soft_wrap=True,
        highlight=False,
    )
    for problem in record.damage:
        console.print(
            f"PARTIAL: {problem}; {record.duration_s:.1f} s were read", soft_wrap=True, highlight=False
        )
    for remark in record.remarks:
        console.print(remark, soft_wrap=True, highlight=False)
    console.print(f"model: {found.model.origin}, hover thrust {found.model.hover_thrust:.3f}", soft_wrap=True)
    table = Table("telemetry", "rate Hz", "jitter ms", "gaps", "longest s")
    table.add_row(*_stream("attitude", found.attitude))
    table.add_row(*_stream("position", found.position))
    console.print(table)
    table = Table("disturbance", "mean", "std", "peak")
    for name, values in summary["disturbance"].items():
        unit = "m/s²" if name == "altitude" else "rad/s²"
        table.add_row(f"{name} {unit}", *(f"{values[key]:.3g}" for key in ("mean", "std", "peak")))
    console.print(table)
    _tell_payload(summary["payload"], console)
    delays = ", ".join(f"{name} {1e3 * delay:.0f} ms" for name, delay in found.response_delays_s.items())
    console.print(f"command to response: {delays or 'the flight is too calm to tell'}", soft_wrap=True)
    verdict = found.verdict
    word = "good enough" if verdict.good_enough else "NOT good enough"
    console.print(
        f"link: {word}: dead time {1e3 * verdict.dead_time_s:.0f} ms; altitude omega_c up to "
        f"{verdict.omega_c:.1f} rad/s, omega_o up to {verdict.omega_o:.0f} rad/s",
        soft_wrap=True,
        highlight=False,
    )
    for reason in verdict.reasons:
        console.print(f"  {reason}", soft_wrap=True, highlight=False)


def _tell_payload(payload: dict[str, Any] | None, console: Console) -> None:
    if payload is None:
        console.print("payload: no thrust or climb rate in the log")
        return
    if not payload["changes"]:
        console.print("payload: no pick-up or drop")
    for change in payload["changes"]:
        mass = f"{change['mass_kg']:+.2f} kg, " if "mass_kg" in change else ""
        console.print(
            f"{change['event']} at {change['time_s']:.2f} s: "
            f"{mass}{100 * change['share_of_empty_mass']:+.1f} % "
            "of the empty mass",
            highlight=False,
        )


def _csv(found: Shadow) -> str:
    """Time, measurement, estimate, disturbance of each channel, mass ratio."""
    estimates = found.estimates
    names = ["time_s"]
    names += [f"{kind}_{name}" for kind in ("measured", "estimate", "disturbance") for name in CHANNELS]
    columns = [estimates.time_s[:, None], estimates.measurement, estimates.estimate, estimates.disturbance]
    if found.mass is not None:
        names.append("mass_ratio")
        columns.append(np.interp(estimates.time_s, found.mass.time_s, found.mass.mass_ratio)[:, None])
    rows = [",".join(f"{value:.6g}" for value in row) for row in np.concatenate(columns, axis=1)]
    return "\n".join([",".join(names), *rows, ""])
