"""The command kffa-offboard. Only what a command needs is imported, when it runs."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from kffa_offboard import __version__
from kffa_offboard.errors import UserError

if TYPE_CHECKING:
    from kffa_offboard.config import DaemonConfig

USAGE_ERROR = 2

# Written out, because importing the control law for its names would make --help slow; a test compares them.
Controller = Literal["pid", "cascaded-pid", "wb-ladrc", "ladrc", "fa-ladrc", "kffa-ladrc"]
OutputName = Literal["rates", "attitude"]
PersonalityName = Literal["px4", "ardupilot"]
AlignName = Literal["start", "engage", "event"]
ExampleName = Literal["1", "2", "3", "4", "position"]

app = typer.Typer(
    name="kffa-offboard",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Start with `kffa-offboard demo`. A simulated vehicle alone: `sim-vehicle run --config FILE`.",
)


def main(arguments: list[str] | None = None) -> None:
    """Run the command line; what a person can put right is one line on stderr and status 2."""
    try:
        app(args=arguments)
    except UserError as error:
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        sys.exit(USAGE_ERROR)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"kffa-offboard {__version__}")
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Offboard attitude and altitude control (KFFA-LADRC) for multirotors that pick up and drop loads.

    Runs beside an unmodified PX4 or ArduPilot: reads telemetry over MAVLink and streams attitude or body-rate
    setpoints with thrust.
    """


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard run --config px4-udp.toml --shadow    (watch only)\n\n"
        "    kffa-offboard run --config px4-udp.toml --engage    (a person arms)\n\n"
        "    kffa-offboard run --config serial.toml --link serial:/dev/ttyS0:921600\n\n"
        "Exit status: 0 scenario done or released, 1 failsafe or failure, 2 wrong usage or no vehicle, "
        "130 stopped by Ctrl-C or SIGTERM."
    )
)
def run(
    config: Annotated[Path, typer.Option(help="Configuration (TOML); those in configs/ are examples.")],
    link: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="Where the vehicle is, instead of the file's link.url: udpin:HOST:PORT, udpout:HOST:PORT, "
            "tcp:HOST:PORT, tcpin:HOST:PORT or serial:DEVICE:BAUD.",
        ),
    ] = None,
    shadow: Annotated[
        bool, typer.Option("--shadow", help="Observe and log only; never send setpoints, modes or arming.")
    ] = False,
    arm: Annotated[
        bool, typer.Option("--arm", help="Arm when engaging on the ground, and disarm after landing.")
    ] = False,
    engage: Annotated[
        bool,
        typer.Option("--engage", help="Take control as soon as telemetry is steady, and fly the scenario."),
    ] = False,
    lockstep: Annotated[
        bool,
        typer.Option(
            "--lockstep", help="Let a simulator in lock-step keep the time (sim-vehicle --lockstep)."
        ),
    ] = False,
    controller: Annotated[
        Controller | None, typer.Option(help="Fly this controller instead of the file's.")
    ] = None,
    output: Annotated[
        OutputName | None, typer.Option(help="Command body rates or attitude, instead of the file's choice.")
    ] = None,
    log: Annotated[
        Path | None, typer.Option(help="Write the flight log to this file (.tlog), not to log.directory.")
    ] = None,
    fix_params: Annotated[
        bool,
        typer.Option(
            "--fix-params",
            help="Set parameters of the autopilot that are wrong for offboard control, while disarmed, and "
            "put the old values back at the end.",
        ),
    ] = False,
    trust_params: Annotated[
        bool, typer.Option("--trust-params", help="Do not read and judge the autopilot's parameters.")
    ] = False,
    json: Annotated[
        bool, typer.Option("--json", help="Print a summary as one JSON object at the end.")
    ] = False,
) -> None:
    """Fly: take telemetry, run the controller, stream setpoints.

    Without --engage the daemon observes until it is asked to engage; without --arm it waits for a person to
    arm. The pilot wins at once: any mode change or disarming that it did not ask for ends its sending.
    Ctrl-C gives control back, closes the log and ends.
    """
    from kffa_offboard.cli_run import RunOptions
    from kffa_offboard.cli_run import run as fly
    from kffa_offboard.config import Overrides, load

    if shadow and (arm or engage):
        raise UserError("--shadow only observes; leave out --arm and --engage, or --shadow")
    if fix_params and (shadow or trust_params):
        other = "--shadow" if shadow else "--trust-params"
        raise UserError(
            f"--fix-params changes the vehicle's parameters, {other} does not; leave out one of them"
        )
    overrides = Overrides(
        link,
        controller,
        output,
        arm=arm,
        engage=engage,
        shadow=shadow,
        fix_parameters=fix_params,
        trust_parameters=trust_params,
    )
    status = fly(load(config, overrides), RunOptions(lockstep=lockstep, log=log, json=json))
    raise typer.Exit(status)


@app.command(
    epilog="Example: `kffa-offboard check my-vehicle.toml`. Exit status: 0 all right, 2 something is wrong."
)
def check(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Configurations to check.")],
) -> None:
    """Check configurations without opening or flying anything; every problem is a line of its own."""
    from kffa_offboard.config import ConfigError, load

    problems: list[str] = []
    for file in files:
        try:
            typer.echo(f"{file}: ok: {_summary(load(file))}")
        except ConfigError as error:
            problems += str(error).splitlines()
    if problems:
        raise UserError("\n".join(problems))


def _summary(config: DaemonConfig) -> str:
    """One line that tells a person what a configuration flies."""
    service = config.service
    flown = [type(segment).__name__.lower() for segment in service.scenario] or ["hold until released"]
    return (
        f"{service.controller.name}, output {service.output}, link {config.link.url}, "
        f"scenario {', '.join(flown)}, failsafe {service.failsafe_action}"
    )


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard demo\n\n"
        "    kffa-offboard demo --personality ardupilot --output attitude\n\n"
        "    kffa-offboard demo --position    (in gusty wind, holding the place)\n\n"
        "    kffa-offboard demo --lockstep --json    (as fast as it will go)\n\n"
        "Exit status: 0 flown, 1 the flight failed, 2 wrong usage, 130 stopped."
    )
)
def demo(
    out: Annotated[Path, typer.Option(help="Where flight.png, logs and true states go.")] = Path("demo-out"),
    json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object as the last line, no table.")
    ] = False,
    personality: Annotated[
        PersonalityName, typer.Option(help="The autopilot that the simulator plays.")
    ] = "px4",
    output: Annotated[OutputName, typer.Option(help="What the controller commands beside thrust.")] = "rates",
    controller: Annotated[Controller, typer.Option(help="The controller that flies.")] = "kffa-ladrc",
    seed: Annotated[int, typer.Option(min=0, help="Of the simulator's noise.")] = 0,
    lockstep: Annotated[
        bool,
        typer.Option("--lockstep", help="Simulated time waits for the controller; repeatable, and faster."),
    ] = False,
    baseline: Annotated[
        bool, typer.Option("--baseline/--no-baseline", help="Fly the cascaded PID, too, for comparison.")
    ] = True,
    position: Annotated[
        bool,
        typer.Option("--position", help="In gusty wind of 5 m/s: hold the place, too, and fly a square."),
    ] = False,
) -> None:
    """Fly a simulated 10 kg quadrotor that picks up 5 kg and drops it; say how far it moved.

    Starts `sim-vehicle` and the daemon as two processes that talk MAVLink 2 over UDP on loopback: take-off to
    5 m, pick-up 12 s and drop 20 s after lift-off (the daemon is not told), landing. With
    --position the drop comes at 18 s, and a square before the landing. The same flight under a cascade of
    PIDs like PX4's stands beside it. Writes flight.png and drop.png.
    """
    from kffa_offboard.demo.command import DemoPlan, run_demo

    plan = DemoPlan(
        directory=out,
        personality=personality,
        output=output,
        controller=controller,
        seed=seed,
        lockstep=lockstep,
        baseline=baseline,
        position=position,
        json=json,
    )
    raise typer.Exit(run_demo(plan))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard compare --autopilot px4 --firmware PX4-Autopilot/build/px4_sitl_default\n\n"
        "    kffa-offboard compare --autopilot ardupilot --firmware ardupilot/build/sitl/bin/arducopter "
        "--full\n\n"
        "    kffa-offboard compare --only native-stock --only kffa-ladrc    (the bundled imitation)\n\n"
        "Exit status: 0 flown, whatever the verdicts, 1 a flight failed, 2 wrong usage, 130 stopped."
    )
)
def compare(
    autopilot: Annotated[PersonalityName, typer.Option(help="The autopilot.")] = "px4",
    firmware: Annotated[
        Path | None,
        typer.Option(
            help="Its software-in-the-loop build: the arducopter program, or PX4's build/px4_sitl_default. "
            "Left out, the bundled imitation flies."
        ),
    ] = None,
    load: Annotated[float, typer.Option(min=0.1, max=6.73, help="What is picked up and dropped, kg.")] = 5.0,
    offset: Annotated[
        float, typer.Option(min=-0.2, max=0.2, help="How far forward of the centre it hangs, m.")
    ] = 0.0,
    rate: Annotated[float, typer.Option(min=20.0, max=200.0, help="Telemetry, Hz.")] = 100.0,
    delay: Annotated[
        float, typer.Option(min=0.0, max=0.3, help="Of the link, there and back, s of simulated time.")
    ] = 0.01,
    seed: Annotated[int, typer.Option(min=0, help="Of the noise of sensors.")] = 0,
    full: Annotated[
        bool, typer.Option("--full", help="Other loads, a load off centre, 50 Hz and a slow link, too.")
    ] = False,
    only: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only this trial; may be repeated.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Where report.html, figures, logs and true states go.")] = Path(
        "compare-out"
    ),
    json: Annotated[
        bool, typer.Option("--json", help="Print the results as one JSON object, no tables.")
    ] = False,
) -> None:
    """Fly the same pick-up and drop under the autopilot's own height hold and under the daemon's controllers.

    Starts firmware and physics for each flight, measures from true states, and writes a table, figures and
    report.html. All of it waits for each other (lock-step), so that a slow computer changes nothing but the
    time it takes: about a minute for each of ten flights with real firmware.
    """
    from kffa_offboard.compare.command import run_compare
    from kffa_offboard.compare.plan import ComparePlan, Conditions

    conditions = Conditions(load_kg=load, offset_m=offset, rate_hz=rate, delay_s=delay, seed=seed)
    plan = ComparePlan(
        directory=out,
        autopilot=autopilot,
        firmware=firmware,
        conditions=conditions,
        full=full,
        only=tuple(only or ()),
        json=json,
    )
    raise typer.Exit(run_compare(plan))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard paper\n\n"
        "    kffa-offboard paper --example 4 --seeds 5 --json\n\n"
        "    kffa-offboard paper --example position\n\n"
        "Exit status: 0 done, whatever the verdicts, 2 wrong usage, 130 stopped."
    )
)
def paper(
    example: Annotated[
        ExampleName | None,
        typer.Option(help="Only this example of the paper, or the position ring; all without it."),
    ] = None,
    out: Annotated[Path, typer.Option(help="Where report.html, results.json, csv/ and figures/ go.")] = Path(
        "paper-out"
    ),
    seeds: Annotated[
        int | None,
        typer.Option(
            min=1, max=1000, help="Noise seeds: 20 in Example 4 and 10 of the position ring without it."
        ),
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print the results as one JSON object, no table.")
    ] = False,
) -> None:
    """Reproduce the paper's simulation section, and say claim by claim where it holds.

    Flies Examples 1 to 4 with PID, WB-LADRC, LADRC, FA-LADRC and KFFA-LADRC on eq 15 with ideal actuators,
    other readings beside them, and the position ring in gusty wind on a vehicle with limits. Writes
    report.html with the figures that correspond to Figs 6-13, and all series. Takes about half a minute. The
    gains are those of configs/paper.toml.
    """
    from kffa_offboard.experiments.command import PaperPlan, run_paper

    plan = PaperPlan(directory=out, seeds=seeds, json=json)
    if example is not None:
        plan = replace(plan, examples=("position" if example == "position" else int(example),))
    raise typer.Exit(run_paper(plan))


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

    The result is a part of a configuration: [control.altitude], [control.rates.*] or [control.attitude.*].
    A channel that was not moved enough is named, with what to fly.
    """
    from kffa_offboard.loganalysis.identify_command import run_identify

    raise typer.Exit(run_identify(logs, out, link_delay_ms * 1e-3, json))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard tune model.toml\n\n"
        "    kffa-offboard tune model.toml --phase-margin-deg 35 --telemetry-hz 50 --out tuned\n\n"
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
    out: Annotated[Path, typer.Option(help="Where tuned.toml and loops.png go.")] = Path("tune-out"),
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, no table.")] = False,
) -> None:
    """Pick omega_c and omega_o of each channel: the quickest that keep the margins.

    The loop is the one that flies, in discrete time, with delay, lag, Kalman filter and observer; margins
    hold at the command of each channel. Writes tuned.toml, to be put into a configuration, and loops.png.
    """
    from kffa_offboard.loganalysis.margins import Wanted
    from kffa_offboard.loganalysis.tune_command import run_tune

    wanted = Wanted(gain_margin_db, phase_margin_deg, delay_margin_ms * 1e-3)
    raise typer.Exit(run_tune(model, wanted, 1.0 / telemetry_hz, out, json))


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
