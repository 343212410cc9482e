"""The position ring's experiment: what is flown, how it is measured, and that the command tells of it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kffa_offboard import cli
from kffa_offboard.experiments import command, position_flights, settings

GOLDEN = Path(__file__).parents[1] / "golden" / "paper-results.json"


@pytest.fixture(scope="module")
def ring() -> dict[str, Any]:
    """The kept results of one seed, which test_paper_golden compares with a flight."""
    kept: dict[str, Any] = json.loads(GOLDEN.read_text(encoding="utf-8"))["position"]["controllers"][
        "kffa-ladrc"
    ]
    return kept


def short() -> settings.PaperSettings:
    """Everything too short to mean anything."""
    told = settings.load()
    times = {"lead_s": 0.3, "hover_s": 0.3, "step_s": 0.4, "side_s": 0.3}
    return told.model_copy(update={"position": told.position.model_copy(update=times)})


def test_the_hover_stays_within_its_target(ring: dict[str, Any]) -> None:
    assert ring["hover"]["rms_m"]["worst"] <= 0.15


def test_a_drop_hardly_moves_the_vehicle(ring: dict[str, Any]) -> None:
    assert ring["hover"]["drop_m"]["worst"] <= 0.30
    assert ring["hover"]["drop_height_m"]["worst"] <= 0.08
    assert ring["square"]["off_the_line_m"]["worst"] <= 0.30


def test_a_step_overshoots_by_five_percent_at_most_empty_or_loaded(ring: dict[str, Any]) -> None:
    for flight in ("step", "loaded-step"):
        assert ring[flight]["overshoot_percent"]["worst"] <= 5.0
        assert ring[flight]["settling_2_percent_s"]["worst"] < 4.0


def test_the_square_ends_where_it_began_and_drops_its_load_on_the_second_side() -> None:
    square = position_flights.planned(settings.load().position)[-1]
    np.testing.assert_allclose(square.target[-1], [0.0, 0.0], atol=1e-9)
    assert square.target.max() == pytest.approx(5.0)
    assert square.target.min() == pytest.approx(-5.0)
    last = np.flatnonzero(square.load_mass)[-1]
    assert square.target[last] == pytest.approx([5.0, -2.5], abs=1.5)


def test_wind_and_noise_are_the_seeds_own_whatever_else_is_flown() -> None:
    told = short()
    one = position_flights.fly_position(told, 1, ("ladrc",))
    two = position_flights.fly_position(told, 2, ("ladrc",))
    key = "ladrc", "step", 0
    np.testing.assert_allclose(one[key].place, two[key].place, rtol=0, atol=1e-9)
    assert np.abs(two[key].place - two["ladrc", "step", 1].place).max() > 1e-6


def test_the_command_writes_figures_series_and_claims(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "load", short)
    monkeypatch.setattr(command, "CONTROLLERS", ("cascaded-pid", "kffa-ladrc"))
    with pytest.raises(SystemExit) as ended:
        cli.main(["paper", "--example", "position", "--seeds", "1", "--out", str(tmp_path), "--json"])
    assert not ended.value.code
    printed = json.loads(capsys.readouterr().out)
    assert printed["position"]["seeds"] == 1
    assert {claim["example"] for claim in printed["claims"]} == {"position"}
    assert len(printed["claims"]) == 5
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == len(list((tmp_path / "figures").glob("*.png"))) == 3
    assert {path.name for path in (tmp_path / "csv").iterdir()} == {
        f"position-{flight}.csv" for flight in position_flights.FLIGHTS
    }
