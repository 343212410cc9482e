"""Wind, gusts and the sine of Example 4; standing on, landing on and leaving the ground."""

import math
from itertools import pairwise

import numpy as np
import pytest

from sim_vehicle import dynamics, environment, payload
from sim_vehicle.environment import Ground, Wind

GRAVITY = 9.8
WEIGHT = 98.0
BODY = payload.VehicleBody(10.0, (0.2906, 0.2906, 0.2906), 0.44)
ALONE = payload.mass_properties(BODY, 0.0)
GROUND = Ground(friction=0.6, gear_radius=0.3, levelling_time=0.1)


# -------------------------------------------------------------------------------------- wind


def test_gusts_have_the_standard_deviation_asked_for() -> None:
    wind = Wind(gust_std=1.5, gust_time_constant=0.8)
    generator = np.random.default_rng(4)
    gust = np.zeros((3, 20_000))
    for _ in range(40):
        gust, _ = environment.advance(wind, gust, 0.0, generator, 0.1)
    np.testing.assert_allclose(gust.std(axis=1), 1.5, rtol=0.02)
    np.testing.assert_allclose(gust.mean(axis=1), 0.0, atol=0.04)
    np.testing.assert_allclose(np.corrcoef(gust), np.eye(3), atol=0.03)


def test_gusts_are_correlated_to_one_in_e_after_their_time_constant() -> None:
    wind = Wind(gust_std=1.5, gust_time_constant=0.8)
    generator = np.random.default_rng(5)
    earlier = 1.5 * generator.standard_normal((3, 20_000))
    later = earlier
    for _ in range(320):
        later, _ = environment.advance(wind, later, 0.0, generator, 0.0025)
    correlation = (earlier * later).mean(axis=1) / 1.5**2
    np.testing.assert_allclose(correlation, math.exp(-1.0), atol=0.03)


def test_gusts_do_not_depend_on_the_step() -> None:
    """Ten small steps fade a gust as one large step does."""
    wind, gust = Wind(gust_std=1.0, gust_time_constant=0.5), np.array([1.0, -2.0, 0.5])
    small = gust
    for _ in range(10):
        small = environment.advance_gust(wind, small, np.zeros(3), 0.02)
    np.testing.assert_allclose(small, environment.advance_gust(wind, gust, np.zeros(3), 0.2))


def test_one_seed_gives_one_sequence_of_gusts() -> None:
    wind = Wind(gust_std=1.0)
    first, second = (
        environment.advance(wind, np.zeros(3), 0.0, np.random.default_rng(8), 0.01)[0] for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)
    assert np.any(first != 0.0)


def test_wind_is_mean_plus_gust() -> None:
    inputs = environment.inputs_at(Wind(mean=(3.0, 0.0, -1.0)), np.array([0.5, 0.25, 0.0]), 0.0)
    np.testing.assert_allclose(inputs.wind_velocity, [3.5, 0.25, -1.0])
    batch = environment.inputs_at(Wind(mean=(3.0, 0.0, -1.0)), np.ones((3, 4)), 0.0)
    np.testing.assert_allclose(batch.wind_velocity, np.tile([[4.0], [1.0], [0.0]], 4))


def test_the_sine_of_example_4_is_two_sine_t_of_vertical_acceleration() -> None:
    wind = Wind(sine_amplitude=2.0)
    for time_s in (0.0, 0.5, math.pi / 2, 4.0):
        inputs = environment.inputs_at(wind, np.zeros(3), time_s)
        np.testing.assert_allclose(inputs.acceleration, [0.0, 0.0, 2.0 * math.sin(time_s)], atol=1e-15)
        np.testing.assert_array_equal(inputs.force, 0.0)


def test_the_sine_can_be_read_as_a_force_or_as_an_air_velocity() -> None:
    options = {"sine_amplitude": 3.0, "sine_period": 4.0, "sine_direction": (1.0, 0.0, 0.0)}
    force = environment.inputs_at(Wind(sine_kind="force", **options), np.zeros(3), 1.0)
    np.testing.assert_allclose(force.force, [3.0, 0.0, 0.0])
    np.testing.assert_array_equal(force.acceleration, 0.0)
    velocity = environment.inputs_at(Wind(sine_kind="velocity", **options), np.zeros((3, 2)), 1.0)
    np.testing.assert_allclose(velocity.wind_velocity, [[3.0, 3.0], [0.0, 0.0], [0.0, 0.0]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gust_std": -1.0}, "gust standard deviation of -1.0 m/s is below zero"),
        ({"gust_std": math.nan}, "gust standard deviation of nan m/s"),
        ({"gust_time_constant": 0.0}, "gust time constant of 0.0 s is not above zero"),
        ({"sine_period": -2.0}, "sine period of -2.0 s is not above zero"),
    ],
)
def test_impossible_winds_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Wind(**options)


# ------------------------------------------------------------------------------------ ground


def on_ground(
    seconds: float,
    thrust: float = 0.0,
    state: np.ndarray | None = None,
    properties: dynamics.MassProperties = ALONE,
    dt: float = 0.0025,
    torque: np.ndarray | None = None,
    force: np.ndarray | None = None,
) -> tuple[np.ndarray, list[float], list[bool]]:
    """Last state, and height and contact after every step."""
    state = np.zeros(12) if state is None else state
    heights, contacts = [], []
    for _ in range(round(seconds / dt)):
        wrench = np.array([thrust, 0.0, 0.0, 0.0])
        state = dynamics.integrate(state, wrench, properties, 0.15, GRAVITY, force, torque, dt=dt)
        state, _, touching = environment.touch_ground(GROUND, state, properties, dt)
        heights.append(state[2])
        contacts.append(touching)
    return state, heights, contacts


@pytest.mark.parametrize("thrust", [0.0, 5.0, 97.0])
@pytest.mark.parametrize("dt", [0.001, 0.0025, 0.02])
@pytest.mark.parametrize("load_mass", [0.0, 5.0])
def test_the_vehicle_rests_without_sinking_or_moving(thrust: float, dt: float, load_mass: float) -> None:
    properties = payload.mass_properties(BODY, load_mass)
    state, heights, contacts = on_ground(1.0, thrust, properties=properties, dt=dt)
    assert set(heights) == {0.0}
    assert all(contacts)
    np.testing.assert_array_equal(state, 0.0)


def test_it_lifts_off_exactly_when_thrust_exceeds_weight() -> None:
    _, heights, contacts = on_ground(0.5, WEIGHT * (1.0 - 1e-9))
    assert max(heights) == 0.0
    assert all(contacts)
    _, heights, contacts = on_ground(0.5, WEIGHT * (1.0 + 1e-9))
    assert min(heights) > 0.0
    assert not any(contacts)


def test_full_thrust_climbs_at_once_as_if_there_were_no_ground() -> None:
    state, _, contacts = on_ground(0.5, 246.0)
    assert not any(contacts)
    assert state[2] == pytest.approx(0.5 * (246.0 / 10.0 - 9.8) * 0.25, rel=5e-3)


def test_the_ground_carries_what_thrust_leaves_of_the_weight() -> None:
    for thrust in (0.0, 40.0):
        wrench = np.array([thrust, 0.0, 0.0, 0.0])
        state = dynamics.integrate(np.zeros(12), wrench, ALONE, 0.0, GRAVITY)
        _, force, touching = environment.touch_ground(GROUND, state, ALONE, 0.0025)
        assert touching is True
        assert force == pytest.approx(WEIGHT - thrust)


def test_in_the_air_there_is_no_contact_and_nothing_changes() -> None:
    state = np.array([1.0, 2.0, 0.001, 1, 1, -1, 0.1, 0.1, 0.1, 1, 1, 1])
    result, force, touching = environment.touch_ground(GROUND, state, ALONE, 0.0025)
    np.testing.assert_array_equal(result, state)
    assert (force, touching) == (0.0, False)


def test_a_hard_landing_neither_bounces_nor_sinks() -> None:
    start = np.zeros(12)
    start[2] = 1.0
    state, heights, contacts = on_ground(1.0, 0.0, start)
    assert min(heights) == 0.0
    first = contacts.index(True)
    assert first * 0.0025 == pytest.approx(math.sqrt(2.0 / 9.8), abs=0.005)
    assert all(contacts[first:])
    assert set(heights[first:]) == {0.0}
    np.testing.assert_array_equal(state[3:6], 0.0)


@pytest.mark.parametrize("thrust", [0.0, 60.0])
def test_a_tilted_vehicle_is_levelled_and_keeps_its_heading(thrust: float) -> None:
    start = np.zeros(12)
    start[6:9] = [0.2, -0.15, 1.0]
    state, heights, _ = on_ground(1.5, thrust, start)
    np.testing.assert_allclose(state[6:8], 0.0, atol=1e-5)
    np.testing.assert_allclose(state[9:12], 0.0, atol=1e-4)
    assert state[8] == pytest.approx(1.0, abs=0.02)
    assert set(heights) == {0.0}


def test_levelling_does_not_swing_past_level() -> None:
    start = np.zeros(12)
    start[6] = 0.3
    roll = [0.3]
    state = start
    for _ in range(100):
        state, _, _ = on_ground(0.0025, 0.0, state)
        roll.append(state[6])
    assert min(roll) >= 0.0
    assert all(later <= earlier for earlier, later in pairwise(roll))


def test_the_gear_holds_a_torque_up_to_weight_times_its_radius() -> None:
    most = WEIGHT * 0.3
    held, _, _ = on_ground(0.5, torque=np.array([0.95 * most, 0.0, 0.0]))
    np.testing.assert_allclose(held[6:12], 0.0, atol=2e-5)
    tipping, _, _ = on_ground(0.1, torque=np.array([1.05 * most, 0.0, 0.0]))
    assert tipping[6] > 0.01


def test_a_vehicle_on_its_side_is_not_raised_by_its_gear() -> None:
    start = np.zeros(12)
    start[6] = 1.4
    state, _, _ = on_ground(1.0, 0.0, start)
    assert state[6] == pytest.approx(1.4, abs=1e-6)


def test_sliding_stops_after_the_distance_of_dry_friction() -> None:
    start = np.zeros(12)
    start[3:5] = [0.6, -0.8]
    state, _, _ = on_ground(0.5, 0.0, start)
    np.testing.assert_allclose(state[3:6], 0.0, atol=1e-9)
    distance = 1.0 / (2.0 * 0.6 * 9.8)
    np.testing.assert_allclose(state[0:2], [0.6 * distance, -0.8 * distance], rtol=0.01)


def test_a_spin_on_the_ground_comes_to_rest() -> None:
    start = np.zeros(12)
    start[11] = 2.0
    state, _, _ = on_ground(0.5, 0.0, start)
    assert state[11] == pytest.approx(0.0, abs=1e-9)
    assert state[8] > 0.0


def test_a_side_force_below_friction_does_not_move_the_vehicle() -> None:
    held, _, _ = on_ground(2.0, force=np.array([0.9 * 0.6 * WEIGHT, 0.0, 0.0]))
    np.testing.assert_allclose(held, 0.0, atol=1e-6)
    sliding, _, _ = on_ground(1.0, force=np.array([1.1 * 0.6 * WEIGHT, 0.0, 0.0]))
    assert sliding[0] == pytest.approx(0.5 * 0.1 * 0.6 * 9.8, rel=0.02)


@pytest.mark.parametrize(("side", "angle", "towards"), [((1.0, 0.0), 7, 1.0), ((0.0, 1.0), 6, -1.0)])
def test_an_off_centre_load_stands_as_long_as_its_weight_is_within_the_gear(
    side: tuple[float, float], angle: int, towards: float
) -> None:
    """Centre of mass 0.2 m ahead (or left) is carried; 0.4 m tips the nose (the left side) down."""

    def stand(seconds: float, distance: float) -> np.ndarray:
        offset = (distance * side[0], distance * side[1], -0.3)
        return on_ground(seconds, 30.0, properties=payload.mass_properties(BODY, 5.0, offset))[0]

    np.testing.assert_allclose(stand(0.5, 0.6)[6:12], 0.0, atol=1e-6)
    assert towards * stand(0.2, 1.2)[angle] > 0.01


def test_a_batch_on_and_off_the_ground_equals_its_members() -> None:
    rng = np.random.default_rng(2)
    state = rng.uniform(-1.0, 1.0, (12, 40))
    loads = rng.uniform(0.0, 6.7, 40)
    together = payload.mass_properties(BODY, loads, (0.2, 0.1, -0.3))
    result, force, touching = environment.touch_ground(GROUND, state, together, 0.0025)
    assert 5 < np.count_nonzero(touching) < 35
    for index in range(40):
        alone = payload.mass_properties(BODY, float(loads[index]), (0.2, 0.1, -0.3))
        single = environment.touch_ground(GROUND, state[:, index], alone, 0.0025)
        np.testing.assert_allclose(result[:, index], single[0], rtol=0.0, atol=1e-12)
        assert np.broadcast_to(force, 40)[index] == pytest.approx(single[1], rel=1e-12)
        assert touching[index] == single[2]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"friction": -0.1}, "friction of -0.1 is below zero"),
        ({"gear_radius": 0.0}, "gear radius of 0.0 m is not above zero"),
        ({"levelling_time": math.nan}, "levelling time of nan s is not above zero"),
    ],
)
def test_impossible_grounds_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Ground(**options)
