"""What the page and the terminal's table say of a comparison."""

from __future__ import annotations

from dataclasses import replace
from io import StringIO
from pathlib import Path

import pytest
from rich.console import Console

from kffa_offboard.compare.measure import LoadFigures, PlaceFigures
from kffa_offboard.compare.plan import ComparePlan, Conditions, Join, trials
from kffa_offboard.compare.report import report
from kffa_offboard.compare.results import Result
from kffa_offboard.compare.table import tables
from kffa_offboard.trials.metrics import Deviation

PLAN = ComparePlan(directory=Path("out"), only=("native-stock", "kffa-ladrc"))
BOTH = Deviation(0.768, 2.092)
LOAD = LoadFigures(5.0, BOTH, BOTH, None, 0.49, 0.0017, 0.04, 0.1, 60.0, 70.0)


def page_of(plan: ComparePlan) -> str:
    return report(plan, [Result(trial, load=LOAD) for trial in trials(plan)], [], [])


@pytest.mark.parametrize("width", [80, 110, 200])
def test_the_table_in_a_terminal_keeps_units_and_every_digit(width: int) -> None:
    results = [Result(trial, load=LOAD) for trial in trials(PLAN)]
    out = StringIO()
    for table in tables(PLAN, results, []):
        Console(file=out, width=width).print(table)
    said = out.getvalue()
    assert "…" not in said
    assert all(unit in said for unit in ("[m]", "[m s]", "[s]", "[deg]"))
    assert (said.count("0.768"), said.count("0.0017"), said.count("KFFA-LADRC")) == (4, 2, 2)


def test_the_page_names_the_imitation_and_calls_only_real_firmware_unmodified() -> None:
    assert "<p>Flown by the bundled imitation of PX4, with" in page_of(PLAN)
    assert "Flown by PX4, unmodified, with" in page_of(replace(PLAN, firmware=Path("px4")))


def test_the_command_on_the_page_repeats_every_option_that_changes_figures() -> None:
    conditions = Conditions(load_kg=3.0, offset_m=0.05, rate_hz=50.0, delay_s=0.06, seed=4)
    own = replace(PLAN, conditions=conditions, full=True, config=Path("my gains.toml"))
    assert (
        "<pre>kffa-offboard compare --autopilot px4 --config &#x27;my gains.toml&#x27; --load 3 "
        "--offset 0.05 --rate 50 --delay 0.06 --seed 4 --full --only native-stock --only kffa-ladrc "
        "--out compare-out</pre>"
    ) in page_of(own)
    join = Join("udpin:127.0.0.1:14550", truth=Path("truth.csv"), lockstep=True)
    joined = page_of(replace(PLAN, join=join))
    assert "--join udpin:127.0.0.1:14550 --truth truth.csv --load 5 --lockstep" in joined
    assert "wait for each other (lock-step)" in joined
    assert "kept its own time" in page_of(replace(PLAN, join=replace(join, lockstep=False)))


def test_how_the_place_was_held_in_wind_is_in_table_and_page() -> None:
    plan = replace(PLAN, full=True, only=("kffa-ladrc", "kffa-ladrc-wind"))
    place = PlaceFigures(0.036, 0.074, 0.075)
    results = [
        Result(trial, load=LOAD, place=place if trial.conditions.wind else None) for trial in trials(plan)
    ]
    (table,) = [table for table in tables(plan, results, []) if "Horizontal" in str(table.title)]
    assert table.row_count == 1
    out = StringIO()
    Console(file=out, width=80).print(table)
    page = report(plan, results, [], [])
    assert all(figure in out.getvalue() and figure in page for figure in ("0.036", "0.074", "0.075"))
    assert "blows with 5 m/s and gusts of 1.5 m/s" in page
    assert "Place in a gusty wind" not in page_of(PLAN)


def test_wide_tables_scroll_by_themselves_on_a_narrow_screen() -> None:
    assert "<div class=wide><table><tr><th></th><th class=number>pick-up peak [m]" in page_of(PLAN)
