"""Whatever pilots, links and autopilots do, these hold."""

from dataclasses import replace
from math import cos, isfinite, nan

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget, ModeKind, SetArmed, SetMode
from kffa_offboard.offboard.segments import Gripper, Hold, Land, Step, Takeoff
from kffa_offboard.offboard.service import Service, State

SENDING = (State.ENGAGING, State.ENGAGED, State.RELEASING)
COMMANDS = (AttitudeTarget, SetMode, SetArmed, events.SetGripper)
SCENARIOS = (
    (Takeoff(0.5, 1.0), Land(0.7)),
    (Takeoff(0.5, 1.0), Step("roll", 0.2, 0.5), Gripper("grab"), Hold(0.5)),
    (Hold(100.0),),
)


def machine(fake):
    """The state machine of the test, with the fake vehicle bound."""

    class Flights(RuleBasedStateMachine):
        @initialize(
            output=st.sampled_from(["rates", "attitude"]),
            action=st.sampled_from(["stop", "hold", "land"]),
            arm=st.booleans(),
            shadow=st.booleans(),
            scenario=st.sampled_from(SCENARIOS),
            airborne=st.booleans(),
            firmware=st.sampled_from(["px4", "ardupilot"]),
        )
        def begin(self, output, action, arm, shadow, scenario, airborne, firmware):
            made = fake.settings(
                output, arm=arm, shadow=shadow, scenario=scenario, failsafe_action=action, engage=True
            )
            brief = replace(made.sequence, arm_timeout_s=2.0, person_arm_timeout_s=2.0, disarm_timeout_s=2.0)
            quick = replace(made.telemetry, settle_time_s=0.1, minimum_attitude_hz=10, minimum_position_hz=10)
            self.settings = replace(made, sequence=brief, telemetry=quick)
            vehicle = fake.airborne(firmware=firmware) if airborne else fake.Vehicle(firmware=firmware)
            self.flight = fake.Lockstep(self.settings, vehicle)
            self.seen = 0
            self.taken_over = False
            self.flight.run(0.6)
            self.check()

        @rule(ticks=st.integers(1, 60))
        def fly(self, ticks):
            self.flight.run(ticks * 0.01)

        @rule(mode=st.sampled_from(list(ModeKind)))
        def the_pilot_chooses_a_mode(self, mode):
            in_control = self.flight.service.state in (State.ENGAGED, State.RELEASING)
            self.flight.vehicle.mode = mode
            before = len(self.flight.log)
            self.flight.give(self.flight.vehicle.heartbeat())
            if in_control and mode is not ModeKind.OFFBOARD:
                assert self.flight.service.state not in SENDING
                assert not any(isinstance(sent, COMMANDS) for _, sent in self.flight.log[before:])
                self.taken_over = True

        @rule(armed=st.booleans())
        def somebody_arms_or_disarms(self, armed):
            self.flight.vehicle.armed = armed
            self.flight.give(self.flight.vehicle.heartbeat())

        @rule(
            kind=st.sampled_from(
                [events.AttitudeReceived, events.PositionReceived, events.HeartbeatReceived]
            ),
            ticks=st.integers(1, 40),
        )
        def a_message_stays_away(self, kind, ticks):
            self.flight.mute = {kind}
            self.flight.run(ticks * 0.01)
            self.flight.mute = set()

        @rule(where=st.sampled_from(["attitude", "rates", "position", "target", "throttle"]))
        def a_number_is_missing(self, where):
            now, level = self.flight.time_us + 1, (0.0, 0.0, 0.0)
            self.flight.time_us = now
            self.flight.give(
                {
                    "attitude": events.AttitudeReceived(now, (nan, 0.0, 0.0), level),
                    "rates": events.AttitudeReceived(now, level, (0.0, nan, 0.0)),
                    "position": events.PositionReceived(now, (0.0, 0.0, nan), level),
                    "target": events.TargetReported(now, nan, level, level),
                    "throttle": events.ThrottleReported(nan),
                }[where]
            )

        @rule(grants=st.booleans(), answers=st.booleans())
        def the_autopilot_changes_its_mind(self, grants, answers):
            self.flight.vehicle.grants_mode = grants
            self.flight.vehicle.answers = answers

        @rule(action=st.sampled_from(["arm", "disarm", "mode", "gripper"]), accepted=st.booleans())
        def an_answer_to_somebody_else(self, action, accepted):
            self.flight.give(events.CommandAnswered(action, 0, accepted, False, "?"))

        @rule()
        def somebody_asks_to_engage(self):
            self.taken_over = False
            self.flight.give(events.EngageRequested())

        @precondition(lambda self: not self.taken_over)
        @rule(action=st.sampled_from(["grab", "release"]))
        def somebody_asks_for_the_gripper(self, action):
            self.flight.give(events.GripperRequested(action))

        @precondition(lambda self: self.flight.service.state in SENDING)
        @rule()
        def somebody_asks_to_release(self):
            self.flight.give(events.ReleaseRequested("asked"))

        @invariant()
        def check(self):
            if not hasattr(self, "flight"):
                return
            flight, service = self.flight, self.flight.service
            assert service.next_deadline() > service._now_us
            new, self.seen = flight.log[self.seen :], len(flight.log)
            limits = self.settings.limits
            for _, output in new:
                if isinstance(output, AttitudeTarget):
                    numbers = (output.thrust, *(output.body_rates or output.attitude))
                    assert all(isfinite(number) for number in numbers)
                    farewell = output.attitude is not None and output.attitude[:2] == (0.0, 0.0)
                    assert farewell or (output.body_rates is None) == (self.settings.output == "attitude")
                    assert 0.0 <= output.thrust <= limits.thrust_max
                    if output.attitude is not None:
                        tilted = cos(output.attitude[0]) * cos(output.attitude[1])
                        assert tilted >= cos(limits.tilt_max_rad) - 1e-9
                assert not (self.settings.shadow and isinstance(output, COMMANDS))
                assert output != SetArmed(True) or self.settings.arm
            times = [time for time, _ in new]
            assert times == sorted(times)
            if self.taken_over or (service.finished is not None and service._retry is None):
                assert service.state not in SENDING
                self.assert_silent_from_here()

        def assert_silent_from_here(self):
            before = len(self.flight.log)
            self.flight.run(0.02)
            assert not any(isinstance(sent, COMMANDS) for _, sent in self.flight.log[before:])

    return Flights


def test_no_command_leaves_that_must_not(fake):
    """The assertions are in the machine: after every step it looks at all that was sent."""
    run_state_machine_as_test(
        machine(fake),
        settings=settings(
            max_examples=60,
            stateful_step_count=12,
            deadline=None,
            derandomize=True,
            suppress_health_check=list(HealthCheck),
        ),
    )


level = st.tuples(*[st.floats(-0.1, 0.1)] * 3)
anything = st.one_of(
    st.builds(
        events.HeartbeatReceived,
        st.sampled_from(["px4", "ardupilot"]),
        st.sampled_from(list(ModeKind)),
        st.just("?"),
        st.integers(0, 3),
        st.booleans(),
        st.booleans(),
    ),
    st.builds(events.EstimateReported, st.booleans(), st.booleans(), st.booleans()),
    st.builds(events.AttitudeReceived, st.integers(0, 10**7), level, level),
    st.builds(events.PositionReceived, st.integers(0, 10**7), level, level),
    st.builds(events.TargetReported, st.just(0), st.floats(), level, st.none()),
    st.builds(events.ThrottleReported, st.floats()),
    st.builds(events.LandedStateReported, st.booleans()),
    st.builds(events.StatusReceived, st.integers(0, 7), st.text(max_size=5)),
    st.just(events.EngageRequested()),
    st.just(events.ReleaseRequested("asked")),
    st.just(events.ReleaseRequested("asked", stay=True)),
    st.builds(events.GripperRequested, st.sampled_from(["grab", "release"])),
    st.builds(events.PositionSetpoint, st.tuples(*[st.none() | st.floats()] * 3), st.none() | st.floats()),
    st.builds(events.AttitudeSetpoint, st.tuples(*[st.floats()] * 3)),
    st.builds(events.LinkMeasured, st.integers(-(10**9), 10**9), st.floats(0.0, 1.0)),
    st.builds(events.GripperRequested, st.sampled_from(["grab", "release"])),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 400_000), anything), max_size=40))
def test_any_sequence_of_events_gives_the_same_outputs_again_and_calls_in_between_change_nothing(
    fake, sequence
):
    made = fake.settings()
    brief = replace(made.telemetry, settle_time_s=0.0, minimum_attitude_hz=0.0, minimum_position_hz=0.0)
    made = replace(made, telemetry=brief)
    first, second, often = Service(made), Service(made), Service(made)
    time_us = 0
    for delay, event in sequence:
        before, time_us = time_us, time_us + delay
        in_between = [] if before == 0 else often.advance((before + time_us) // 2)
        outputs = first.handle(time_us, event)
        assert repr(outputs) == repr(second.handle(time_us, event))
        assert repr(outputs) == repr(in_between + often.handle(time_us, event))
        assert first.next_deadline() == often.next_deadline() > time_us


def test_two_flights_of_the_same_vehicle_are_the_same_byte_for_byte(fake):
    logs = []
    for _ in range(2):
        flight = fake.Lockstep(fake.settings(scenario=(Takeoff(0.5), Land(0.7))))
        flight.run(20.0, lambda flight=flight: flight.service.finished is not None)
        assert flight.service.finished.successful
        logs.append(repr(flight.log))
    assert logs[0] == logs[1]


@pytest.mark.parametrize("period", [0.004, 0.02, 0.033])
def test_the_service_flies_at_other_telemetry_rates(fake, period):
    made = fake.settings(scenario=(Hold(100.0),))
    made = replace(
        made, telemetry=replace(made.telemetry, minimum_attitude_hz=25.0, minimum_position_hz=25.0)
    )
    service, vehicle, time_us = Service(made), fake.airborne(), 0
    for count in range(round(5.0 / period)):
        time_us += round(period * 1e6)
        vehicle.move(time_us, period)
        tiny = 1e-9 * (count % 2)  # no sensor repeats itself to the last bit
        outputs = service.handle(time_us, vehicle.heartbeat())
        outputs += service.handle(
            time_us,
            events.PositionReceived(time_us, (tiny, 0.0, vehicle.position), (0.0, 0.0, vehicle.velocity)),
        )
        outputs += service.handle(time_us, events.LandedStateReported(False))
        outputs += service.handle(
            time_us, events.AttitudeReceived(time_us, tuple(vehicle.attitude + tiny), tuple(vehicle.rates))
        )
        for output in outputs:
            for answer in vehicle.receive(time_us, output):
                service.handle(time_us, answer)
    assert service.state is State.ENGAGED
    assert vehicle.position == pytest.approx(3.0, abs=0.05)
