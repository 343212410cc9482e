"""The filterpy filter is the textbook filter, tracks a load step, and copes with gaps and jitter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kffa_offboard.control import kalman
from kffa_offboard.control.observer import PlantModel

MODEL = PlantModel(np.array([2.0, 24.0]), np.array([10.0, 0.0]), np.zeros(2))
EXTENDED = kalman.KalmanParameters(np.array([1e-5, 4e-6]), np.array([50.0, 100.0]))
LITERAL = kalman.KalmanParameters(np.full(2, 1e-3), np.full(2, 1.0), model="literal")


FUSED = kalman.KalmanParameters(np.array([1e-5, 4e-6]), np.array([50.0, 100.0]), np.array([1e-4, 4e-4]))


def textbook_step(exact_model, parameters, state, command, measurement, fresh, dt, rate):
    """Predict and correct channel by channel with scalars, straight from eq 44-48."""
    n, blocks, out = parameters.states, [], []
    covariances = kalman.covariances(parameters, MODEL, state)
    for c in range(2):
        a = float(MODEL.damping[c])
        p = (1 - np.exp(-a * dt)) / a if a else dt
        q = (dt - p) / a if a else dt**2 / 2
        f, noise = exact_model(parameters, MODEL, c, dt)
        x = np.array([state.estimate[c], state.rate[c], state.disturbance[c]])[:n]
        covariance = covariances[c]
        x = f @ x + np.array([q, p, 0.0])[:n] * MODEL.b0[c] * command[c]
        covariance = f @ covariance @ f.T + noise
        sensors = [(0, measurement[c], parameters.measurement_variance[c])]
        if parameters.rate_variance is not None:  # independent noise: one after the other is the same as both
            sensors.append((1, rate[c], parameters.rate_variance[c]))
        for row, value, r in sensors if fresh[c] else []:
            gain = covariance[:, row] / (covariance[row, row] + r)
            x = x + gain * (value - x[row])
            covariance = covariance - np.outer(gain, covariance[row])
        blocks.append((x, covariance))
        out.append(x[0])
    return blocks, np.array(out)


@pytest.mark.parametrize("parameters", [EXTENDED, LITERAL, FUSED], ids=["extended", "literal", "fused"])
@given(data=st.data())
def test_filterpy_and_the_textbook_agree(exact_model, parameters, data) -> None:
    state = kalman.initial_state(parameters, np.array([0.1, 5.0]), np.array([0.0, -9.8]))
    for _ in range(12):
        dt = data.draw(st.floats(0.001, 0.2))
        command = np.array(data.draw(st.lists(st.floats(-1, 1), min_size=2, max_size=2)))
        measurement = np.array(data.draw(st.lists(st.floats(-5, 5), min_size=2, max_size=2)))
        fresh = np.array(data.draw(st.lists(st.booleans(), min_size=2, max_size=2)))
        rate = np.array(data.draw(st.lists(st.floats(-5, 5), min_size=2, max_size=2)))
        blocks, expected = textbook_step(
            exact_model, parameters, state, command, measurement, fresh, dt, rate
        )
        state, filtered = kalman.step(parameters, MODEL, state, command, measurement, fresh, dt, rate)
        np.testing.assert_allclose(filtered, expected, rtol=1e-8, atol=1e-9)
        n, covariances = parameters.states, kalman.covariances(parameters, MODEL, state)
        for c, (x, covariance) in enumerate(blocks):
            np.testing.assert_allclose(
                np.array([state.estimate[c], state.rate[c], state.disturbance[c]])[:n],
                x,
                rtol=1e-7,
                atol=1e-8,
            )
            np.testing.assert_allclose(covariances[c], covariance, rtol=1e-6, atol=1e-9)


@given(dts=st.lists(st.floats(0.001, 0.2), min_size=20, max_size=60), seed=st.integers(0, 1000))
def test_for_any_jitter_and_gaps_the_error_is_what_the_filter_says_it_is(dts: list[float], seed: int) -> None:
    generator = np.random.default_rng(seed)
    state = kalman.initial_state(EXTENDED, np.zeros(2), np.zeros(2))
    for dt in dts:
        measurement = np.sqrt(EXTENDED.measurement_variance) * generator.standard_normal(2)
        fresh = generator.random(2) < 0.8
        state, filtered = kalman.step(EXTENDED, MODEL, state, np.zeros(2), measurement, fresh, dt)
        covariances = kalman.covariances(EXTENDED, MODEL, state)
        deviations = np.sqrt(covariances[:, 0, 0])
        assert np.all(np.isfinite(deviations)) and np.all(np.abs(filtered) < 6.0 * deviations)
    assert np.all(np.linalg.eigvalsh(covariances) > -1e-12)


def test_the_literal_filter_filters_nothing() -> None:
    # Design section 3: with Q = 0.03 I and R = 0.001 the gain on the output is 0.97.
    state = kalman.initial_state(LITERAL, np.zeros(2), np.zeros(2))
    for _ in range(200):
        state, _ = kalman.step(LITERAL, MODEL, state, np.zeros(2), np.zeros(2), np.array([True, True]), 0.005)
    _, jumped = kalman.step(LITERAL, MODEL, state, np.zeros(2), np.ones(2), np.array([True, True]), 0.005)
    np.testing.assert_allclose(jumped, 0.97, atol=0.01)


def test_the_extended_filter_quietens_noise_and_still_finds_a_released_load() -> None:
    generator = np.random.default_rng(3)
    state = kalman.initial_state(EXTENDED, np.zeros(2), np.zeros(2))
    errors, raw = [], []
    for _ in range(400):
        noise = 0.002 * generator.standard_normal(2)
        state, filtered = kalman.step(
            EXTENDED, MODEL, state, np.zeros(2), noise, np.array([True, True]), 0.01
        )
        errors.append(filtered[1])
        raw.append(noise[1])
    assert np.std(errors[50:]) < 0.75 * np.std(raw[50:])
    for k in range(1, 31):
        y = np.array([0.0, 0.5 * 4.9 * (0.01 * k) ** 2])
        state, _ = kalman.step(EXTENDED, MODEL, state, np.zeros(2), y, np.array([True, True]), 0.01)
    assert state.disturbance[1] == pytest.approx(4.9, rel=0.1)


def test_the_climb_rate_makes_the_height_quieter() -> None:
    spread = []
    for parameters in (EXTENDED, FUSED):
        generator = np.random.default_rng(4)
        state = kalman.initial_state(parameters, np.zeros(2), np.zeros(2))
        heights = []
        for _ in range(600):
            height = np.sqrt(parameters.measurement_variance) * generator.standard_normal(2)
            rate = np.sqrt(FUSED.rate_variance) * generator.standard_normal(2)
            state, filtered = kalman.step(
                parameters, MODEL, state, np.zeros(2), height, np.array([True, True]), 0.01, rate
            )
            heights.append(filtered[1])
        spread.append(np.std(heights[100:]))
    assert spread[1] < 0.7 * spread[0]


def test_what_is_not_fresh_is_not_read() -> None:
    state = kalman.initial_state(FUSED, np.zeros(2), np.zeros(2))
    fresh, nothing = np.array([True, False]), np.array([0.1, np.nan])
    state, _ = kalman.step(FUSED, MODEL, state, np.zeros(2), nothing, fresh, 0.01, nothing)
    assert np.all(np.isfinite([state.estimate, state.rate, state.disturbance]))
    assert state.estimate[0] > 0.01 and state.estimate[1] == 0.0


def test_without_a_rate_the_gain_is_that_of_a_filter_without_one() -> None:
    estimates = []
    for parameters in (FUSED, EXTENDED):
        state = kalman.initial_state(parameters, np.zeros(2), np.zeros(2))
        for _ in range(20):
            state, _ = kalman.step(
                parameters, MODEL, state, np.zeros(2), np.full(2, 0.1), np.full(2, True), 0.01
            )
        estimates.append([state.estimate, state.rate, state.disturbance])
    np.testing.assert_array_equal(*estimates)


def test_a_known_step_of_the_disturbance_is_added_to_it() -> None:
    state = kalman.initial_state(EXTENDED, np.zeros(2), np.array([1.0, -9.8]))
    stepped = kalman.with_disturbance_step(EXTENDED, state, np.array([0.0, 3.0]))
    np.testing.assert_allclose(stepped.disturbance, [1.0, -6.8])
