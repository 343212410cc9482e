"""The observer is told the command as the vehicle feels it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kffa_offboard.control import actuator


def parameters(delay: float, lag: float = 0.0) -> actuator.ActuatorParameters:
    return actuator.ActuatorParameters(np.array([delay]), np.array([lag]))


@given(
    dts=st.lists(st.floats(0.002, 0.05), min_size=5, max_size=20),
    delay=st.floats(0.0, 0.1),
    seed=st.integers(0, 99),
)
def test_the_mean_acting_command_is_the_integral_of_the_delayed_one(
    dts: list[float], delay: float, seed: int
) -> None:
    commands = np.random.default_rng(seed).uniform(-1, 1, len(dts))
    state = actuator.initial_state(np.zeros(1))
    starts, now, acted = [-np.inf], 0.0, []
    for dt, command in zip(dts, commands, strict=True):
        state = actuator.send(state, np.array([command]))
        starts.append(now)
        state, mean = actuator.step(parameters(delay), state, dt)
        acted.append(mean[0] * dt)
        now += dt
    edges = np.append(np.array(starts[1:]) + delay, np.inf)
    spans = np.clip(np.minimum(edges[1:], now) - edges[:-1], 0.0, None)
    assert sum(acted) == pytest.approx(float(spans @ commands), abs=1e-9)


def test_a_step_through_delay_and_lag_reaches_63_percent_after_both() -> None:
    state = actuator.send(actuator.initial_state(np.zeros(1)), np.ones(1))
    for _ in range(9):  # 0.04 s delay + 0.05 s lag
        state, _ = actuator.step(parameters(0.04, 0.05), state, 0.01)
    assert state.lagged[0] == pytest.approx(1 - np.exp(-1), abs=1e-9)


@given(delay=st.floats(0.0, 0.08), lag=st.sampled_from([0.0, 0.03, 0.06]), horizon=st.floats(0.01, 0.1))
def test_the_forecast_is_what_comes_when_nothing_more_is_sent(
    delay: float, lag: float, horizon: float
) -> None:
    state = actuator.initial_state(np.zeros(1))
    for value in (0.3, -0.7, 1.0, 0.2):
        state = actuator.send(state, np.array([value]))
        state, _ = actuator.step(parameters(delay, lag), state, 0.01)
    predicted = actuator.forecast(parameters(delay, lag), state, np.array([horizon]))
    _, came = actuator.step(parameters(delay, lag), state, horizon)
    assert predicted[0] == pytest.approx(came[0], abs=1e-9)


def test_commands_that_have_had_their_effect_are_forgotten() -> None:
    state = actuator.initial_state(np.zeros(1))
    for k in range(500):
        state = actuator.send(state, np.array([float(k)]))
        state, _ = actuator.step(parameters(0.05), state, 0.01)
    assert len(state.commands) <= 7


def test_a_command_between_two_steps_takes_over_from_the_last_one_when_it_is_sent() -> None:
    state = actuator.send(actuator.initial_state(np.zeros(1)), np.ones(1))
    state = actuator.send(state, np.full(1, -1.0), after=0.02)
    state, mean = actuator.step(parameters(0.01), state, 0.05)
    assert mean[0] == pytest.approx((0.01 * 0.0 + 0.02 * 1.0 + 0.02 * -1.0) / 0.05)
    state, mean = actuator.step(parameters(0.01), state, 0.05)
    assert mean[0] == pytest.approx(-1.0)


def test_a_command_supersedes_what_was_sent_later_than_its_own_moment() -> None:
    """Samples that were taken before the command between two steps, but come after it."""
    state = actuator.send(actuator.initial_state(np.zeros(1)), np.ones(1))
    state = actuator.send(state, np.full(1, -1.0), after=0.02)
    state, mean = actuator.step(parameters(0.0), state, 0.01)
    assert mean[0] == pytest.approx(1.0)
    state = actuator.send(state, np.full(1, 0.5))
    state, mean = actuator.step(parameters(0.0), state, 0.05)
    assert mean[0] == pytest.approx(0.5)


def test_a_command_sent_again_at_the_same_moment_replaces_the_first() -> None:
    state = actuator.send(actuator.initial_state(np.zeros(1)), np.ones(1))
    state = actuator.send(state, np.full(1, 0.5))
    _, acted = actuator.step(parameters(0.0), state, 0.01)
    assert acted[0] == 0.5


def test_the_mean_over_a_step_is_that_of_the_lag_and_not_its_end() -> None:
    state = actuator.send(actuator.initial_state(np.zeros(1)), np.ones(1))
    state, mean = actuator.step(parameters(0.0, 0.1), state, 0.1)
    np.testing.assert_allclose(mean, np.exp(-1.0), rtol=1e-12)
    np.testing.assert_allclose(state.lagged, 1.0 - np.exp(-1.0), rtol=1e-12)


def test_a_channel_with_a_longer_delay_than_the_others_has_its_own() -> None:
    both = actuator.ActuatorParameters(np.array([0.0, 0.1]), np.zeros(2))
    state = actuator.initial_state(np.zeros(2))
    acted = []
    for number in range(30):
        state = actuator.send(state, np.full(2, float(number)))
        state, mean = actuator.step(both, state, 0.01)
        acted.append(mean)
    np.testing.assert_allclose(acted[20], [20.0, 10.0], atol=1e-6)


def test_with_a_delay_that_was_made_longer_the_oldest_command_acts_on() -> None:
    state = actuator.initial_state(np.zeros(1))
    for _ in range(10):
        state = actuator.send(state, np.ones(1))
        state, _ = actuator.step(parameters(0.02), state, 0.01)
    _, mean = actuator.step(parameters(0.5), state, 0.01)
    np.testing.assert_allclose(mean, 1.0)
