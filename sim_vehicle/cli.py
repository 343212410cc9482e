"""The command `sim-vehicle`."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from importlib import metadata
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NoReturn, TextIO

import typer
from rich.console import Console

from sim_vehicle import config as configuration
from sim_vehicle.backends.base import Backend
from sim_vehicle.backends.choose import open_backend
from sim_vehicle.cli_usage import EXIT_BAD_INPUT, OneLineGroup
from sim_vehicle.config import SimConfig
from sim_vehicle.errors import SimulatorError
from sim_vehicle.truth import FIRST_LINE, TruthFile, TruthRecorder

LONGEST_S = 1e9
"""Most seconds of --duration; without it, the flight has no end."""

EXIT_INTERRUPTED = 130
EXIT_TERMINATED = 143

app = typer.Typer(
    cls=OneLineGroup,
    help="A simulated 10 kg quadrotor that picks up and drops loads, behind MAVLink, "
    "behaving as PX4 or as ArduCopter.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["--help", "-h"]},
)


class _Terminated(Exception):
    """SIGTERM came."""


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"sim-vehicle {metadata.version('kffa-offboard')}")
        raise typer.Exit


@app.callback()
def _commands(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Keep `run` a sub-command although it is the only one."""


@app.command(
    epilog=(
        "Examples:\n\n"
        "    sim-vehicle run --config configs/sim-px4.toml\n\n"
        "    sim-vehicle run --config configs/demo-px4-vehicle.toml --truth true.csv    (a load, too)\n\n"
        "    sim-vehicle run --link udpout:127.0.0.1:14540 --link tcpin:127.0.0.1:5760\n\n"
        "Exit status: 0 after --duration, 2 for bad input, 130 after Ctrl-C, 143 after SIGTERM."
    )
)
def run(
    config: Annotated[
        Path | None, typer.Option(help="TOML file; without it, PX4 on udpout:127.0.0.1:14540.")
    ] = None,
    link: Annotated[
        list[str] | None,
        typer.Option(
            help="udpin:HOST:PORT, udpout:HOST:PORT, tcpin:HOST:PORT or tcp:HOST:PORT, instead of the file's "
            "link.endpoints; may be repeated."
        ),
    ] = None,
    personality: Annotated[str | None, typer.Option(help="px4 or ardupilot, instead of the file's.")] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of all noise, instead of the file's.")] = None,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="Let simulated time wait for the controller.")
    ] = False,
    backend: Annotated[
        str | None,
        typer.Option(
            help="bundled (the simulator's own firmware), ardupilot-json or px4-hil (an unmodified "
            "ArduCopter or PX4 in software-in-the-loop), instead of the file's."
        ),
    ] = None,
    speedup: Annotated[
        float | None,
        typer.Option(help="With real firmware: simulated seconds per second; 0 for as fast as possible."),
    ] = None,
    truth: Annotated[
        Path | None, typer.Option(help="Write true states and events to this CSV file, every 10 ms.")
    ] = None,
    duration: Annotated[
        float | None, typer.Option(help="End after this many seconds of simulated time.")
    ] = None,
) -> None:
    """Fly the simulated vehicle until Ctrl-C.

    In real time, any ground station or controller can connect. With --lockstep, simulated time
    advances only when the controller has answered: deterministic, and as fast as the machine allows.
    With --backend ardupilot-json or px4-hil, it is the body that an ArduCopter or PX4 of yours flies;
    connect to that one.
    """
    try:
        overrides = _overrides(link, personality, seed, lockstep, backend, speedup)
        settings = (
            configuration.load(config, overrides) if config else configuration.build(overrides, "options")
        )
        _check_options(settings, link, personality, speedup)
        if duration is not None and not 0.0 < duration <= LONGEST_S:
            wrong = f"above {LONGEST_S:g}" if duration > LONGEST_S else "not above zero"
            raise SimulatorError(f"--duration {duration:g}: {wrong}; give seconds of simulated time")
        _fly(settings, truth, duration)
    except SimulatorError as problem:
        _give_up(str(problem))
    except KeyboardInterrupt:
        raise typer.Exit(EXIT_INTERRUPTED) from None
    except _Terminated:
        raise typer.Exit(EXIT_TERMINATED) from None


def _overrides(
    link: list[str] | None,
    personality: str | None,
    seed: int | None,
    lockstep: bool,
    backend: str | None,
    speedup: float | None,
) -> dict[str, dict[str, Any]]:
    """Options as sections of the configuration."""
    given: dict[str, dict[str, Any]] = {
        "link": {"endpoints": link or None},
        "vehicle": {"personality": personality, "seed": seed},
        "lockstep": {"enabled": lockstep or None},
        "backend": {"kind": backend, "real_time_factor": speedup},
    }
    chosen = {
        section: {key: value for key, value in keys.items() if value is not None}
        for section, keys in given.items()
    }
    return {section: keys for section, keys in chosen.items() if keys}


def _check_options(
    settings: SimConfig, link: list[str] | None, personality: str | None, speedup: float | None
) -> None:
    """Raise SimulatorError for an option that the chosen backend would not heed."""
    kind = settings.backend.kind
    if kind == "bundled":
        if speedup is not None:
            raise SimulatorError(
                "--speedup: the bundled firmware flies in real time; use --lockstep for speed"
            )
        return
    if (
        speedup is not None
        and kind == "ardupilot-json"
        and settings.backend.ardupilot_json.pace == "firmware"
    ):
        raise SimulatorError("--speedup: the file lets the firmware pace; give its own --speedup instead")
    for option, value in (("--link", link), ("--personality", personality)):
        if value:
            raise SimulatorError(
                f"{option}: the {kind} backend is only the vehicle's body; MAVLink is the firmware's own"
            )


def _fly(settings: SimConfig, truth: Path | None, duration: float | None) -> None:
    with (
        _terminate_as_exception(),
        open_backend(settings, _say) as backend,
        _truth_file(truth, backend.plant.truth) as record,
    ):
        print(backend.announcement, flush=True)
        with _status_line() as show:

            def progress() -> None:
                record()
                show(backend)

            backend.run(duration, progress)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


@contextlib.contextmanager
def _truth_file(path: Path | None, recorder: TruthRecorder) -> Iterator[Callable[[], None]]:
    """Yield what writes the truth so far; writes the rest at the end, however the flight ends.

    Without a file it is let go: the states of a day would fill the memory.
    """
    if path is None:
        yield recorder.rows.clear
        return
    _refuse_other_kinds(path)
    try:
        stream: TextIO = path.open("w", encoding="utf-8", newline="")
    except OSError as problem:
        raise _unwritable(path, problem) from problem
    record = TruthFile(stream, recorder)

    def write() -> None:
        try:
            record.flush()
        except OSError as problem:
            raise _unwritable(path, problem) from problem

    try:
        yield write
    finally:
        try:
            write()
        finally:
            with contextlib.suppress(OSError):  # what could not be written was said
                stream.close()


def _unwritable(path: Path, problem: OSError) -> SimulatorError:
    reason = problem.strerror or str(problem)
    return SimulatorError(f"--truth {path}: cannot be written: {reason}; choose another file")


def _refuse_other_kinds(path: Path) -> None:
    """Raise SimulatorError if writing the truth would destroy a file that is something else."""
    try:
        if not path.is_file() or path.stat().st_size == 0:
            return
        with path.open("rb") as file:
            before = file.read(len(FIRST_LINE))
    except OSError:
        return  # whoever opens it for writing says why
    if before != FIRST_LINE.encode():
        raise SimulatorError(
            f"--truth {path}: is there and holds no true states, it would be lost; choose another file"
        )


@contextlib.contextmanager
def _status_line() -> Iterator[Callable[[Backend], None]]:
    """Yield what shows where the vehicle is; shows nothing if nobody watches."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield lambda backend: None
        return
    began = time.monotonic()
    with console.status("starting", refresh_per_second=5.0) as status:

        def show(backend: Backend) -> None:
            plant = backend.plant
            x, y, z = plant.state.position.tolist()
            speed = plant.time_us * 1e-6 / max(1e-3, time.monotonic() - began)
            status.update(
                f"{plant.time_us * 1e-6:7.1f} s  x{speed:.1f}  {backend.autopilot}  "
                f"height {z:.2f} m  x {x:.2f} y {y:.2f} m  load {float(plant.state.load_mass):.2f} kg"
            )

        yield show


@contextlib.contextmanager
def _terminate_as_exception() -> Iterator[None]:
    """SIGTERM ends the flight as cleanly as Ctrl-C does."""

    def end(number: int, frame: FrameType | None) -> NoReturn:
        raise _Terminated

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _give_up(reason: str) -> NoReturn:
    print(f"error: {' '.join(reason.split())}", file=sys.stderr)
    raise typer.Exit(EXIT_BAD_INPUT)


def main() -> None:
    """Entry point."""
    app()
