"""A daemon that dies in the middle of a flight: the autopilot's own failsafe flies, within these bounds."""

import math

import numpy as np
import pytest

from kffa_offboard.offboard.segments import Hold, Sine

ALONE_S = 12.0
HOVER = (Hold(1000.0),)
SWING = (Sine("roll", math.radians(15.0), 2.0, 1000.0),)


def killed(fault_flight, personality, scenario, at_s):
    """Fly until `at_s`; then the daemon says no more. Height above that moment's, climb rate, tilt."""
    flight = fault_flight(personality, seconds=at_s, scenario=scenario, output="rates").fly()
    assert flight.engaged_s is not None
    assert flight.released_s is None
    vehicle, began = flight.vehicle, flight.vehicle.time_us
    states = []
    while vehicle.time_us < began + ALONE_S * 1e6:
        vehicle.advance(vehicle.time_us + 10_000)
        list(vehicle.outgoing())
        states.append(vehicle.state.rigid.copy())
    states = np.array(states)
    return vehicle, states[:, 2] - flight.heights[-1], states[:, 5], abs(states[:, 6:8]).max(axis=1)


@pytest.mark.parametrize(
    ("personality", "drop", "descent", "lands"), [("px4", 5.1, 1.7, True), ("ardupilot", 0.1, 0.15, False)]
)
def test_a_daemon_killed_in_hover_leaves_a_level_vehicle_to_the_autopilot(
    fault_flight, personality, drop, descent, lands
):
    vehicle, height, climb, tilt = killed(fault_flight, personality, HOVER, 4.0)
    assert -drop < height.min()
    assert height.max() < 0.3  # the thrust of the last setpoint runs on, with its noise
    assert -descent < climb.min()
    assert tilt.max() < 0.01
    assert vehicle.firmware.armed is not lands, "PX4 lands and disarms, ArduCopter holds its height"


@pytest.mark.parametrize(
    ("personality", "at_s", "rise"),
    [
        ("px4", 4.13, 1.1),
        ("px4", 4.31, 0.1),
        ("px4", 4.5, 1.1),
        ("px4", 4.77, 0.7),
        ("ardupilot", 4.13, 0.35),
    ],
)
def test_how_far_a_killed_daemon_lets_the_vehicle_rise_is_the_noise_of_its_last_thrust(
    fault_flight, personality, at_s, rise
):
    """It runs on for 1 s with PX4, for 0.5 s with ArduCopter."""
    _, height, climb, tilt = killed(fault_flight, personality, HOVER, at_s)
    assert height.max() < rise
    assert climb.min() > -1.7
    assert tilt.max() < 0.025


@pytest.mark.parametrize(
    ("personality", "at_s", "tilt_max", "rise"),
    [("px4", 4.25, 0.85, 0.1), ("px4", 3.9, 0.7, 1.5), ("ardupilot", 4.75, 0.45, 0.6)],
)
def test_a_daemon_killed_in_a_swing_leaves_a_vehicle_that_the_autopilot_levels(
    fault_flight, personality, at_s, tilt_max, rise
):
    _, height, _, tilt = killed(fault_flight, personality, SWING, at_s)
    assert tilt.max() < tilt_max
    assert height.max() < rise
    assert tilt[300:].max() < 0.15, "all but level after 3 s"
