"""The load is weighed from thrust and climb rate, and its changes are noticed. Many flights in one batch."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from kffa_offboard.control import actuator, payload
from kffa_offboard.control.payload import GRAVITY

EMPTY, HOVER, DT = 10.0, 0.398, 0.01
DELAY, LAG, RATE_NOISE = 0.06, 0.05, 0.02
SEEDS = 200
PARAMETERS = payload.PayloadParameters(
    vehicle_mass=EMPTY,
    hover_thrust=HOVER,
    actuator=actuator.ActuatorParameters(np.array([DELAY]), np.array([LAG])),
    rate_variance=RATE_NOISE**2,
)


@dataclass
class Flown:
    """Estimates and decided changes of every step and flight, (steps, flights)."""

    time: np.ndarray
    mass: np.ndarray
    std: np.ndarray
    change: np.ndarray

    def at(self, time):
        return self.mass[np.searchsorted(self.time, time)]


def fly(
    load_of,
    seconds,
    *,
    flights=SEEDS,
    climb_of=lambda t: 0.0,
    gust=0.0,
    tilt_of=lambda t: 1.0,
    mistimed=0.0,
    jitter=0.0,
    gain=0.15,
    observed=0.15,
):
    """Hold a climb rate by P control of it, with noise, delay and lag; the load is `load_of(t)` kg.

    A sample is up to `jitter` s older or newer than usual. The load is balanced `observed` s late.
    """
    generator = np.random.default_rng(7)
    true = replace(PARAMETERS.actuator, delay=PARAMETERS.actuator.delay + mistimed)
    start = np.full((1, flights), HOVER * (1.0 + load_of(0.0) / EMPTY))
    queue = actuator.initial_state(start)
    rate, wind, wanted = np.zeros(flights), np.zeros(flights), start[0]
    state = payload.initial_state(start[0], rate)
    times, masses, stds, changes = [], [], [], []
    for k in range(round(seconds / DT)):
        time = (k + 1) * DT
        total, factor = EMPTY + load_of(time), tilt_of(time)
        queue, acted = actuator.step(true, queue, DT)
        wind += (-wind / 2.0 + gust * np.sqrt(1.0 / DT) * generator.standard_normal(flights)) * DT
        acceleration = acted[0] * factor * EMPTY / HOVER * GRAVITY / total - GRAVITY + wind / total
        rate = rate + acceleration * DT
        measured = rate + RATE_NOISE * generator.standard_normal(flights)
        if jitter:
            measured += acceleration * generator.uniform(-jitter, jitter, flights)
        state, found = payload.step(PARAMETERS, state, measured, np.array(factor), True, DT)
        if time < 1.0:
            state = payload.accept(PARAMETERS, state)
        # Closing the loop: what an observer would have found of the load, late; and a correction.
        balance = HOVER * (1.0 + load_of(time - observed) / EMPTY)
        wanted = np.clip((balance + gain * (climb_of(time) - measured)) / factor, 0.05, 0.95)
        state = payload.send(state, wanted)
        queue = actuator.send(queue, wanted[None])
        times.append(time)
        masses.append(found.mass)
        stds.append(found.std)
        changes.append(found.change if time >= 1.0 else 0.0 * found.change)
    return Flown(np.array(times), np.array(masses), np.array(stds), np.array(changes))


def picked_up(mass, time=2.0):
    return lambda t: mass if t >= time else 0.0


@pytest.fixture(scope="module")
def pick_up_and_drop():
    return fly(lambda t: 5.0 if 2.0 <= t < 4.0 else 0.0, 5.0)


def test_the_mass_is_within_five_percent_one_second_after_pick_up(pick_up_and_drop):
    assert np.abs(pick_up_and_drop.at(3.0) - 5.0).max() <= 0.25


def test_pick_up_and_drop_are_noticed_once_and_within_a_quarter_of_a_second(pick_up_and_drop):
    noticed = pick_up_and_drop.change != 0.0
    assert (noticed.sum(axis=0) == 2).all()
    first = pick_up_and_drop.time[noticed.argmax(axis=0)]
    last = pick_up_and_drop.time[len(noticed) - 1 - noticed[::-1].argmax(axis=0)]
    assert (first - 2.0).max() <= 0.25 and (first > 2.0).all()
    assert (last - 4.0).max() <= 0.25 and (last > 4.0).all()


def test_a_change_has_its_sign_and_its_size(pick_up_and_drop):
    changes = pick_up_and_drop.change[pick_up_and_drop.change != 0.0]
    up, down = changes[changes > 0.0], changes[changes < 0.0]
    assert len(up) == len(down) == SEEDS
    assert abs(up.mean() - 5.0) <= 0.6 and up.std() <= 0.6
    assert abs(down.mean() + 5.0) <= 0.3 and down.std() <= 0.4


def test_the_stated_deviation_is_that_of_the_noise_and_of_the_hover_thrust():
    flown = fly(lambda t: 5.0, 4.0)
    error = flown.at(3.5) - 5.0
    std = flown.std[350, 0]
    from_hover = 15.0 * PARAMETERS.hover_thrust_uncertainty
    noise = np.sqrt(std**2 - from_hover**2)
    assert std > from_hover
    assert 0.4 * noise <= error.std() <= noise  # less than stated: here is no wind


def test_the_stated_deviation_of_a_drop_covers_samples_of_another_age_than_usual():
    """PX4's are 4 to 12 ms old when they come, and what thrust does is known no better."""
    flown = fly(
        lambda t: 5.0 if t < 2.0 else 0.0, 2.5, jitter=0.005, mistimed=-0.008, gain=0.4, observed=0.05
    )
    step = (flown.change != 0.0).argmax(axis=0)
    flights = np.arange(SEEDS)
    error = flown.mass[step, flights] / flown.std[step, flights]
    assert np.abs(error).max() <= 3.0 and np.sqrt(np.mean(error**2)) <= 1.25


def test_a_hover_thrust_that_is_one_percent_wrong_shows_as_one_percent_of_all_mass():
    wrong = replace(PARAMETERS, hover_thrust=1.01 * HOVER)
    state = payload.initial_state(np.array(1.5 * HOVER), np.array(0.0))
    for _ in range(400):
        state, found = payload.step(wrong, state, np.array(0.0), np.array(1.0), True, DT)
        state = payload.send(state, np.array(1.5 * HOVER))
    assert found.mass + EMPTY == pytest.approx(15.0 / 1.01, abs=0.01)


@pytest.mark.parametrize(("mass", "limit"), [(1.0, 0.5), (2.0, 0.35), (6.73, 0.25)])
def test_other_loads_are_noticed_too(mass, limit):
    flown = fly(picked_up(mass), 3.2)
    noticed = flown.change > 0.0
    assert noticed.any(axis=0).all()
    assert (flown.time[noticed.argmax(axis=0)] - 2.0).max() <= limit
    assert np.abs(flown.at(3.0) - mass).max() <= 0.35


def test_nothing_is_noticed_in_gusts():
    """A vertical force of 1.4 N rms that lasts 2 s: more than 1.5 m/s of gusts with a drag of 0.6 N s/m."""
    flown = fly(lambda t: 0.0, 20.0, gust=1.4)
    assert not flown.change.any()


def test_nothing_is_noticed_when_the_vehicle_climbs_and_brakes_with_a_delay_that_is_not_quite_known():
    flown = fly(lambda t: 5.0, 12.0, climb_of=lambda t: 3.0 * np.sign(np.sin(2.0 * t)), mistimed=0.008)
    assert not flown.change.any()


def test_a_tilt_is_taken_into_account():
    flown = fly(lambda t: 5.0, 6.0, tilt_of=lambda t: np.cos(0.4) if t > 3.0 else 1.0)
    assert not flown.change.any()
    assert abs(flown.at(5.5).mean() - 5.0) <= 0.05


def test_an_alarm_without_a_change_is_forgotten():
    state = payload.initial_state(np.array(HOVER), np.array(0.0))
    for k in range(400):
        rate = 0.3 if k in (200, 201, 202) else 0.0  # three bad samples
        state, found = payload.step(PARAMETERS, state, np.array(rate), np.array(1.0), True, DT)
        state = payload.send(state, np.array(HOVER))
        assert k < 100 or found.change == 0.0
    assert np.isinf(state.suspected)
    assert abs(found.mass) <= 0.2


def test_without_a_fresh_rate_the_estimate_waits():
    state = payload.initial_state(np.array(HOVER), np.array(0.0))
    after, found = payload.step(PARAMETERS, state, np.array(np.nan), np.array(1.0), False, DT)
    assert np.isfinite(found.mass) and after.ratio == state.ratio
    assert after.ratio_variance > state.ratio_variance


def test_one_flight_is_the_same_in_a_batch():
    single = fly(picked_up(3.0, 1.5), 2.5, flights=1)
    generator_order = fly(picked_up(3.0, 1.5), 2.5, flights=1)
    assert np.array_equal(single.mass, generator_order.mass)
    one = payload.initial_state(np.array(HOVER), np.array(0.1))
    many = payload.initial_state(np.full(3, HOVER), np.full(3, 0.1))
    for k in range(50):
        rate = 0.1 * np.sin(0.3 * k)
        one, a = payload.step(PARAMETERS, one, np.array(rate), np.array(1.0), k % 2 == 0, DT)
        many, b = payload.step(PARAMETERS, many, np.full(3, rate), np.ones(3), k % 2 == 0, DT)
        one, many = payload.send(one, np.array(0.5)), payload.send(many, np.full(3, 0.5))
    assert np.allclose(b.mass, a.mass) and np.allclose(b.std, a.std)


@pytest.mark.parametrize("flying", [True, False])
def test_with_jitter_the_thrust_of_one_vehicle_moves_as_that_of_a_batch(flying):
    generator = np.random.default_rng(5)
    one = payload.initial_state(np.array(HOVER), np.array(0.1))
    batch = payload.initial_state(np.full(1, HOVER), np.full(1, 0.1))
    for dt in generator.choice([0.003, 0.004, 0.005, 0.03, 0.3], 400, p=[0.3, 0.3, 0.3, 0.08, 0.02]):
        if flying:
            one, _ = payload.step(PARAMETERS, one, np.array(0.1), np.array(1.0), True, float(dt))
            batch, _ = payload.step(PARAMETERS, batch, np.full(1, 0.1), np.ones(1), True, float(dt))
        else:
            one, batch = (payload.advance(PARAMETERS, state, float(dt)) for state in (one, batch))
        assert float(one.acted) == pytest.approx(batch.acted[0], rel=1e-14)
        assert one.thrust.ages == batch.thrust.ages
        assert one.thrust.lagged == pytest.approx(batch.thrust.lagged[0, 0], rel=1e-14)
        thrust = generator.uniform(0.3, 0.7)
        one, batch = payload.send(one, np.array(thrust)), payload.send(batch, np.full(1, thrust))


@pytest.mark.parametrize(("before", "after"), [(0.0, 5.0), (5.0, 0.0)])
def test_one_vehicle_alone_notices_a_load_that_comes_and_one_that_goes(before, after):
    """Its steps are written out, other than those of a batch."""
    thrust, rate = np.array(HOVER * (1.0 + before / EMPTY)), 0.0
    state = payload.initial_state(thrust, np.array(0.0))
    noticed = []
    for k in range(250):
        total = EMPTY + (before if k < 200 else after)
        rate += (float(thrust) * EMPTY / HOVER * GRAVITY / total - GRAVITY) * DT
        state, found = payload.step(PARAMETERS, state, np.array(rate), np.array(1.0), True, DT)
        if k < 100:
            state = payload.accept(PARAMETERS, state)
        if found.change != 0.0:
            noticed.append((k, float(found.change)))
    ((step, change),) = noticed
    assert 200 < step <= 225 and change == pytest.approx(after - before, abs=0.5)


@pytest.mark.parametrize("shape", [(), (3,)])
@pytest.mark.parametrize(("rate", "total"), [(-1000.0, 5.0 * EMPTY), (1000.0, EMPTY / 3.0)])
def test_however_wrong_a_climb_rate_is_the_vehicle_weighs_a_third_to_five_times_its_own_mass(
    shape, rate, total
):
    """Mass is divided by the estimate: one that comes near zero, or below it, would be no mass any more."""
    state = payload.initial_state(np.full(shape, HOVER), np.zeros(shape))
    for measured in (0.0, rate):
        measured = np.full(shape, measured)
        state, found = payload.step(PARAMETERS, state, measured, np.ones(shape), True, DT)
    assert EMPTY + found.mass == pytest.approx(np.full(shape, total))
