"""Control is not taken, or is given up, when link, battery or place do not allow it, and it is said why."""

from dataclasses import replace
from math import nan

import numpy as np
import pytest
from msgspec import structs

from kffa_offboard.control.observer import ObserverParameters
from kffa_offboard.offboard import admission, events
from kffa_offboard.offboard.loop import begin_loop
from kffa_offboard.offboard.segments import Hold
from kffa_offboard.offboard.service import State
from kffa_offboard.offboard.settings import LimitSettings
from kffa_offboard.offboard.telemetry import Stream, Telemetry

HOLD = (Hold(100.0),)


def ready(fake, **changes):
    flight = fake.Lockstep(fake.settings(engage=False, scenario=HOLD, **changes), fake.airborne())
    return flight.run_to(State.READY)


def refusal_of(flight):
    flight.give(events.EngageRequested())
    return flight.texts[-1]


def test_a_low_battery_forbids_engaging(fake):
    flight = ready(fake)
    flight.give(events.BatteryReported(19.0))
    assert refusal_of(flight) == "not engaged: battery at 19 %, 20 needed"
    flight.give(events.BatteryReported(20.0))
    assert refusal_of(flight) == "engaging in the air"


def test_a_battery_that_runs_low_in_flight_is_said_once_and_left_to_the_autopilot(fake):
    flight = ready(fake)
    flight.give(events.EngageRequested())
    flight.run_to(State.ENGAGED)
    for _ in range(3):
        flight.give(events.BatteryReported(10.0))
        flight.run(0.1)
    assert flight.texts.count("battery low") == 1 and flight.service.state is State.ENGAGED


def with_thrust_max(settings, value):
    return replace(settings, limits=replace(settings.limits, thrust_max=value))


def test_a_limit_of_thrust_below_what_carries_the_load_is_refused_in_flight(fake):
    """It was taken: a 10 kg quadrotor with 5 kg fell from 4 m."""
    flight = fake.Lockstep(
        fake.settings(scenario=HOLD), fake.airborne(weight=1.5, own_thrust=1.5 * fake.hover)
    )
    flight.run_to(State.ENGAGED)
    flight.run(3.0)
    flight.log.clear()
    flown = flight.service.settings
    flight.give(events.SettingsChanged(with_thrust_max(flown, 0.5)))
    (refused,) = [said for _, said in flight.sent(events.RequestRefused)]
    assert refused.reason == "thrust 0.60 carries the vehicle; thrust_max = 0.5"
    assert flight.service.settings is flown
    flight.give(events.SettingsChanged(with_thrust_max(flown, 0.65)))
    assert flight.service.settings.limits.thrust_max == 0.65
    flight.run(2.0)
    assert flight.service.state is State.ENGAGED and flight.vehicle.position == pytest.approx(3.0, abs=0.1)


def test_a_limit_of_thrust_below_what_the_autopilot_flies_with_forbids_engaging(fake):
    flight = fake.Lockstep(
        with_thrust_max(fake.settings(engage=False, scenario=HOLD), 0.5),
        fake.airborne(weight=1.5, own_thrust=1.5 * fake.hover),
    ).run_to(State.READY)
    assert refusal_of(flight) == "not engaged: thrust 0.60 carries the vehicle; thrust_max = 0.5"


def test_telemetry_that_became_slow_after_ready_forbids_engaging(fake):
    """It is judged at the moment of engaging, not when "ready" was said."""
    flight = ready(fake)
    kept = [0]

    def every_fifth(event):
        if not isinstance(event, events.AttitudeReceived):
            return event
        kept[0] += 1
        return event if kept[0] % 5 == 0 else events.StatusReceived(6, "")

    flight.change = every_fifth
    flight.run(1.2)
    assert flight.service.state is State.READY
    assert refusal_of(flight) == "not engaged: attitude telemetry 20 Hz, 40 needed"


def test_a_latency_that_the_bandwidth_does_not_bear_forbids_engaging(fake):
    flight = ready(fake)
    flight.give(events.LinkMeasured(0, 0.5))
    assert refusal_of(flight).startswith("not engaged: latency 500 ms; omega_c = 6 bears 167")


@pytest.mark.parametrize(("round_trip_s", "bears"), [(0.05, "33"), (0.07, "40")])
def test_on_a_slow_link_a_bandwidth_may_still_be_lowered(fake, round_trip_s, bears):
    """omega_o = 30 is to be engaged with 0.06 s, and flown with up to 0.077 s."""
    flight = ready(fake)
    flight.give(events.EngageRequested())
    flight.run_to(State.ENGAGED)
    flight.give(events.LinkMeasured(0, round_trip_s))
    for omega_c in (30.0, 7.0, 5.0):
        controller = flight.service.settings.controller
        law = replace(controller.law, omega_c=np.full(4, omega_c))
        settings = replace(flight.service.settings, controller=replace(controller, law=law))
        flight.give(events.SettingsChanged(settings))
        assert (flight.service.settings is settings) == (omega_c < 30.0)
    ((_, refused),) = flight.sent(events.RequestRefused)
    assert refused.reason == f"latency {1e3 * round_trip_s:.0f} ms; omega_c = 30 bears {bears}"
    flight.run(0.3)
    assert flight.service.state is State.ENGAGED


def test_leaving_the_fence_is_a_failsafe(fake):
    limits = replace(fake.settings().limits, fence_radius_m=20.0)
    flight = ready(fake, limits=limits)
    flight.give(events.EngageRequested())
    flight.run_to(State.ENGAGED)
    away = [0.0]

    def drift(event):
        if not isinstance(event, events.PositionReceived):
            return event
        away[0] += 0.1
        return structs.replace(event, position=(away[0], 0.0, event.position[2]))

    flight.change = drift
    flight.run(3.0, lambda: flight.service.state is State.FAILSAFE)
    assert "failsafe: 20.0 m away, fence at 20" in flight.texts
    assert away[0] == pytest.approx(20.1, abs=0.15)


@pytest.mark.parametrize(
    ("kind", "change", "reason"),
    [
        (events.AttitudeReceived, {"body_rates": (0.0, 10.5, 0.0)}, "body rate 10.5 rad/s, 10 possible"),
        (events.PositionReceived, {"velocity": (0.0, 0.0, -12.0)}, "climb rate 12 m/s, 10 allowed"),
    ],
)
def test_rates_out_of_limits_are_a_failsafe_within_the_same_call(fake, kind, change, reason):
    flight = ready(fake)
    flight.give(events.EngageRequested())
    flight.run_to(State.ENGAGED)
    flight.change = lambda event: structs.replace(event, **change) if isinstance(event, kind) else event
    flight.tick()
    assert flight.service.state is State.FAILSAFE and f"failsafe: {reason}" in flight.texts


def test_thrust_that_just_carries_leaves_nothing_to_climb_with():
    limits = LimitSettings(thrust_max=0.8)
    assert admission.too_weak(limits, None) is None
    assert admission.too_weak(limits, 0.76) is None
    assert admission.too_weak(limits, 0.77) == "thrust 0.77 carries the vehicle; thrust_max = 0.8"


@pytest.mark.parametrize(
    ("share", "climb_rate", "landed", "grounded"),
    [
        (1.0, 0.0, None, False),
        (0.01, 0.0, None, True),
        (0.01, -3.0, None, None),  # it may fall
        (0.01, 3.0, None, None),
        (1.0, 0.0, True, None),  # what is said contradicts what is seen
        (0.01, 0.0, True, True),
        (0.01, -3.0, False, False),
        (0.51, 0.0, None, False),  # half of the thrust of a hover is what tells
        (0.49, 0.0, None, True),
        (0.51, 0.0, True, None),
        (0.49, 0.0, True, True),
    ],
)
def test_whether_the_vehicle_stands_is_told_only_if_it_is_known(fake, share, climb_rate, landed, grounded):
    settings = fake.settings()
    known = Telemetry(
        heartbeat=events.HeartbeatReceived("px4", events.ModeKind.OTHER, "POSCTL", 0, True),
        position=events.PositionReceived(0, (0.0, 0.0, 1.0), (0.0, 0.0, climb_rate)),
        throttle=share * settings.hover_thrust,
        on_ground=landed,
    )
    assert admission.grounded(settings, known, 0) is grounded
    disarmed = structs.replace(known, heartbeat=structs.replace(known.heartbeat, armed=False))
    assert admission.grounded(settings, disarmed, 0) is True, "its motors stand"


SECOND_US = 1_000_000


def samples(count):
    """A stream with so many samples in the second that ends at `SECOND_US`."""
    return Stream(arrivals=tuple(SECOND_US - 1000 * k for k in reversed(range(count))))


def with_bandwidths(settings, *omega_o):
    observer = ObserverParameters.from_bandwidth(np.array(omega_o))
    return replace(settings, controller=replace(settings.controller, observer=observer))


@pytest.mark.parametrize(
    ("attitude", "position", "reason"),
    [
        (20, 8, None),
        (19, 8, "attitude at 19 Hz; omega_o = 50 needs 20"),
        (20, 7, "position at 7 Hz; omega_o = 20 needs 8"),
    ],
)
@pytest.mark.parametrize("fastest", [(50.0, 30.0, 40.0), (30.0, 50.0, 40.0), (30.0, 40.0, 50.0)])
def test_height_is_observed_at_the_rate_of_the_position_and_the_rest_at_that_of_the_attitude(
    fake, attitude, position, reason, fastest
):
    """Each observer wants a sample every 2.5 / omega_o."""
    known = Telemetry(attitude_stream=samples(attitude), position_stream=samples(position))
    assert admission.slow(with_bandwidths(fake.settings(), *fastest, 20.0), known, SECOND_US) == reason


def seen(roll=0.1, pitch=-0.1, altitude=3.0, climb_rate=0.0):
    return Telemetry(
        attitude=events.AttitudeReceived(0, (roll, pitch, 0.0), (0.0, 0.0, 0.0)),
        position=events.PositionReceived(0, (0.0, 0.0, altitude), (0.0, 0.0, climb_rate)),
    )


@pytest.mark.parametrize(
    ("climbs", "now", "reason"),
    [
        (0.0, {"roll": 0.19, "pitch": -0.19, "altitude": 3.29, "climb_rate": -0.99}, None),
        (0.0, {"roll": 0.21}, "attitude off by 0.11 rad"),
        (0.0, {"pitch": 0.01}, "attitude off by 0.11 rad"),
        (0.0, {"altitude": 2.69}, "height off by 0.31 m"),
        (0.0, {"climb_rate": 1.1}, "climb rate off by 1.1 m/s"),
        (0.0, {"climb_rate": -1.1}, "climb rate off by 1.1 m/s"),
        (2.0, {"climb_rate": 2.0}, None),
        (2.0, {"climb_rate": -2.0}, "climb rate off by 4 m/s"),
    ],
)
def test_estimates_have_settled_when_they_are_what_is_measured(fake, climbs, now, reason):
    """The observer begins at rest at what is seen first, here with the climb rate that it is told."""
    loop = begin_loop(fake.settings(), seen(), 0)
    observer = loop.controller.observer
    observer = structs.replace(observer, rate=observer.rate + np.array([0.0, 0.0, 0.0, climbs]))
    loop = loop.with_controller(structs.replace(loop.controller, observer=observer))
    said = admission.unsettled(seen(**now), loop)
    assert said == (None if reason is None else f"estimates are settling: {reason}")


@pytest.mark.parametrize("slow_channel", [0, 1, 2, 3])
@pytest.mark.parametrize(
    ("most", "bears_s"),
    [(admission.LATENCY_TO_ENGAGE, 0.01 + 1.5 / 30.0), (admission.LATENCY_IN_FLIGHT, 0.01 + 2.0 / 30.0)],
)
def test_the_latency_that_an_observer_bears_is_that_of_its_fastest_channel(fake, slow_channel, most, bears_s):
    """Beside the delay of 0.01 s that it is told of; omega_c = 6 would bear 0.17 s."""
    omega_o = np.full(4, 30.0)
    omega_o[slow_channel] = 10.0
    settings = with_bandwidths(fake.settings(), *omega_o)
    link = events.LinkMeasured(0, 0.0)
    assert admission.late(settings, bears_s - 0.001, link, most) is None
    assert f"omega_o = 30 bears {1e3 * bears_s:.0f}" in admission.late(settings, bears_s + 0.001, link, most)


@pytest.mark.parametrize(
    ("most", "bears_s"),
    [(admission.LATENCY_TO_ENGAGE, 1.0 / 6.0), (admission.LATENCY_IN_FLIGHT, 1.2 / 6.0)],
)
def test_the_latency_that_a_law_bears_is_that_of_its_fastest_channel(fake, most, bears_s):
    """omega_c is 6 rad/s on all channels but yaw; observers so slow bear far more."""
    settings = with_bandwidths(fake.settings(), 4.0, 4.0, 4.0, 4.0)
    link = events.LinkMeasured(0, 0.0)
    assert admission.late(settings, bears_s - 0.001, link, most) is None
    assert f"omega_c = 6 bears {1e3 * bears_s:.0f}" in admission.late(settings, bears_s + 0.001, link, most)


def test_what_is_enough_for_telemetry_may_be_too_slow_for_the_observers(fake):
    known = Telemetry(
        heartbeat=events.HeartbeatReceived("px4", events.ModeKind.OTHER, "POSCTL", 0, True),
        attitude_stream=samples(50),
        position_stream=samples(50),
        steady_since_us=0,
    )
    quick = with_bandwidths(fake.settings(), 130.0, 25.0, 10.0, 30.0)
    for settings, said in ((fake.settings(), None), (quick, "attitude at 50 Hz; omega_o = 130 needs 52")):
        assert admission.refusal(settings, known, None, None, None, SECOND_US) == said


def test_on_telemetry_that_just_suffices_a_bandwidth_may_be_set_anew_and_may_not_grow(fake):
    """Where there is more, three percent must be left: seconds have a sample more or less."""
    flown = with_bandwidths(fake.settings(), 50.0, 25.0, 10.0, 30.0)
    grown, more = (with_bandwidths(fake.settings(), roll, 25.0, 10.0, 30.0) for roll in (50.1, 51.0))

    def refused(after, attitude_hz):
        known = Telemetry(attitude_stream=samples(attitude_hz), position_stream=samples(50))
        return admission.unbearable(flown, after, known, nan, None, SECOND_US)

    assert refused(flown, 20) is None
    assert refused(grown, 20) == "attitude at 20 Hz; omega_o = 50.1 needs 20"
    assert refused(grown, 21) is None, "20.04 and three percent are 20.6"
    assert refused(more, 21) is not None, "20.4 and three percent are 21.01"


@pytest.mark.parametrize(
    ("x", "y", "outside"),
    [
        (110.0, -20.0, False),
        (110.1, -20.0, True),
        (10.0, -119.9, False),
        (10.0, -120.1, True),
        (80, 55, True),
    ],
)
def test_the_fence_is_a_circle_around_where_control_was_taken(x, y, outside):
    known = Telemetry(position=events.PositionReceived(0, (x, y, 3.0), (0.0, 0.0, 0.0)))
    assert (admission.outside_fence(LimitSettings(), known, (10.0, -20.0)) is not None) == outside
    assert admission.outside_fence(LimitSettings(), known, None) is None
