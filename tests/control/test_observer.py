"""The observer finds rate and disturbance, for any sampling, and its gains are the published ones."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from kffa_offboard.control import observer

ONE = np.ones(1)


def plant(b0: float = 2.0, damping: float = 0.0, stiffness: float = 0.0) -> observer.PlantModel:
    return observer.PlantModel(b0 * ONE, damping * ONE, stiffness * ONE)


def at_rest() -> observer.ObserverState:
    zero = np.zeros(1)
    return observer.ObserverState(zero, zero, zero, zero)


@given(damping=st.floats(0.0, 30.0), dt=st.floats(1e-4, 0.3))
def test_the_transition_is_the_matrix_exponential(damping: float, dt: float) -> None:
    continuous = np.array([[0.0, 1.0, 0.0], [0.0, -damping, 1.0], [0.0, 0.0, 0.0]])
    e, p, q = (float(v) for v in observer.transition(np.asarray(damping), dt))
    np.testing.assert_allclose(
        [[1.0, p, q], [0.0, e, p], [0.0, 0.0, 1.0]], expm(continuous * dt), rtol=1e-8, atol=1e-12
    )


@given(omega_o=st.floats(1.0, 300.0), h=st.floats(0.001, 0.2))
def test_without_damping_the_gains_are_those_of_miklosovic(omega_o: float, h: float) -> None:
    parameters = observer.ObserverParameters.from_bandwidth(omega_o * ONE)
    gains = observer.correction_gains(parameters, np.zeros(1), h * ONE)
    beta = np.exp(-omega_o * h)
    expected = [1 - beta**3, 1.5 * (1 - beta) ** 2 * (1 + beta) / h, (1 - beta) ** 3 / h**2]
    np.testing.assert_allclose(np.ravel(gains), expected, rtol=1e-6)


@given(omega_o=st.floats(2.0, 100.0), damping=st.floats(0.0, 15.0), h=st.floats(0.002, 0.1))
def test_the_error_poles_are_where_they_are_asked_for(omega_o: float, damping: float, h: float) -> None:
    parameters = observer.ObserverParameters.from_bandwidth(omega_o * ONE)
    l1, l2, l3 = (float(v[0]) for v in observer.correction_gains(parameters, damping * ONE, h * ONE))
    e, p, q = (float(v[0]) for v in observer.transition(damping * ONE, h * ONE))
    phi = np.array([[1.0, p, q], [0.0, e, p], [0.0, 0.0, 1.0]])
    error = (np.eye(3) - np.outer([l1, l2, l3], [1.0, 0.0, 0.0])) @ phi
    beta = np.exp(-omega_o * h)
    wanted = np.array([1.0, -3 * beta, 3 * beta**2, -(beta**3)])
    np.testing.assert_allclose(np.poly(error), wanted, atol=1e-6)


def test_a_constant_disturbance_is_found_exactly() -> None:
    model = plant(damping=3.0, stiffness=10.0)
    parameters = observer.ObserverParameters.from_bandwidth(20.0 * ONE)
    state, y, v, h, true_disturbance = at_rest(), 0.3, 0.0, 0.01, -4.0
    continuous = np.array([[0.0, 1.0], [-10.0, -3.0]])
    step_matrix = expm(continuous * h)
    forcing = np.linalg.solve(continuous, (step_matrix - np.eye(2)) @ np.array([0.0, 1.0]))
    fresh = np.array([True])
    for k in range(300):
        u = np.sin(0.05 * k)
        y, v = step_matrix @ [y, v] + forcing * (true_disturbance + 2.0 * u)
        state = observer.predict(model, state, np.array([u]), h)
        state = observer.correct(parameters, model, state, np.array([y]), fresh)
    assert state.disturbance[0] == pytest.approx(true_disturbance, abs=0.05)
    assert state.rate[0] == pytest.approx(v, abs=0.02)


def closed_loop_radius(omega_o: float, omega_c: float, h: float, exact: bool) -> float:
    """Spectral radius of a double integrator (y, v) under LADRC with the estimates (s1, s2, s3)."""
    plant_part = np.array([[1.0, h], [0.0, 1.0]])
    forcing = np.array([h**2 / 2, h])
    feedback = np.array([omega_c**2, 2 * omega_c, 1.0])
    if exact:
        parameters = observer.ObserverParameters.from_bandwidth(omega_o * ONE)
        gains = np.ravel(observer.correction_gains(parameters, np.zeros(1), h * ONE))
        phi = np.array([[1.0, h, h**2 / 2], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
        gamma = np.array([h**2 / 2, h, 0.0])
    else:
        gains = h * np.array([3 * omega_o, 3 * omega_o**2, omega_o**3])
        phi = np.eye(3) + h * np.eye(3, k=1)
        gamma = np.array([0.0, h, 0.0])
    columns = []
    for start in np.eye(5):
        state, estimate = start[:2], start[2:]
        u = -feedback @ estimate
        new_state = plant_part @ state + forcing * u
        if exact:  # current estimator: predict, then correct with the new output
            predicted = phi @ estimate + gamma * u
            new_estimate = predicted + gains * (new_state[0] - predicted[0])
        else:
            new_estimate = phi @ estimate + gamma * u + gains * (state[0] - estimate[0])
        columns.append(np.concatenate([new_state, new_estimate]))
    return float(np.max(np.abs(np.linalg.eigvals(np.array(columns).T))))


@pytest.mark.parametrize(("omega_o", "omega_c"), [(260.0, 30.0), (240.0, 25.0)])
def test_the_published_bandwidths_are_stable_where_forward_euler_diverges(
    omega_o: float, omega_c: float
) -> None:
    assert closed_loop_radius(omega_o, omega_c, 0.005, exact=False) > 1.5
    assert closed_loop_radius(omega_o, omega_c, 0.005, exact=True) < 0.95


@given(
    dts=st.lists(st.floats(0.001, 0.2), min_size=30, max_size=80),
    damping=st.floats(0.0, 20.0),
    omega_o=st.floats(5.0, 260.0),
)
def test_the_error_dies_out_for_any_jitter(dts: list[float], damping: float, omega_o: float) -> None:
    model = plant(damping=damping)
    parameters = observer.ObserverParameters.from_bandwidth(omega_o * ONE)
    state = observer.ObserverState(0.1 * ONE, 0 * ONE, 0 * ONE, 0 * ONE)
    for dt in dts:
        state = observer.predict(model, state, np.zeros(1), dt)
        state = observer.correct(parameters, model, state, np.zeros(1), np.array([True]))
        assert np.all(np.isfinite([state.estimate, state.rate, state.disturbance]))
        assert abs(state.estimate[0]) < 10.0
    decayed = np.exp(-omega_o * sum(dts))
    assert abs(state.estimate[0]) <= max(1e-6, 1e3 * decayed**0.5)


@pytest.mark.parametrize("batch", [False, True])
@pytest.mark.parametrize(("omega_o", "damping"), [(25.0, 200.0), (10.0, 100.0), (10.0, 50.0)])
def test_estimates_of_a_plant_quicker_than_the_observer_stay_near_when_half_the_samples_are_lost(
    omega_o: float, damping: float, batch: bool
) -> None:
    random, noise = np.random.default_rng(4), 0.001
    shape = (1, 1) if batch else (1,)
    model, parameters = plant(damping=damping), observer.ObserverParameters.from_bandwidth(omega_o * ONE)
    state = observer.ObserverState(*np.zeros((4, *shape)))
    for _ in range(2000):
        state = observer.predict(model, state, np.zeros(shape), 0.01)
        measured, fresh = noise * random.normal(size=shape), random.random(shape) < 0.5
        state = observer.correct(parameters, model, state, measured, fresh)
        assert abs(state.estimate.item()) <= 10.0 * noise


def test_a_plant_slower_than_the_observer_has_the_poles_that_are_asked_for() -> None:
    parameters = observer.ObserverParameters.from_gains(np.array([[60.0], [2100.0], [26000.0]]))  # complex
    assert np.array_equal(parameters.hurried(59.0 * ONE).poles, parameters.poles)
    assert parameters.hurried(90.0 * ONE).poles.sum().real == pytest.approx(90.0)


def test_a_channel_without_a_measurement_is_predicted_and_later_corrected_for_the_whole_gap() -> None:
    model, parameters = plant(), observer.ObserverParameters.from_bandwidth(20.0 * ONE)
    moving = observer.ObserverState(ONE, 2.0 * ONE, 0 * ONE, 0 * ONE)
    state = observer.predict(model, moving, np.zeros(1), 0.01)
    state = observer.correct(parameters, model, state, np.array([np.nan]), np.array([False]))
    assert state.estimate[0] == pytest.approx(1.02)
    assert state.elapsed[0] == pytest.approx(0.01)
    state = observer.predict(model, state, np.zeros(1), 0.01)
    twice = observer.correct(parameters, model, state, np.array([1.1]), np.array([True]))
    at_once = observer.correct(
        parameters,
        model,
        observer.predict(model, moving, np.zeros(1), 0.02),
        np.array([1.1]),
        np.array([True]),
    )
    assert twice.disturbance[0] == pytest.approx(at_once.disturbance[0], rel=1e-9)


def test_gains_chosen_by_hand_give_their_own_poles() -> None:
    gains = np.array([[60.0], [1100.0], [6000.0]])  # (s + 10)(s + 20)(s + 30)
    parameters = observer.ObserverParameters.from_gains(gains)
    np.testing.assert_allclose(np.sort(parameters.poles[:, 0].real), [10.0, 20.0, 30.0], rtol=1e-9)
    with pytest.raises(ValueError, match="right half plane"):
        observer.ObserverParameters.from_gains(np.array([[1.0], [1.0], [6000.0]]))
