"""Motors, mixing with priorities, one step of the whole aircraft, and its sensors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_vehicle import airframe, dynamics, payload
from sim_vehicle.airframe import AirframeParameters, AirframeState, SensorNoise
from sim_vehicle.environment import EnvironmentInputs, Wind, inputs_at

AIRFRAME = AirframeParameters()
PAPER = AirframeParameters(profile="paper")
NO_TORQUE = np.zeros(3)
AT_FIVE_METRES = np.array([0, 0, 5.0, 0, 0, 0, 0, 0, 0, 0, 0, 0])
torque_share = st.floats(-60.0, 60.0)


def hovering(parameters: AirframeParameters, load_mass: float = 0.0) -> AirframeState:
    """At 5 m with the motors already carrying the weight."""
    state = airframe.initial_state(AT_FIVE_METRES, load_mass)
    weight = (parameters.base_mass + load_mass) * parameters.gravity
    return replace(state, motor_thrust=np.full(4, 0.25 * weight))


def fly(
    parameters: AirframeParameters, state: AirframeState, commands: np.ndarray, seconds: float
) -> AirframeState:
    for _ in range(round(seconds / 0.0025)):
        state = airframe.step(parameters, state, commands)
    return state


def torques(parameters: AirframeParameters, commands: np.ndarray) -> np.ndarray:
    """Torque [N m] that motors at these commands give an unloaded vehicle."""
    lever = np.array([parameters.arm, parameters.arm, 1.0])
    return (lever * airframe.wrench(parameters, parameters.motor_max_thrust * commands)[1:].T).T


# ------------------------------------------------------------------------------------- hover


def test_the_empty_vehicle_hovers_at_two_fifths_of_its_thrust() -> None:
    assert AIRFRAME.hover_thrust() == pytest.approx(0.398, abs=5e-4)
    assert AIRFRAME.hover_thrust(6.73) == pytest.approx(1.0 / 1.5, abs=1e-3)


@pytest.mark.parametrize("parameters", [AIRFRAME, PAPER], ids=["airframe", "paper"])
@pytest.mark.parametrize("load_mass", [0.0, 5.0, 6.73])
def test_hover_thrust_holds_the_vehicle_where_it_is(parameters: AirframeParameters, load_mass: float) -> None:
    commands = airframe.mix(parameters, parameters.hover_thrust(load_mass), NO_TORQUE)
    state = fly(parameters, hovering(parameters, load_mass), commands, 2.0)
    np.testing.assert_allclose(state.rigid, AT_FIVE_METRES, atol=1e-10)
    assert float(state.total_thrust) == pytest.approx((10.0 + load_mass) * 9.8)
    assert state.on_ground is False


def test_a_drop_leaves_velocity_alone_and_then_accelerates_upwards() -> None:
    state = hovering(AIRFRAME, 5.0)
    moving = replace(state, rigid=state.rigid + np.array([0, 0, 0, 1.0, 0, 0.5, 0, 0, 0, 0, 0, 0]))
    dropped = airframe.with_load(moving, 0.0)
    np.testing.assert_array_equal(dropped.velocity, [1.0, 0.0, 0.5])
    after = airframe.step(AIRFRAME, dropped, np.full(4, AIRFRAME.hover_thrust(5.0)))
    assert (after.velocity[2] - 0.5) / 0.0025 == pytest.approx(4.9, abs=0.01)


def test_a_load_below_the_centre_slows_roll_down_as_its_inertia_says() -> None:
    def roll_acceleration(load_mass: float) -> float:
        state = hovering(AIRFRAME, load_mass)
        state = replace(state, motor_thrust=state.motor_thrust + np.array([0.0, 1.0, 0.0, -1.0]))
        commands = state.motor_thrust / AIRFRAME.motor_max_thrust
        return airframe.step(AIRFRAME, state, commands).body_rates[0] / 0.0025

    assert roll_acceleration(0.0) == pytest.approx(0.88 / 0.2906, rel=1e-3)
    assert roll_acceleration(5.0) == pytest.approx(0.88 / 0.5906, rel=1e-3)


def test_a_load_above_the_limit_cannot_fly() -> None:
    with pytest.raises(ValueError, match=r"load of 7 kg is above the limit of 6\.73 kg"):
        airframe.with_load(airframe.initial_state(), 7.0)
    with pytest.raises(ValueError, match=r"load of 7 kg is above the limit of 6\.73 kg"):
        airframe.step(AIRFRAME, replace(airframe.initial_state(), load_mass=7.0), np.zeros(4))


# ------------------------------------------------------------------------------------ motors


def test_thrust_has_gone_63_percent_of_the_way_after_50_ms() -> None:
    state = fly(AIRFRAME, airframe.initial_state(), np.ones(4), 0.05)
    np.testing.assert_allclose(state.motor_thrust / 61.5, 1.0 - math.exp(-1.0))


def test_motor_lag_does_not_depend_on_the_step() -> None:
    coarse = airframe.step(AIRFRAME, airframe.initial_state(), np.full(4, 0.3), dt=0.04)
    fine = airframe.initial_state()
    for _ in range(16):
        fine = airframe.step(AIRFRAME, fine, np.full(4, 0.3), dt=0.0025)
    np.testing.assert_allclose(coarse.motor_thrust, fine.motor_thrust)


def test_a_step_applies_the_mean_of_the_lagging_thrust() -> None:
    """The climb after a thrust step is that of the exact integral of the lag."""
    parameters = replace(AIRFRAME, drag=0.0)
    state = hovering(parameters)
    end = airframe.step(parameters, state, np.full(4, 1.0), dt=0.02)
    lag, gain = 0.05, (246.0 - 98.0) / 10.0
    expected = gain * (0.02 - lag * (1.0 - math.exp(-0.02 / lag)))
    assert end.velocity[2] == pytest.approx(expected, rel=1e-12)


def test_motors_give_neither_more_than_their_most_nor_less_than_nothing() -> None:
    state = fly(AIRFRAME, airframe.initial_state(), np.array([2.0, -1.0, 1.0, 0.0]), 1.0)
    np.testing.assert_allclose(state.motor_thrust, [61.5, 0.0, 61.5, 0.0], atol=1e-6)


def test_without_lag_thrust_follows_at_once() -> None:
    parameters = replace(AIRFRAME, motor_time_constant=0.0)
    state = airframe.step(parameters, airframe.initial_state(), np.full(4, 0.2))
    np.testing.assert_allclose(state.motor_thrust, 12.3)


def test_a_command_that_is_no_number_shows_and_is_not_taken_for_zero() -> None:
    state = airframe.step(AIRFRAME, airframe.initial_state(), np.array([math.nan, 0.0, 0.0, 0.0]))
    assert math.isnan(state.motor_thrust[0])


# ------------------------------------------------------------------------------------ mixing


@pytest.mark.parametrize(
    ("torque", "stronger", "weaker"),
    [((1.0, 0, 0), [1], [3]), ((0, 1.0, 0), [2], [0]), ((0, 0, 1.0), [0, 2], [1, 3])],
)
def test_each_torque_uses_the_motors_of_equation_14(
    torque: tuple[float, float, float], stronger: list[int], weaker: list[int]
) -> None:
    change = airframe.mix(AIRFRAME, 0.4, np.array(torque)) - 0.4
    assert np.all(change[stronger] > 0.0)
    assert np.all(change[weaker] < 0.0)
    assert change.sum() == pytest.approx(0.0, abs=1e-15)


@given(st.floats(0.35, 0.65), st.floats(-8.0, 8.0), st.floats(-8.0, 8.0), st.floats(-1.0, 1.0))
def test_motors_give_back_what_was_mixed(thrust: float, x: float, y: float, z: float) -> None:
    torque = np.array([x, y, z])
    commands = airframe.mix(AIRFRAME, thrust, torque)
    assert np.all((commands >= 0.0) & (commands <= 1.0))
    assert float(commands.mean()) == pytest.approx(thrust, abs=1e-12)
    np.testing.assert_allclose(torques(AIRFRAME, commands), torque, atol=1e-10)


@given(st.floats(-0.5, 1.5), torque_share, torque_share, torque_share)
def test_priorities_hold_for_every_demand(thrust: float, x: float, y: float, z: float) -> None:
    commands = airframe.mix(AIRFRAME, thrust, np.array([x, y, z]))
    assert np.all((commands >= -1e-12) & (commands <= 1.0 + 1e-12))
    given_thrust, given_torque = float(commands.mean()), torques(AIRFRAME, commands)
    wanted_thrust = min(1.0, max(0.0, thrust))
    assert given_thrust <= wanted_thrust + 1e-12  # never raised
    assert given_thrust >= min(wanted_thrust, 0.5) - 1e-12
    # Yaw costs the others nothing, and roll and pitch shrink together.
    np.testing.assert_allclose(
        airframe.mix(AIRFRAME, thrust, np.array([x, y, 0.0])).mean(), given_thrust, atol=1e-12
    )
    without_yaw = torques(AIRFRAME, airframe.mix(AIRFRAME, thrust, np.array([x, y, 0.0])))
    np.testing.assert_allclose(without_yaw[0:2], given_torque[0:2], atol=1e-9)
    assert given_torque[0] * y == pytest.approx(given_torque[1] * x, abs=1e-6)
    for got, wanted in zip(given_torque, (x, y, z), strict=True):
        assert got * wanted >= -1e-9
        assert abs(got) <= abs(wanted) + 1e-9


def test_at_full_thrust_thrust_gives_way_to_roll() -> None:
    torque = np.array([10.0, 0.0, 0.0])
    commands = airframe.mix(AIRFRAME, 1.0, torque)
    np.testing.assert_allclose(torques(AIRFRAME, commands), torque, atol=1e-12)
    assert commands[1] == pytest.approx(1.0)
    assert float(commands.mean()) == pytest.approx(1.0 - 10.0 / (2.0 * 0.44 * 61.5))


def test_roll_and_pitch_beyond_reach_are_scaled_together() -> None:
    given_torque = torques(AIRFRAME, airframe.mix(AIRFRAME, 0.2, np.array([60.0, -30.0, 0.0])))
    assert given_torque[0] == pytest.approx(0.2 * 2.0 * 0.44 * 61.5)
    assert given_torque[1] == pytest.approx(-0.5 * given_torque[0])


def test_yaw_gets_what_roll_and_pitch_leave_and_all_of_it() -> None:
    free = airframe.mix(AIRFRAME, 0.5, np.array([0.0, 0.0, 100.0]))
    np.testing.assert_allclose(free, [1.0, 0.0, 1.0, 0.0])
    shared = airframe.mix(AIRFRAME, 0.5, np.array([0.3 * 2.0 * 0.44 * 61.5, 0.0, 100.0]))
    np.testing.assert_allclose(shared, [0.7, 0.6, 0.7, 0.0], atol=1e-12)
    none_left = airframe.mix(AIRFRAME, 0.5, np.array([60.0, 0.0, 100.0]))
    np.testing.assert_allclose(none_left, [0.5, 1.0, 0.5, 0.0], atol=1e-12)


def test_no_thrust_means_motors_off_whatever_the_torque() -> None:
    np.testing.assert_array_equal(airframe.mix(AIRFRAME, 0.0, np.array([5.0, -3.0, 1.0])), 0.0)


def test_mixing_a_batch_equals_mixing_its_members() -> None:
    rng = np.random.default_rng(6)
    thrust, torque = rng.uniform(0.0, 1.0, 50), rng.uniform(-40.0, 40.0, (3, 50))
    for parameters in (AIRFRAME, PAPER):
        together = airframe.mix(parameters, thrust, torque)
        for index in range(50):
            alone = airframe.mix(parameters, float(thrust[index]), torque[:, index])
            np.testing.assert_allclose(together[:, index], alone, atol=1e-14)


# ------------------------------------------------------------------------ the paper's profile


def test_in_the_paper_profile_u1_to_u4_reach_equation_15_unchanged() -> None:
    """Even 45,000 N, a negative motor force and without lag."""
    demanded = np.array([45_000.0, 2_000.0, -30_000.0, 50.0])
    state = airframe.step(
        PAPER, airframe.initial_state(AT_FIVE_METRES, 5.0), airframe.motor_commands(PAPER, demanded), dt=0.005
    )
    expected = dynamics.integrate(
        AT_FIVE_METRES,
        demanded,
        payload.mass_properties(PAPER.body, 5.0, profile="paper"),
        0.15,
        9.8,
        kinematics="paper",
        dt=0.005,
    )
    np.testing.assert_allclose(state.rigid, expected, rtol=1e-10)
    np.testing.assert_allclose(airframe.wrench(PAPER, state.motor_thrust), demanded, rtol=1e-10)


def test_in_the_paper_profile_mixing_never_limits() -> None:
    torque = np.array([300.0, -500.0, 20.0])
    commands = airframe.mix(PAPER, 9.0, torque)
    assert float(commands.mean()) == pytest.approx(9.0)
    np.testing.assert_allclose(torques(PAPER, commands), torque, atol=1e-9)


def test_without_ground_the_paper_vehicle_may_fall_below_zero() -> None:
    state = airframe.step(replace(PAPER, ground=None), airframe.initial_state(), np.zeros(4))
    assert state.position[2] < 0.0
    assert state.on_ground is False


# -------------------------------------------------------------------------------- environment


def test_the_sine_of_example_4_accelerates_light_and_heavy_vehicles_alike() -> None:
    environment = inputs_at(Wind(sine_amplitude=2.0), np.zeros(3), math.pi / 2)
    for load_mass in (0.0, 5.0):
        state = hovering(PAPER, load_mass)
        commands = state.motor_thrust / PAPER.motor_max_thrust
        after = airframe.step(PAPER, state, commands, environment)
        assert after.velocity[2] / 0.0025 == pytest.approx(2.0, rel=1e-3)


def test_a_force_and_a_torque_from_outside_act_on_the_whole_vehicle() -> None:
    environment = EnvironmentInputs(force=np.array([15.0, 0, 0]), torque=np.array([0, 0, 0.2906]))
    state = hovering(AIRFRAME, 5.0)
    after = airframe.step(AIRFRAME, state, state.motor_thrust / AIRFRAME.motor_max_thrust, environment)
    assert after.velocity[0] / 0.0025 == pytest.approx(1.0, rel=1e-3)
    assert after.body_rates[2] / 0.0025 == pytest.approx(1.0, rel=1e-3)


def test_wind_pushes_through_drag_relative_to_the_air() -> None:
    environment = EnvironmentInputs(wind_velocity=np.array([0.0, 10.0, 0.0]))
    state = hovering(AIRFRAME)
    after = airframe.step(AIRFRAME, state, state.motor_thrust / AIRFRAME.motor_max_thrust, environment)
    assert after.velocity[1] / 0.0025 == pytest.approx(0.15 * 10.0 / 10.0, rel=1e-3)


# ------------------------------------------------------------------------------------- ground


def test_an_idle_vehicle_stands_still_and_says_so() -> None:
    state = fly(AIRFRAME, airframe.initial_state(load_mass=5.0), np.full(4, 5.0 / 246.0), 1.0)
    np.testing.assert_array_equal(state.rigid, 0.0)
    assert state.on_ground is True
    assert state.ground_force == pytest.approx(15.0 * 9.8 - 5.0, rel=1e-4)


def test_it_leaves_the_ground_when_the_motors_carry_its_weight() -> None:
    """1 - exp(-t / 50 ms) reaches hover thrust of full thrust at 25.4 ms."""
    state, steps = airframe.initial_state(), 0
    while state.on_ground:
        state, steps = airframe.step(AIRFRAME, state, np.ones(4), dt=0.0005), steps + 1
    assert steps * 0.0005 == pytest.approx(-0.05 * math.log(1.0 - AIRFRAME.hover_thrust()), abs=0.0011)


# -------------------------------------------------------------------------- batches and values


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 6), profile=st.sampled_from(["paper", "airframe"]))
def test_a_batch_steps_like_its_members_alone(seed: int, size: int, profile: str) -> None:
    """Some on the ground, some in the air, each with its own load, wind and commands."""
    rng = np.random.default_rng(seed)
    parameters = AirframeParameters(profile=profile, load_offset=(0.1, 0.05, -0.3))
    rigid = rng.uniform(-0.5, 0.5, (12, size))
    rigid[2] = np.maximum(rigid[2], 0.0)
    load, commands = rng.uniform(0.0, 6.7, size), rng.uniform(-0.1, 1.1, (4, size))
    wind, force, acceleration, torque = rng.normal(size=(4, 3, size))

    def run(pick: slice | int, mass: float | np.ndarray) -> AirframeState:
        inputs = EnvironmentInputs(wind[:, pick], force[:, pick], acceleration[:, pick], torque[:, pick])
        state = airframe.initial_state(rigid[:, pick], mass)
        for _ in range(5):
            state = airframe.step(parameters, state, commands[:, pick], inputs)
        return state

    together = run(slice(None), load)
    for index in range(size):
        alone = run(index, float(load[index]))
        np.testing.assert_allclose(together.rigid[:, index], alone.rigid, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(together.motor_thrust[:, index], alone.motor_thrust, atol=1e-12)
        assert together.on_ground[index] == alone.on_ground
        force_there = np.broadcast_to(together.ground_force, size)[index]
        assert force_there == pytest.approx(alone.ground_force, rel=1e-9, abs=1e-9)


def test_a_step_leaves_its_inputs_alone_and_repeats_exactly() -> None:
    state = hovering(AIRFRAME, 3.0)
    before, commands = state.rigid.copy(), np.array([0.5, 0.6, 0.5, 0.4])
    first = airframe.step(AIRFRAME, state, commands)
    second = airframe.step(AIRFRAME, state, commands)
    np.testing.assert_array_equal(state.rigid, before)
    np.testing.assert_array_equal(first.rigid, second.rigid)
    assert np.any(first.rigid != before)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"base_mass": -10.0}, "base mass of -10.0 kg is not above zero; give a positive number"),
        ({"arm": math.nan}, "arm of nan m is not above zero"),
        ({"inertia": (0.3, 0.0, 0.3)}, "moment of inertia of 0.0 kg m.2 is not above zero"),
        ({"motor_time_constant": -0.05}, "motor time constant of -0.05 s is below zero; give 0 or more"),
    ],
)
def test_impossible_aircraft_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AirframeParameters(**options)


# ------------------------------------------------------------------------------------ sensors


def test_sensors_have_the_noise_asked_for() -> None:
    state = airframe.initial_state(np.tile(AT_FIVE_METRES[:, None], 20_000))
    measured = airframe.measure(SensorNoise(), state, np.random.default_rng(7))
    np.testing.assert_allclose(measured.position.std(axis=1), [0.02, 0.02, 0.01], rtol=0.03)
    np.testing.assert_allclose(measured.velocity.std(axis=1), 0.02, rtol=0.03)
    np.testing.assert_allclose(measured.euler.std(axis=1), 0.002, rtol=0.03)
    np.testing.assert_allclose(measured.body_rates.std(axis=1), 0.01, rtol=0.03)
    np.testing.assert_allclose(measured.position.mean(axis=1), [0.0, 0.0, 5.0], atol=1e-3)


def test_one_seed_gives_one_measurement() -> None:
    state = hovering(AIRFRAME)
    first, second = (airframe.measure(SensorNoise(), state, np.random.default_rng(1)).euler for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_silent_sensors_report_the_truth_with_yaw_within_half_a_turn() -> None:
    rigid = AT_FIVE_METRES.copy()
    rigid[8] = 4.0
    noise = SensorNoise(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    measured = airframe.measure(noise, airframe.initial_state(rigid), np.random.default_rng(1))
    np.testing.assert_array_equal(measured.position, [0.0, 0.0, 5.0])
    np.testing.assert_allclose(measured.euler, [0.0, 0.0, 4.0 - 2.0 * math.pi], atol=1e-15)
