"""The position ring in the service: what is captured, what is commanded, when it is given up."""

from dataclasses import dataclass, field, replace
from math import radians

import numpy as np
import pytest
from msgspec import structs

from kffa_offboard.control.position import PositionDesign, acceleration_of, design_ring
from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget, ModeKind, Signals
from kffa_offboard.offboard.flight import Directive
from kffa_offboard.offboard.horizontal import (
    astray,
    begin_horizontal,
    position_reference,
    step_horizontal,
)
from kffa_offboard.offboard.loop import begin_loop
from kffa_offboard.offboard.segments import Hold, Land, Move, Step, Takeoff
from kffa_offboard.offboard.service import State
from kffa_offboard.offboard.settings import PositionSettings
from kffa_offboard.offboard.telemetry import Telemetry
from kffa_offboard.offboard.tuning import adopt

G = 9.8


def ring(name="ladrc", **changes):
    numbers = PositionDesign(tilt_max=radians(20.0))
    return PositionSettings(design_ring(name, numbers), radians(20.0), **changes)


@dataclass
class Drifter:
    """Adds x and y to what the vehicle of the conftest reports: a point mass that its tilt accelerates."""

    vehicle: object
    wind: np.ndarray = field(default_factory=lambda: np.zeros(2))
    place: np.ndarray = field(default_factory=lambda: np.zeros(2))
    velocity: np.ndarray = field(default_factory=lambda: np.zeros(2))
    history: list = field(default_factory=list)

    def __call__(self, event):
        if not isinstance(event, events.PositionReceived):
            return event
        if self.vehicle.position > 0.0:
            total = acceleration_of(G, np.asarray(self.vehicle.attitude)) + self.wind
            self.place = self.place + self.velocity * 0.01
            self.velocity = self.velocity + total * 0.01
        self.history.append(tuple(self.place))
        (_, _, z), (_, _, climb) = event.position, event.velocity
        tiny = 1e-9 * (len(self.history) % 2)  # no sensor repeats itself to the last bit
        return structs.replace(event, position=(*(self.place + tiny), z), velocity=(*self.velocity, climb))


def flight_of(fake, settings, vehicle=None, **changes):
    flight = fake.Lockstep(settings, vehicle)
    flight.drifter = Drifter(flight.vehicle, **changes)
    flight.change = flight.drifter
    return flight


def held(fake, output="rates", **changes):
    return fake.settings(output, position=ring(), scenario=(Takeoff(2.0, 1.0), Hold(60.0)), **changes)


# ------------------------------------------------------------------------------------ holding


@pytest.mark.parametrize("output", ["rates", "attitude"])
def test_the_place_of_lift_off_is_held_in_a_wind(fake, output):
    flight = flight_of(fake, held(fake, output), wind=np.array([0.3, -0.2]))
    flight.run(22.0)
    assert flight.service.state is State.ENGAGED
    assert np.hypot(*flight.drifter.place) <= 0.02
    assert max(np.hypot(*place) for place in flight.drifter.history) <= 0.4


def test_without_the_ring_the_wind_carries_it_away(fake):
    settings = fake.settings(scenario=(Takeoff(2.0, 1.0), Hold(60.0)))
    flight = flight_of(fake, settings, wind=np.array([0.3, -0.2]))
    flight.run(15.0)
    assert np.hypot(*flight.drifter.place) > 5.0


def test_the_signals_show_the_rings_roll_and_pitch_references(fake):
    flight = flight_of(fake, held(fake), wind=np.array([0.3, -0.2]))
    flight.run(22.0)
    roll, pitch = flight.sent(Signals)[-1][1].reference[:2]
    assert (roll, pitch) == pytest.approx((-0.2 / G, -0.3 / G), abs=2e-3)


def test_on_the_ground_the_attitude_is_not_commanded(fake):
    flight = flight_of(fake, held(fake, "attitude"))
    flight.vehicle.attitude[:] = (0.05, 0.03, 0.0)  # standing on a slope
    flight.run(30.0, lambda: flight.vehicle.position > 0.0)
    targets = [target.attitude[:2] for _, target in flight.sent(AttitudeTarget)]
    assert len(targets) > 50
    assert set(targets[:-2]) == {(0.0, 0.0)}


@pytest.mark.parametrize(("ground_thrust", "acting"), [(None, True), (None, False), (0.2, True)])
def test_to_be_thrown_to_and_fro_counts_in_the_air_under_our_setpoints_only(ground_thrust, acting):
    """A pilot who flies like that may engage afterwards."""
    level = events.AttitudeReceived(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    settings = ring()
    known = Telemetry(attitude=level, position=events.PositionReceived(1, (0.0, 0.0, 5.0), (0.0, 0.0, 0.0)))
    state = begin_horizontal(settings, known)
    directive = Directive((0.0, 0.0, 0.0, 5.0), ground_thrust)
    for k in range(500):
        velocity = (2.0 * np.sin(0.1 * k), 0.0, 0.0)
        moving = events.PositionReceived(10_000 * k, (0.0, 0.0, 5.0), velocity)
        known = Telemetry(attitude=level, position=moving)
        state, _ = step_horizontal(settings, state, known, directive, acting, True, 0.01)
    thrown = "thrown to and fro: the load swings too much"
    assert (astray(settings, state) == thrown) is (acting and ground_thrust is None)


@pytest.mark.parametrize(("ground_thrust", "felt"), [(None, G * np.tan(0.1)), (0.2, 0.0)])
def test_who_does_not_fly_is_told_what_the_attitude_gives_and_on_a_slope_nothing(ground_thrust, felt):
    tilted = events.AttitudeReceived(1, (0.0, 0.1, 0.0), (0.0, 0.0, 0.0))
    still = events.PositionReceived(1, (4.0, 2.0, 0.0), (0.0, 0.0, 0.0))
    known = Telemetry(attitude=tilted, position=still)
    settings = ring()
    settings = replace(settings, ring=replace(settings.ring, gravity=G))
    state = begin_horizontal(settings, known)
    directive = Directive((0.0, 0.0, 0.5, 3.0), ground_thrust, align=True)
    for _ in range(300):
        state, reference = step_horizontal(settings, state, known, directive, False, True, 0.01)
    assert state.ring.observer.disturbance == pytest.approx([-felt, 0.0], abs=0.05)  # what holds it there
    assert state.captured == pytest.approx((4.0, 2.0), abs=0.05)
    assert reference[2:] == (0.5, 3.0)
    assert reference[:2] == pytest.approx((0.0, 0.1) if ground_thrust is None else (0.0, 0.0), abs=0.01)
    elsewhere = structs.replace(directive, align=False, offset=(3.0, 0.0))
    for _ in range(50):
        state, _ = step_horizontal(settings, state, known, elsewhere, False, True, 0.01)
    assert state.ring.actuator.commands[-1] == pytest.approx([felt, 0.0])  # not what the ring would do


def test_the_wind_is_known_before_engaging_in_the_air(fake):
    settings = replace(held(fake, arm=False), scenario=(Hold(60.0),))
    flight = flight_of(fake, settings, fake.airborne(), wind=np.array([0.0, 0.5]))
    flight.run_to(State.ENGAGED)
    flight.run(0.4)
    assert flight.sent(Signals)[-1][1].reference[0] >= 0.5 / G - 0.005  # leans against it at once


# ------------------------------------------------------------------------------------ loads on a rope


def on_rope(**changes):
    numbers = PositionDesign(tilt_max=radians(20.0), **changes)
    rings = {"ring": design_ring("kffa-ladrc", numbers), "damping": design_ring("pid", numbers)}
    return replace(ring(), **rings, on_rope=True)


def test_the_ring_that_damps_holds_only_while_its_setpoints_act():
    """Before and afterwards the other one observes: what it finds of the wind is where the first goes on."""
    tilted = events.AttitudeReceived(1, (0.0, 0.1, 0.0), (0.0, 0.0, 0.0))
    known = Telemetry(attitude=tilted, position=events.PositionReceived(1, (4.0, 2.0, 0.0), (0.0, 0.0, 0.0)))
    settings, directive = on_rope(), Directive((0.0, 0.0, 0.0, 3.0))
    state = begin_horizontal(settings, known)
    for _ in range(300):
        state, _ = step_horizontal(settings, state, known, directive, False, True, 0.01)
    assert not state.damps and state.ring.observer.disturbance[0] == pytest.approx(-0.98, abs=0.05)
    state, reference = step_horizontal(settings, state, known, directive, True, True, 0.01)
    assert state.damps and state.ring.pid.integral == pytest.approx([0.98, 0.0], abs=0.05)
    assert reference[:2] == pytest.approx((0.0, 0.1), abs=0.01)
    state, _ = step_horizontal(settings, state, known, directive, False, True, 0.01)
    assert not state.damps and state.ring.kalman is not None and state.ring.observer.disturbance.any()


def test_a_place_that_is_captured_anew_is_the_set_point_at_once():
    """What was on its way to the old one is forgotten."""
    settings = replace(on_rope(), sway_rad_s=1.0)
    known = Telemetry(
        attitude=events.AttitudeReceived(1, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        position=events.PositionReceived(1, (4.0, 2.0, 3.0), (0.0, 0.0, 0.0)),
    )
    here = Directive((0.0, 0.0, 0.0, 3.0), align=True)
    state, _ = step_horizontal(settings, begin_horizontal(settings, known), known, here, True, True, 0.01)
    there = Directive((0.0, 0.0, 0.0, 3.0), offset=(1.0, 0.0))
    for _ in range(100):
        state, _ = step_horizontal(settings, state, known, there, True, True, 0.01)
    assert 4.0 < position_reference(state)[0] < 4.9  # on its way
    for _ in range(3):
        state, _ = step_horizontal(settings, state, known, here, True, True, 0.01)
        assert position_reference(state) == pytest.approx(state.captured, abs=1e-9)


def test_its_numbers_can_be_changed_in_flight(fake):
    before = fake.settings(position=on_rope())
    after = replace(before, position=on_rope(omega_c=2.5))
    known = Telemetry(
        attitude=events.AttitudeReceived(1, (0.0, 0.1, 0.0), (0.0, 0.0, 0.0)),
        position=events.PositionReceived(1, (4.0, 2.0, 3.0), (0.0, 0.0, 0.0)),
    )
    loop = begin_loop(before, known, 0)
    horizontal, _ = step_horizontal(
        before.position, loop.horizontal, known, Directive((0.0, 0.0, 0.0, 3.0)), True, True, 0.01
    )
    adopted = adopt(structs.replace(loop, horizontal=horizontal), before, after).horizontal
    assert horizontal.damps and adopted.damps
    assert adopted.ring.pid.integral == pytest.approx(horizontal.ring.pid.integral)


# ------------------------------------------------------------------------------------ engaging


def test_engaging_in_the_air_stops_without_a_bump_and_stays(fake):
    settings = held(fake, arm=False)
    settings = replace(settings, scenario=(Hold(60.0),))
    flight = flight_of(fake, settings, fake.airborne(), velocity=np.array([2.0, 0.0]))
    flight.run_to(State.ENGAGED)
    here = flight.drifter.place.copy()
    flight.run(12.0)
    pitch = np.array([signals.reference[1] for _, signals in flight.sent(Signals)])
    assert np.abs(np.diff(pitch)).max() <= 0.02  # nothing jumps
    assert np.abs(pitch).max() <= radians(20.0) + 1e-9
    assert np.hypot(*flight.drifter.velocity) <= 0.02
    assert here[0] < flight.drifter.place[0] <= here[0] + 5.0  # ahead: where it could stop
    furthest = max(x for x, _ in flight.drifter.history)
    assert furthest <= flight.drifter.place[0] + 0.1  # and it did not have to come back


def test_engaging_at_rest_moves_nothing(fake):
    settings = replace(held(fake, arm=False), scenario=(Hold(60.0),))
    flight = flight_of(fake, settings, fake.airborne())
    flight.drifter.place = np.array([30.0, -20.0])
    flight.run(4.0)
    assert flight.service.state is State.ENGAGED
    references = np.array([signals.reference[:2] for _, signals in flight.sent(Signals)])
    assert np.abs(references).max() <= 1e-6
    assert flight.drifter.place == pytest.approx([30.0, -20.0])


def test_releasing_during_a_move_holds_where_it_can_stop(fake):
    settings = held(fake)
    settings = replace(settings, scenario=(Takeoff(2.0, 1.0), Move(8.0, 0.0, 10.0)))
    flight = flight_of(fake, settings)
    assert flight.run(30.0, lambda: flight.drifter.velocity[0] > 1.5)
    flight.vehicle.grants_mode = False
    flight.give(events.ReleaseRequested("enough"))
    at = flight.drifter.place[0]
    flight.run(1.9)
    assert flight.service.state is State.RELEASING
    furthest = max(x for x, _ in flight.drifter.history)
    assert at + 0.5 < furthest < at + 4.0
    assert -0.05 <= flight.drifter.velocity[0] < 1.0  # it slows down and does not turn back


# ------------------------------------------------------------------------------------ moves


def test_a_move_goes_north_and_east_and_stays_there(fake):
    scenario = (Takeoff(2.0, 1.0), Move(3.0, 0.0, 6.0), Move(0.0, 2.0, 6.0), Hold(60.0))
    flight = flight_of(fake, replace(held(fake), scenario=scenario))
    flight.run(30.0)
    assert flight.drifter.place == pytest.approx([3.0, -2.0], abs=0.03)  # y is west
    assert max(x for x, _ in flight.drifter.history) <= 3.0 * 1.05


def test_a_move_does_not_change_the_landing(fake):
    scenario = (Takeoff(2.0, 1.0), Move(2.0, 0.0, 6.0), Land(0.7))
    flight = flight_of(fake, replace(held(fake), scenario=scenario))
    assert flight.run(40.0, lambda: flight.service.finished is not None)
    assert flight.service.finished.successful
    assert flight.drifter.place == pytest.approx([2.0, 0.0], abs=0.05)


# ------------------------------------------------------------------------------------ safety


def test_an_impossible_jump_of_the_position_is_a_failsafe(fake):
    flight = flight_of(fake, held(fake))
    flight.run(15.0)
    flight.drifter.place = np.add(flight.drifter.place, (4.0, 0.0))
    flight.run(0.1)
    assert flight.service.state is State.FAILSAFE
    assert "position jumped 4.0 m" in flight.service.finished.reason


def test_being_carried_too_far_from_the_set_point_is_a_failsafe(fake):
    settings = replace(held(fake), position=ring(error_max_m=2.0))
    flight = flight_of(fake, settings)
    flight.run(15.0)
    flight.drifter.wind = np.array([6.0, 0.0])  # more than 20 degrees of tilt can hold
    assert flight.run(10.0, lambda: flight.service.state is State.FAILSAFE)
    assert "from the set point" in flight.service.finished.reason


def test_the_same_jump_without_the_ring_is_nobodys_business(fake):
    flight = flight_of(fake, fake.settings(scenario=(Takeoff(2.0, 1.0), Hold(60.0))))
    flight.run(15.0)
    flight.drifter.place = np.add(flight.drifter.place, (4.0, 0.0))
    flight.run(0.5)
    assert flight.service.state is State.ENGAGED


def test_the_pilot_wins_with_the_ring_too(fake):
    flight = flight_of(fake, held(fake))
    flight.run(12.0)
    flight.vehicle.mode = ModeKind.OTHER
    flight.run(1.1)
    count = len(flight.sent(AttitudeTarget))
    flight.run(1.0)
    assert len(flight.sent(AttitudeTarget)) == count


# ------------------------------------------------------------------------------------ refusals


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenario": (Move(1.0, 0.0, 5.0),)}, r"segment 1 \(move\): needs the position ring"),
        (
            {"scenario": (Step("pitch", 0.1, 1.0),), "position": ring()},
            "segment 1: pitch is commanded by the position ring",
        ),
        ({"scenario": (Move(5.0, 0.0, 4.4),), "position": ring()}, "too short .* give at least 4.5"),
        ({"position": replace(ring(), tilt_max_rad=0.8)}, "tilt_max_deg = 45.8.* is above"),
    ],
)
def test_what_cannot_be_flown_is_refused_before_flying(fake, changes, message):
    with pytest.raises(ValueError, match=message):
        fake.settings(**changes)


def test_steps_of_heading_and_height_go_with_the_ring(fake):
    scenario = (Step("yaw", 0.5, 1.0), Step("altitude", 1.0, 1.0))
    assert fake.settings(scenario=scenario, position=ring()).scenario == scenario


def test_a_speed_that_cannot_be_is_a_failsafe_within_the_same_call(fake):
    flight = flight_of(fake, fake.settings(position=ring("kffa-ladrc"), scenario=()), fake.airborne())
    flight.run_to(State.ENGAGED).run(0.5)
    honest = flight.change

    def gale(event):
        event = honest(event)
        if not isinstance(event, events.PositionReceived):
            return event
        return structs.replace(event, velocity=(0.0, -21.0, event.velocity[2]))

    flight.change = gale
    flight.tick()
    assert "failsafe: speed 21 m/s, 20 possible" in flight.texts


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"omega_c": 5.0}, "position: omega_c from 2 to 5; go in steps of 2 times at most"),
        ({"omega_o": 1000.0}, "position: omega_o from 6 to 1e+03; go in steps of 2 times at most"),
        ({"lag": 0.5}, "position: lag from 0.12 to 0.5; go in steps of 1.5 times at most"),
        ({"omega_c": 3.5, "omega_o": 12.0}, None),
        ({"omega_c": 0.5}, None),
    ],
)
def test_a_ring_that_is_far_from_the_one_that_flies_is_refused_in_flight(fake, changes, reason):
    """With three times the bandwidth, an observer of 1000 rad/s or four times the lag it swung by 0.2 rad."""
    flown = held(fake)
    flight = flight_of(fake, flown, fake.airborne()).run_to(State.ENGAGED)
    designed = replace(flown.position, ring=design_ring("ladrc", PositionDesign(**changes)))
    flight.give(events.SettingsChanged(replace(flown, position=designed)))
    said = [refused.reason for _, refused in flight.sent(events.RequestRefused)]
    assert said == ([] if reason is None else [reason])
