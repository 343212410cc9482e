"""What would leave the limits is refused before it is flown, and held there if it comes all the same."""

from dataclasses import replace
from math import inf, pi

import numpy as np
import pytest
from msgspec import structs

from kffa_offboard.control import vehicle
from kffa_offboard.offboard import events, external
from kffa_offboard.offboard.course import Bounds, course_problem
from kffa_offboard.offboard.events import PositionSetpoint, Signals
from kffa_offboard.offboard.guard import Wish, check_wish
from kffa_offboard.offboard.segments import Altitude, Hold, Land, Move, Sine, Step, Takeoff, Triangle
from kffa_offboard.offboard.service import State
from kffa_offboard.offboard.settings import LimitSettings

LIMITS = LimitSettings(altitude_max_m=10.0, fence_radius_m=20.0)
UP = Takeoff(8.0)


@pytest.mark.parametrize(
    ("segments", "words"),
    [
        ((Takeoff(12.0),), "segment 1 (takeoff): goes to 12.0 m, outside -3 .. 10 m"),
        ((UP, Altitude(12.0)), "segment 2 (altitude): goes to 12.0 m, outside -3 .. 10 m"),
        ((UP, Altitude(2.0, 6.0)), "segment 2 (altitude): climbs or sinks at 6 m/s"),
        ((UP, Altitude(9.0), Step("altitude", 1.5, 1.0)), "segment 3 (step): goes to 10.5 m"),
        ((UP, Step("altitude", 2.5, 1.0)), "segment 2 (step): goes to 10.5 m"),
        ((UP, Sine("altitude", 2.5, 10.0)), "segment 2 (sine): goes to 10.5 m"),
        ((UP, Triangle("altitude", -2.5, 10.0)), "segment 2 (triangle): goes to 10.5 m"),
        ((Takeoff(5.0, 6.0),), "segment 1 (takeoff): climbs or sinks at 6 m/s"),
        ((UP, Land(5.5)), "segment 2 (land): climbs or sinks at 5.5 m/s"),
        ((UP, Sine("altitude", 1.0, 1.0)), "segment 2 (sine): climbs or sinks at 6.28 m/s"),
        (
            (UP, Move(12.0, 0.0, 20.0), Move(0.0, 16.0, 20.0)),
            "segment 3 (move): leads 20.0 m away, 19 possible",
        ),
    ],
)
def test_a_scenario_that_leaves_the_limits_is_named(segments, words):
    assert words in course_problem(segments, LIMITS.bounds, None)


def test_a_scenario_within_limits_passes_and_unknown_heights_wait_until_engaging():
    bounds = LIMITS.bounds
    inside = (UP, Step("altitude", 1.5, 1.0), Move(12.0, 0.0, 20.0), Move(-12.0, 16.0, 20.0), Land())
    assert course_problem(inside, bounds, None) is None
    wave = (Sine("altitude", 2.0, 10.0),)
    assert course_problem(wave, bounds, None) is None
    assert course_problem(wave, bounds, 9.0) == "segment 1 (sine): goes to 11.0 m, outside -3 .. 10 m"
    assert course_problem(wave, Bounds(-inf, inf, 5.0, 20.0, 19.0), 9.0) is None


def test_a_file_with_such_a_scenario_is_refused(fake):
    with pytest.raises(ValueError, match=r"scenario segment 2 .step.: goes to 52.0 m, outside -3 .. 50 m"):
        fake.settings(scenario=(Takeoff(40.0), Step("altitude", 12.0, 1.0)))


def test_engaging_in_the_air_is_refused_when_the_scenario_would_climb_too_high_from_there(fake):
    scenario = (Sine("altitude", 8.0, 20.0), Hold(10.0))
    limits = replace(fake.settings().limits, altitude_max_m=10.0)
    settings = fake.settings(scenario=scenario, limits=limits, engage=False)
    flight = fake.Lockstep(settings, fake.airborne()).run_to(State.READY)
    flight.give(events.EngageRequested())
    assert flight.texts[-1].startswith("not engaged: segment 1 (sine): goes to 11.0 m, outside -3 .. 10")


def test_a_place_beyond_the_fence_is_not_gone_to(fake):
    settings = replace(fake.settings(), limits=LIMITS)
    settings = replace(settings, position=None)
    centre = (5.0, 0.0)

    def refusal(x):
        # x and y are only judged with a ring; its numbers do not matter here
        object.__setattr__(settings, "position", object())
        return external.refusal(settings, PositionSetpoint((x, 0.0, None)), 0.0, centre)

    assert refusal(23.9) is None and refusal(-13.9) is None
    assert refusal(24.5) == "20 m away, fence at 20" and refusal(-15.0) == "20 m away, fence at 20"


# ---------------------------------------------------------------------- the guard, in flight


def test_what_is_followed_stays_within_tilt_height_and_fence():
    wish, said = check_wish(LIMITS, Wish(1.0, -1.0, 12.0, (30.0, 40.0)), None, 0.0)
    assert wish.roll == -wish.pitch == pytest.approx(LIMITS.tilt_max_rad / 2**0.5)
    assert wish.altitude == 10.0 and said == "set point held at the fence"
    assert wish.place == pytest.approx((11.4, 15.2))
    assert check_wish(LIMITS, Wish(0.0, 0.0, 12.0), None, 0.0)[1] == "set point held at 10 m of height"
    assert check_wish(LIMITS, Wish(0.0, 0.0, -5.0), None, 0.0)[0].altitude == -3.0


def test_height_is_followed_no_faster_than_the_climb_rate():
    before = Wish(0.0, 0.0, 5.0)
    for asked, given in ((9.0, 5.05), (1.0, 4.95), (5.02, 5.02)):
        wish, said = check_wish(LIMITS, Wish(0.0, 0.0, asked), before, 0.01)
        assert wish.altitude == pytest.approx(given) and said is None


def test_a_time_that_goes_back_moves_no_height():
    wish, _ = check_wish(LIMITS, Wish(0.0, 0.0, 9.0), Wish(0.0, 0.0, 5.0), -0.5)
    assert wish.altitude == 5.0


def test_a_wish_within_limits_is_not_touched():
    wish = Wish(0.1, -0.2, 5.0 + pi, (3.0, -4.0))
    assert check_wish(LIMITS, wish, structs.replace(wish, altitude=wish.altitude - 0.001), 0.01)[0] == wish


def test_a_set_point_that_runs_away_is_held_at_the_limit_and_said(fake):
    """The scenario is right and the service's own memory is not: the guard still holds."""
    limits = replace(fake.settings().limits, altitude_max_m=6.0)
    flight = fake.Lockstep(fake.settings(scenario=(Hold(100.0),), limits=limits), fake.airborne())
    flight.run_to(State.ENGAGED)
    inner = flight.service._flight
    flight.service._flight = structs.replace(
        inner, scenario=structs.replace(inner.scenario, hold_altitude=30.0)
    )
    flight.run(4.0)
    assert "set point held at 6 m of height" in flight.texts
    references = [signals.reference[3] for _, signals in flight.sent(Signals)]
    assert max(references) <= 6.001


def test_estimates_that_have_not_settled_forbid_engaging(fake):
    flight = fake.Lockstep(fake.settings(engage=False, scenario=(Hold(9.0),)), fake.airborne())
    flight.run_to(State.READY)
    loop = flight.service._loop
    controller = vehicle.as_arrays(loop.controller)
    rate = controller.observer.rate + np.array([0.0, 0.0, 0.0, 2.0])
    wrong = structs.replace(controller.observer, rate=rate)
    flight.service._loop = loop.with_controller(structs.replace(controller, observer=wrong))
    flight.give(events.EngageRequested())
    assert flight.texts[-1].startswith("not engaged: estimates are settling: climb rate off by 2")
