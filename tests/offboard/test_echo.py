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


NOW_US = 3_000_000


def looking(sent=((NOW_US, 0.4),)):
    """Reports are looked at since 0 s; these setpoints were sent."""
    echo, _ = report(Echo(), 0, 0.4)
    for time_us, thrust in sent:
        echo = send(echo, time_us, thrust)
    return echo


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("away", "ours"),
    [
        (0.0, True),
        (3e-7, True),  # what real ArduCopter makes of it
        (1.9e-6, True),
        (2.1e-6, None),
        (5e-5, None),  # seen once of real ArduCopter
        (0.99e-4, None),
        (1.01e-4, False),
        (0.1, False),
    ],
)
def test_a_report_is_ours_or_somebody_elses_or_cannot_be_told(sign, away, ours):
    echo, _ = report(looking(), NOW_US, 0.4 + sign * away)
    assert echo.ours == (ours,)


def test_every_setpoint_of_the_last_second_is_known_at_250_hz():
    times = [NOW_US - 4_000 * k for k in reversed(range(251))]
    echo = looking([(time_us, 0.3 + 0.001 * k) for k, time_us in enumerate(times)])
    for k in range(251):
        echo, _ = report(echo, NOW_US, 0.3 + 0.001 * k)
        assert echo.ours[-1] is True, k


def test_who_has_sent_nothing_for_a_second_suspects_nobody():
    echo, _ = report(looking([(NOW_US - 1_000_001, 0.4)]), NOW_US, 0.6)
    assert echo.ours == (True,)


def noticed(*thrusts):
    """Is somebody else noticed at the last of these reports?"""
    echo, now = looking(), False
    for thrust in thrusts:
        assert not now, "only at the last"
        echo, now = report(echo, NOW_US, thrust)
    return now


OURS, UNDECIDED, OTHERS = 0.4, 0.40001, 0.6


@pytest.mark.parametrize(
    ("ours", "between", "others", "noticed_now"),
    [
        (5, 0, 5, True),
        (4, 0, 10, False),
        (10, 0, 4, False),
        (5, 50, 5, True),
        (5, 51, 5, False),
    ],
)
def test_five_of_each_within_sixty_reports_are_two_senders(ours, between, others, noticed_now):
    assert noticed(*[OURS] * ours, *[UNDECIDED] * between, *[OTHERS] * others) == noticed_now


def test_reports_are_judged_from_two_seconds_in_the_air_on_and_anew_in_each_flight():
    early, _ = report(looking([(1_999_999, 0.4)]), 1_999_999, 0.6)
    assert early.ours == ()
    echo, _ = report(looking([(2_000_000, 0.4)]), 2_000_000, 0.6)
    assert echo.ours == (False,)
    landed = forget_reports(echo)
    assert (landed.since_us, landed.ours) == (None, ())
    assert landed.latest == echo.latest, "what was sent is kept: it may be reported late"
