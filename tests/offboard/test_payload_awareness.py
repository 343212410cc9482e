"""The daemon knows what the vehicle carries, says so, and releases a load together with its thrust."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from kffa_offboard.control import actuator
from kffa_offboard.control.payload import PayloadParameters
from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget, ModeKind, PayloadReport, SetGripper
from kffa_offboard.offboard.payload import Load, PayloadSample, _watch_changes, begin_awareness
from kffa_offboard.offboard.payload_settings import PayloadSettings
from kffa_offboard.offboard.release import plan_release
from kffa_offboard.offboard.segments import Gripper, Hold, Land, Takeoff
from kffa_offboard.offboard.service import State

LOADED = 1.5  # 5 kg on 10 kg
HEIGHT = 3.0
STAY = (Hold(100.0),)


def payload_settings(fake, **changes):
    estimator = PayloadParameters(
        vehicle_mass=10.0,
        hover_thrust=fake.hover,
        actuator=actuator.ActuatorParameters(np.array([0.01]), np.array([0.0])),
        rate_variance=0.02**2,
    )
    return PayloadSettings(estimator, **({"max_load_kg": 6.7, "gripper_open_s": 0.0} | changes))


def settings(fake, scenario=STAY, **changes):
    return fake.settings(scenario=scenario, payload=payload_settings(fake, **changes))


def hovering(fake, scenario=STAY, weight=1.0, **changes):
    """Engaged in the air with a load that has been weighed."""
    vehicle = fake.airborne(weight=weight, own_thrust=fake.hover * weight)
    flight = fake.Lockstep(settings(fake, scenario, **changes), vehicle).run_to(State.ENGAGED)
    flight.run(2.0)
    return flight


def release_works(flight, after_s=0.0):
    """The load leaves `after_s` after the command."""
    vehicle, receive, opened = flight.vehicle, flight.vehicle.receive, []

    def with_gripper(time_us, output):
        if output == SetGripper("release"):
            opened.append(time_us)
        return receive(time_us, output)

    def move(time_us, dt):
        if opened and time_us > opened[0] + after_s * 1e6:
            vehicle.weight = 1.0
        type(vehicle).move(vehicle, time_us, dt)

    vehicle.receive, vehicle.move = with_gripper, move
    return flight


def said(flight):
    words = ("picked", "dropped", "load", "carrying", "release", "gripper")
    return [text for text in flight.texts if text.startswith(words) and not text.startswith("released:")]


def reports(flight):
    return [report for _, report in flight.sent(PayloadReport)]


def excursion(flight, seconds):
    start = len(flight.altitudes)
    before = flight.altitudes[-1]
    flight.run(seconds)
    return max(abs(altitude - before) for altitude in flight.altitudes[start:])


# ------------------------------------------------------------------------ pick-up and drop


def test_a_pick_up_is_named_with_its_mass_and_a_drop_within_0_3_seconds(fake):
    flight = hovering(fake)
    flight.vehicle.weight = LOADED
    flight.run(1.0)
    assert said(flight) == ["picked up 5.0 kg"]
    assert reports(flight)[-1].mass_kg == pytest.approx(5.0, abs=0.25)
    flight.vehicle.weight = 1.0
    flight.run(0.3)
    assert said(flight)[1:] == ["dropped 5.0 kg"]


@pytest.mark.parametrize("jerk", [-0.3, 0.2, 0.5])
def test_a_jerk_is_no_change(fake, jerk):
    """A winch that starts or brakes: kilograms more or less for 0.2 s, and "dropped 0.0 kg" after them."""
    flight = hovering(fake, weight=LOADED)
    flight.vehicle.weight = LOADED + jerk
    flight.run(0.2)
    flight.vehicle.weight = LOADED
    flight.run(2.0)
    assert said(flight) == ["carrying 5.0 kg"]


def test_the_mass_is_reported_at_its_rate_with_a_deviation(fake):
    flight = hovering(fake, weight=LOADED, report_hz=5.0)
    before = len(reports(flight))
    flight.run(2.0)
    news = reports(flight)[before:]
    assert len(news) == 10
    assert all(report.mass_kg == pytest.approx(5.0, abs=0.1) and 0.1 < report.std_kg < 0.3 for report in news)


def test_a_load_that_was_there_before_is_named_once(fake):
    flight = hovering(fake, weight=LOADED)
    flight.run(2.0)
    assert said(flight) == ["carrying 5.0 kg"]


def test_too_heavy_a_load_is_announced_once(fake):
    flight = hovering(fake)
    flight.vehicle.weight = 1.75
    flight.run(3.0)
    picked, heavy = said(flight)
    assert picked in ("picked up 7.5 kg", "picked up 7.6 kg")
    assert heavy in (
        "load of 7.5 kg is above the limit of 6.7 kg",
        "load of 7.6 kg is above the limit of 6.7 kg",
    )
    assert all(len(text) <= 50 for text in said(flight))


def test_a_whole_flight_without_a_load_has_nothing_to_say_and_reports_only_in_the_air(fake):
    scenario = (Takeoff(2.0), Hold(2.0), Land(0.7))
    flight = fake.Lockstep(settings(fake, scenario)).run_to(State.ENGAGED)
    flight.run(30.0, lambda: flight.service.finished is not None)
    assert flight.service.finished.successful
    assert said(flight) == []
    times = [time for time, _ in flight.sent(PayloadReport)]
    heights = flight.altitudes
    assert times and all(heights[(time - flight.start_us) // fake.tick_us - 1] > 0.3 for time in times)
    assert all(abs(report.mass_kg) < 0.3 for report in reports(flight))


def test_touching_the_ground_with_a_load_is_no_drop(fake):
    scenario = (Hold(1.0), Land(0.7))
    vehicle = fake.airborne(weight=LOADED, own_thrust=fake.hover * LOADED)
    flight = fake.Lockstep(settings(fake, scenario), vehicle)
    flight.run(30.0, lambda: flight.service.finished is not None)
    assert flight.vehicle.grounded
    assert said(flight) in ([], ["carrying 5.0 kg"])


def test_without_the_mass_of_the_vehicle_nothing_is_reported(fake):
    flight = fake.Lockstep(fake.settings(scenario=(Hold(100.0),)), fake.airborne()).run_to(State.ENGAGED)
    flight.run(2.0)
    flight.vehicle.weight = LOADED
    flight.run(1.0)
    assert said(flight) == [] and reports(flight) == []


# ----------------------------------------------------------------------- commanded release


RELEASE = (Hold(2.5), Gripper("release"), Hold(100.0))


def released(fake, open_s, **changes):
    flight = release_works(hovering(fake, RELEASE, LOADED, gripper_open_s=open_s, **changes), open_s or 0.0)
    assert not flight.sent(SetGripper)
    return flight


def test_a_commanded_release_moves_the_vehicle_a_tenth_as_far_as_a_surprise(fake):
    surprise = excursion(released(fake, None), 4.0)
    known = released(fake, 0.0)
    assert excursion(known, 4.0) <= 0.1 * surprise
    assert said(known)[1:] == ["dropped 5.0 kg"]
    assert abs(reports(known)[-1].mass_kg) <= 0.1


def test_a_slow_gripper_is_waited_for(fake):
    known = released(fake, 0.4)
    surprise = excursion(released(fake, None), 4.0)
    assert excursion(known, 4.0) <= 0.1 * surprise
    assert said(known)[1:] == ["dropped 5.0 kg"]


def test_the_gripper_of_slow_motors_waits_for_them(fake):
    """The load leaves at the centroid of the step of thrust, which is the lag after its arrival."""
    made = settings(fake)
    lag = replace(made.controller.actuator, lag=np.full(4, 0.05))
    controller = replace(made.controller, actuator=lag)
    plan = plan_release(made.payload, controller, 5.0, 0.01)
    assert plan.gripper_after_s == pytest.approx(0.01 + 0.05)
    assert plan.shows_after_s == pytest.approx(0.01 + 0.05 + 0.01)
    assert plan.disturbance_step == pytest.approx(0.5 * 9.80665)
    slow = plan_release(replace(made.payload, gripper_open_s=0.3), controller, 5.0, 0.01)
    assert (slow.gripper_after_s, slow.shows_after_s) == pytest.approx((0.0, 0.3 + 0.01))


def test_a_release_that_does_not_happen_is_survived_and_said(fake):
    flight = hovering(fake, RELEASE, LOADED)
    pick_up = hovering(fake)
    pick_up.vehicle.weight = LOADED
    assert excursion(flight, 4.0) <= 1.2 * excursion(pick_up, 4.0)
    assert said(flight)[1:] == ["release not seen: still 5.0 kg"]
    assert flight.service.state is State.ENGAGED
    assert abs(flight.vehicle.position - HEIGHT) <= 0.01
    assert reports(flight)[-1].mass_kg == pytest.approx(5.0, abs=0.1)


def test_a_refused_release_is_taken_back(fake):
    ignored = excursion(hovering(fake, RELEASE, LOADED), 4.0)
    flight = hovering(fake, RELEASE, LOADED)
    receive = flight.vehicle.receive
    refusal = events.CommandAnswered("gripper", 211, False, False, "FAILED")
    flight.vehicle.receive = lambda time_us, output: (
        [refusal] if isinstance(output, SetGripper) else receive(time_us, output)
    )
    assert excursion(flight, 4.0) <= 0.5 * ignored
    assert said(flight)[1:] == ["gripper refused: FAILED"]
    assert reports(flight)[-1].mass_kg == pytest.approx(5.0, abs=0.1)


def test_a_late_refusal_is_taken_back_too(fake):
    flight = hovering(fake, RELEASE, LOADED)
    flight.mute = {events.CommandAnswered}
    flight.run(3.0, lambda: bool(flight.sent(SetGripper)))
    flight.run(0.2)
    flight.mute = set()
    flight.give(events.CommandAnswered("gripper", 211, False, False, "FAILED"))
    flight.run(3.0)
    assert said(flight)[1:] == ["gripper refused: FAILED"]
    assert abs(flight.vehicle.position - HEIGHT) <= 0.01
    assert reports(flight)[-1].mass_kg == pytest.approx(5.0, abs=0.1)


def retold(flight, share):
    """The same with another hover thrust, as PARAM_SET of ALT_HOVER_THR gives it in flight."""
    made = flight.service.settings
    model, estimator = made.controller.model, made.payload.estimator
    b0 = model.b0 / np.array([1.0, 1.0, 1.0, share])
    return replace(
        made,
        hover_thrust=share * made.hover_thrust,
        controller=replace(made.controller, model=replace(model, b0=b0)),
        payload=replace(
            made.payload, estimator=replace(estimator, hover_thrust=share * estimator.hover_thrust)
        ),
    )


@pytest.mark.parametrize("share", [0.7, 1.15, 1.3])
def test_a_late_refusal_is_taken_back_with_another_hover_thrust_too(fake, share):
    """What the disturbance was before the release is then told by another model: thrust stepped by 0.2."""

    def thrust_after_refusal(settings_of):
        flight = hovering(fake, RELEASE, LOADED)
        flight.mute = {events.CommandAnswered}
        flight.run(3.0, lambda: bool(flight.sent(SetGripper)))
        flight.run(0.5)
        flight.mute = set()
        flight.give(events.SettingsChanged(settings_of(flight)))
        flight.give(events.CommandAnswered("gripper", 211, False, False, "FAILED"))
        flight.run(0.02)
        return flight.sent(AttitudeTarget)[-1][1].thrust

    as_it_was = thrust_after_refusal(lambda flight: flight.service.settings)
    assert thrust_after_refusal(lambda flight: retold(flight, share)) == pytest.approx(as_it_was, abs=0.02)


@pytest.mark.parametrize(("share", "told"), [(0.8, "carrying 8.7 kg"), (1.1, "carrying 3.6 kg")])
def test_another_hover_thrust_is_no_pick_up_and_no_drop(fake, share, told):
    """Thrust is weighed with it, so the load is another one in words; nobody brought or took any."""
    flight = hovering(fake, weight=LOADED, max_load_kg=None)
    assert said(flight) == ["carrying 5.0 kg"]
    flight.give(events.SettingsChanged(retold(flight, share)))
    flight.run(3.0)
    assert said(flight)[1:] == [told]
    flight.vehicle.weight = 1.2
    flight.run(1.0)
    assert said(flight)[2].startswith("dropped"), "what really leaves is seen again"


def test_a_gripper_without_a_load_is_only_worked(fake):
    flight = hovering(fake, RELEASE)
    assert excursion(flight, 2.0) <= 0.002
    assert [sent.action for _, sent in flight.sent(SetGripper)] == ["release"]
    assert said(flight) == []


# ----------------------------------------------------------------- somebody asks for it


def test_a_release_right_before_landing_is_still_announced(fake):
    flight = release_works(hovering(fake, (Hold(2.5), Gripper("release"), Land(0.7)), LOADED))
    flight.run(2.0)
    assert said(flight)[1:] == ["dropped 5.0 kg"]
    flight.run(20.0, lambda: flight.service.finished is not None)
    assert said(flight)[2:] == []


def test_a_requested_release_is_one_of_the_daemons_own(fake):
    flight = release_works(hovering(fake, weight=LOADED))
    surprise = release_works(hovering(fake, weight=LOADED, gripper_open_s=None))
    for each in (flight, surprise):
        each.give(events.GripperRequested("release"))
    assert excursion(flight, 3.0) <= 0.15 * excursion(surprise, 3.0)
    assert said(flight)[1:] == ["dropped 5.0 kg"]


def test_asking_twice_releases_once(fake):
    flight = release_works(hovering(fake, weight=LOADED))
    flight.give(events.GripperRequested("release"))
    flight.give(events.GripperRequested("release"))
    flight.run(1.0)
    assert len(flight.sent(SetGripper)) <= 2
    assert said(flight)[1:] == ["dropped 5.0 kg"]


@pytest.mark.parametrize("again_s", [0.1, 0.3, 0.38, 0.42])
def test_asking_again_while_the_gripper_opens_moves_neither_the_moment_nor_the_vehicle(fake, again_s):
    """The thrust stepped a second time, or at another moment than the load's: 4 cm up and 3 cm down."""
    flight = release_works(hovering(fake, weight=LOADED, gripper_open_s=0.4), 0.4)
    flight.give(events.GripperRequested("release"))
    assert excursion(flight, again_s) <= 0.003
    flight.give(events.GripperRequested("release"))
    assert flight.texts[-1] == "gripper not worked: a release is under way"
    assert not flight.sent(events.RequestRefused)[-1][1].final
    assert excursion(flight, 3.0) <= 0.003
    assert len(flight.sent(SetGripper)) == 1
    assert "dropped 5.0 kg" in said(flight)
    flight.give(events.GripperRequested("release"))
    assert len(flight.sent(SetGripper)) == 2, "its outcome is known: it may be asked for again"


def lagging(fake):
    """Motors that lag 0.2 s, so that the gripper's command waits that long."""
    made = settings(fake)
    actuators = replace(made.controller.actuator, lag=np.array([0.0, 0.0, 0.0, 0.2]))
    return replace(made, controller=replace(made.controller, actuator=actuators))


def test_a_pilot_who_takes_over_before_the_gripper_opens_keeps_the_load(fake):
    vehicle = fake.airborne(weight=LOADED, own_thrust=fake.hover * LOADED)
    flight = fake.Lockstep(lagging(fake), vehicle).run_to(State.ENGAGED)
    flight.run(2.0)
    flight.give(events.GripperRequested("release"))
    flight.run(0.1)
    assert not flight.sent(SetGripper)
    flight.vehicle.mode = ModeKind.OTHER
    flight.give(flight.vehicle.heartbeat())
    flight.run(1.0)
    assert not flight.sent(SetGripper)
    assert said(flight)[1:] == ["release called off"]


def test_the_gripper_is_worked_for_others_while_the_autopilot_flies(fake):
    flight = fake.Lockstep(settings(fake), fake.airborne())
    flight.service.settings = replace(flight.service.settings, engage=False)
    flight.give(events.GripperRequested("grab"))
    assert said(flight) == ["gripper not worked: no heartbeat"]
    flight.run(2.0)
    flight.give(events.GripperRequested("grab"))
    assert [sent.action for _, sent in flight.sent(SetGripper)] == ["grab"]


def test_in_shadow_the_gripper_is_left_alone(fake):
    flight = fake.Lockstep(replace(settings(fake), shadow=True), fake.airborne())
    flight.run(2.0)
    flight.give(events.GripperRequested("release"))
    assert not flight.sent(SetGripper)
    assert said(flight) == ["gripper not worked: shadow mode"]


def test_two_flights_with_a_release_are_the_same(fake):
    logs = []
    for _ in range(2):
        flight = released(fake, 0.0)
        flight.run(2.0)
        logs.append(repr(flight.log))
    assert logs[0] == logs[1]


@pytest.mark.parametrize("name", ["report_hz", "max_load_kg", "settle_s", "release_timeout_s"])
def test_numbers_that_make_no_sense_are_refused(fake, name):
    with pytest.raises(ValueError, match=f"payload.{name} = -1.0: must be positive"):
        payload_settings(fake, **{name: -1.0})


def test_a_load_that_comes_while_the_first_estimate_settles_is_named_whole(fake):
    flight = fake.Lockstep(settings(fake), fake.airborne()).run_to(State.ENGAGED)
    flight.vehicle.weight = LOADED
    flight.run(2.0)
    assert said(flight) in (["carrying 4.9 kg"], ["carrying 5.0 kg"], ["carrying 5.1 kg"])


def changes_of(fake, changes, told=0.0):
    """What is said about decided changes: (time [s], load after it, change)."""
    made = payload_settings(fake)
    state = structs.replace(
        begin_awareness(PayloadSample(0, 0.01, fake.hover, (0.0, 0.0, 0.0), 0.0, True, True)), told=told
    )
    said = []
    mass = told
    for k in range(1000):
        change = next((change for at, _, change in changes if round(at * 100) == k), 0.0)
        mass = next((after for at, after, _ in changes if round(at * 100) == k), mass)
        sample = PayloadSample(10_000 * k, 0.01, fake.hover, (0.0, 0.0, 0.0), 0.0, True, True)
        state, outputs = _watch_changes(made, state, Load(mass, 0.2), change, sample)
        said += [(round(k * 0.01, 1), output.text) for output in outputs]
    return said


def test_a_drop_without_a_load_is_not_believed_nor_what_follows_it(fake):
    """Thrust that swings on too slow a link: nothing is said until it has been quiet for 2 s."""
    swing = [(0.0, -2.4, -2.4), (0.3, 1.2, 3.6), (0.6, -2.9, -4.1), (0.9, 18.0, 20.9), (1.2, 0.0, -18.0)]
    assert changes_of(fake, swing) == []
    assert changes_of(fake, [*swing, (1.5, 5.0, 5.0)]) == [(3.5, "carrying 5.0 kg")]
    assert changes_of(fake, [(0.0, -2.0, -7.0), (0.3, 0.1, 2.1)], told=5.0) == [(2.3, "carrying no load")]


def test_more_than_was_carried_is_not_dropped(fake):
    assert changes_of(fake, [(1.0, 0.0, -6.6)], told=4.8)[0][1] == "carrying no load"
    assert changes_of(fake, [(1.0, 0.0, -4.9)], told=4.8) == [(1.0, "dropped 4.9 kg")]


def test_a_rest_is_told_when_it_is_four_deviations_and_exact(fake):
    """A tenth of a second after a drop PX4's samples left 0.7 kg of 5: "dropped 4.3 kg"."""
    assert changes_of(fake, [(1.0, 0.75, -4.25)], told=5.0) == [(1.0, "dropped 5.0 kg")]
    assert changes_of(fake, [(1.0, 0.85, -4.15)], told=5.0) == [(1.4, "dropped 4.2 kg")]
    noticed, exact = (1.0, 1.3, -2.8), (1.2, 0.45, 0.0)  # what real PX4 showed of 4.13 less 3.68 kg
    assert changes_of(fake, [noticed, exact], told=4.1) == [(1.4, "dropped 4.1 kg")], "0.45 of 0.6 are none"
    assert changes_of(fake, [noticed, (1.2, 0.8, 0.0)], told=4.1) == [(1.4, "dropped 3.3 kg")]


def test_a_load_that_leaves_during_a_landing_is_announced(fake):
    vehicle = fake.airborne(weight=LOADED, own_thrust=fake.hover * LOADED, position=8.0)
    flight = fake.Lockstep(settings(fake, (Hold(2.0), Land(0.7))), vehicle).run_to(State.ENGAGED)
    flight.run(20.0, lambda: flight.vehicle.position < 5.0)
    flight.vehicle.weight = 1.0
    flight.run(0.4)
    assert said(flight) == ["carrying 5.0 kg", "dropped 5.0 kg"]
    flight.run(20.0, lambda: flight.service.finished is not None)
    assert flight.service.finished.successful and said(flight)[2:] == []
