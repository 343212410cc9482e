"""Waiting, ready, engaging: what is asked when, what is refused and why."""

from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs

from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget, ModeKind, SetArmed, SetMode
from kffa_offboard.offboard.segments import Hold, Land, Takeoff
from kffa_offboard.offboard.service import Finished, State

OFFBOARD = SetMode(ModeKind.OFFBOARD)


def seconds_of(flight, output):
    return [(time - flight.start_us) * 1e-6 for time, sent in flight.log if sent == output]


def engaged_at(flight):
    return next((time - flight.start_us) * 1e-6 for time, text in announced(flight) if "engaging" in text)


def announced(flight):
    return [(time, output.text) for time, output in flight.sent(events.Announce)]


# ---------------------------------------------------------------------------- telemetry


def test_the_first_heartbeat_brings_the_request_for_telemetry(fake):
    flight = fake.Lockstep(fake.settings())
    assert flight.service.next_deadline() is None
    flight.run(0.05)
    assert flight.sent(events.RequestMessageRates) == [
        (flight.start_us + 10_000, events.RequestMessageRates(100.0, 100.0, 20.0, 5.0))
    ]


def test_the_request_is_repeated_every_second_while_too_little_arrives_and_then_no_more(fake):
    settings = fake.settings()
    settings = replace(settings, telemetry=replace(settings.telemetry, request_limit=4))
    flight = fake.Lockstep(settings)
    flight.mute = {events.PositionReceived}
    flight.run(8.0)
    times = [(time - flight.start_us) * 1e-6 for time, _ in flight.sent(events.RequestMessageRates)]
    assert times == pytest.approx([0.01, 1.01, 2.01, 3.01])
    assert flight.texts == ["no position comes; has the autopilot an estimate, and the link room?"]


def test_a_refused_telemetry_rate_is_announced_once(fake):
    flight = fake.Lockstep(fake.settings(engage=False))
    flight.run(0.5)
    for _ in range(3):
        flight.give(events.CommandAnswered("message-rate", 511, False, False, "DENIED"))
    assert flight.texts == ["message-rate refused: DENIED"]


def test_ready_after_telemetry_has_settled(fake):
    flight = fake.Lockstep(fake.settings(engage=False))
    flight.run_to(State.READY)
    assert (flight.time_us - flight.start_us) * 1e-6 == pytest.approx(1.02, abs=0.02)


@pytest.mark.parametrize(
    "missing", [events.PositionReceived, events.AttitudeReceived, events.HeartbeatReceived]
)
def test_not_ready_while_a_message_is_missing(fake, missing):
    flight = fake.Lockstep(fake.settings())
    flight.mute = {missing}
    flight.run(3.0)
    assert flight.service.state is State.WAITING


def test_not_ready_at_too_low_a_rate(fake):
    settings = fake.settings()
    settings = replace(settings, telemetry=replace(settings.telemetry, minimum_attitude_hz=126.0))
    flight = fake.Lockstep(settings)
    flight.run(3.0)
    flight.give(events.EngageRequested())
    assert flight.service.state is State.WAITING
    assert flight.texts[-1] == "not engaged: attitude telemetry 100 Hz, 101 needed"


def test_a_break_in_telemetry_while_ready_starts_anew(fake):
    flight = fake.Lockstep(fake.settings(engage=False)).run_to(State.READY)
    flight.mute = {events.PositionReceived}
    flight.run(0.3)
    assert flight.service.state is State.WAITING
    assert flight.texts[-1] == "not ready: no position for 0.25 s"
    assert flight.service.finished is None
    flight.mute = set()
    flight.run(0.9)
    assert flight.service.state is State.WAITING
    flight.run_to(State.READY, 0.3)


def test_every_attitude_sample_makes_one_control_step_in_every_state(fake):
    flight = fake.Lockstep(fake.settings())
    flight.run(40.0, lambda: flight.service.finished is not None)
    signals = [output for _, output in flight.sent(events.Signals)]
    ticks = (flight.time_us - flight.start_us) // fake.tick_us
    assert len(signals) == ticks - 1
    states = list(dict.fromkeys(signal.state for signal in signals))
    assert states == ["waiting", "engaging", "engaged", "releasing", "ready"]
    assert all(signal.dt == pytest.approx(0.01) for signal in signals)


def test_in_shadow_the_observer_is_told_what_the_autopilot_applies(fake):
    flight = fake.Lockstep(fake.settings(shadow=True), fake.airborne(attitude=np.array([0.2, 0.0, 0.0])))
    flight.run(1.0)
    signal = flight.sent(events.Signals)[-1][1]
    vehicle = flight.vehicle
    expected = vehicle.applied * np.cos(vehicle.attitude[0])
    assert signal.applied[3] == pytest.approx(expected, rel=1e-3)
    assert signal.applied[0] == pytest.approx(vehicle.rates[0], abs=0.02)


def test_in_shadow_the_disturbance_estimate_follows_the_load(fake):
    flight = fake.Lockstep(fake.settings(shadow=True), fake.airborne())
    flight.run(1.0)
    assert flight.sent(events.Signals)[-1][1].disturbance[3] == pytest.approx(-9.8, abs=0.1)
    flight.vehicle.weight, flight.vehicle.own_thrust = 1.3, 1.3 * fake.hover
    flight.run(2.0)
    assert flight.sent(events.Signals)[-1][1].disturbance[3] == pytest.approx(-1.3 * 9.8, abs=0.1)


def test_in_shadow_the_reference_starts_from_what_is_estimated(fake):
    flight = fake.Lockstep(fake.settings(shadow=True), fake.Vehicle(attitude=np.array([0.2, 0.0, 0.0])))
    flight.run(1.0)
    signal = flight.sent(events.Signals)[-1][1]
    assert signal.reference[0] == pytest.approx(0.2, abs=0.005)


def test_without_a_reported_target_the_throttle_counts_and_then_hover_thrust(fake):
    flight = fake.Lockstep(fake.settings(shadow=True), fake.airborne(reports_target=False))
    flight.run(1.0)
    assert flight.sent(events.Signals)[-1][1].applied[3] == pytest.approx(fake.hover)
    flight.give(events.ThrottleReported(0.25))
    flight.run(0.1)
    assert flight.sent(events.Signals)[-1][1].applied[3] == pytest.approx(0.25, rel=1e-3)


# ----------------------------------------------------------------------------- engaging


@pytest.mark.parametrize("firmware", ["px4", "ardupilot"])
def test_stream_then_mode_then_arm(fake, firmware):
    flight = fake.Lockstep(fake.settings(), fake.Vehicle(firmware=firmware)).run_to(State.ENGAGED)
    start = engaged_at(flight)
    first_setpoint = (flight.sent(AttitudeTarget)[0][0] - flight.start_us) * 1e-6
    assert first_setpoint - start == pytest.approx(0.01)
    assert seconds_of(flight, OFFBOARD) == pytest.approx([start + 0.3])
    assert len(seconds_of(flight, SetArmed(True))) == 1
    assert seconds_of(flight, SetArmed(True))[0] > seconds_of(flight, OFFBOARD)[0]
    assert all(target.thrust == 0.0 for _, target in flight.sent(AttitudeTarget))


@pytest.mark.parametrize("answers", [True, False])
def test_the_mode_is_asked_for_every_half_second_and_given_up_after_five(fake, answers):
    flight = fake.Lockstep(fake.settings(), fake.Vehicle(grants_mode=False, answers=answers))
    flight.run_to(State.ENGAGING).run_to(State.READY)
    start = engaged_at(flight) + 0.3
    assert seconds_of(flight, OFFBOARD) == pytest.approx([start + 0.5 * k for k in range(10)])
    assert (flight.time_us - flight.start_us) * 1e-6 == pytest.approx(start + 5.0, abs=0.02)
    assert flight.texts[-1] == "not engaged: no OFFBOARD mode in 5 s"
    assert flight.texts.count("mode refused: DENIED") == (1 if answers else 0)
    flight.log.clear()
    flight.run(3.0)
    assert not flight.sent(AttitudeTarget) and flight.service.state is State.READY


def test_arming_is_asked_for_every_second_and_given_up_in_the_end(fake):
    settings = fake.settings()
    settings = replace(settings, sequence=replace(settings.sequence, arm_timeout_s=6.0))
    flight = fake.Lockstep(settings, fake.Vehicle(grants_arming=False)).run_to(State.ENGAGING)
    flight.run_to(State.READY)
    times = seconds_of(flight, SetArmed(True))
    assert np.diff(times) == pytest.approx(np.ones(5))
    assert flight.texts.count("arm refused: DENIED") == 1
    assert "not engaged: not armed in 6 s" in flight.texts
    undone = seconds_of(flight, SetArmed(False))
    assert undone == pytest.approx(times[0] + 6.0 + 0.5 * np.arange(20)), "disarming was refused, too"
    assert "may still arm: keep away" in flight.texts
    assert flight.service.finished is None, "it may be engaged again"


def test_arming_that_takes_effect_after_it_was_given_up_is_undone(fake):
    """On a link that loses the first request to disarm, and every answer."""
    flight = fake.Lockstep(fake.settings(), fake.Vehicle(grants_arming=False, answers=False))
    flight.run_to(State.ENGAGING).run_to(State.RELEASING, 40.0)
    assert "not engaged: not armed in 30 s" in flight.texts
    flight.vehicle.armed = True
    flight.give(flight.vehicle.heartbeat())
    flight.vehicle.grants_arming = True
    flight.run_to(State.READY, 2.1)
    assert not flight.vehicle.armed
    assert not any(target.thrust for _, target in flight.sent(AttitudeTarget))
    assert flight.service.finished is None


def test_an_accepted_command_is_not_repeated(fake):
    flight = fake.Lockstep(fake.settings()).run_to(State.ENGAGING)
    flight.mute = {events.HeartbeatReceived}
    flight.run(2.0)
    assert len(flight.sent(SetMode)) == 1


def test_a_vehicle_that_a_person_may_arm_idles_until_then(fake):
    flight = fake.Lockstep(fake.settings(arm=False)).run_to(State.ENGAGING)
    flight.run(3.0)
    assert flight.service.state is State.ENGAGING and not flight.sent(SetArmed)
    assert "flies as soon as a person arms" in flight.texts
    flight.vehicle.set_armed(flight.time_us, True)
    flight.run_to(State.ENGAGED, 1.5)
    assert all(target.thrust == 0.0 for _, target in flight.sent(AttitudeTarget))


def test_waiting_for_a_person_ends(fake):
    settings = fake.settings(arm=False)
    settings = replace(settings, sequence=replace(settings.sequence, person_arm_timeout_s=4.0))
    flight = fake.Lockstep(settings).run_to(State.ENGAGING)
    flight.run_to(State.READY)
    assert flight.texts[-1] == "not engaged: nobody armed in 4 s"


def test_it_does_not_engage_unasked(fake):
    flight = fake.Lockstep(fake.settings(engage=False))
    flight.run(4.0)
    assert flight.service.state is State.READY
    kinds = {type(output) for _, output in flight.log}
    assert kinds == {events.RequestMessageRates, events.Announce, events.Signals, events.OwnHeartbeat}


def test_a_request_engages_when_ready(fake):
    flight = fake.Lockstep(fake.settings(engage=False)).run_to(State.READY)
    flight.give(events.EngageRequested())
    assert flight.service.state is State.ENGAGING


@pytest.mark.parametrize(
    ("changes", "vehicle", "words"),
    [
        ({"shadow": True}, {}, "shadow mode"),
        ({"scenario": (Hold(1.0), Land(0.5))}, {}, "on the ground, and no take-off first"),
        ({"scenario": ()}, {}, "on the ground, and no take-off first"),
        (
            {},
            {"armed": True, "reports_landed": False, "reports_target": False},
            "cannot tell whether it flies",
        ),
        (
            {},
            {"armed": True, "position": 60.0, "mode": ModeKind.HOLD},
            "altitude 60.0 m outside -3.0 .. 50.0",
        ),
    ],
)
def test_engaging_is_refused_with_the_reason(fake, changes, vehicle, words):
    flight = fake.Lockstep(fake.settings(engage=False, **changes), fake.Vehicle(**vehicle)).run_to(
        State.READY
    )
    flight.give(events.EngageRequested())
    assert flight.service.state is State.READY
    assert flight.texts[-1] == f"not engaged: {words}"


def test_a_landed_state_that_the_thrust_contradicts_does_not_engage(fake):
    flight = fake.Lockstep(fake.settings(engage=False), fake.airborne()).run_to(State.READY)
    flight.change = lambda event: (
        structs.replace(event, on_ground=True) if isinstance(event, events.LandedStateReported) else event
    )
    flight.run(0.5)
    flight.give(events.EngageRequested())
    assert flight.texts[-1] == "not engaged: cannot tell whether it flies"


def test_an_old_landed_state_does_not_tell_that_a_vehicle_stands(fake):
    """All that tells of the ground is lost; then the pilot takes off, and zero thrust would be a fall."""
    vehicle = fake.Vehicle(mode=ModeKind.HOLD, armed=True, armed_us=-10_000_000)
    flight = fake.Lockstep(fake.settings(engage=False), vehicle).run_to(State.READY)
    vehicle.reports_landed = vehicle.reports_target = False
    vehicle.own_thrust = 1.05 * fake.hover
    flight.run(3.2)
    vehicle.own_thrust = None
    flight.run(1.0)
    assert vehicle.position > 2.0
    flight.give(events.EngageRequested())
    assert flight.texts[-1] == "not engaged: cannot tell whether it flies"


@pytest.mark.parametrize("reports_landed", [True, False])
def test_a_pilot_who_takes_off_before_the_mode_is_granted_does_not_get_zero_thrust(fake, reports_landed):
    vehicle = fake.Vehicle(mode=ModeKind.HOLD, grants_mode=False, reports_landed=reports_landed)
    flight = fake.Lockstep(fake.settings(arm=False), vehicle).run_to(State.ENGAGING)
    vehicle.armed, vehicle.armed_us = True, -10_000_000
    vehicle.own_thrust = 1.1 * fake.hover
    flight.run(2.0)
    vehicle.grants_mode = True
    flight.run(2.0)
    assert "control given up: it flies" in flight.texts
    assert flight.service.state is State.READY
    assert vehicle.mode is ModeKind.HOLD and vehicle.position > 2.0


def test_a_vehicle_that_falls_with_little_thrust_is_not_on_the_ground(fake):
    vehicle = fake.airborne(position=20.0, reports_landed=False)
    flight = fake.Lockstep(fake.settings(engage=False), vehicle).run_to(State.READY)
    vehicle.own_thrust = 0.4 * fake.hover
    flight.run(0.2)
    flight.give(events.EngageRequested())
    assert flight.texts[-1] == "not engaged: cannot tell whether it flies"
    vehicle.own_thrust = None
    flight.run(3.0)
    flight.give(events.EngageRequested())
    assert flight.texts[-1] == "engaging in the air"


# ------------------------------------------------------------------- engaging in the air


@pytest.mark.parametrize("output", ["rates", "attitude"])
@pytest.mark.parametrize("weight", [1.0, 1.3])
def test_engaging_in_the_air_begins_with_the_thrust_that_the_autopilot_applied(fake, output, weight):
    vehicle = fake.airborne(weight=weight, own_thrust=fake.hover * weight)
    flight = fake.Lockstep(fake.settings(output, scenario=(Hold(5.0),)), vehicle).run_to(State.ENGAGING)
    flight.run_to(State.ENGAGED, 5.0)
    sent = flight.sent(AttitudeTarget)
    before = vehicle.own_thrust
    assert sent[0][1].thrust == pytest.approx(before, rel=0.02)
    flight.run(3.0)
    thrusts = np.array([target.thrust for _, target in flight.sent(AttitudeTarget)])
    np.testing.assert_allclose(thrusts, before, rtol=0.02)
    assert abs(flight.vehicle.position - 3.0) < 0.02


def test_the_first_thrust_is_the_autopilots_even_if_the_observer_thinks_otherwise(fake):
    """A report of 10 % more than what acts: the blend hides the difference and then fades."""
    flight = fake.Lockstep(
        fake.settings(scenario=(Hold(9.0),), engage=False), fake.airborne(reports_target=False)
    )
    flight.run_to(State.READY)
    flight.give(events.ThrottleReported(1.1 * fake.hover))
    flight.give(events.EngageRequested())
    flight.tick()
    assert flight.sent(AttitudeTarget)[0][1].thrust == pytest.approx(1.1 * fake.hover, rel=0.005)
    flight.run(4.0)
    assert flight.service.state is State.ENGAGED
    reference = flight.sent(events.Signals)[-1][1].reference[3]
    assert flight.vehicle.applied == pytest.approx(fake.hover, rel=0.005)
    assert flight.vehicle.position == pytest.approx(reference, abs=0.005)


@pytest.mark.parametrize("reported", [40.0, 1.5, -1.0])
def test_a_reported_thrust_that_is_none_does_not_move_the_vehicle(fake, reported):
    """A throttle in percent, say: taken for thrust, it engaged with 0.95 and climbed to the limits."""
    flight = fake.Lockstep(fake.settings(scenario=(Hold(100.0),)), fake.airborne())
    flight.change = lambda event: (
        structs.replace(event, thrust=reported) if isinstance(event, events.TargetReported) else event
    )
    flight.run_to(State.ENGAGED)
    flight.run(3.0)
    thrusts = [target.thrust for _, target in flight.sent(AttitudeTarget)]
    np.testing.assert_allclose(thrusts, fake.hover, rtol=0.02)


def test_a_difference_in_thrust_at_the_change_of_mode_fades(fake):
    vehicle = fake.airborne(reports_target=False)
    flight = fake.Lockstep(fake.settings(scenario=(), engage=False), vehicle).run_to(State.READY)
    flight.give(events.EngageRequested())
    flight.run(0.29)
    flight.give(events.ThrottleReported(1.1 * fake.hover))
    flight.tick()
    flight.tick()
    assert flight.sent(AttitudeTarget)[-1][1].thrust == pytest.approx(1.1 * fake.hover, rel=0.01)
    flight.run(4.0)
    reference = flight.sent(events.Signals)[-1][1].reference[3]
    assert flight.vehicle.position == pytest.approx(reference, abs=0.005)


def test_until_the_mode_is_granted_the_observer_is_told_the_autopilots_own_command(fake):
    vehicle = fake.airborne(attitude=np.array([0.3, 0.0, 0.0]), reports_target=False)
    flight = fake.Lockstep(fake.settings(scenario=()), vehicle).run_to(State.ENGAGING)
    flight.vehicle.rates = np.array([0.4, 0.0, 0.0])
    flight.tick()
    before = flight.sent(events.Signals)[-1][1]
    assert before.applied[0] == pytest.approx(flight.vehicle.rates[0])
    assert abs(before.command[0] - before.applied[0]) > 0.1
    flight.run(1.0, lambda: flight.vehicle.mode is ModeKind.OFFBOARD)
    flight.run(0.02)
    after = flight.sent(events.Signals)[-1][1]
    assert after.state == "engaging" and after.applied == after.command


def test_engaging_in_the_air_holds_height_and_heading(fake):
    vehicle = fake.airborne(attitude=np.array([0.05, -0.05, 0.5]))
    flight = fake.Lockstep(fake.settings(scenario=()), vehicle).run_to(State.ENGAGED)
    heights = np.array(flight.altitudes[-100:])
    flight.run(6.0)
    assert np.max(np.abs(np.array(flight.altitudes) - heights[0])) < 0.05
    reference = flight.sent(events.Signals)[-1][1].reference
    assert np.abs(flight.vehicle.attitude[:2]).max() < 0.01
    assert flight.vehicle.attitude[2] == pytest.approx(reference[2], abs=0.01)
    assert flight.service.state is State.ENGAGED


def test_the_scenario_in_the_air_climbs_without_a_ramp(fake):
    flight = fake.Lockstep(fake.settings(scenario=(Takeoff(5.0, 1.0), Hold(1.0))), fake.airborne())
    flight.run_to(State.ENGAGED)
    flight.run(4.5)
    assert flight.vehicle.position == pytest.approx(5.0, abs=0.1)
    assert min(target.thrust for _, target in flight.sent(AttitudeTarget)) > 0.7 * fake.hover


# ------------------------------------------------------------------------ parameters

THRUST = events.ParameterProblem("GUID_OPTIONS", "unsafe", "GUID_OPTIONS bit 3 is off; set GUID_OPTIONS 8")
BOOST = events.ParameterProblem("ATC_ANGLE_BOOST", "warning", "ATC_ANGLE_BOOST 1; set ATC_ANGLE_BOOST 0")


def test_the_service_is_not_ready_while_parameters_are_being_read(fake):
    flight = fake.Lockstep(fake.settings())
    flight.give(events.ParametersChecked((), complete=False))
    flight.run(3.0)
    assert flight.service.state is State.WAITING
    flight.give(events.ParametersChecked((BOOST,)))
    flight.run_to(State.ENGAGED)
    assert BOOST.text in flight.texts


def test_an_unsafe_parameter_forbids_engaging_and_ends_a_run_that_was_to_engage(fake):
    flight = fake.Lockstep(fake.settings())
    flight.give(events.ParametersChecked((THRUST,)))
    flight.run(3.0)
    assert flight.service.finished == Finished(False, f"not engaged: {THRUST.text}")
    assert not flight.sent((events.AttitudeTarget, events.SetMode, events.SetArmed))


def test_a_run_that_only_watches_goes_on_and_may_engage_once_the_parameter_is_right(fake):
    flight = fake.Lockstep(fake.settings(engage=False))
    flight.give(events.ParametersChecked((THRUST,)))
    flight.run_to(State.READY)
    flight.give(events.EngageRequested())
    assert flight.service.state is State.READY
    assert flight.texts[-1] == f"not engaged: {THRUST.text}"
    flight.give(events.ParametersChecked(()))
    flight.give(events.EngageRequested())
    flight.run_to(State.ENGAGED)


def test_a_problem_is_announced_once(fake):
    flight = fake.Lockstep(fake.settings(engage=False))
    for _ in range(3):
        flight.give(events.ParametersChecked((), complete=False))
        flight.give(events.ParametersChecked((BOOST,)))
    assert flight.texts == [BOOST.text]
