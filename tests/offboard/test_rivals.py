"""For how long a rival for the vehicle is remembered, when control is fought over, what people are told."""

import pytest

from kffa_offboard.offboard.events import IntrusionNoticed
from kffa_offboard.offboard.rivals import Rivals, forbids, fought_over, notice

SECOND_US = 1_000_000
SETPOINTS = IntrusionNoticed("255/190 sends setpoints to the vehicle", "ends")
SECOND_VEHICLE = IntrusionNoticed("two vehicles are 1/1", "forbids")


def noticed(*entries):
    """What is known after these events, each with its time in s, and which of them people were told."""
    rivals, told = Rivals(), []
    for time_s, event in entries:
        rivals, now = notice(rivals, round(time_s * SECOND_US), event)
        if now:
            told.append((time_s, event.text))
    return rivals, told


@pytest.mark.parametrize("rival", [SETPOINTS, SECOND_VEHICLE])
def test_the_five_seconds_count_from_when_a_rival_was_last_seen(rival):
    rivals, _ = noticed((1.0, rival), (5.0, rival))
    assert forbids(rivals, 10 * SECOND_US) == rival.text
    assert forbids(rivals, 10 * SECOND_US + 1) is None


def test_the_last_rival_is_the_one_that_is_named():
    rivals, _ = noticed((0.0, SETPOINTS), (1.0, SECOND_VEHICLE))
    assert forbids(rivals, SECOND_US) == SECOND_VEHICLE.text


@pytest.mark.parametrize(
    ("times", "ends"),
    [
        ((0.0, 1.0, 2.0), True),
        ((0.0, 1.0, 2.000001), False),
        ((0.0, 0.1), False),
        ((0.0, 50.0, 100.0, 100.1, 100.2), True),  # strays long ago excuse nothing
        ((0.0, 50.0, 100.0, 100.1), False),
    ],
)
def test_three_setpoints_within_two_seconds_are_a_fight_whatever_was_before(times, ends):
    rivals, _ = noticed(*((time, SETPOINTS) for time in times))
    assert fought_over(rivals, round(times[-1] * SECOND_US)) == ends


def test_after_two_seconds_the_fight_is_over():
    rivals, _ = noticed((0.0, SETPOINTS), (0.1, SETPOINTS), (0.2, SETPOINTS))
    assert fought_over(rivals, 2 * SECOND_US) and not fought_over(rivals, 2 * SECOND_US + 1)


def test_the_same_is_said_every_half_minute_and_something_else_after_a_second():
    refused = IntrusionNoticed("refusing 255/190: not signed", "said")
    first, after_a_second, after_another = (0.0, SETPOINTS), (1.0, SECOND_VEHICLE), (2.0, refused)
    again, and_after_that = (30.0, SETPOINTS), (31.0, SECOND_VEHICLE)
    too_early = (
        (time - 1e-6, event) for time, event in (after_a_second, after_another, again, and_after_that)
    )
    said = [first, after_a_second, after_another, again, and_after_that]
    _, told = noticed(*sorted((*said, *too_early), key=lambda entry: entry[0]))
    assert told == [(time, event.text) for time, event in said]


def test_eight_rivals_by_turns_are_each_said_every_half_minute_and_more_are_not_remembered():
    rivals = [IntrusionNoticed(f"another vehicle is 1/1: 10.0.0.{k}", "forbids") for k in range(8)]
    known, told = noticed(*((1.0 * k, rivals[k % 8]) for k in range(60)))
    assert [text for _, text in told].count(rivals[0].text) == 2
    assert len(told) == 16
    strangers = [IntrusionNoticed(f"refusing 1/{k}: not signed", "said") for k in range(60)]
    known, told = noticed(*((1.0 * k, stranger) for k, stranger in enumerate(strangers)))
    assert len(told) == 60 and len(known.said) == 8
