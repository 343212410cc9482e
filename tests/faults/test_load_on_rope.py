"""A load that swings under the position ring: driven by its law, damped where a rope is told or shows."""

import math
from dataclasses import replace
from itertools import accumulate

import pytest

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.offboard.events import SettingsChanged
from kffa_offboard.offboard.segments import Altitude, Hold, Move
from kffa_offboard.offboard.swinging import for_swinging_load

AT = 3.0
PUSHED = 3.6
LOAD_KG, LENGTH_M = 5.0, 1.0
HOLD = (Hold(1000.0),)
SWINGS = "the load swings: damping it"
WIND = {"wind": {"mean_m_s": [4.0, -3.0, 0.0]}, "vehicle": {"seed": 0, "drag_n_s_m": 0.6}}

WAYS = [
    ("px4", "rates", 0.0),
    ("ardupilot", "attitude", 0.0),
    ("px4", "attitude", 0.15),
    ("ardupilot", "rates", 0.15),
]
"""What is commanded, and how far below the centre the rope is fastened."""


def ring(personality, **changes):
    """The demonstration's position ring."""
    position = load(bundled(f"demo-{personality}-position.toml")).service.position
    return replace(position, **changes)


def on_rope(personality, length_m):
    """The ring that is told of a rope of this length."""
    return ring(personality, on_rope=True, sway_rad_s=math.sqrt(9.80665 / length_m))


def yielding(personality, output):
    """The demonstration's controller as a configuration with a rope has it."""
    service = load(bundled(f"demo-{personality}.toml"), Overrides(output=output)).service
    return {"controller": for_swinging_load(service).controller}


def push(vehicle):
    """The load is given 1 m/s: it swings by 15 degrees."""
    vehicle.plant._rope._state.velocity[0] += 1.0


@pytest.fixture
def fly(fault_flight):
    """A flight with a load on a rope, its swing [rad] and distance from where it began [m] at each slot."""

    def flown(
        position,
        seconds,
        personality="px4",
        output=None,
        more=None,
        pushed=True,
        below_m=0.0,
        told=False,
        stiffness=0.0,
        length_m=LENGTH_M,
        scenario=HOLD,
        acts=None,
    ):
        schedule = [{"time_s": AT, "mass_kg": LOAD_KG}]
        rope = {
            "payload": {
                "clock": "boot",
                "rope_length_m": length_m,
                "rope_below_m": below_m,
                "rope_stiffness_n_m": stiffness,
                "schedule": schedule,
            }
        }
        flight = fault_flight(
            personality,
            output=output,
            vehicle_changes=rope | (more or {}),
            acts=acts or ({PUSHED: push} if pushed else {}),
            scenario=scenario,
            changes={"position": position} | (yielding(personality, output) if told else {}),
            seconds=seconds,
        ).prepare()
        flight.swing, flight.away = [], []
        look = flight.look

        def seen():
            look()
            flight.swing.append(flight.vehicle.plant._rope.angle)
            flight.away.append(math.hypot(*flight.vehicle.state.rigid[:2]))

        flight.look = seen
        return flight.until(seconds)

    return flown


def worst(values, begin_s, end_s):
    """Of a list with a value each 10 ms."""
    return max(values[round(100 * begin_s) : round(100 * end_s)])


@pytest.mark.parametrize(("personality", "output", "below_m"), [*WAYS, ("px4", "rates", 0.15)])
def test_on_a_rope_that_is_told_the_swing_is_damped(fly, personality, output, below_m):
    """From the centre, and from a hook below it, by which the load turns the vehicle, too."""
    flight = fly(ring(personality, on_rope=True), 18.0, personality, output, told=True, below_m=below_m)
    assert flight.released_s is None and SWINGS not in flight.texts
    assert flight.violations == []
    assert worst(flight.swing, PUSHED, 5.0) > math.radians(12.0)
    assert worst(flight.swing, 16.0, 18.0) < math.radians(5.0)
    assert max(flight.away) < 0.45 and max(flight.tilts) < 0.15


@pytest.mark.parametrize(("personality", "output", "below_m"), WAYS)
def test_on_one_that_is_not_the_swing_grows_until_it_shows_and_is_damped_then(
    fly, personality, output, below_m
):
    flight = fly(ring(personality), 33.0, personality, output, below_m=below_m)
    assert flight.released_s is None and flight.texts.count(SWINGS) == 1
    assert flight.violations == []
    assert math.radians(13.0) < max(flight.swing) < math.radians(40.0)
    assert worst(flight.swing, 31.0, 33.0) < math.radians(3.0)
    assert max(flight.away) < 0.8 and max(flight.tilts) < math.radians(21.0)


@pytest.mark.parametrize(("personality", "output"), [("px4", "rates"), ("ardupilot", "attitude")])
def test_on_a_short_one_it_shows_before_it_is_too_late(fly, personality, output):
    """Half a metre in gusty wind: the swing doubles with every turn, and from 60 degrees on is not damped."""
    flight = fly(ring(personality), 25.0, personality, output, length_m=0.5, more=WIND, pushed=False)
    assert flight.released_s is None and flight.texts.count(SWINGS) == 1
    assert flight.violations == []
    assert math.radians(15.0) < max(flight.swing) < math.radians(50.0)
    assert worst(flight.swing, 23.0, 25.0) < math.radians(10.0)


def test_without_the_other_ring_the_load_ends_circling_the_vehicle(fly):
    """What the ones above are for."""
    flight = fly(ring("px4", damping=None), 22.0)
    assert SWINGS not in flight.texts
    assert worst(flight.swing, 20.0, 22.0) > math.radians(60.0)


def test_a_load_that_throws_the_vehicle_to_and_fro_ends_control(fly):
    """The same, on half a metre: it would go on until the rope pulls with a hundred times the weight."""
    flight = fly(ring("px4", damping=None), 25.0, length_m=0.5)
    assert "failsafe: thrown to and fro: the load swings too much" in flight.texts
    ended = round(100 * flight.released_s)
    assert math.radians(60.0) < flight.swing[ended] < math.radians(88.0)
    assert max(flight.tilts[:ended]) < math.radians(21.0)


@pytest.mark.parametrize("told", [False, True])
def test_below_the_centre_roll_and_pitch_drive_it_if_they_hold_against_its_pull(fly, told):
    """Without a ring, 15 degrees at first; a swing that drives nothing fades with the vehicle's drag."""
    flight = fly(None, 12.0, told=told, below_m=0.15)
    assert (worst(flight.swing, 10.0, 12.0) < math.radians(16.0)) is told
    assert (worst(flight.swing, 10.0, 12.0) > math.radians(25.0)) is not told


def test_a_rope_that_hangs_still_is_held_still(fly):
    flight = fly(ring("px4", on_rope=True), 12.0, pushed=False)
    assert worst(flight.swing, AT + 1.0, 12.0) < math.radians(1.5)
    assert max(flight.away) < 0.15


def test_the_ring_that_damps_leans_into_the_wind_from_its_first_step_on(fly):
    """What the other one has found of the wind while it observed: else 5 m/s blow it away by 0.4 m."""
    flight = fly(ring("px4", on_rope=True), 12.0, more=WIND, pushed=False)
    began = round(100 * flight.engaged_s)
    x, y = flight.away[began], max(flight.away[began:])
    assert y - x < 0.25


def test_numbers_that_are_set_in_flight_leave_it_damped(fly):
    flight = fly(ring("px4"), 20.0)
    assert SWINGS in flight.texts
    before = flight.service.settings
    wider = replace(flight.settings, limits=replace(flight.settings.limits, tilt_failsafe_rad=0.9))
    flight.session.tell(flight.vehicle.time_us, SettingsChanged(wider))
    flight.until(33.0)
    after = flight.service.settings
    assert after.limits.tilt_failsafe_rad == 0.9 != before.limits.tilt_failsafe_rad
    assert after.controller.law.rejection.tolist() == [0.0, 0.0, 1.0, 1.0]
    assert flight.released_s is None and worst(flight.swing, 31.0, 33.0) < math.radians(3.0)


@pytest.mark.parametrize(("personality", "output"), [("px4", "rates"), ("ardupilot", "attitude")])
def test_thrust_that_shakes_on_a_rope_that_stretches_ends_control(fly, personality, output):
    """5 kg on 3,000 N/m bounce with 30 rad/s; the autopilot's own hold leaves them alone."""
    position = ring(personality, on_rope=True)
    flight = fly(position, 16.0, personality, output, pushed=False, told=True, stiffness=3000.0)
    assert "failsafe: thrust shakes from end to end" in flight.texts
    assert flight.released_s < AT + 4.0 and flight.violations == []
    assert flight.targets[-1][1].thrust == pytest.approx(0.6, abs=0.15)  # carries 15 kg
    assert abs(worst(flight.heights, 3.0, 16.0) - 5.0) < 1.0


def test_a_stiff_one_and_a_soft_one_do_not_shake_it(fly):
    for stiffness in (300.0, 20_000.0):
        flight = fly(ring("px4", on_rope=True), 8.0, pushed=False, told=True, stiffness=stiffness)
        assert flight.released_s is None and flight.violations == []
        assert max(abs(height - 5.0) for height in flight.heights) < 0.15


# ------------------------------------------------------------------------- a whole delivery


@pytest.mark.parametrize(
    ("personality", "output", "length_m"), [("px4", "rates", 1.0), ("ardupilot", "attitude", 3.0)]
)
def test_a_move_with_a_load_on_a_rope_ends_where_it_is_to(fly, personality, output, length_m):
    """10 m at 2 m/s: a PID that knows the set point's place alone went 2.1 m too far, and took 21 s."""
    moves = (Hold(2.0), Move(10.0, 0.0, 10.0, 2.0), Hold(1000.0))
    options = {"pushed": False, "told": True, "length_m": length_m, "scenario": moves}
    flight = fly(on_rope(personality, length_m), 24.0, personality, output, **options)
    assert flight.released_s is None and flight.violations == []
    assert 10.0 < max(flight.away) < 10.2
    arrived = flight.engaged_s + 2.0 + 11.0
    late = flight.away[round(100 * arrived) :]
    assert min(late) > 9.8 and max(late) < 10.2
    assert max(flight.swing) < math.radians(9.0 if length_m == 1.0 else 6.0)
    assert worst(flight.swing, 22.0, 24.0) < math.radians(1.5)


def test_a_set_point_that_takes_no_care_makes_the_load_swing_three_times_as_much(fly):
    """What the frequency of the rope is for."""
    moves = (Hold(2.0), Move(10.0, 0.0, 10.0, 2.0), Hold(1000.0))
    options = {"pushed": False, "told": True, "length_m": 3.0, "scenario": moves}
    careless, careful = (
        fly(position, 16.0, **options) for position in (ring("px4", on_rope=True), on_rope("px4", 3.0))
    )
    assert max(careless.swing) > 2.2 * max(careful.swing)


DELIVERY = (
    *(Hold(1.0), Altitude(9.0), Hold(2.0), Move(4.0, 0.0, 8.0), Hold(2.0)),
    *(Altitude(5.0), Hold(2.0), Altitude(9.0), Hold(1000.0)),
)
"""With 6 m of rope, from 5 m: lifted, carried, set down, lifted again."""


@pytest.mark.parametrize(
    ("personality", "output", "below_m", "told"),
    [(*way, told) for way, told in zip(WAYS, (True, False, False, True), strict=True)],
)
def test_a_load_is_lifted_off_the_ground_and_set_down(fly, personality, output, below_m, told):
    """Its weight comes when the rope gets taut and goes when it stands; the height hardly notices."""
    flight = fly(
        on_rope(personality, 6.0) if told else ring(personality),
        39.0,
        personality,
        output,
        more=WIND,
        below_m=below_m,
        told=told,
        length_m=6.0,
        scenario=DELIVERY,
    )
    assert flight.released_s is None and flight.violations == []
    happened = [event.text for event in flight.vehicle.truth.events if event.text.startswith("load")]
    assert happened == ["load lifted", "load set down", "load lifted"]
    loads = [text.rpartition(" ")[0][:-4] for text in flight.texts if text.endswith("kg")]
    assert loads == ["picked up", "dropped", "picked up"]
    assert max(flight.tilts) < (0.22 if told else 0.3) and max(flight.heights) < 9.1
    down = flight.vehicle.truth.time_of("load set down")
    after = flight.heights[round(100 * down) : round(100 * down) + 100]
    rise = max(later - lowest for lowest, later in zip(accumulate(after, min), after, strict=True))
    assert rise < 0.03


@pytest.mark.parametrize(("personality", "output"), [("px4", "rates"), ("ardupilot", "attitude")])
def test_a_rope_that_has_caught_on_the_ground_ends_control(fly, personality, output):
    """Full thrust would pull at it as long as the climb is asked for, with 130 N."""

    def catch(vehicle):
        vehicle.plant._rope.mass_kg = 1000.0

    climb = (Hold(1.0), Altitude(9.0), Hold(1000.0))
    options = {"told": True, "length_m": 6.0, "scenario": climb, "acts": {PUSHED: catch}}
    flight = fly(ring(personality, on_rope=True), 12.0, personality, output, **options)
    assert "failsafe: full thrust lifts nothing for 3 s" in flight.texts
    assert flight.released_s < 10.0 and flight.violations == []
    assert max(flight.heights) < 6.05


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_a_rope_that_parts_under_full_thrust_throws_the_vehicle_up_by_less_than_half_a_metre(
    fly, personality
):
    """130 N more than its weight are gone at once, half a metre below the height that is asked for."""

    def catch(vehicle):
        vehicle.plant._rope.mass_kg = 1000.0

    climb = (Hold(1.0), Altitude(9.0), Hold(1000.0))
    parts = {PUSHED: catch, 7.0: lambda vehicle: vehicle.set_load(0.0)}
    options = {"told": True, "length_m": 6.0, "scenario": climb, "acts": parts}
    flight = fly(ring(personality, on_rope=True), 12.0, personality, **options)
    assert flight.released_s is None and flight.violations == []
    assert max(flight.heights) < 9.5 and abs(flight.heights[-1] - 9.0) < 0.03
    assert max(flight.tilts) < 0.1
