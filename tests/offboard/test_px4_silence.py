"""Telemetry of a PX4 falls silent: it keeps to the kind of setpoint that it has had."""

from dataclasses import replace

import numpy as np
import pytest

from kffa_offboard.control.actuator import ActuatorParameters
from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.offboard.farewell import LEVEL_S
from kffa_offboard.offboard.service import State

RATE_LAG_S = 0.08
"""Of the vehicle in these tests."""


def blind(fake, output="rates"):
    """Rolls back to level when telemetry falls silent, which it may; how it answers rates is known."""
    settings = fake.settings(output)
    lag = ActuatorParameters(delay=np.full(4, 0.01), lag=np.array([RATE_LAG_S] * 3 + [0.0]))
    controller = replace(settings.controller, actuator=lag)
    silent = replace(settings.telemetry, timeout_s=3.0, position_timeout_s=3.0)
    flight = fake.hovering(output=output, controller=controller, telemetry=silent)
    flight.vehicle.attitude[:] = 0.12, -0.08, 0.0
    flight.run(0.08)
    flight.mute = {events.AttitudeReceived, events.PositionReceived}
    flight.log.clear()
    return flight


def test_it_is_levelled_by_body_rates_which_it_follows_at_once(fake):
    flight = blind(fake)
    assert np.abs(flight.vehicle.attitude[:2]).max() > 0.05
    flight.run(2.5)
    assert flight.service.state is State.ENGAGED
    sent = [target for _, target in flight.sent(AttitudeTarget)]
    assert len(sent) == 25 and all(target.attitude is None for target in sent)
    assert np.abs(flight.vehicle.attitude[:2]).max() < 0.02  # it was 0.12, and turned by 1 rad/s
    assert [target.thrust for target in sent] == pytest.approx([fake.hover] * 25, abs=0.005)


def test_rates_that_are_held_for_as_long_as_px4_takes_to_see_an_attitude_do_not_tilt_it_the_other_way(fake):
    """The farewell is an attitude: until it counts, the last rates run on."""
    flight = blind(fake)
    flight.run(0.1)
    rates = flight.vehicle.target.body_rates
    assert rates is not None and max(map(abs, rates)) > 0.1
    for _ in range(round(LEVEL_S / 0.01)):
        flight.vehicle.move(flight.time_us, 0.01)
    assert np.abs(flight.vehicle.attitude[:2]).max() < 0.02


def test_what_is_commanded_by_attitudes_is_levelled_by_one(fake):
    flight = blind(fake, "attitude")
    flight.run(0.5)
    assert {target.attitude[:2] for _, target in flight.sent(AttitudeTarget)} == {(0.0, 0.0)}


def test_the_observer_is_told_of_the_rates(fake):
    flight = blind(fake)
    flight.run(0.15)
    ((_, target),) = flight.sent(AttitudeTarget)
    told = flight.service._loop.controller.commands[-1]
    assert told[:2] == pytest.approx(target.body_rates[:2], rel=0.05) and abs(told[0]) > 0.05


def test_the_last_setpoint_is_a_level_attitude_all_the_same(fake):
    """Nobody steers any more: the autopilot levels by its own estimate, half a second later at most."""
    flight = blind(fake)
    flight.run(3.2)
    assert flight.service.state is State.FAILSAFE
    last = flight.sent(AttitudeTarget)[-1][1]
    assert last.body_rates is None and last.attitude[:2] == (0.0, 0.0)
