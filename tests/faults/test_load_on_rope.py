"""A load that swings under the position ring: driven by its law, damped where a rope is told or shows."""

import math
from dataclasses import replace

import pytest

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.offboard.events import SettingsChanged
from kffa_offboard.offboard.swinging import for_swinging_load

AT = 3.0
PUSHED = 3.6
LOAD_KG, LENGTH_M = 5.0, 1.0
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
    ):
        schedule = [{"time_s": AT, "mass_kg": LOAD_KG}]
        rope = {
            "payload": {
                "clock": "boot",
                "rope_length_m": LENGTH_M,
                "rope_below_m": below_m,
                "rope_stiffness_n_m": stiffness,
                "schedule": schedule,
            }
        }
        flight = fault_flight(
            personality,
            output=output,
            vehicle_changes=rope | (more or {}),
            acts={PUSHED: push} if pushed else {},
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


def test_without_the_other_ring_the_load_ends_circling_the_vehicle(fly):
    """What the two above are for."""
    flight = fly(ring("px4", damping=None), 22.0)
    assert SWINGS not in flight.texts
    assert worst(flight.swing, 20.0, 22.0) > math.radians(60.0)


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
