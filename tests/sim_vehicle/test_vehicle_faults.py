"""What breaks on the vehicle, and a load on a rope."""

from math import pi, sin, sqrt

import numpy as np
import pytest

from sim_vehicle import faults, swing
from sim_vehicle.config import build
from sim_vehicle.config_faults import BatterySag, FaultsSection, Gust, ThrustLimit, WeakMotor

HALF = np.full(4, 0.5)
DT = 0.0025


def test_a_weak_motor_gives_its_share_from_its_time_on():
    section = FaultsSection(weak_motor=(WeakMotor(start_s=2.0, motor=3, loss=0.3),))
    assert faults.motor_commands(section, 1.99, HALF).tolist() == [0.5] * 4
    assert faults.motor_commands(section, 2.0, HALF) == pytest.approx([0.5, 0.5, 0.35, 0.5])
    many = faults.motor_commands(section, 2.0, np.full((4, 7), 0.5))
    assert many[2] == pytest.approx(np.full(7, 0.35)) and many.shape == (4, 7)


def test_thrust_is_limited_for_its_time_and_a_battery_sags_to_its_lowest():
    section = FaultsSection(
        thrust_limit=(ThrustLimit(start_s=1.0, duration_s=1.0, share=0.2),),
        battery_sag=(BatterySag(start_s=5.0, loss_per_s=0.1, lowest=0.6),),
    )
    assert [float(faults.motor_commands(section, t, HALF)[0]) for t in (0.9, 1.5, 2.1, 6.0, 60.0)] == (
        pytest.approx([0.5, 0.2, 0.5, 0.45, 0.3])
    )


def test_a_gust_comes_and_goes():
    section = FaultsSection(gust=(Gust(start_s=1.0, duration_s=2.0, velocity_m_s=(12.0, 0.0, -1.0)),))
    assert faults.wind(section, 2.0).tolist() == [12.0, 0.0, -1.0]
    assert faults.wind(section, 3.0).tolist() == [0.0, 0.0, 0.0]


def test_faults_are_read_from_the_configuration():
    config = build(
        {"faults": {"weak_motor": [{"start_s": 3.0}], "gust": [{"start_s": 1.0, "duration_s": 1.0}]}}, "x"
    )
    assert config.faults.weak_motor[0].loss == 0.3 and config.faults.gust[0].velocity_m_s[0] == 12.0


@pytest.mark.parametrize(("vehicle_mass", "share"), [(1e9, 1.0), (2.0, 0.5)])
def test_a_load_on_a_rope_swings_with_the_period_of_the_pendulum_and_keeps_its_energy(vehicle_mass, share):
    """Below a free vehicle that is carried by its weight's thrust the reduced mass shortens the period."""
    length, mass = 1.0, 2.0
    state = swing.SwingState(np.array([sin(0.1), 0.0, -sqrt(1.0 - sin(0.1) ** 2)]), np.zeros(3))
    carried = np.array([0.0, 0.0, 9.8 * mass / vehicle_mass])  # a thrust that carries the load, too
    velocity, places = np.zeros(3), []
    for _ in range(8000):
        state, force = swing.step(state, length, mass, vehicle_mass, velocity, carried, 9.8, DT)
        velocity = velocity + DT * (carried + force / vehicle_mass)
        places.append(state.offset[0])
    x = np.array(places)
    crossings = np.flatnonzero((x[:-1] > 0.0) & (x[1:] <= 0.0)) * DT
    expected = 2.0 * pi * sqrt(length * share / 9.8)
    assert np.diff(crossings).mean() == pytest.approx(expected, rel=0.01)
    assert abs(x[-1000:]).max() == pytest.approx(sin(0.1), rel=0.02)
    assert np.linalg.norm(state.offset) == pytest.approx(length, rel=2e-3)


def test_many_ropes_at_once_are_each_the_single_one():
    rng = np.random.default_rng(0)
    offsets = rng.normal(size=(3, 5))
    offsets /= np.linalg.norm(offsets, axis=0)
    velocities = rng.normal(size=(3, 5))
    together = swing.SwingState(offsets, velocities)
    zeros = np.zeros((3, 5))
    after, force = swing.step(together, 1.0, 2.0, 10.0, zeros, zeros, 9.8, DT)
    for k in range(5):
        alone = swing.SwingState(offsets[:, k], velocities[:, k])
        one, pull = swing.step(alone, 1.0, 2.0, 10.0, np.zeros(3), np.zeros(3), 9.8, DT)
        assert after.offset[:, k] == pytest.approx(one.offset, abs=1e-12)
        assert force[:, k] == pytest.approx(pull, abs=1e-9)


def test_a_rope_does_not_push():
    state = swing.SwingState(np.array([0.0, 0.0, 1.0]), np.zeros(3))  # the load above, at rest
    _, force = swing.step(state, 1.0, 2.0, 10.0, np.zeros(3), np.zeros(3), 9.8, DT)
    assert force.tolist() == [0.0, 0.0, 0.0]
