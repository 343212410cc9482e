"""A load on a rope: in the air, on the ground, and at a winch."""

from dataclasses import replace
from math import acos, atan2, pi, sin, sqrt

import numpy as np
import pytest

from sim_vehicle import airframe, environment, swing
from sim_vehicle.config import build
from sim_vehicle.errors import SimulatorError
from sim_vehicle.frames import rotation_matrix
from sim_vehicle.plant import Plant

DT = 0.0025
METRE = swing.RopeParameters(1.0)
MASS, GRAVITY = 5.0, 9.8


@pytest.mark.parametrize(("vehicle_mass", "share"), [(1e9, 1.0), (2.0, 0.5)])
def test_a_load_on_a_rope_swings_with_the_period_of_the_pendulum_and_keeps_its_energy(vehicle_mass, share):
    """Below a free vehicle that is carried by its weight's thrust the reduced mass shortens the period."""
    length, mass = 1.0, 2.0
    rope = swing.RopeParameters(length)
    state = swing.SwingState(np.array([sin(0.1), 0.0, -sqrt(1.0 - sin(0.1) ** 2)]), np.zeros(3))
    carried = np.array([0.0, 0.0, 9.8 * mass / vehicle_mass])  # a thrust that carries the load, too
    velocity, places = np.zeros(3), []
    for _ in range(8000):
        state, force = swing.step(state, rope, mass, vehicle_mass, velocity, carried, 9.8, DT)
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
    after, force = swing.step(together, METRE, 2.0, 10.0, zeros, zeros, 9.8, DT)
    for k in range(5):
        alone = swing.SwingState(offsets[:, k], velocities[:, k])
        one, pull = swing.step(alone, METRE, 2.0, 10.0, np.zeros(3), np.zeros(3), 9.8, DT)
        assert after.offset[:, k] == pytest.approx(one.offset, abs=1e-12)
        assert force[:, k] == pytest.approx(pull, abs=1e-9)


def test_a_rope_does_not_push():
    state = swing.SwingState(np.array([0.0, 0.0, 1.0]), np.zeros(3))  # the load above, at rest
    _, force = swing.step(state, METRE, 2.0, 10.0, np.zeros(3), np.zeros(3), 9.8, DT)
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
    rope.hang(4.0, state.rigid)
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
        rope.hang(5.0, level)
        rope._place[:] = (0.6, 0.0, 5.0 - below - 0.8)  # the load is to the north
        force, torque = rope.step(body, level, DT)
        assert rope.angle == pytest.approx(atan2(0.6, 0.8), abs=0.01)
        assert force[0] > 10.0 and force[1] == 0.0 and force[2] == pytest.approx(-force[0] * 0.8 / 0.6)
        assert torque == pytest.approx([0.0, -below * force[0], 0.0])  # nose up: the hook is drawn north


def test_the_hook_is_where_the_vehicle_turns_it():
    """Rolled by a quarter turn, a load that hangs straight below pulls on a lever of its whole length."""
    body, rolled = airframe.AirframeParameters(), np.zeros(12)
    rolled[2], rolled[6] = 5.0, 0.5 * pi
    rope = swing.Rope(1.0, below=0.2)
    rope.hang(5.0, rolled)
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
    rope.hang(mass, state.rigid, body.gravity)
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


# ---------------------------------------------------------------------------- on the ground


def at_height(height):
    """Vehicle state (12,), level and at rest."""
    rigid = np.zeros(12)
    rigid[2] = height
    return rigid


def fly(rope, thrust, seconds, height, body=None, dt=DT):
    """Under constant thrust [N]; vehicle states and places of the load, a row for each step."""
    body = body or airframe.AirframeParameters(drag=0.0, motor_time_constant=0.0)
    rigid, states, places = at_height(height), [], []
    state = replace(airframe.initial_state(rigid), motor_thrust=np.full(4, thrust / 4.0))
    for _ in range(round(seconds / dt)):
        force, torque = rope.step(body, state.rigid, dt)
        inputs = environment.EnvironmentInputs(force=force, torque=torque)
        state = airframe.step(body, state, np.full(4, thrust / body.max_thrust_total), inputs, dt)
        states.append(state.rigid.copy())
        places.append(rope._place.copy())
    return np.array(states), np.array(places)


def test_below_the_ropes_length_a_load_lies_where_it_was_and_pulls_nothing():
    rope = swing.Rope(3.0)
    rope.hang(MASS, at_height(1.0))
    assert not rope.lifted and rope.angle == 0.0
    _, places = fly(rope, 98.0, 1.0, 1.0)
    assert np.all(places == 0.0)
    rope.step(airframe.AirframeParameters(), at_height(2.5), DT)
    assert float(rope._state.tension) == 0.0


@pytest.mark.parametrize(("length", "dt"), [(3.0, 0.0025), (1.0, 0.005)])
def test_a_taut_rope_holds_the_vehicle_down_while_it_pulls_less_than_the_load_weighs(length, dt):
    """10 kg that lift 30 N more than their weight: the load of 49 N stays, so does the vehicle."""
    rope = swing.Rope(length)
    rope.hang(MASS, at_height(length))
    states, places = fly(rope, 98.0 + 30.0, 2.0, length, dt=dt)
    rest = states[round(1.0 / dt) :]
    assert np.abs(rest[:, 2] - length).max() < 1e-3 * length and np.abs(rest[:, 5]).max() < 1e-3
    assert float(rope._state.tension) == pytest.approx(30.0, rel=0.01)
    assert np.all(places == 0.0) and not rope.lifted


def test_with_more_it_lifts_the_load_and_both_accelerate_as_one():
    rope = swing.Rope(3.0)
    rope.hang(MASS, at_height(3.0))
    states, places = fly(rope, 15.0 * (GRAVITY + 1.0), 2.0, 3.0)
    assert places[-1][2] == pytest.approx(0.5 * 2.0**2, rel=0.01) and rope.lifted
    assert states[-1][2] - places[-1][2] == pytest.approx(3.0, abs=2e-3)
    assert float(rope._state.tension) == pytest.approx(MASS * (GRAVITY + 1.0), rel=0.01)


def test_a_load_that_is_set_down_stays_there_and_the_rope_goes_slack():
    """Sinking at 1 m/s, and on with the thrust that carried both: the vehicle shoots up until it is taut."""
    rope, rigid = swing.Rope(2.0), at_height(3.0)
    rigid[5] = -1.0
    rope.hang(MASS, rigid)
    body = airframe.AirframeParameters(drag=0.0, motor_time_constant=0.0)
    state = replace(airframe.initial_state(rigid), motor_thrust=np.full(4, 15.0 * GRAVITY / 4.0))
    heights, tensions = [], []
    for _ in range(480):
        force, torque = rope.step(body, state.rigid, DT)
        inputs = environment.EnvironmentInputs(force=force, torque=torque)
        state = airframe.step(body, state, np.full(4, 15.0 * GRAVITY / 246.0), inputs, DT)
        heights.append(float(rope._place[2]))
        tensions.append(float(rope._state.tension))
    assert min(heights) == 0.0 == heights[-1] and not rope.lifted
    assert tensions[300] == pytest.approx(MASS * GRAVITY, rel=0.01)
    assert tensions[410:] == [0.0] * 70  # from 1.025 s on


@pytest.mark.parametrize(("pull", "slides"), [(0.5, False), (0.7, True)])
def test_a_load_on_the_ground_slides_if_it_is_pulled_by_more_than_friction(pull, slides):
    """Almost sideways, by so many times its weight; friction is 0.6."""
    body, rope, below = airframe.AirframeParameters(drag=0.0), swing.Rope(5.0), 0.25
    rope.hang(MASS, at_height(0.5))
    rope._place[:] = (-sqrt(25.0 - 0.25**2), 0.0, 0.0)
    rigid = at_height(below)
    acceleration = pull * MASS * GRAVITY / 10.0
    tensions = []
    for _ in range(200):
        force, _ = rope.step(body, rigid, DT)
        tensions.append(float(rope._state.tension))
        rigid[3] += DT * (acceleration + force[0] / 10.0)
        rigid[0] += DT * rigid[3]
    assert rigid[0] == pytest.approx(
        0.5 * (0.7 - 0.6) * MASS * GRAVITY / 15.0 * 0.5**2 if slides else 0.0, abs=0.02
    )
    assert bool(rope.place[0] > -4.98) is slides
    # Sliding, both gather speed together: 10 kg are pulled by what does not do that.
    steady = 10.0 * (acceleration - (0.1 * MASS * GRAVITY / 15.0 if slides else 0.0))
    assert tensions[100:] == pytest.approx([steady] * 100, rel=0.05)


def test_pick_up_and_set_down_are_in_the_truth():
    schedule = [{"time_s": 0.0, "mass_kg": MASS}]
    simulated = build({"payload": {"rope_length_m": 1.0, "clock": "boot", "schedule": schedule}}, "x")
    plant = Plant(simulated, np.random.default_rng(0))
    plant.state = airframe.initial_state(at_height(0.5))
    for share, steps in ((0.8, 400), (0.2, 1200)):
        for _ in range(steps):
            plant.step(np.full(4, share))
    said = [event.text for event in plant.truth.events]
    assert said == ["pick-up 5 kg", "load lifted", "load set down"]


def test_what_is_left_of_a_load_swings_on():
    rope = swing.Rope(1.0)
    rope.hang(MASS, at_height(5.0))
    rope._place[:] = (0.6, 0.0, 4.2)
    rope.hang(2.0, at_height(5.0))
    assert rope.mass_kg == 2.0 and rope._place.tolist() == [0.6, 0.0, 4.2]
    rope.hang(0.0, at_height(5.0))
    rope.hang(2.0, at_height(5.0))
    assert rope._place.tolist() == [0.0, 0.0, 4.0]


# ------------------------------------------------------------------------------------ winch


@pytest.mark.parametrize(("before", "after", "speed"), [(1.0, 6.0, 1.0), (6.0, 1.0, 2.0), (1.0, 1.5, 1.0)])
def test_a_winch_comes_to_its_speed_and_stops_at_the_length(before, after, speed):
    """A trapezoid of speed, or a triangle where the way is short."""
    rope, acceleration = swing.Rope(before), swing.WINCH_M_S2
    rope.wind(after, speed)
    rates = np.array([rope.turn(DT) for _ in range(4000)])
    assert rope.length == after
    way = abs(after - before)
    peak = min(speed, sqrt(way * acceleration))
    assert np.abs(rates).max() == pytest.approx(peak, rel=0.05)
    expected = way / peak + peak / acceleration
    assert np.flatnonzero(rates).size * DT == pytest.approx(expected, rel=0.05)


def test_what_a_winch_lowers_pulls_less_while_it_gathers_speed_and_more_while_it_brakes():
    rope, body = swing.Rope(2.0), airframe.AirframeParameters(ground=None)
    rope.hang(MASS, at_height(20.0))
    rope.wind(8.0, 1.0)
    tensions = []
    for _ in range(3000):
        rope.step(body, at_height(20.0), DT)  # a vehicle that stands still
        tensions.append(float(rope._state.tension))
    pull = np.array(tensions) / MASS
    assert pull[200] == pytest.approx(GRAVITY - swing.WINCH_M_S2, rel=0.01)
    assert pull[1200] == pytest.approx(GRAVITY, rel=0.01)
    assert pull[2600] == pytest.approx(GRAVITY + swing.WINCH_M_S2, rel=0.01)
    assert rope.offset[2] == pytest.approx(-8.0, abs=0.01)


def test_a_winch_turns_with_nothing_on_the_hook_too():
    moves = [{"time_s": 0.0, "length_m": 3.0, "speed_m_s": 2.0}]
    simulated = build({"payload": {"rope_length_m": 1.0, "clock": "boot", "winch": moves}}, "x")
    plant = Plant(simulated, np.random.default_rng(0))
    for _ in range(1200):
        plant.step(np.zeros(4))
    plant.state = airframe.initial_state(at_height(5.0))
    plant.set_load(MASS)
    assert plant._rope.offset.tolist() == [0.0, 0.0, -3.0]


def test_a_load_that_whirls_round_the_hook_keeps_its_energy():
    """8 m/s on half a metre: the rope turns by a twelfth of a radian in a step, which is divided."""
    body, rope = airframe.AirframeParameters(ground=None), swing.Rope(0.5)
    rope.hang(MASS, at_height(20.0))
    rope._state.velocity[0] = 8.0
    energies = []
    for _ in range(200):
        rope.step(body, at_height(20.0), 0.005)
        height, velocity = rope.place[2] - 19.5, rope._state.velocity
        energies.append(GRAVITY * height + 0.5 * float(velocity @ velocity))
    assert energies == pytest.approx([32.0] * 200, rel=0.05)


def test_winch_moves_are_read_and_what_makes_no_sense_is_refused():
    moves = [{"time_s": 1.0, "length_m": 5.0}, {"time_s": 9.0, "length_m": 1.0, "speed_m_s": 1.0}]
    config = build({"payload": {"rope_length_m": 1.0, "winch": moves}}, "x")
    assert config.payload.winch[0].speed_m_s == 0.5 and config.payload.winch[1].length_m == 1.0
    with pytest.raises(SimulatorError, match=r"payload.*winch: there is no rope; give rope_length_m"):
        build({"payload": {"winch": moves}}, "x")
    with pytest.raises(SimulatorError, match=r"winch at 1 s comes after the one at 9 s"):
        build({"payload": {"rope_length_m": 1.0, "winch": moves[::-1]}}, "x")
