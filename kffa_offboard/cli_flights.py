"""Commands that fly simulated vehicles or real firmware: demo, compare, paper, campaign, selftest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from kffa_offboard.cli_choices import Controller, OutputName
from kffa_offboard.errors import UserError

PersonalityName = Literal["px4", "ardupilot"]
ExampleName = Literal["1", "2", "3", "4", "position"]
EngineName = Literal["local", "dask"]


app = typer.Typer()


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
        "    kffa-offboard compare --autopilot ardupilot --join udpin:127.0.0.1:14550    (it runs)\n\n"
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
    join: Annotated[
        str | None,
        typer.Option(
            metavar="URL",
            help="Fly on a firmware that is already running and sends MAVLink there: udpin:HOST:PORT or "
            "udpout:HOST:PORT. Its physics is started here, unless --truth is given.",
        ),
    ] = None,
    physics_port: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=65535,
            help="With --join: where it looks for its physics; 9002 (ArduPilot) or 4560 (PX4).",
        ),
    ] = None,
    truth: Annotated[
        Path | None,
        typer.Option(
            help="With --join: its physics is running, too, and writes true states to this CSV file."
        ),
    ] = None,
    lockstep: Annotated[
        bool, typer.Option("--lockstep", help="With --truth: that physics waits for the controller.")
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option(help="The daemon's configuration instead of ours; link and scenario are filled in."),
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
        bool,
        typer.Option(
            "--full",
            help="Other loads, a load off centre, 50 Hz, a slow link and gusty wind, too; with a real PX4 "
            "height from other sensors.",
        ),
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

    Starts firmware and physics for each flight (or joins what runs: --join), measures from true states, and
    writes a table, figures and report.html. All of it waits for each other (lock-step), so that a slow
    computer changes nothing but the time it takes: about a minute for each of ten flights with real firmware.
    """
    from kffa_offboard.compare.command import run_compare
    from kffa_offboard.compare.plan import ComparePlan, Conditions, Join

    if join is None and (physics_port is not None or truth is not None or lockstep):
        raise UserError(
            "--physics-port, --truth and --lockstep go with --join URL; give it, or leave them out"
        )
    conditions = Conditions(load_kg=load, offset_m=offset, rate_hz=rate, delay_s=delay, seed=seed)
    plan = ComparePlan(
        directory=out,
        autopilot=autopilot,
        firmware=firmware,
        conditions=conditions,
        full=full,
        only=tuple(only or ()),
        json=json,
        join=None if join is None else Join(join, physics_port, truth, lockstep),
        config=config,
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
        "    kffa-offboard campaign\n\n"
        "    kffa-offboard campaign my-campaign.toml --compare pid,ladrc,kffa-ladrc\n\n"
        "    kffa-offboard campaign my-campaign.toml --flight 8123    (that one alone, with a report)\n\n"
        "    kffa-offboard campaign --engine dask --scheduler tcp://10.0.0.1:8786\n\n"
        "Exit status: 0 flown, however many failed, 2 wrong usage, 130 stopped."
    )
)
def campaign(
    file: Annotated[
        Path | None,
        typer.Argument(metavar="[FILE]", help="Campaign (TOML); configs/campaign.toml without it."),
    ] = None,
    out: Annotated[
        Path, typer.Option(help="Where flights, summary and report go; it is gone on there.")
    ] = Path("campaign-out"),
    flights: Annotated[
        int | None, typer.Option(min=1, max=10_000_000, help="How many, instead of the file's number.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the file's.")] = None,
    compare: Annotated[
        str | None,
        typer.Option(
            metavar="A,B,...", help="Controllers that fly the same flights, instead of the one configured."
        ),
    ] = None,
    flight: Annotated[
        int | None,
        typer.Option(min=0, max=10_000_000, help="Fly the flight of this number alone, with a report."),
    ] = None,
    engine: Annotated[EngineName, typer.Option(help="This machine's cores, or a Dask cluster.")] = "local",
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Of the Dask cluster: tcp://HOST:PORT.")
    ] = None,
    jobs: Annotated[
        int, typer.Option(min=-1, help="Processes on this machine; -1 is one for each core.")
    ] = -1,
    json: Annotated[
        bool, typer.Option("--json", help="Print the summary as one JSON object, no tables.")
    ] = False,
) -> None:
    """Fly thousands of pick-ups and drops under random conditions; say how many fail, and how the rest do.

    Load, its offset, moment of the drop, wind, noise, link delay, hover-thrust error and motor lag are drawn
    for each flight from its number. Writes every flight as Parquet, summary.json and report.html. A campaign
    that is stopped goes on where it was when the command is given again. Needs the extra:
    pip install "kffa-offboard[campaign]".
    """
    from kffa_offboard.campaign.command import CampaignPlan, run_campaign

    plan = CampaignPlan(
        file=file,
        directory=out,
        flights=flights,
        seed=seed,
        compare=compare,
        flight=flight,
        engine=engine,
        scheduler=scheduler,
        jobs=jobs,
        json=json,
    )
    raise typer.Exit(run_campaign(plan))


@app.command(
    epilog=(
        "Examples:\n\n"
        "    kffa-offboard selftest\n\n"
        "    kffa-offboard selftest --json --out selftest-out\n\n"
        "Exit status: 0 all passed, 1 something failed, 2 wrong usage, 130 stopped."
    )
)
def selftest(
    out: Annotated[Path, typer.Option(help="Where selftest.json, logs and true states go.")] = Path(
        "selftest-out"
    ),
    json: Annotated[
        bool, typer.Option("--json", help="Print the results as one JSON object, no table.")
    ] = False,
) -> None:
    """See before flying that this installation does what it should, on this machine.

    Checks the control law against known answers, flies pick-up and drop on the bundled vehicle as PX4 and as
    ArduCopter, injects faults and looks for the reactions of docs/safety.md, feeds the guard with bad
    commands, replays what was just recorded, and measures whether this machine keeps up with 100 and 250 Hz.
    A minute or two.
    """
    from kffa_offboard.selftest.command import SelftestPlan, run_selftest

    raise typer.Exit(run_selftest(SelftestPlan(directory=out, json=json)))
