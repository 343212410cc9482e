"""The pilot wins at once, silence wins too, and what cannot be true is not flown on."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest
from msgspec import structs

from kffa_offboard.control import vehicle
from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget, ModeKind, SetArmed, SetMode, Severity
from kffa_offboard.offboard.segments import Takeoff
from kffa_offboard.offboard.service import Finished, State

SENT = (AttitudeTarget, SetMode, SetArmed, events.SetGripper)


def assert_silent(flight, seconds=3.0):
    flight.log.clear()
    flight.run(seconds)
    assert not flight.sent(SENT)


def assert_failsafe(flight, reason):
    assert flight.service.state is State.FAILSAFE
    assert flight.service.finished == Finished(False, f"failsafe: {reason}")
    assert (Severity.CRITICAL, f"failsafe: {reason}") in [
        (output.severity, output.text) for _, output in flight.sent(events.Announce)
    ]


# ------------------------------------------------------------------------------ the pilot


@pytest.mark.parametrize("mode", [ModeKind.OTHER, ModeKind.HOLD, ModeKind.LAND])
def test_another_mode_ends_sending_within_the_same_call(fake, mode):
    flight = fake.hovering()
    flight.vehicle.mode = mode
    flight.give(flight.vehicle.heartbeat())
    assert flight.service.state is State.READY
    assert flight.service.finished is None
    assert flight.texts == [f"control given up: mode {mode.name}"]
    assert_silent(flight)


@pytest.mark.parametrize("action", ["stop", "hold", "land"])
def test_a_daemon_that_hung_gives_control_up_in_silence(fake, action):
    """The autopilot's own failsafe flies by then, or a pilot: neither is to be disturbed."""
    flight = fake.hovering(failsafe_action=action)
    flight.give(events.HangNoticed(3.04))
    assert flight.texts == ["control given up: the daemon hung for 3.0 s"]
    assert not flight.sent(SENT)
    assert_silent(flight)


def test_a_daemon_that_hung_while_it_asked_for_land_mode_asks_no_more(fake):
    flight = fake.hovering(failsafe_action="land")
    flight.vehicle.grants_mode = False
    flight.mute = {events.AttitudeReceived}
    flight.run_to(State.FAILSAFE, 0.3)
    assert flight.sent(SetMode)
    flight.give(events.HangNoticed(3.0))
    assert flight.service.finished == Finished(False, "failsafe: no attitude for 0.25 s")
    assert_silent(flight)


def test_another_mode_of_the_same_kind_is_the_pilots_too(fake):
    flight = fake.hovering()
    flight.give(structs.replace(flight.vehicle.heartbeat(), custom_mode=20, mode_name="GUIDED_NOGPS"))
    assert flight.texts == ["control given up: mode GUIDED_NOGPS"]
    assert_silent(flight)


def test_disarming_in_flight_ends_sending(fake):
    flight = fake.hovering()
    flight.vehicle.armed = False
    flight.give(flight.vehicle.heartbeat())
    assert flight.texts == ["control given up: disarmed"]
    assert_silent(flight)


def test_after_the_pilot_took_over_only_a_request_engages_again(fake):
    flight = fake.hovering()
    flight.vehicle.mode = ModeKind.HOLD
    flight.give(flight.vehicle.heartbeat())
    assert_silent(flight, 5.0)
    flight.vehicle.mode = ModeKind.OFFBOARD  # even this is no request
    assert_silent(flight, 3.0)
    flight.vehicle.mode = ModeKind.HOLD
    flight.run(1.5)
    flight.give(events.EngageRequested())
    flight.run_to(State.ENGAGED, 3.0)


def test_the_pilot_wins_while_engaging(fake):
    flight = fake.Lockstep(fake.settings(), fake.airborne(grants_mode=False)).run_to(State.ENGAGING)
    flight.run(0.5)
    flight.vehicle.mode = ModeKind.OTHER
    flight.give(flight.vehicle.heartbeat())
    assert flight.service.state is State.READY
    assert_silent(flight)


def test_a_mode_that_was_granted_and_taken_back_is_not_asked_for_again(fake):
    flight = fake.Lockstep(fake.settings(), fake.airborne()).run_to(State.ENGAGING)
    flight.run(5.0, lambda: flight.vehicle.mode is ModeKind.OFFBOARD)
    flight.mute = {events.HeartbeatReceived}
    flight.vehicle.mode = ModeKind.HOLD
    flight.run(0.2)
    flight.mute = set()
    flight.give(flight.vehicle.heartbeat())
    assert flight.service.state is State.ENGAGING, "a heartbeat this early may be an old one"
    flight.mute = {events.HeartbeatReceived}
    flight.run(0.3)
    flight.mute = set()
    flight.give(flight.vehicle.heartbeat())
    assert flight.service.state is State.READY
    assert len(flight.sent(SetMode)) == 1
    assert_silent(flight)


def test_disarming_while_engaging_ends_it(fake):
    flight = fake.Lockstep(fake.settings(), fake.airborne()).run_to(State.ENGAGING)
    flight.vehicle.armed = False
    flight.give(flight.vehicle.heartbeat())
    assert flight.texts[-1] == "control given up: disarmed"
    assert_silent(flight)


@pytest.mark.parametrize("change", [{"armed": False}, {"mode": ModeKind.OTHER}])
def test_the_pilot_wins_while_releasing(fake, change):
    flight = fake.hovering()
    flight.vehicle.grants_mode = False
    flight.give(events.ReleaseRequested("by hand"))
    for name, value in change.items():
        setattr(flight.vehicle, name, value)
    flight.give(flight.vehicle.heartbeat())
    assert flight.service.finished == Finished(True, "by hand")
    assert_silent(flight)


# -------------------------------------------------------------------------------- shadow


def test_in_shadow_nothing_is_sent_but_requests_heartbeats_and_lines(fake):
    flight = fake.Lockstep(fake.settings(shadow=True), fake.airborne())
    flight.run(2.0)
    flight.give(events.EngageRequested())
    flight.give(events.GripperRequested("release"))
    flight.run(1.0)
    flight.vehicle.mode = ModeKind.OFFBOARD
    flight.run(2.0)
    kinds = {type(output) for _, output in flight.log}
    to_vehicle = {events.RequestMessageRates, events.Announce, events.OwnHeartbeat}
    assert kinds == to_vehicle | {events.Signals, events.RequestRefused}


# ------------------------------------------------------------------------------ failsafe


@pytest.mark.parametrize(
    ("kind", "seconds", "reason"),
    [
        (events.AttitudeReceived, 0.25, "no attitude for 0.25 s"),
        (events.PositionReceived, 0.25, "no position for 0.25 s"),
        (events.HeartbeatReceived, 3.0, "no heartbeat for 3 s"),
    ],
)
def test_silence_is_a_failsafe_at_its_nominal_time(fake, kind, seconds, reason):
    flight = fake.hovering()
    flight.run(1.1, lambda: (flight.time_us - flight.start_us) // fake.tick_us % 100 == 1)
    flight.mute = {kind}
    silent_since = flight.time_us
    flight.run(4.0, lambda: flight.service.finished is not None)
    assert_failsafe(flight, reason)
    (time,) = [when for when, said in flight.sent(events.Announce) if said.text == f"failsafe: {reason}"]
    assert (time - silent_since) * 1e-6 == pytest.approx(seconds)
    flight.mute = set()
    assert_silent(flight)


def test_an_event_that_comes_after_the_timeout_finds_the_failsafe_already_there(fake):
    flight = fake.hovering()
    now = flight.time_us + 300_000
    outputs = flight.service.handle(now, events.AttitudeReceived(now, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert flight.service.state is State.FAILSAFE
    announced = next(k for k, output in enumerate(outputs) if "failsafe" in getattr(output, "text", ""))
    assert not any(isinstance(output, AttitudeTarget) for output in outputs[announced:])


def test_a_frozen_stream_is_a_failsafe(fake):
    flight = fake.hovering()
    frozen = flight.time_us
    flight.change = lambda event: (
        structs.replace(event, sample_time_us=frozen) if isinstance(event, events.AttitudeReceived) else event
    )
    flight.run(0.3)
    assert flight.service.state is State.FAILSAFE
    assert flight.service.counts[0] > 15


def test_single_repeated_samples_are_tolerated(fake):
    flight = fake.hovering()
    flight.change = lambda event: (
        structs.replace(event, sample_time_us=event.sample_time_us - event.sample_time_us % 20_000)
        if isinstance(event, events.AttitudeReceived)
        else event
    )
    flight.run(2.0)
    assert flight.service.state is State.ENGAGED
    assert flight.service.counts[0] == pytest.approx(100, abs=2)


@pytest.mark.parametrize(
    ("kind", "changes", "reason"),
    [
        (events.AttitudeReceived, {"attitude": (nan, 0.0, 0.0)}, "attitude is not finite"),
        (events.AttitudeReceived, {"body_rates": (0.0, nan, 0.0)}, "attitude is not finite"),
        (events.PositionReceived, {"position": (0.0, 0.0, nan)}, "position is not finite"),
        (events.AttitudeReceived, {"attitude": (0.5, 0.0, 0.0)}, "attitude jumped 0.50 rad, 0.30 possible"),
        (events.PositionReceived, {"position": (0.0, 0.0, 9.0)}, "altitude jumped 6.00 m, 0.60 possible"),
    ],
)
def test_what_cannot_be_true_is_a_failsafe_within_the_same_call(fake, kind, changes, reason):
    flight = fake.hovering()
    flight.change = lambda event: structs.replace(event, **changes) if isinstance(event, kind) else event
    flight.tick()
    assert flight.service.state is State.FAILSAFE
    assert flight.texts[0].startswith(f"failsafe: {reason[:15]}")
    last = flight.sent(events.Announce)[0]
    position = flight.log.index(last)
    assert not any(isinstance(output, AttitudeTarget) for _, output in flight.log[position:])
    flight.change = lambda event: event
    assert_silent(flight)


def test_tilt_out_of_limits_is_a_failsafe(fake):
    flight = fake.hovering()
    rolling = [0.0]

    def roll(event):
        if not isinstance(event, events.AttitudeReceived):
            return event
        rolling[0] += 0.05
        return structs.replace(event, attitude=(rolling[0], 0.0, 0.0), body_rates=(5.0, 0.0, 0.0))

    flight.change = roll
    flight.run(0.5)
    assert_failsafe(flight, "tilt beyond 1.05 rad")


def test_altitude_out_of_limits_is_a_failsafe(fake):
    settings = fake.settings()
    flight = fake.hovering(limits=replace(settings.limits, altitude_max_m=3.5))
    flight.vehicle.weight = 0.5
    for climb_rate in (1.0, 2.0, 3.0):  # as fast as a climb rate is believed
        flight.vehicle.velocity = climb_rate
        flight.run(0.01)
    flight.run(2.0)
    assert flight.service.state is State.FAILSAFE
    assert "altitude 3.5 m outside -3.0 .. 3.5" in flight.texts[0]


@pytest.mark.parametrize(("action", "mode"), [("hold", ModeKind.HOLD), ("land", ModeKind.LAND)])
def test_the_configured_action_asks_for_a_mode_and_sends_no_setpoint(fake, action, mode):
    flight = fake.hovering(failsafe_action=action)
    flight.mute = {events.PositionReceived}
    flight.run(0.4)
    assert [sent.mode for _, sent in flight.sent(SetMode)] == [mode]
    assert_failsafe(flight, "no position for 0.25 s")
    assert flight.vehicle.mode is mode
    assert_silent(flight)


def test_a_failsafe_mode_is_asked_for_again_while_unanswered(fake):
    flight = fake.hovering(failsafe_action="hold")
    flight.vehicle.grants_mode = flight.vehicle.answers = False
    flight.mute = {events.AttitudeReceived}
    flight.run(4.0)
    times = [time * 1e-6 for time, _ in flight.sent(SetMode)]
    assert np.diff(times) == pytest.approx([0.5, 0.5, 0.5])
    assert flight.service.finished is not None


def test_a_failsafe_on_the_ground_disarms_what_was_armed_here(fake):
    flight = fake.Lockstep(fake.settings(failsafe_action="hold")).run_to(State.ENGAGED)
    flight.mute = {events.AttitudeReceived}
    flight.run(0.4)
    assert flight.service.state is State.FAILSAFE
    assert not flight.vehicle.armed
    assert not any(sent.mode is ModeKind.HOLD for _, sent in flight.sent(SetMode))


def test_a_failsafe_before_control_was_asked_for_asks_for_no_mode(fake):
    flight = fake.Lockstep(fake.settings(failsafe_action="land"), fake.airborne()).run_to(State.ENGAGING)
    flight.mute = {events.AttitudeReceived}
    flight.run(0.28)
    assert flight.service.state is State.FAILSAFE
    assert not flight.sent(SetMode)


@pytest.mark.parametrize("answers", [True, False])
def test_a_failsafe_before_control_was_granted_leaves_the_pilot_the_vehicle(fake, answers):
    """OFFBOARD is refused, or not answered, again and again; then telemetry is lost."""
    vehicle = fake.airborne(grants_mode=False, answers=answers)
    flight = fake.Lockstep(fake.settings(failsafe_action="land"), vehicle).run_to(State.ENGAGING)
    flight.run(1.5)
    assert {sent.mode for _, sent in flight.sent(SetMode)} == {ModeKind.OFFBOARD}
    flight.vehicle.grants_mode = True
    flight.mute = {events.AttitudeReceived}
    flight.log.clear()
    flight.run(0.26)
    assert flight.service.state is State.FAILSAFE
    assert not flight.sent(SetMode)
    assert_silent(flight)


def test_a_command_that_is_not_finite_is_a_failsafe_and_never_sent(fake, monkeypatch):
    flight = fake.hovering()
    honest = vehicle.step

    def broken(*arguments):
        state, output = honest(*arguments)
        return state, structs.replace(output, command=(0.0, nan, 0.0, 0.4))

    monkeypatch.setattr(vehicle, "step", broken)
    flight.tick()
    still, level = (target for _, target in flight.sent(AttitudeTarget))
    assert still.body_rates == (0.0, 0.0, 0.0) and level.attitude[:2] == (0.0, 0.0)
    assert_failsafe(flight, "setpoint is not a finite number")


@pytest.mark.parametrize(
    ("height", "timeout_s", "reason"),
    [(5.0, 10.0, "full thrust lifts nothing for 3 s"), (3.5, 0.5, "take-off stuck at 3.0 of 3.5 m")],
)
def test_a_takeoff_that_gets_stuck_is_a_failsafe(fake, height, timeout_s, reason):
    """Held down, as by a rope, under full thrust; or not there in the time that there is for the last bit."""
    settings = fake.settings(scenario=(Takeoff(height),))
    settings = replace(settings, flight=replace(settings.flight, arrival_timeout_s=timeout_s))
    flight = fake.Lockstep(settings, fake.airborne()).run_to(State.ENGAGED)
    flight.change = lambda event: (
        structs.replace(event, position=(0.0, 0.0, 3.0), velocity=(0.0, event.velocity[1], 0.0))
        if isinstance(event, events.PositionReceived)
        else event
    )
    flight.run(20.0, lambda: flight.service.finished is not None)
    assert flight.service.finished.reason.startswith(f"failsafe: {reason}")


def test_a_fault_while_nothing_is_in_our_hands_starts_the_observers_anew(fake):
    flight = fake.Lockstep(fake.settings(engage=False), fake.airborne()).run_to(State.READY)
    flight.give(events.AttitudeReceived(flight.time_us + 1, (nan, 0.0, 0.0), (0.0, 0.0, 0.0)))
    assert flight.service.state is State.WAITING and flight.service.finished is None
    assert flight.texts[-1] == "not ready: attitude is not finite"
    flight.run_to(State.READY, 1.5)


def test_an_autopilot_that_restarts_is_observed_anew(fake):
    flight = fake.Lockstep(fake.settings(engage=False)).run_to(State.READY)
    earlier = 4_000_000
    flight.change = lambda event: (
        structs.replace(event, sample_time_us=event.sample_time_us - earlier)
        if isinstance(event, (events.AttitudeReceived, events.PositionReceived))
        else event
    )
    flight.run(0.5)
    assert flight.service.state is State.WAITING
    flight.run_to(State.READY, 2.0)
    assert flight.service.state is State.READY
