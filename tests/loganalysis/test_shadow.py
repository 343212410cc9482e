"""Estimators and link judgement over recorded flights."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from kffa_offboard.errors import UserError
from kffa_offboard.loganalysis.link_quality import StreamQuality, response_delay, stream_quality, verdict
from kffa_offboard.loganalysis.mass import track_mass
from kffa_offboard.loganalysis.record import FlightRecord, Series
from kffa_offboard.loganalysis.shadow import shadow
from kffa_offboard.loganalysis.shadow_command import run_shadow
from kffa_offboard.loganalysis.shadow_figure import draw

HOVER = 0.4
PICKUP_S, DROP_S = 8.0, 14.0


def hover_with_load(share: float, rate_hz: float = 50.0) -> FlightRecord:
    """A hover at 5 m whose thrust rises with the load at once; the climb rate is all noise."""
    random = np.random.default_rng(0)
    time_s = np.arange(0.0, 20.0, 1.0 / rate_hz)
    loaded = (time_s >= PICKUP_S) & (time_s < DROP_S)
    thrust = HOVER * np.where(loaded, 1.0 + share, 1.0)
    zero = np.zeros((len(time_s), 3))
    height = np.concatenate([zero[:, :2], np.full((len(time_s), 1), 5.0)], axis=1)
    climb = np.concatenate([zero[:, :2], 0.02 * random.standard_normal((len(time_s), 1))], axis=1)
    return FlightRecord(
        path=Path("hover"),
        source="ulog",
        attitude=Series(time_s, zero),
        body_rates=Series(time_s, zero),
        position=Series(time_s, height + 0.005 * random.standard_normal(height.shape)),
        velocity=Series(time_s, climb),
        rates_setpoint=Series(time_s, zero),
        thrust=Series(time_s, thrust[:, None]),
        landed=Series(np.zeros(1), np.zeros((1, 1))),
    )


@pytest.mark.parametrize("share", [0.5, 0.15])
def test_a_load_is_told_with_its_time_and_mass(share: float) -> None:
    track = track_mass(hover_with_load(share), HOVER, 0.0)
    assert track is not None
    pickup, drop = track.changes
    assert pickup.time_s == pytest.approx(PICKUP_S, abs=0.15)
    assert drop.time_s == pytest.approx(DROP_S, abs=0.15)
    assert pickup.share == pytest.approx(share, rel=0.1)
    assert drop.share == pytest.approx(-share, rel=0.1)


def test_a_hover_without_load_tells_of_none() -> None:
    track = track_mass(hover_with_load(0.0), HOVER, 0.0)
    assert track is not None
    assert track.changes == ()
    assert np.nanmax(np.abs(track.mass_ratio - 1.0)) < 0.05


def in_gusts(record: FlightRecord, std_m_s2: float) -> FlightRecord:
    """The same height held against gusts that push for about 1 s."""
    random, dt = np.random.default_rng(3), record.thrust.time_s[1] - record.thrust.time_s[0]
    push, pushes = 0.0, []
    for kick in random.standard_normal(len(record.thrust)):
        push += dt * -push / 1.0 + std_m_s2 * (2.0 * dt) ** 0.5 * kick
        pushes.append(push)
    thrust = record.thrust.values * (1.0 - np.array(pushes)[:, None] / 9.80665)
    return replace(record, thrust=Series(record.thrust.time_s, thrust))


def test_strong_gusts_are_no_loads_and_widen_the_spread_of_the_mass() -> None:
    track = track_mass(in_gusts(hover_with_load(0.5), 0.35), HOVER, 0.0)
    assert track is not None
    pickup, drop = track.changes
    assert pickup.share == pytest.approx(0.5, abs=0.12)
    assert drop.share == pytest.approx(-0.5, abs=0.12)
    truth = np.where((track.time_s >= PICKUP_S) & (track.time_s < DROP_S), 1.5, 1.0)
    near = np.minimum(np.abs(track.time_s - PICKUP_S), np.abs(track.time_s - DROP_S)) < 0.8
    rest = np.isfinite(track.mass_ratio) & ~near
    within = np.abs(track.mass_ratio - truth)[rest] < 2.0 * track.std[rest]
    assert np.mean(within) > 0.85


def test_the_model_comes_from_the_first_steady_hover_and_the_disturbance_is_gravity() -> None:
    found = shadow(hover_with_load(0.0), None)
    assert found.model.hover_thrust == pytest.approx(HOVER, rel=1e-3)
    settled = found.estimates.disturbance[found.estimates.time_s > 5.0, 3]
    assert np.mean(settled) == pytest.approx(-9.80665, rel=0.02)


def test_a_log_without_a_hover_asks_for_a_configuration() -> None:
    record = hover_with_load(0.0)
    climbing = replace(record.velocity, values=record.velocity.values + 3.0)
    with pytest.raises(UserError, match="--config"):
        shadow(replace(record, velocity=climbing), None)


def steady(rate_hz: float, gap_s: float = 0.0) -> StreamQuality:
    time_s = np.arange(0.0, 10.0, 1.0 / rate_hz)
    time_s[len(time_s) // 2 :] += gap_s
    quality = stream_quality(Series(time_s, np.zeros((len(time_s), 3)), time_s + 0.02))
    assert quality is not None
    return quality


def test_rate_gaps_and_jitter_are_measured() -> None:
    quality = steady(50.0, gap_s=0.5)
    assert quality.gaps == 1
    assert quality.longest_gap_s == pytest.approx(0.52)
    assert quality.period_s == pytest.approx(0.02)
    assert quality.jitter_s == pytest.approx(0.0, abs=1e-9)


def test_a_quick_link_is_good_a_slow_one_and_one_with_gaps_are_not() -> None:
    good = verdict(steady(100.0), steady(100.0), 0.05, 0.0)
    slow = verdict(steady(4.0), steady(4.0), 0.3, 0.0)
    broken = verdict(steady(100.0), steady(100.0, gap_s=1.0), 0.05, 0.0)
    assert good.good_enough
    assert 1.0 < good.omega_c < good.omega_o
    assert not slow.good_enough
    assert slow.omega_c < good.omega_c
    assert not broken.good_enough
    assert "gap" in broken.reasons[0]


def test_the_delay_of_an_answer_shows_in_the_cross_correlation() -> None:
    time_s = np.arange(0.0, 20.0, 0.01)
    command = np.sign(np.sin(3.0 * time_s))
    late = Series(time_s + 0.12, command[:, None])
    delay = response_delay(Series(time_s, command[:, None]), late, 0, 0)
    assert delay == pytest.approx(0.12, abs=0.011)


def test_json_and_files_of_the_command(
    log_files: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = Path(__file__).parents[2] / "configs" / "demo-px4.toml"
    assert run_shadow(log_files["ulog"], config, 10.0, True, tmp_path / "out") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["kind"] == "ulog"
    assert told["telemetry"]["attitude"]["rate_hz"] == pytest.approx(50.0)
    assert (tmp_path / "out" / "shadow.csv").read_text().startswith("time_s,measured_roll")
    assert (tmp_path / "out" / "shadow.png").stat().st_size > 5_000


def test_the_picture_has_the_times_that_are_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    monkeypatch.setattr("kffa_offboard.loganalysis.shadow_figure.plt.close", drawn.append)
    flight = hover_with_load(0.5)
    since_power_up = {
        name: Series(series.time_s + 300.0, series.values)
        for name, series in vars(flight).items()
        if isinstance(series, Series)
    }
    found = shadow(replace(flight, **since_power_up), None)
    assert found.mass is not None
    draw(tmp_path / "shadow.png", found, None)
    altitude, _, mass = drawn[0].axes
    strokes = [line.get_xdata()[0] for line in mass.lines[1:]]  # type: ignore[index]
    assert strokes == [change.time_s for change in found.mass.changes]
    assert altitude.lines[0].get_xdata()[0] == found.estimates.time_s[0] >= 300.0  # type: ignore[index]
