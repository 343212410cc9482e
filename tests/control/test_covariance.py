"""A channel's covariance rests where the Riccati equation says, and filterpy is asked no more then."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from msgspec import structs

from kffa_offboard.control import kalman
from kffa_offboard.control.covariance import Spread, at_rest, corrected, later
from kffa_offboard.control.kalman import KalmanParameters
from kffa_offboard.control.observer import PlantModel

MODEL = PlantModel(np.array([2.0, 24.0]), np.array([10.0, 0.0]), np.zeros(2))
PATIENT = KalmanParameters(np.array([1e-5, 4e-6]), np.array([50.0, 100.0]), np.array([1e-4, 4e-4]))
TOLERANT = KalmanParameters(
    PATIENT.measurement_variance,
    PATIENT.disturbance_intensity,
    PATIENT.rate_variance,
    period_tolerance=0.3,
    rest_tolerance=0.02,
)
LITERAL = KalmanParameters(np.full(2, 1e-3), np.full(2, 1.0), model="literal")


def begin(parameters: KalmanParameters, channel: int = 0) -> Spread:
    return kalman.initial_state(parameters, np.zeros(2), np.zeros(2)).spreads[channel]


def measured(
    parameters: KalmanParameters, spread: Spread, times: Iterable[float], channel: int = 0
) -> Spread:
    for dt in times:
        _, spread = corrected(parameters, MODEL, channel, True, spread, dt)
    return spread


@pytest.fixture
def asked(monkeypatch) -> list[None]:
    """Has an entry for each time that filterpy was asked."""
    calls: list[None] = []
    update = KalmanFilter.update

    def counted(self, *arguments, **named) -> None:
        calls.append(None)
        update(self, *arguments, **named)

    monkeypatch.setattr(KalmanFilter, "update", counted)
    return calls


@pytest.mark.parametrize("parameters", [PATIENT, LITERAL], ids=["extended", "literal"])
@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize("period", [0.004, 0.02])
def test_it_comes_to_rest_where_the_riccati_equation_says(exact_model, parameters, channel, period) -> None:
    spread = begin(parameters, channel)
    for _ in range(3000):
        _, spread = corrected(parameters, MODEL, channel, True, spread, period)
    (rest,) = at_rest(parameters, MODEL, channel, True, period)
    matrix = begin(parameters, channel).covariance.matrix
    deviations = np.sqrt(np.diag(rest.matrix))
    for _ in range(6000):  # the same without ever taking it for what it is going to be
        matrix = textbook(exact_model(parameters, MODEL, channel, period), parameters, channel, matrix)
    assert np.max(np.abs(rest.matrix - matrix) / np.outer(deviations, deviations)) < 1e-9
    assert spread.covariance is rest


def textbook(model, parameters: KalmanParameters, channel: int, matrix):
    f, noise = model
    matrix = f @ matrix @ f.T + noise
    variances = [parameters.measurement_variance[channel]]
    if parameters.rate_variance is not None:
        variances.append(parameters.rate_variance[channel])
    for row, variance in enumerate(variances):
        gain = matrix[:, row] / (matrix[row, row] + variance)
        matrix = matrix - np.outer(gain, matrix[row])
    return 0.5 * (matrix + matrix.T)


def test_at_rest_filterpy_is_asked_nothing_whatever_the_jitter_of_whole_milliseconds(asked) -> None:
    spread = measured(TOLERANT, begin(TOLERANT), [0.01] * 200)
    assert 10 < len(asked) < 100
    asked.clear()
    measured(TOLERANT, spread, [0.009, 0.011, 0.010, 0.012, 0.008] * 20)
    assert len(asked) <= 5  # once for each of these times


def test_a_late_sample_is_forgotten_in_time_and_the_next_like_it_costs_nothing(asked) -> None:
    spread = measured(TOLERANT, begin(TOLERANT), [0.01] * 200)
    (rest,) = at_rest(TOLERANT, MODEL, 0, True, 0.01)
    asked.clear()
    assert measured(TOLERANT, spread, [0.03]).covariance is not rest
    assert measured(TOLERANT, spread, [0.03] + [0.01] * 40).covariance is rest
    assert 1 < len(asked) <= 41
    asked.clear()
    measured(TOLERANT, spread, ([0.03] + [0.01] * 40) * 3)
    assert asked == []


def test_a_late_sample_has_the_gain_of_its_own_time() -> None:
    gains = []
    for parameters in (PATIENT, TOLERANT):
        spread = measured(parameters, begin(parameters), [0.01] * 3000)
        gains.append(corrected(parameters, MODEL, 0, True, spread, 0.05)[0])
    np.testing.assert_allclose(gains[1], gains[0], rtol=1e-9)


def test_being_at_rest_moves_the_gain_by_a_fiftieth_at_most() -> None:
    patient, tolerant = begin(PATIENT), begin(TOLERANT)
    for _ in range(400):
        exact, patient = corrected(PATIENT, MODEL, 0, True, patient, 0.01)
        near, tolerant = corrected(TOLERANT, MODEL, 0, True, tolerant, 0.01)
        assert np.all(np.abs(near - exact) <= 0.02 * np.abs(exact).max(axis=0))


def test_a_channel_that_is_measured_at_every_second_step_comes_to_rest_too(asked) -> None:
    state = kalman.initial_state(TOLERANT, np.zeros(2), np.zeros(2))
    both, one = np.array([True, True]), np.array([True, False])

    def fly(state: kalman.KalmanState) -> kalman.KalmanState:
        for fresh in (both, one) * 200:
            state, _ = kalman.step(TOLERANT, MODEL, state, np.zeros(2), np.zeros(2), fresh, 0.01, np.zeros(2))
        return state

    state = fly(state)
    assert [spread.period for spread in state.spreads] == [0.01, 0.02]
    asked.clear()
    fly(state)
    assert asked == []


def test_what_comes_five_times_in_a_row_is_the_usual_time() -> None:
    spread = measured(TOLERANT, begin(TOLERANT), [0.01] * 10)
    assert measured(TOLERANT, spread, [0.02] * 4).period == 0.01
    assert measured(TOLERANT, spread, [0.02, 0.02, 0.01, 0.02, 0.02, 0.02, 0.02]).period == 0.01
    assert measured(TOLERANT, spread, [0.02] * 5).period == 0.02
    assert measured(TOLERANT, spread, [0.02, 0.03, 0.045, 0.07, 0.1]).period == 0.01, "odd, each another"
    burst = [0.04, 0.001, 0.001, 0.001, 0.01]  # a sender that makes up for a delay
    assert measured(TOLERANT, spread, burst).period == 0.01


def test_the_literal_noise_is_added_in_every_step_and_the_others_grows_with_time(exact_model) -> None:
    for parameters in (LITERAL, PATIENT):
        state = kalman.initial_state(parameters, np.zeros(2), np.zeros(2))
        spread = state.spreads[0]
        for _ in range(3):
            spread = later(parameters, MODEL, 0, spread, 0.01)
        grown = kalman.covariances(
            parameters, MODEL, structs.replace(state, spreads=(spread, state.spreads[1]))
        )[0]
        matrix = state.spreads[0].covariance.matrix
        for _ in range(3):
            f, noise = exact_model(parameters, MODEL, 0, 0.01)
            matrix = f @ matrix @ f.T + noise
        np.testing.assert_allclose(grown, matrix, rtol=1e-6)


def test_one_lost_sample_leaves_rest_where_it_is_and_has_its_own_gain_all_the_same() -> None:
    forgiving = replace(TOLERANT, late_tolerance=1.0)
    spread = measured(forgiving, begin(forgiving), [0.01] * 200)
    (rest,) = at_rest(forgiving, MODEL, 0, True, 0.01)
    late, after = corrected(forgiving, MODEL, 0, True, spread, 0.02)
    assert after.covariance is rest and after.period == 0.01
    own, _ = corrected(PATIENT, MODEL, 0, True, Spread(rest, period=0.01), 0.02)
    np.testing.assert_allclose(late, own, rtol=1e-12)
    assert measured(forgiving, spread, [0.02] * 5).period == 0.02


@pytest.mark.parametrize("late", [0.03, 0.06, 0.14])
def test_a_late_sample_has_the_gain_of_the_latest_that_is_tolerated(late) -> None:
    """Over 0.3 s the disturbance grew to 5 m/s^2: two samples of hover noise swung thrust from end to end."""
    forgiving = replace(TOLERANT, late_tolerance=2.0)
    spread = measured(forgiving, begin(forgiving), [0.01] * 200)
    expected, _ = corrected(PATIENT, MODEL, 0, True, Spread(spread.covariance, period=0.01), 0.03)
    gain, after = corrected(forgiving, MODEL, 0, True, spread, late)
    np.testing.assert_allclose(gain, expected, rtol=1e-12)
    assert measured(forgiving, after, [late] * 4).period == late, "what comes again and again is the period"


@pytest.mark.parametrize("late", [0.16, 0.3, 3.0])
def test_after_a_silence_output_and_rate_are_as_measured_and_the_disturbance_stays(late) -> None:
    """With the gain of 0.03 s a height that was predicted 5 cm too low stayed so for a tenth of a second."""
    forgiving = replace(TOLERANT, late_tolerance=2.0)
    spread = measured(forgiving, begin(forgiving), [0.01] * 200)
    gain, after = corrected(forgiving, MODEL, 0, True, spread, late)
    assert gain.tolist() == [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]
    assert after.covariance is spread.covariance, "at rest"
    assert measured(forgiving, after, [late] * 4).period == late, "what comes again and again is the period"
    without, _ = corrected(forgiving, MODEL, 0, False, spread, late)
    latest, _ = corrected(forgiving, MODEL, 0, False, spread, 0.03)
    assert without.tolist() == latest.tolist(), "the rate is not known from the output alone"


def test_at_rest_filterpy_is_asked_once_for_the_gain_of_each_odd_time_and_once_for_all_silences(
    asked,
) -> None:
    unseen = np.array([1.3e-5, 4e-6])  # by the other tests, whose results are remembered
    forgiving = replace(TOLERANT, measurement_variance=unseen, late_tolerance=2.0)
    spread = measured(forgiving, begin(forgiving), [0.01] * 200)
    asked.clear()
    after = measured(forgiving, spread, [0.05, 0.011, 0.008, 0.3, 0.009, 0.002, 0.01, 0.02, 0.05])
    after = measured(forgiving, after, [0.01] * 20)  # so many late ones without a pause are a longer period
    assert after.covariance is spread.covariance
    assert len(asked) == 3, "0.002, 0.02, and the latest that is tolerated"
    asked.clear()
    measured(forgiving, after, [0.3, 0.02, 0.01, 1.0, 0.002, 0.012])
    assert asked == []


def test_what_was_at_rest_is_so_at_a_new_period() -> None:
    forgiving = replace(TOLERANT, late_tolerance=2.0)
    spread = measured(forgiving, begin(forgiving), [0.01] * 200)
    for period in (0.02, 0.004, 0.01):
        (rest,) = at_rest(forgiving, MODEL, 0, True, period)
        assert measured(forgiving, spread, [period] * 5).covariance is rest
        gain, _ = corrected(forgiving, MODEL, 0, True, measured(forgiving, spread, [period] * 4), period)
        expected, _ = corrected(PATIENT, MODEL, 0, True, Spread(rest, period=period), period)
        np.testing.assert_allclose(gain, expected, rtol=1e-12)
    (rest,) = at_rest(forgiving, MODEL, 0, True, 0.02)
    assert measured(forgiving, begin(forgiving), [0.01] * 2 + [0.02] * 5).covariance is not rest


def test_an_odd_time_has_the_gain_of_the_nearest_multiple_or_part_of_the_period() -> None:
    forgiving = replace(TOLERANT, late_tolerance=2.0)
    spread = measured(forgiving, begin(forgiving), [0.01] * 200)
    for odd, nearest in [(0.0145, 0.01), (0.022, 0.02), (0.0262, 0.03), (0.006, 0.005), (0.0032, 0.01 / 3)]:
        gain, _ = corrected(forgiving, MODEL, 0, True, spread, odd)
        exact, _ = corrected(PATIENT, MODEL, 0, True, Spread(spread.covariance, period=0.01), nearest)
        np.testing.assert_allclose(gain, exact, rtol=1e-9)
    at_once, _ = corrected(forgiving, MODEL, 0, True, spread, 1e-6)
    tenth, _ = corrected(PATIENT, MODEL, 0, True, Spread(spread.covariance, period=0.01), 0.001)
    np.testing.assert_allclose(at_once, tenth, rtol=1e-9)


@pytest.mark.parametrize("channel", [0, 1])
@pytest.mark.parametrize("times", [[0.001, 0.019], [0.006, 0.014], [0.019, 0.001]], ids=str)
def test_without_a_usual_time_the_mean_is_the_period_in_two_seconds(times, channel) -> None:
    """With 1 and 19 ms in turn the first was the period for ever: gains on rates were a third of them."""
    forgiving = replace(TOLERANT, late_tolerance=2.0)
    spread = measured(forgiving, begin(forgiving, channel), times * 100, channel)
    exact = measured(PATIENT, begin(PATIENT, channel), times * 100, channel)
    means = []
    for parameters, state in ((forgiving, spread), (PATIENT, exact)):
        gains = []
        for dt in times * 5:
            gain, state = corrected(parameters, MODEL, channel, True, state, dt)
            gains.append(gain)
        means.append(np.mean(gains, axis=0))
    assert spread.period == pytest.approx(0.01, rel=0.35)
    np.testing.assert_allclose(means[0][1:, 1], means[1][1:, 1], rtol=0.1)  # rate and disturbance


@pytest.mark.parametrize("times", [[0.001, 0.001, 0.019], [0.001] * 4 + [0.046], [0.001, 0.099]], ids=str)
def test_bursts_are_not_taken_for_quick_telemetry(times) -> None:
    """What was kept back and comes all at once: the first period stayed, with half the gain on the rate."""
    forgiving, mean = replace(TOLERANT, late_tolerance=2.0), sum(times) / len(times)
    spread = measured(forgiving, begin(forgiving), times * 60)
    assert spread.period == pytest.approx(mean, rel=0.5)


def test_a_twentieth_of_late_samples_and_a_silence_each_second_are_no_new_period() -> None:
    forgiving = replace(TOLERANT, late_tolerance=2.0)
    for times in ([0.01] * 19 + [0.05], [0.01] * 100 + [0.3], [0.01] * 40 + [3.0]):
        spread = begin(forgiving)
        for dt in times * 20:
            _, spread = corrected(forgiving, MODEL, 0, True, spread, dt)
            assert spread.period == 0.01


def test_before_it_has_come_to_rest_an_odd_time_does_not_hold_it_up(asked) -> None:
    forgiving = replace(TOLERANT, late_tolerance=2.0)
    times = [0.01, 0.01, 0.03, 0.01, 0.3, 0.01, 0.002, 0.01]
    odd = measured(forgiving, begin(forgiving), times)
    assert odd.covariance is measured(forgiving, begin(forgiving), [0.01] * len(times)).covariance


def test_channels_with_the_same_noise_and_damping_are_worked_out_once(asked) -> None:
    alike = replace(TOLERANT, measurement_variance=np.full(2, 7e-6), disturbance_intensity=np.full(2, 50.0))
    alike = replace(alike, rate_variance=np.full(2, 3e-4))
    same, other = (PlantModel(MODEL.b0, np.array([10.0, damping]), np.zeros(2)) for damping in (10.0, 9.0))
    gains = []
    for model, channel in ((same, 0), (same, 1), (other, 1)):
        asked.clear()
        spread = begin(alike, channel)
        for _ in range(50):
            gain, spread = corrected(alike, model, channel, True, spread, 0.01)
        gains.append((gain, len(asked)))
    np.testing.assert_array_equal(gains[0][0], gains[1][0])
    assert gains[0][1] > 10 and gains[1][1] == 0 and gains[2][1] > 10


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("period", [1e-6, 1e-3, 0.004, 0.05, 0.5, 3.0, 30.0])
def test_whatever_the_period_gains_are_finite_and_the_rest_is_a_covariance(period) -> None:
    for parameters in (TOLERANT, LITERAL):
        for channel in (0, 1):
            (rest,) = at_rest(parameters, MODEL, channel, True, period)
            deviations = np.sqrt(np.diag(rest.matrix))
            assert np.linalg.eigvalsh(rest.matrix / np.outer(deviations, deviations)).min() > -1e-9
            spread = begin(parameters, channel)
            for _ in range(30):
                gain, spread = corrected(parameters, MODEL, channel, True, spread, period)
                assert np.all(np.isfinite(gain))
