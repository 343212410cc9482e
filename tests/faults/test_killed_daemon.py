"""A daemon that dies in the middle of a flight: the autopilot's own failsafe flies, within these bounds.

They follow from the last setpoint, which runs on until then, and so from the moment: each is tried at eight.
"""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from kffa_offboard.offboard.events import AttitudeTarget
from kffa_offboard.offboard.segments import Hold, Sine
from sim_vehicle.vehicle import SimulatedVehicle

HOVER = (Hold(1000.0),)
AMPLITUDE_RAD, OMEGA_RAD_S = math.radians(15.0), math.pi
SWING = (Sine("roll", AMPLITUDE_RAD, 2.0 * math.pi / OMEGA_RAD_S, 1000.0),)
MOMENTS_S = [3.6 + 0.27 * k for k in range(8)]  # a swing of 2 s from end to end

RUNS_ON_S = {"px4": 1.0 + 0.06 + 0.07, "ardupilot": 0.5 + 0.07}
"""COM_OF_LOSS_T and what PX4 takes to notice, GUID_TIMEOUT; link and motors."""
BRAKES_M_S2 = 5.0
"""At least, against a climb rate that it has got, each of them."""
HOVER_THRUST, THRUST_NOISE = 0.398, 0.043
LANDS_M_S = 1.5


@dataclass
class Alone:
    """What becomes of a vehicle whose daemon says no more, from that moment's height on."""

    vehicle: SimulatedVehicle
    last: AttitudeTarget
    climb_rate: float
    height: np.ndarray
    climb: np.ndarray
    tilt: np.ndarray

    def carried(self, runs_on_s):
        """Where the last thrust takes it in that time, and with which climb rate it then goes on."""
        acceleration = 9.8 * (self.last.thrust / HOVER_THRUST - 1.0)
        speed = acceleration * runs_on_s
        return (0.5 * speed + self.climb_rate) * runs_on_s, speed + self.climb_rate


def killed(flight, alone_s):
    """The same vehicle goes on alone, beside the flight."""
    assert flight.engaged_s is not None
    assert flight.released_s is None
    vehicle = flight.copied().vehicle
    rigid, states = vehicle.state.rigid.copy(), []
    end_us = vehicle.time_us + alone_s * 1e6
    while vehicle.time_us < end_us:
        vehicle.advance(vehicle.time_us + 10_000)
        list(vehicle.outgoing())
        states.append(vehicle.state.rigid.copy())
    states = np.array(states)
    tilt = abs(states[:, 6:8]).max(axis=1)
    return Alone(vehicle, flight.targets[-1][1], rigid[5], states[:, 2] - rigid[2], states[:, 5], tilt)


def at_moments(fault_flight, personality, scenario, alone_s):
    flight = fault_flight(personality, scenario=scenario, output="rates").prepare()
    for at_s in MOMENTS_S:
        yield killed(flight.until(at_s), alone_s)


@pytest.mark.parametrize(("personality", "lands"), [("px4", True), ("ardupilot", False)])
def test_a_daemon_killed_in_hover_leaves_a_level_vehicle_to_the_autopilot(fault_flight, personality, lands):
    alone = killed(fault_flight(personality, scenario=HOVER, output="rates").prepare().until(4.0), 12.0)
    assert alone.vehicle.firmware.armed is not lands, "PX4 lands and disarms"
    assert alone.tilt.max() < 0.01
    assert alone.height.max() < 0.3, "the thrust of the last setpoint runs on, with its noise"
    if lands:
        assert alone.climb.min() > -1.7
        assert -5.1 < alone.height.min() < -4.9
    else:
        assert alone.climb.min() > -0.15
        assert alone.height.min() > -0.1
        assert abs(alone.height[-1] - alone.height[-300]) < 0.1


@pytest.mark.parametrize(
    ("personality", "scenario", "at_s", "rise", "tilt"),
    [
        ("px4", HOVER, 4.13, 1.1, 0.025),
        ("px4", HOVER, 4.31, 0.1, 0.025),
        ("px4", HOVER, 4.5, 1.1, 0.025),
        ("px4", HOVER, 4.77, 0.7, 0.025),
        ("ardupilot", HOVER, 4.13, 0.35, 0.025),
        ("px4", SWING, 4.25, 0.1, 0.85),
        ("px4", SWING, 3.9, 1.5, 0.7),
        ("ardupilot", SWING, 4.75, 0.6, 0.45),
    ],
)
def test_a_daemon_killed_at_these_moments_leaves_the_vehicle_near(
    fault_flight, personality, scenario, at_s, rise, tilt
):
    """What the setpoint of each of them is worth; what holds for all follows below."""
    alone = killed(fault_flight(personality, scenario=scenario, output="rates").prepare().until(at_s), 12.0)
    assert alone.height.max() < rise
    assert alone.tilt.max() < tilt
    assert alone.tilt[300:].max() < 0.15
    if scenario is HOVER:
        assert alone.climb.min() > -1.7


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_how_far_a_killed_daemon_lets_the_vehicle_rise_is_the_noise_of_its_last_thrust(
    fault_flight, personality
):
    """It runs on and is braked then: on PX4 0.02 m in half of 40 moments, and up to 2.1 m."""
    runs_on_s = RUNS_ON_S[personality]
    for alone in at_moments(fault_flight, personality, HOVER, 4.0):
        assert abs(alone.last.thrust - HOVER_THRUST) < 4.0 * THRUST_NOISE
        moved, speed = alone.carried(runs_on_s)
        braking = speed**2 / (2.0 * BRAKES_M_S2)
        assert alone.height.max() < max(moved, 0.0) + (braking if speed > 0.0 else 0.0) + 0.1
        if personality == "px4":
            assert alone.climb.min() > min(speed, -LANDS_M_S) - 0.2
        else:
            assert alone.height.min() > min(moved, 0.0) - (braking if speed < 0.0 else 0.0) - 0.1
        assert alone.tilt.max() < 0.01 + runs_on_s * max(map(abs, alone.last.body_rates[:2]))


@pytest.mark.parametrize(("personality", "level_s"), [("px4", 5.0), ("ardupilot", 3.0)])
def test_a_daemon_killed_in_a_swing_leaves_a_vehicle_that_the_autopilot_levels(
    fault_flight, personality, level_s
):
    """The rate runs on: in the worst phase that is the root of the sum of squares. PX4 brakes, too."""
    runs_on_s = RUNS_ON_S[personality]
    for alone in at_moments(fault_flight, personality, SWING, level_s + 0.5):
        assert alone.tilt.max() < AMPLITUDE_RAD * math.hypot(1.0, OMEGA_RAD_S * runs_on_s)
        assert alone.tilt[300:].max() < AMPLITUDE_RAD
        assert alone.tilt[round(100 * level_s) :].max() < 0.05
        moved, speed = alone.carried(runs_on_s)
        braking = speed**2 / (2.0 * BRAKES_M_S2) if speed > 0.0 else 0.0
        assert alone.height.max() < max(moved, 0.0) + braking + 0.1
