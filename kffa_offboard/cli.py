"""The command kffa-offboard. Only what a command needs is imported, when it runs."""

from __future__ import annotations

import errno
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kffa_offboard import __version__, cli_flights, cli_logs
from kffa_offboard.cli_choices import Controller, OutputName
from kffa_offboard.cli_usage import OneLineGroup
from kffa_offboard.errors import UserError

if TYPE_CHECKING:
    from kffa_offboard.config import DaemonConfig

USAGE_ERROR = 2

app = typer.Typer(
    name="kffa-offboard",
    cls=OneLineGroup,
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
    except SystemExit as ended:
        if ended.__context__ is not None and isinstance(ended.__context__.__cause__, KeyboardInterrupt):
            print("stopped", file=sys.stderr)  # typer only makes a status of it
        raise
    except UserError as error:
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        sys.exit(USAGE_ERROR)
    except OSError as error:
        if error.errno not in (errno.ENAMETOOLONG, errno.ELOOP):
            raise
        print(f"error: {error.filename}: {error.strerror}; name another file", file=sys.stderr)
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
        "    kffa-offboard run --config north.toml --config south.toml    (two vehicles)\n\n"
        "    kffa-offboard run --config px4-udp.toml --plot udpout:127.0.0.1:9870    (PlotJuggler)\n\n"
        "Exit status: 0 scenario done or released, 1 failsafe or failure, 2 wrong usage or no vehicle, "
        "130 stopped by Ctrl-C, SIGTERM or SIGHUP."
    )
)
def run(
    config: Annotated[
        list[Path],
        typer.Option(
            help="Configuration (TOML); those in configs/ are examples. Several, each after a --config of "
            "its own, fly as many vehicles."
        ),
    ],
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
    realtime: Annotated[
        bool,
        typer.Option(
            "--realtime",
            help="Run with real-time scheduling, locked memory and on one core ([realtime] in the file).",
        ),
    ] = False,
    reengage: Annotated[
        bool,
        typer.Option("--reengage", help="With --engage: also after a restart in flight, by whatever cause."),
    ] = False,
    plot: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="Send the inner signals of every control step there as JSON, for PlotJuggler's UDP server: "
            "udpout:127.0.0.1:9870.",
        ),
    ] = None,
    json: Annotated[
        bool, typer.Option("--json", help="Print a summary as one JSON object at the end.")
    ] = False,
) -> None:
    """Fly: take telemetry, run the controller, stream setpoints.

    Without --engage the daemon observes until it is asked to engage; without --arm it waits for a person to
    arm. The pilot wins at once: any mode change or disarming that it did not ask for ends its sending.
    Ctrl-C gives control back, closes the log and ends.
    """
    from kffa_offboard.lean_imports import load_kalman_filter_alone

    load_kalman_filter_alone()  # before whatever imports the control law
    from kffa_offboard.cli_run import run as fly
    from kffa_offboard.cli_vehicle import RunOptions
    from kffa_offboard.config import Overrides
    from kffa_offboard.config_fleet import load_fleet

    if shadow and (arm or engage):
        raise UserError("--shadow only observes; leave out --arm and --engage, or --shadow")
    if fix_params and (shadow or trust_params):
        other = "--shadow" if shadow else "--trust-params"
        raise UserError(
            f"--fix-params changes the vehicle's parameters, {other} does not; leave out one of them"
        )
    if reengage and not engage:
        raise UserError(
            "--reengage is what --engage does after a restart in flight; give both, or leave it out"
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
    if realtime and lockstep:
        raise UserError("--realtime is for flying by the clock, --lockstep is not; leave out one of them")
    options = RunOptions(lockstep, log, json, realtime, reengage, plot)
    if len(config) > 1 and (lockstep or log is not None or link is not None):
        raise UserError("--lockstep, --log and --link are for one vehicle; put them into the configurations")
    status = fly(load_fleet(config, overrides), options)
    raise typer.Exit(status)


@app.command(
    epilog="Example: `kffa-offboard check my-vehicle.toml`. Exit status: 0 all right, 2 something is wrong."
)
def check(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="Configurations to check.")],
) -> None:
    """Check configurations without opening a link or flying; every problem is a line of its own.

    What this computer lacks for a flight (the signing key) is a warning: it may be another's configuration.
    """
    from kffa_offboard.cli_vehicle import key_problem, slow_line
    from kffa_offboard.config import ConfigError, load

    problems: list[str] = []
    for file in files:
        try:
            config = load(file)
            typer.echo(f"{file}: ok: {_summary(config)}")
            for doubt in (slow_line(config), key_problem(config)):
                if doubt is not None:
                    typer.echo(f"{file}: warning: {doubt}")
        except ConfigError as error:
            problems += str(error).splitlines()
    if problems:
        raise UserError("\n".join(problems))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard key vehicle.key\n\n"
        "    kffa-offboard key vehicle.key --passphrase    (asks for the ground station's words)\n\n"
        'Then `[signing] key_file = "vehicle.key"` in the configuration. Exit status: 0 made, 2 not.'
    )
)
def key(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The new file; it must not exist.")],
    passphrase: Annotated[
        bool,
        typer.Option(
            "--passphrase",
            help="Ask for a passphrase; MAVProxy and QGroundControl make the same key of it.",
        ),
    ] = False,
) -> None:
    """Make a key for MAVLink 2 signing, in a file that only you can read; it is not shown."""
    from kffa_offboard.mavlink.signing_key import key_of_passphrase, write_new_key

    words = _asked_for_words() if passphrase else None
    write_new_key(file, None if words is None else key_of_passphrase(words))
    typer.echo(f"{file}: made, for you alone; give the vehicle and its ground stations the same key")


def _asked_for_words() -> str:
    """The passphrase, typed twice. Raises UserError if nobody is there to type it."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # getpass, of a terminal that is not there, beside its own words
            return str(typer.prompt("Passphrase", hide_input=True, confirmation_prompt=True))
    except typer.Abort as end:
        if isinstance(end.__context__, EOFError):
            raise UserError("--passphrase: nobody answered; run this at a terminal") from end
        raise


def _summary(config: DaemonConfig) -> str:
    """One line that tells a person what a configuration flies."""
    service = config.service
    flown = [type(segment).__name__.lower() for segment in service.scenario] or ["hold until released"]
    return (
        f"{service.controller.name}, output {service.output}, link {config.link.url}, "
        f"scenario {', '.join(flown)}, failsafe {service.failsafe_action}"
    )


app.add_typer(cli_flights.app)
app.add_typer(cli_logs.app)
