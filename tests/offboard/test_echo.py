"""Whose setpoints the autopilot follows, by what it reports of their thrust."""

import numpy as np
import pytest

from kffa_offboard.offboard.echo import Echo, forget_reports, report, send


def judged(alter, other=None, late_us=40_000, seconds=6.0, echo=None):
    """Was somebody else noticed: setpoints at 100 Hz, reports at 20 Hz of what `alter` makes of them."""
    rng = np.random.default_rng(1)
    echo, noticed = echo or Echo(), False
    sent = []
    for time_us in range(0, round(seconds * 1e6), 10_000):
        sent.append(0.4 + 0.05 * rng.standard_normal())
        echo = send(echo, time_us, sent[-1])
        if time_us % 50_000 == 0 and time_us >= late_us:
            followed = sent[-1 - late_us // 10_000]
            if other is not None and rng.random() < other:
                followed = 0.4
            echo, now = report(echo, time_us, float(np.float32(alter(followed))))
            noticed = noticed or now
    return noticed


@pytest.mark.parametrize("late_us", [0, 40_000, 250_000, 500_000, 900_000])
def test_an_autopilot_that_repeats_our_thrust_raises_no_alarm_however_late(late_us):
    assert not judged(lambda thrust: thrust, late_us=late_us)


@pytest.mark.parametrize(
    "alter", [lambda thrust: 1.1 * thrust, lambda thrust: round(thrust, 2), lambda _: 0.0]
)
def test_an_autopilot_that_alters_thrust_raises_none_either(alter):
    assert not judged(alter)


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
@pytest.mark.parametrize("late_us", [40_000, 900_000])
def test_reports_that_are_ours_and_somebody_elses_by_turns_do(share, late_us):
    assert judged(lambda thrust: thrust, other=share, late_us=late_us)


def test_a_single_foreign_report_does_not():
    assert not judged(lambda thrust: thrust, other=0.02)


def test_the_first_reports_in_the_air_are_not_judged():
    assert not judged(lambda thrust: thrust, other=0.5, seconds=2.0)
    echo, _ = report(send(Echo(), 0, 0.4), 0, 0.4)
    assert forget_reports(echo) == send(Echo(), 0, 0.4)


def test_what_was_sent_more_than_a_second_ago_is_not_reported_any_more():
    """Else a vehicle that never follows us would be ours whenever its thrust comes by an old one."""
    echo, _ = report(Echo(), 0, 0.4)
    for number in range(1200):
        echo = send(echo, number * 10_000, 0.4 if number < 500 else 0.5)
    for number in range(10):
        echo, noticed = report(echo, 12_000_000 + number, 0.4 if number % 2 else 0.6)
    assert not noticed and echo.ours == (False,) * 10


def test_what_is_remembered_is_bounded():
    echo, _ = report(Echo(), 0, 0.4)
    for number in range(5000):
        echo = send(echo, number * 4_000, 0.4)
        echo, _ = report(echo, number * 4_000, 0.4)
    assert sum(map(len, echo.former)) + len(echo.latest) <= 272 and len(echo.ours) <= 60
