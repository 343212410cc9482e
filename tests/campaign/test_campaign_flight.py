"""Flights of a campaign: the same alone and among others, and measured as their traces say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from kffa_offboard.campaign import flight, measure
from kffa_offboard.campaign.conditions import Conditions, Surroundings, draw
from kffa_offboard.campaign.flight import fly
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.campaign.single import as_report_flight, fly_alone

WIDTH = 24
Shortened = Callable[..., Campaign]


def same(ours: object, theirs: object, rows: object) -> None:
    for name, values in vars(ours).items():
        np.testing.assert_array_equal(values, getattr(theirs, name)[rows], err_msg=name)


def test_a_flight_is_the_same_to_the_last_bit_alone_and_among_others(campaign: Campaign) -> None:
    numbers = np.arange(WIDTH)
    conditions, outcomes = fly(campaign, "kffa-ladrc", numbers, WIDTH)
    shuffled = np.random.default_rng(0).permutation(numbers)
    others = fly(campaign, "kffa-ladrc", shuffled, WIDTH)
    same(others[0], conditions, shuffled)
    same(others[1], outcomes, shuffled)
    alone = fly_alone(campaign, "kffa-ladrc", 17, WIDTH)
    same(alone.conditions, conditions, [17])
    same(alone.outcomes, outcomes, [17])


def test_conditions_stay_within_their_ranges_and_fill_them(campaign: Campaign) -> None:
    drawn, ranges = draw(campaign.file, np.arange(400)), campaign.file.random
    for name, (lower, upper) in ranges.model_dump().items():
        values = {
            "load_offset_m": np.hypot(drawn.offset_x_m, drawn.offset_y_m),
            "wind_m_s": np.hypot(drawn.wind_x_m_s, drawn.wind_y_m_s),
        }.get(name, getattr(drawn, name, None))
        assert lower - 1e-12 <= values.min() < lower + 0.1 * (upper - lower), name
        assert upper - 0.1 * (upper - lower) < values.max() <= upper + 1e-12, name


def test_noise_and_gusts_have_the_chosen_spread_and_are_the_flights_own(campaign: Campaign) -> None:
    numbers = np.arange(100)
    still = Conditions(**{name: np.zeros(100) for name in vars(draw(campaign.file, numbers))})
    told = replace(still, noise_factor=np.full(100, 2.0), gust_std_m_s=np.full(100, 1.5))
    surroundings = Surroundings(campaign.file, told, numbers, 0.01)
    noise, wind = zip(*(tuple(map(np.copy, surroundings.step())) for _ in range(2000)), strict=True)
    assert np.std(noise, axis=(0, 2)) == pytest.approx(
        2.0 * np.repeat([0.002, 0.01, 0.01, 0.02], [3, 3, 1, 1]), rel=0.03
    )
    assert np.std(np.array(wind)[600:]) == pytest.approx(1.5, rel=0.1)
    for n in (7, 99):
        one = Conditions(**{name: values[n : n + 1] for name, values in vars(told).items()})
        alone = Surroundings(campaign.file, one, numbers[n : n + 1], 0.01)
        for k in range(100):
            np.testing.assert_array_equal(alone.step()[0][:, 0], noise[k][:, n])


def test_the_running_sums_are_those_of_the_trace(campaign: Campaign) -> None:
    early = int(np.argmin(draw(campaign.file, np.arange(20)).drop_after_s))
    flown = fly_alone(campaign, "kffa-ladrc", early, WIDTH)
    assert flown.conditions.drop_after_s[0] < 0.5  # before the time after the pick-up is over
    error = np.abs(flown.rigid[:, 2] - campaign.file.flight.altitude_m)
    pickup, drop = flown.time_s >= 0.5 - 1e-9, flown.time_s >= 0.5 + flown.conditions.drop_after_s[0]
    before = (flown.time_s < 1.1 - 1e-9) & ~drop
    after = flown.time_s < 0.5 + flown.conditions.drop_after_s[0] + 0.6
    out, told = flown.outcomes, campaign.control_s
    assert out.pickup_peak_m[0] == error[pickup & before].max()
    assert out.pickup_iae_m_s[0] == pytest.approx(error[pickup & before].sum() * told)
    assert out.drop_peak_m[0] == error[drop & after].max()
    assert out.hover_rms_m[0] == pytest.approx(np.sqrt(np.mean(error[~pickup] ** 2)))
    cosine = np.cos(flown.rigid[:, 6]) * np.cos(flown.rigid[:, 7])
    assert out.tilt_max_rad[0] == pytest.approx(np.arccos(cosine.min()))
    assert flown.load_kg[pickup & ~drop] == pytest.approx(flown.conditions.load_kg[0])
    assert not flown.load_kg[~pickup].any()


@pytest.fixture
def calm(shortened: Shortened) -> Shortened:
    """No wind, no noise, everything as the daemon's configuration assumes it; called with changes."""
    random = {
        "load_kg": [5.0, 5.0], "load_offset_m": [0.0, 0.0], "wind_m_s": [0.0, 0.0],
        "gust_std_m_s": [0.0, 0.0], "noise_factor": [0.0, 0.0], "link_delay_s": [0.02, 0.02],
        "hover_thrust_error": [0.0, 0.0], "motor_lag_s": [0.05, 0.05],
    }  # fmt: skip

    def made(**changes: object) -> Campaign:
        return shortened({"random": {**random, **changes}, "failed": {"recovery_max_s": 1.5}}, "kffa-ladrc")

    return made


def test_in_calm_conditions_five_kilograms_move_it_by_what_the_demonstration_says(calm: Shortened) -> None:
    _, out = fly(calm(), "kffa-ladrc", np.arange(1), 1)
    assert 0.04 < out.pickup_peak_m[0] < 0.08
    assert out.failure[0] == 0
    assert np.isnan(out.failed_at_s[0])
    assert out.hover_rms_m[0] < 1e-9


def test_a_weaker_battery_and_a_load_off_centre_are_felt(calm: Shortened) -> None:
    _, out = fly(calm(load_offset_m=[0.05, 0.05]), "kffa-ladrc", np.arange(1), 1)
    assert np.degrees(out.tilt_max_rad[0]) > 1.0
    flown = fly_alone(calm(hover_thrust_error=[0.1, 0.1]), "kffa-ladrc", 0, 1)
    assert flown.blocks["command"][20:45, 3].mean() == pytest.approx(0.398 * 1.1, rel=0.01)


def test_a_slow_link_makes_flights_fail(calm: Shortened) -> None:
    slow = calm(link_delay_s=[0.15, 0.15], noise_factor=[1.0, 1.0], load_offset_m=[0.05, 0.05])
    _, out = fly(slow, "kffa-ladrc", np.arange(4), 4)
    assert (out.failure > 0).all()
    assert (out.failed_at_s > 0.0).all()


@pytest.mark.parametrize(
    ("height", "cosine", "reason"),
    [
        (7.1, 1.0, "altitude"),
        (5.0, 0.7, "tilt"),
        (-0.01, 1.0, "ground"),
        (5.5, 1.0, "not recovered"),
        (np.nan, 1.0, "altitude"),
        (5.0, np.nan, "tilt"),
    ],
)
def test_each_reason_to_fail(campaign: Campaign, height: float, cosine: float, reason: str) -> None:
    failed = campaign.file.failed.model_copy(
        update={"altitude_error_max_m": 10.0 if reason == "ground" else 2.0}
    )
    seen = measure.Observation(failed, 0.5, np.array([1.0, 1.0]), 0.01)
    for k in range(160):
        bad = k >= 20
        heights = np.array([5.0, height if bad else 5.0])
        seen.see(
            k * 0.01, heights, heights - 5.0, np.array([1.0, cosine if bad else 1.0]), np.zeros(2, dtype=bool)
        )
    out = seen.outcomes()
    assert [measure.FAILURES[number] for number in out.failure] == ["", reason]
    assert out.failed_at_s[1] == pytest.approx(0.2 if reason != "not recovered" else 1.0)
    assert out.pickup_peak_m[0] == 0.0


def test_a_flight_that_is_no_number_any_more_has_failed_and_leaves_its_figures_finite(
    campaign: Campaign,
) -> None:
    batch = flight.Batch(campaign, "kffa-ladrc", np.arange(3))
    for k in range(campaign.steps):
        if k == 60:
            batch._rigid[:, 1] = np.nan
        batch.step(k * campaign.control_s)
    out = batch.observation.outcomes()
    assert [measure.FAILURES[number] for number in out.failure] == ["", "tilt", ""]
    assert np.isfinite([out.pickup_peak_m, out.drop_peak_m, out.tilt_max_rad, out.hover_rms_m]).all()


def test_a_flight_that_failed_before_the_pick_up_shows_none(shortened: Shortened) -> None:
    hopeless = shortened({"failed": {"altitude_error_max_m": 1e-6}}, "kffa-ladrc")
    flown = fly_alone(hopeless, "kffa-ladrc", 0, 1)
    assert flown.failure == "altitude"
    assert not as_report_flight(hopeless, flown).events


def test_what_is_sent_arrives_after_the_delay_of_each_flight() -> None:
    line = flight._DelayLine(np.zeros((2, 3)), np.array([0.0, 0.01, 0.02]), 2)
    for k in range(1, 9):
        line.push(np.full((2, 3), float(k)))
    np.testing.assert_array_equal(line.read(), [[8.0, 6.0, 4.0]] * 2)
    np.testing.assert_array_equal(line.read(slice(1, 2), 2), [[6.0, 4.0, 2.0]])


def test_the_midpoint_rule_is_exact_enough(campaign: Campaign, monkeypatch: pytest.MonkeyPatch) -> None:
    _, ours = fly(campaign, "kffa-ladrc", np.arange(WIDTH), WIDTH)
    step = flight.airframe.step
    monkeypatch.setattr(flight.airframe, "step", lambda *told: step(*told[:-1], "runge-kutta"))
    _, finer = fly(campaign, "kffa-ladrc", np.arange(WIDTH), WIDTH)
    np.testing.assert_allclose(ours.drop_peak_m, finer.drop_peak_m, rtol=0, atol=1e-5)
    np.testing.assert_allclose(ours.tilt_max_rad, finer.tilt_max_rad, rtol=0, atol=1e-4)
    assert (ours.drop_peak_m != finer.drop_peak_m).any()
