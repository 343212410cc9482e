"""``kffa-offboard tune``: a model in, bandwidths, margins and pictures of the loops out."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from rich.console import Console
from rich.table import Table

from kffa_offboard.config import ConfigError, read_toml
from kffa_offboard.config_control import ControlTable
from kffa_offboard.config_errors import explain
from kffa_offboard.control.controllers import CHANNELS
from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis.margins import Wanted
from kffa_offboard.loganalysis.model_file import as_toml, merged
from kffa_offboard.loganalysis.output_files import make_directory, refuse_others, write_text
from kffa_offboard.loganalysis.tune import AltitudeChoice, TunedChannel, Tuning, tune

RANGE_SHARE = 0.2
"""omega_c_range, the fuzzy rules' play, as a share of omega_c."""


HEAD = "Tuned by kffa-offboard"
"""With which the comment at the head of the tuned tables begins."""


def run_tune(
    model: Path, wanted: Wanted, period_s: float, out: Path, as_json: bool, peak_m: float | None = None
) -> int:
    """Do it and return the exit status, 0."""
    document = read_toml(model)
    given = document.get("control", {})
    control, channels = control_of(given, str(model))
    tuning = tune(control, channels, period_s, wanted, peak_m, with_trade_off=True)
    tuned = list(tuning.channels)
    make_directory(out)
    refuse_others(out / "tuned.toml", [model], begins=f"# {HEAD}")
    tables = tuned_tables(given, control, tuned)
    comments = {_table_name(control, channel): [_describe(channel)] for channel in tuned}
    head = f"{HEAD} from {model.name}: put these tables into your configuration."
    write_text(out / "tuned.toml", as_toml(tables, comments, head))
    # matplotlib and python-control are slow to import
    from kffa_offboard.loganalysis.tune_figure import draw, draw_trade_off

    draw(out / "loops.png", tuned, wanted)
    if tuning.trade_off:
        draw_trade_off(out / "trade-off.png", tuning)
    if as_json:
        print(json.dumps(_as_json(tuning)), flush=True)
    else:
        _tell(tuning, wanted, out, Console())
    return 0


def control_of(given: Any, name: str) -> tuple[ControlTable, tuple[int, ...]]:
    """The `[control]` table with defaults for what is missing, and the channels that are given.

    Raises UserError for a model that is none, one line for each problem.
    """
    if not isinstance(given, dict) or not any(key in given for key in ("altitude", "rates", "attitude")):
        raise UserError(
            f"{name}: no [control.*] tables; give the file that `kffa-offboard identify --out` wrote"
        )
    output = given.get("output", "rates" if "rates" in given or "attitude" not in given else "attitude")
    complete = merged({"altitude": {"hover_thrust": 0.5}, "output": output}, given)
    try:
        control = ControlTable.model_validate(complete)
    except ValidationError as error:
        raise ConfigError(name, [f"control.{line}" for line in explain(error, ControlTable)]) from error
    axes = given.get(output, {})
    channels = [k for k, channel in enumerate(CHANNELS[:3]) if channel in axes]
    if "altitude" in given:
        channels.append(3)
    return control, tuple(channels)


def _table_name(control: ControlTable, channel: TunedChannel) -> str:
    if channel.name == "altitude":
        return "control.altitude"
    return f"control.{control.output}.{channel.name}"


def tuned_tables(given: dict[str, Any], control: ControlTable, tuned: list[TunedChannel]) -> dict[str, Any]:
    """The model with the bandwidths put in."""
    tables: dict[str, Any] = {"control": dict(given)}
    for channel in tuned:
        gains: dict[str, Any] = {
            "omega_c": round(channel.omega_c, 3),
            "omega_o": round(channel.omega_o, 2),
            "omega_c_range": round(RANGE_SHARE * channel.omega_c, 3),
            "prediction_s": round(channel.prediction_s, 4),
        }
        if channel.altitude is not None:
            gains["measurement_noise_m"] = round(channel.altitude.measurement_noise_m, 4)
            gains["disturbance_intensity"] = round(channel.altitude.disturbance_intensity, 2)
        for part in reversed(_table_name(control, channel).split(".")):
            gains = {part: gains}
        tables = merged(tables, gains)
    return tables


def _describe(channel: TunedChannel) -> str:
    margins = channel.margins
    return (
        f"{margins.gain_db:.1f} dB, {margins.phase_deg:.0f} deg, {1e3 * margins.delay_s:.0f} ms of delay; "
        f"crossover at {margins.crossover_rad_s:.1f} rad/s"
    )


def _as_json(tuning: Tuning) -> dict[str, Any]:
    told: dict[str, Any] = {}
    for channel in tuning.channels:
        told[channel.name] = {
            "omega_c": channel.omega_c,
            "omega_o": channel.omega_o,
            "prediction_s": channel.prediction_s,
            **asdict(channel.margins),
            "disturbance_peak": channel.disturbance_peak,
            "disturbance_area": channel.disturbance_area,
            **({} if channel.altitude is None else asdict(channel.altitude)),
        }
    if tuning.trade_off:
        told["trade_off"] = [
            {"share": share, "peak_m": found.peak, **asdict(found.margins)}
            for share, found in tuning.trade_off
        ]
    return told


def _tell(tuning: Tuning, wanted: Wanted, out: Path, console: Console) -> None:
    table = Table(
        "channel", "omega_c", "omega_o", "looks ahead", "gain margin", "phase margin", "delay margin"
    )
    for channel in tuning.channels:
        margins = channel.margins
        table.add_row(
            channel.name,
            f"{channel.omega_c:.2f} rad/s",
            f"{channel.omega_o:.1f} rad/s",
            f"{1e3 * channel.prediction_s:.0f} ms",
            f"{margins.gain_db:.1f} dB",
            f"{margins.phase_deg:.0f} deg at {margins.crossover_rad_s:.1f} rad/s",
            f"{1e3 * margins.delay_s:.0f} ms",
        )
    console.print(table)
    for channel in tuning.channels:
        if channel.altitude is not None:
            _tell_altitude(channel, channel.altitude, wanted, console)
    if tuning.trade_off:
        console.print(_trade_off_table(tuning))
    files = ["tuned.toml", "loops.png", *(["trade-off.png"] if tuning.trade_off else [])]
    console.print(f"Written: {', '.join(str(out / name) for name in files)}", soft_wrap=True, highlight=False)


def _tell_altitude(channel: TunedChannel, found: AltitudeChoice, wanted: Wanted, console: Console) -> None:
    console.print(
        f"A load of half the vehicle's mass moves it by {found.pick_up_peak_m:.3f} m when it is picked up, "
        f"by {found.drop_peak_m:.3f} m when it is dropped; sensor noise moves thrust by "
        f"{100.0 * found.thrust_noise:.1f} % rms.",
        highlight=False,
    )
    if not channel.margins.meet(wanted):
        console.print(
            f"The margins are less than {wanted.gain_db:g} dB, {wanted.phase_deg:g} deg, "
            f"{1e3 * wanted.delay_s:g} ms: that peak leaves no more. See the trade-off.",
            highlight=False,
        )


def _trade_off_table(tuning: Tuning) -> Table:
    table = Table("margins asked for", "peak", "gain", "phase", "delay", "omega_c, omega_o")
    for share, found in tuning.trade_off:
        table.add_row(
            f"{100.0 * share:.0f} %",
            f"{found.peak:.3f} m",
            f"{found.margins.gain_db:.1f} dB",
            f"{found.margins.phase_deg:.0f} deg",
            f"{1e3 * found.margins.delay_s:.0f} ms",
            f"{found.omega_c:.1f}, {found.omega_o:.0f} rad/s",
        )
    return table
