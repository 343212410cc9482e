"""What breaks on the vehicle, and a load on a rope."""

from dataclasses import replace
from math import acos, atan2, pi, sin, sqrt

import numpy as np
import pytest

from sim_vehicle import airframe, environment, faults, swing
from sim_vehicle.config import build
from sim_vehicle.config_faults import BatterySag, FaultsSection, Gust, ThrustLimit, WeakMotor
from sim_vehicle.frames import rotation_matrix
from sim_vehicle.plant import Plant

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


def tilted():
    """Vehicle state (12,): at 20 m, rolled and pitched and turning, and moving."""
    rigid = np.zeros(12)
    rigid[2:9] = (20.0, 0.5, -0.3, 0.2, 0.2, -0.1, 0.4)
    rigid[9:12] = (0.5, -0.4, 0.3)
    return rigid


def hook_of(state):
    """0.2 m below the centre, in the world."""
    return state.position + rotation_matrix(state.euler) @ (0.0, 0.0, -0.2)


def test_vehicle_and_load_on_a_rope_keep_what_momentum_they_have_together():
    """Falling, without drag: sideways none comes in, downwards weight; and the rope keeps its length."""
    body = airframe.AirframeParameters(drag=0.0, ground=None)
    state, rope = airframe.initial_state(tilted()), swing.Rope(1.5, below=0.2)
    rope.hang(4.0, state.velocity)
    rope._state.velocity[:] += (1.0, 2.0, -1.0)
    seconds, momentum = 1.0, []
    load = hook_of(state) + rope.offset
    for _ in range(round(seconds / DT) + 1):
        momentum.append(body.base_mass * state.velocity + 4.0 * rope._state.velocity)
        force, torque = rope.step(body, state.rigid, DT)
        inputs = environment.EnvironmentInputs(force=force, torque=torque)
        state = airframe.step(body, state, np.zeros(4), inputs, DT)
        load = load + DT * rope._state.velocity
    assert np.linalg.norm(load - hook_of(state)) == pytest.approx(1.5, abs=0.02)
    gained = np.array(momentum[-1]) - momentum[0]
    assert gained == pytest.approx([0.0, 0.0, -14.0 * 9.8 * seconds], abs=1e-6)


def test_from_a_hook_below_the_centre_the_rope_turns_the_vehicle_and_from_the_centre_it_does_not():
    body, level = airframe.AirframeParameters(), np.zeros(12)
    level[2] = 5.0
    for below in (0.0, 0.2):
        rope = swing.Rope(1.0, below=below)
        rope.hang(5.0, np.zeros(3))
        rope._state.offset[:] = (0.6, 0.0, -0.8)  # the load is to the north
        force, torque = rope.step(body, level, DT)
        assert rope.angle == pytest.approx(atan2(0.6, 0.8), abs=0.01)
        assert force[0] > 10.0 and force[1] == 0.0 and force[2] == pytest.approx(-force[0] * 0.8 / 0.6)
        assert torque == pytest.approx([0.0, -below * force[0], 0.0])  # nose up: the hook is drawn north


def test_the_hook_is_where_the_vehicle_turns_it():
    """Rolled by a quarter turn, a load that hangs straight below pulls on a lever of its whole length."""
    body, rolled = airframe.AirframeParameters(), np.zeros(12)
    rolled[2], rolled[6] = 5.0, 0.5 * pi
    rope = swing.Rope(1.0, below=0.2)
    rope.hang(5.0, np.zeros(3))
    force, torque = rope.step(body, rolled, DT)
    assert force == pytest.approx([0.0, 0.0, force[2]]) and force[2] < -10.0
    assert torque == pytest.approx([0.2 * force[2], 0.0, 0.0])  # back to level


def test_the_swing_of_a_load_is_in_the_truth():
    simulated = build({"payload": {"rope_length_m": 1.0, "clock": "boot"}}, "x")
    plant = Plant(simulated, np.random.default_rng(0))
    rigid = np.zeros(12)
    rigid[2] = 5.0
    share = plant.body.hover_thrust(5.0)
    plant.state = replace(airframe.initial_state(rigid), motor_thrust=np.full(4, share * 246.0 / 4.0))
    plant.record(True, "x")
    plant.set_load(5.0)
    plant._rope._state.velocity[0] = 2.0
    angles = []
    for _ in range(400):
        plant.step(np.full(4, share))
        plant.record(True, "x")
        angles.append(plant.truth.rows[-1].load_swing)
    assert plant.truth.rows[0].load_swing == 0.0
    # 2 m/s lift it by v^2 / 2g of the part that the vehicle does not follow with: 10 of 15 kg.
    highest = acos(1.0 - 2.0**2 / (2.0 * 9.8) * 10.0 / 15.0)
    assert max(angles) == pytest.approx(highest, rel=0.03)


def test_on_a_rope_that_stretches_load_and_vehicle_bounce_with_the_frequency_of_the_spring():
    """At rest the load's weight stretches it; what there is of a bounce fades with its loss."""
    body, stiffness, mass = airframe.AirframeParameters(drag=0.0, ground=None), 2000.0, 5.0
    rigid = np.zeros(12)
    rigid[2] = 20.0
    share = body.hover_thrust(mass)
    state = replace(airframe.initial_state(rigid), motor_thrust=np.full(4, share * 246.0 / 4.0))
    rope = swing.Rope(1.0, stiffness=stiffness)
    rope.hang(mass, state.velocity, body.gravity)
    assert rope.offset[2] == pytest.approx(-1.0 - mass * body.gravity / stiffness)
    stretches, dt = [], 0.001
    for k in range(1000):
        if k == 200:
            rope._state.velocity[2] -= 0.2
        force, torque = rope.step(body, state.rigid, dt)
        inputs = environment.EnvironmentInputs(force=force, torque=torque)
        state = airframe.step(body, state, np.full(4, share), inputs, dt)
        stretches.append(-rope.offset[2] - 1.0)
    rest = mass * body.gravity / stiffness
    assert np.abs(np.array(stretches[:200]) - rest).max() < 1e-4
    bounce = np.array(stretches[200:]) - rest
    crossings = np.flatnonzero((bounce[:-1] < 0.0) & (bounce[1:] >= 0.0)) * dt
    omega = sqrt(stiffness * (1.0 / mass + 1.0 / body.base_mass))
    assert 2.0 * pi / np.diff(crossings).mean() == pytest.approx(omega, rel=0.01)
    assert bounce.max() == pytest.approx(0.2 / omega, rel=0.15)
    periods = 0.8 * omega / (2.0 * pi)
    faded = np.abs(bounce[-round(2.0 * pi / omega / dt) :]).max() / bounce.max()
    assert faded == pytest.approx(np.exp(-2.0 * pi * swing.LOSS * (periods - 1.25)), rel=0.3)
