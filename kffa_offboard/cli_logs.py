"""Commands that read flight logs: replay, shadow, identify, tune, report, export."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

AlignName = Literal["start", "engage", "event"]


app = typer.Typer()


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard replay logs/2026-05-01_14-02-11.tlog\n\n"
        "    kffa-offboard replay flight.tlog --config bolder.toml    (what would other gains have done?)\n\n"
        "Exit status: 0 identical (or --config), 1 different, 2 wrong usage or not a log of ours."
    )
)
def replay(
    log: Annotated[Path, typer.Argument(metavar="FLIGHT.tlog", help="A log of `kffa-offboard run`.")],
    config: Annotated[
        Path | None,
        typer.Option(help="Fly this configuration instead of the recorded one and report what changes."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the result as one JSON object.")] = False,
) -> None:
    """Fly a recorded flight again and compare every command, byte for byte.

    The log holds the configuration, so nothing else is needed. The first difference is told with its time,
    field and both values.
    """
    from kffa_offboard.replay.command import ReplayPlan, run_replay

    raise typer.Exit(run_replay(ReplayPlan(log=log, config=config, json=json)))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard shadow flight.ulg\n\n"
        "    kffa-offboard shadow 00000042.BIN --vehicle-mass-kg 3.2 --out shadow-out\n\n"
        "    kffa-offboard shadow flight.tlog --config my-vehicle.toml --json\n\n"
        "Exit status: 0 done, 2 no flight log, or one without a flight."
    )
)
def shadow(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A .tlog, an ArduPilot .BIN or a PX4 .ulg.")],
    config: Annotated[
        Path | None,
        typer.Option(help="Take the vehicle's model from this configuration, not from the log."),
    ] = None,
    vehicle_mass_kg: Annotated[
        float | None, typer.Option(min=0.01, help="Empty mass; then loads are told in kilograms.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, no tables.")] = False,
    out: Annotated[Path | None, typer.Option(help="Write shadow.csv and shadow.png there.")] = None,
) -> None:
    """Run the estimators over a recorded flight: disturbances, payload, and whether the link is good enough.

    Nothing is flown. Without --config the model is made from the log: hover thrust is the median thrust of
    the first steady hover, which is taken to be without load.
    """
    from kffa_offboard.loganalysis.shadow_command import run_shadow

    raise typer.Exit(run_shadow(log, config, vehicle_mass_kg, json, out))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard run --config configs/identify-px4.toml --arm --engage    (the flight)\n\n"
        "    kffa-offboard identify logs/*.tlog --out model.toml\n\n"
        "    kffa-offboard identify flight.ulg --link-delay-ms 40 --out model.toml\n\n"
        "Exit status: 0 at least one channel identified, 1 none, 2 wrong usage or no flight log."
    )
)
def identify(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="Logs (.tlog, .BIN, .ulg) of one vehicle.")
    ],
    out: Annotated[Path | None, typer.Option(help="Write the model there (TOML).")] = None,
    link_delay_ms: Annotated[
        float,
        typer.Option(
            min=0.0, max=500.0, help="Delay of telemetry and command links, for logs written on board."
        ),
    ] = 0.0,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, no table.")] = False,
) -> None:
    """Find each channel's b0, lag and delay, with confidence intervals, from flights with enough excitation.

    The result is a part of a configuration: `[control.altitude]`, `[control.rates.*]` or
    `[control.attitude.*]`. A channel that was not moved enough is named, with what to fly.
    """
    from kffa_offboard.loganalysis.identify_command import run_identify

    raise typer.Exit(run_identify(logs, out, link_delay_ms * 1e-3, json))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard tune model.toml\n\n"
        "    kffa-offboard tune model.toml --phase-margin-deg 35 --telemetry-hz 50 --out tuned\n\n"
        "    kffa-offboard tune model.toml --peak-m 0.08\n\n"
        "Exit status: 0 done, 2 wrong usage, or margins that no bandwidth has."
    )
)
def tune(
    model: Annotated[Path, typer.Argument(metavar="MODEL.toml", help="What `identify --out` wrote.")],
    gain_margin_db: Annotated[float, typer.Option(min=1.0, max=30.0)] = 6.0,
    phase_margin_deg: Annotated[float, typer.Option(min=5.0, max=80.0)] = 45.0,
    delay_margin_ms: Annotated[float, typer.Option(min=0.0, max=500.0)] = 20.0,
    telemetry_hz: Annotated[
        float, typer.Option(min=10.0, max=400.0, help="Of attitude and position.")
    ] = 100.0,
    peak_m: Annotated[
        float | None,
        typer.Option(
            min=0.001,
            max=10.0,
            help="Instead of the margins: half the vehicle's mass, picked up or dropped, may move it so far; "
            "the altitude channel gets the most margin that leaves.",
        ),
    ] = None,
    out: Annotated[Path, typer.Option(help="Where tuned.toml, loops.png and trade-off.png go.")] = Path(
        "tune-out"
    ),
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, no table.")] = False,
) -> None:
    """Pick omega_c, omega_o and how far each channel looks ahead: the quickest that keep the margins.

    The loop is the one that flies, in discrete time, with delay, lag, Kalman filter and observer; margins
    hold at the command of each channel. On the altitude channel the Kalman filter is tuned, too; a table
    and trade-off.png tell what margins cost. Writes tuned.toml, to be put into a configuration, and
    loops.png.
    """
    from kffa_offboard.loganalysis.margins import Wanted
    from kffa_offboard.loganalysis.tune_command import run_tune

    wanted = Wanted(gain_margin_db, phase_margin_deg, delay_margin_ms * 1e-3)
    raise typer.Exit(run_tune(model, wanted, 1.0 / telemetry_hz, out, json, peak_m))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard report logs/2026-05-01_14-02-11.tlog\n\n"
        "    kffa-offboard report before.tlog after.tlog --align event --out compare.html\n\n"
        "    kffa-offboard report flight.tlog --png figures    (PNGs for a paper, too)\n\n"
        "Exit status: 0 written, 2 wrong usage, no flight log, or one without a flight."
    )
)
def report(
    logs: Annotated[
        list[Path],
        typer.Argument(metavar="LOG...", help="Flights (.tlog, .BIN, .ulg), laid over one another."),
    ],
    out: Annotated[Path, typer.Option(help="The page.")] = Path("report.html"),
    png: Annotated[Path | None, typer.Option(metavar="DIR", help="Draw figures for papers there.")] = None,
    align: Annotated[
        AlignName,
        typer.Option(
            help="Time 0 of each flight: start of its log, engaging (else arming), or first pick-up or drop."
        ),
    ] = "engage",
) -> None:
    """Show flights: one page with tables and interactive plots that needs no network.

    Of logs of `kffa-offboard run`: reference, measurement, estimate, command, disturbance, omega_c, load,
    latency and events. Of logs of a ground station or of the autopilot: what they hold.
    """
    from kffa_offboard.report.command import ReportPlan, run_report

    raise typer.Exit(run_report(ReportPlan(tuple(logs), out, png, align)))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard export logs/2026-05-01_14-02-11.tlog    (writes it beside the log)\n\n"
        "    kffa-offboard export flight.tlog --out flight.csv\n\n"
        "Exit status: 0 written, 2 wrong usage, or a log without inner signals."
    )
)
def export(
    log: Annotated[Path, typer.Argument(metavar="FLIGHT.tlog", help="A log of `kffa-offboard run`.")],
    out: Annotated[Path | None, typer.Option(help="The table; FLIGHT.csv if left out.")] = None,
) -> None:
    """Write the inner signals of a flight as CSV, for PlotJuggler, pandas or a spreadsheet.

    One line for each control step; the names are those of `run --plot`, so that one PlotJuggler layout
    serves both.
    """
    from kffa_offboard.loganalysis.export_command import run_export

    raise typer.Exit(run_export(log, out))
