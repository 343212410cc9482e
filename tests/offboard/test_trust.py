"""What a sound estimator shows is believed at any rate of telemetry; what does not fit is noticed in time."""

from math import cos, sin

import numpy as np
import pytest

from kffa_offboard.offboard import trust
from kffa_offboard.offboard.events import AttitudeReceived, PositionReceived
from kffa_offboard.offboard.settings import LimitSettings, TelemetrySettings
from kffa_offboard.offboard.telemetry import Stream, Telemetry
from kffa_offboard.offboard.trust import Trust

SETTINGS, LIMITS = TelemetrySettings(), LimitSettings()
RATES = pytest.mark.parametrize("rate_hz", [10, 25, 50, 100, 250])


def times(rate_hz, seconds, seed=0, jitter=0.3):
    """Sample times [s], rounded to milliseconds as on the wire, uneven by `jitter` of the period."""
    generator = np.random.default_rng(seed)
    count = round(seconds * rate_hz)
    uneven = (np.arange(count) + jitter * generator.uniform(-1.0, 1.0, count)) / rate_hz
    return [max(round(t, 3), 0.0) for t in uneven.tolist()]


def watch_heights(samples):
    """Of (time [s], height, climb rate): faults with their times, and the times of what was passed over."""
    known, faults, passed_over = Trust(), [], []
    for t, height, climb_rate in samples:
        now = round(t * 1e6)
        event = PositionReceived(now, (0.0, 0.0, height), (0.0, 0.0, climb_rate))
        known, fits, fault = trust.watch_position(SETTINGS, LIMITS, known, now, event, False)
        if fault is not None:
            faults.append((t, fault))
        if not fits:
            passed_over.append(t)
    return faults, passed_over


def watch_angles(samples):
    """The same of (time [s], roll, pitch, body rates)."""
    known, faults = Trust(), []
    for t, roll, pitch, rates in samples:
        now = round(t * 1e6)
        event = AttitudeReceived(now, (roll, pitch, 0.3), rates)
        known, fault = trust.watch_attitude(SETTINGS, LIMITS, known, now, event, False)
        if fault is not None:
            faults.append((t, fault))
    return faults


def noisy(samples, height_m=0.01, climb_rate_m_s=0.05, seed=1):
    generator = np.random.default_rng(seed)
    for t, height, climb_rate in samples:
        yield (
            t,
            height + height_m * generator.standard_normal(),
            climb_rate + climb_rate_m_s * generator.standard_normal(),
        )


def swing(t, amplitude_m, omega):
    return t, 5.0 + amplitude_m * sin(omega * t), amplitude_m * omega * cos(omega * t)


def dropped(t):
    """A load leaves at 1 s: 4.9 m/s^2 upwards, and as much downwards 0.3 s later."""
    up, down = max(min(t, 1.6) - 1.0, 0.0), max(min(t, 1.6) - 1.3, 0.0)
    return t, 5.0 + 2.45 * (up**2 - 2.0 * down**2), 4.9 * (up - 2.0 * down)


def thrown(t):
    """1.5 times the weight in thrust for half a second, none for half a second, and weight."""
    fast, falling, then = min(t, 0.5), min(max(t - 0.5, 0.0), 0.5), max(t - 1.0, 0.0)
    speed = 4.9 * fast - 9.8 * falling
    return t, 5.0 + 2.45 * fast**2 + 2.45 * falling - 4.9 * falling**2 - 2.45 * then, speed


def touched_down(t):
    """Sinks with 1 m/s and stands still from 1 s on, from one moment to the next."""
    return t, max(1.0 - t, 0.0), -1.0 if t < 1.0 else 0.0


def height_reset(t):
    """The estimator sets its height anew, by what is just no impossible jump."""
    return t, 5.0 if t < 1.0 else 5.45, 0.0


def climb_rate_reset(t):
    """It believed to stand while it climbed with 1 m/s, and sets both anew."""
    return (t, 5.0, 0.0) if t < 1.0 else (t, 5.3 + (t - 1.0), 1.0)


SOUND = {
    "hover": lambda t: (t, 5.0, 0.0),
    "height swings": lambda t: swing(t, 0.3, 6.0),
    "load drops": dropped,
    "full thrust and none": thrown,
    "touch-down": touched_down,
    "height reset": height_reset,
    "climb rate reset": climb_rate_reset,
    "drifts apart by 0.5 m/s": lambda t: (t, 5.0 + 0.5 * t, 0.0),
}

SUDDEN = ("touch-down", "climb rate reset")  # may cost a few samples


@RATES
@pytest.mark.parametrize("name", SOUND)
def test_what_a_sound_estimator_shows_is_believed(rate_hz, name):
    for seed in range(5):
        samples = [SOUND[name](t) for t in times(rate_hz, 3.0, seed)]
        faults, passed_over = watch_heights(noisy(samples, seed=seed))
        assert faults == []
        assert len(passed_over) <= (3 if name in SUDDEN else 0)


@RATES
def test_a_swing_of_20_degrees_at_4_rad_s_fits_its_body_rates(rate_hz):
    """And so does an attitude that is set anew by 0.15 rad within it."""
    generator = np.random.default_rng(2)
    samples = []
    for t in times(rate_hz, 3.0):
        roll = 0.35 * sin(4.0 * t) + (0.15 if t > 1.0 else 0.0)
        rates = (1.4 * cos(4.0 * t), 0.0, 0.0)
        noise, rate_noise = 0.003 * generator.standard_normal(), 0.1 * generator.standard_normal(3)
        samples.append((t, roll + noise, 0.0, tuple((np.array(rates) + rate_noise).tolist())))
    assert watch_angles(samples) == []


@pytest.mark.parametrize(("rate_hz", "step"), [(250, 0.19), (100, 0.2), (50, 0.2), (10, 0.3)])
def test_an_attitude_that_is_set_anew_by_more_is_noticed_in_that_sample(rate_hz, step):
    samples = [(t, 0.0, 0.0 if t < 1.0 else -step, (0.0, 0.0, 0.0)) for t in times(rate_hz, 2.0)]
    first = min(t for t, _, pitch, _ in samples if pitch)
    assert watch_angles(samples)[0] == (first, "body rates do not fit the attitude")


@RATES
@pytest.mark.parametrize("error", [-3.0, 1.5, 6.0])
def test_a_single_wrong_climb_rate_is_no_fault(rate_hz, error):
    samples = [(t, 5.0, 0.0) for t in times(rate_hz, 2.0)]
    samples[rate_hz] = (*samples[rate_hz][:2], error)
    faults, passed_over = watch_heights(noisy(samples))
    assert faults == []
    assert len(passed_over) == (abs(error) > 2.6 or (error > 1.4 and rate_hz >= 50))


@RATES
@pytest.mark.parametrize(("error", "within_s"), [(1.5, 0.5), (2.0, 0.35), (3.0, 0.2), (9.0, 0.2)])
def test_a_climb_rate_that_stays_wrong_is_noticed(rate_hz, error, within_s):
    """Or one that goes wrong within half a second."""
    sudden = [(t, 5.0, 0.0 if t < 1.0 else error) for t in times(rate_hz, 3.0)]
    faults, _ = watch_heights(noisy(sudden))
    assert faults and faults[0][0] < 1.0 + within_s + 1.5 / rate_hz
    growing = [(t, 5.0, min(max(2.0 * (t - 1.0), 0.0), 1.0) * error) for t in times(rate_hz, 3.0)]
    faults, _ = watch_heights(noisy(growing))
    assert faults and faults[0][0] < 1.5 + within_s + 1.5 / rate_hz


@RATES
@pytest.mark.parametrize(("error", "within_s"), [(1.5, 0.25), (2.0, 0.2), (3.0, 0.1), (9.0, 0.05)])
def test_a_body_rate_that_stays_wrong_is_noticed(rate_hz, error, within_s):
    samples = [(t, 0.0, 0.0, (0.0, 0.0 if t < 1.0 else error, 0.0)) for t in times(rate_hz, 2.0)]
    faults = watch_angles(samples)
    assert faults and faults[0] == (faults[0][0], "body rates do not fit the attitude")
    assert faults[0][0] < 1.0 + within_s + 2.5 / rate_hz


def flown_with_silences(acceleration, silent_s):
    """Times heard within 4 s, and what was moved and how fast; from 0.5 s on all but 0.15 s are silent.

    `acceleration` is that in the silence of this number, when this share of it is over.
    """
    t = 1e-3 * np.arange(4000)
    number, since = np.divmod(t - 0.5, silent_s + 0.15)
    silent = (number >= 0.0) & (since < silent_s)
    parts = zip(number, since / silent_s, silent, strict=True)
    found = [acceleration(n, share) if quiet else 0.0 for n, share, quiet in parts]
    rate = 1e-3 * np.cumsum(found)
    heard = ~silent & (np.arange(4000) % 10 == 0)
    return [array[heard].tolist() for array in (t, 1e-3 * np.cumsum(rate), rate)]


@pytest.mark.parametrize("silent_s", [0.2, 0.3, 0.8])
@pytest.mark.parametrize(
    "acceleration",
    [lambda n, share: -9.8 if share < 0.6 else 14.7, lambda n, share: 9.8 if n % 2 else -9.8],
    ids=["none, then full thrust", "the other way in each"],
)
def test_whatever_thrust_did_in_a_silence_height_and_climb_rate_are_believed(acceleration, silent_s):
    """2.5 m/s were all that could be, and the mean of two climb rates all there was between them."""
    heard = zip(*flown_with_silences(acceleration, silent_s), strict=True)
    samples = noisy([(t, 5.0 + height, climb_rate) for t, height, climb_rate in heard])
    assert watch_heights(samples) == ([], [])


@pytest.mark.parametrize("silent_s", [0.3, 0.6])
def test_a_vehicle_that_rolls_over_in_each_silence_and_back_fits_its_body_rates(silent_s):
    """By 0.5 rad, there and back in two silences each, at rest when it is heard."""
    most = 4.0 * 0.5 / silent_s**2

    def acceleration(number, share):
        return (1.0 if number % 4 < 2 else -1.0) * (most if share < 0.5 else -most)

    samples = [
        (t, roll - 0.5, 0.0, (rate, 0.0, 0.0))
        for t, roll, rate in zip(*flown_with_silences(acceleration, silent_s), strict=True)
    ]
    assert watch_angles(samples) == []


@pytest.mark.parametrize(("error", "within_s"), [(1.5, 0.5), (3.0, 0.2), (9.0, 0.2)])
def test_after_a_silence_a_climb_rate_that_is_wrong_is_noticed_as_soon(error, within_s):
    """What the silence allows for does not grow with the time in which no climb rate fits."""
    samples = [(t, 5.0, 0.0 if t < 1.0 else error) for t in times(100, 3.0) if not 1.0 < t < 1.3]
    faults, _ = watch_heights(noisy(samples))
    assert faults and faults[0][0] < 1.3 + within_s + 0.02


def test_after_a_silence_a_body_rate_that_is_wrong_is_noticed_as_soon():
    samples = [(t, 0.0, 0.0, (3.0 * (t >= 1.0), 0.0, 0.0)) for t in times(100, 2.0) if not 1.0 < t < 1.3]
    assert watch_angles(samples)[0][0] < 1.3 + 0.12


def test_what_was_passed_over_counts_as_dropped_and_does_not_arrive():
    known = Telemetry(position_stream=Stream(1_000, 2_000, (2_000,), 0, 4))
    assert trust.pass_over(known) == Telemetry(position_stream=Stream(1_000, 2_000, (2_000,), 0, 5))


def test_a_rate_that_no_vehicle_of_ours_has_is_a_fault():
    fastest, climb_rate = LIMITS.attitude_rate_max_rad_s, LIMITS.climb_rate_max_m_s
    for share, faults in ((0.99, 0), (-0.99, 0), (1.01, 1), (-1.01, 1)):
        assert len(watch_angles([(0.0, 0.0, 0.0, (0.0, 0.0, share * fastest))])) == faults
        assert len(watch_heights([(0.0, 5.0, share * climb_rate)])[0]) == faults


@pytest.mark.parametrize("flying", [True, False])
def test_only_in_the_air_and_to_the_last_bit_are_values_that_stand_still_a_fault(flying):
    known, faults = Trust(), {"still": 0, "rates move": 0, "position": 0}
    long_us = round(3e6 * SETTINGS.frozen_time_s)
    for kind in faults:
        for now in range(0, long_us, 10_000):
            rate = 1e-6 * (now // 10_000 % 2) if kind == "rates move" else 0.0
            attitude = AttitudeReceived(now, (0.0, 0.0, 0.3), (0.0, rate, 0.0))
            known, fault = trust.watch_attitude(SETTINGS, LIMITS, known, now, attitude, flying)
            faults[kind] += fault is not None and kind != "position"
            position = PositionReceived(now, (0.0, 0.0, 5.0), (0.0, 0.0, 0.0))
            known, _, fault = trust.watch_position(SETTINGS, LIMITS, known, now, position, flying)
            faults[kind] += fault is not None and kind == "position"
        known = Trust()
    assert faults["rates move"] == 0
    assert (faults["still"] > 0) == (faults["position"] > 0) == flying


def test_a_height_that_is_set_anew_four_times_a_second_is_noticed():
    """Each step alone would be believed, and so would one now and then."""
    hover = times(100, 4.0)
    assert watch_heights([(t, 5.0 + 0.5 * (4.0 * t // 1), 0.0) for t in hover])[0]
    assert not watch_heights([(t, 5.0 + 0.5 * (0.5 * t // 1), 0.0) for t in hover])[0]


def test_single_late_samples_are_no_link_that_fills_up_however_many():
    late_us = round(1e6 * SETTINGS.late_max_s) + 50_000
    known, faults = Trust(), []
    for number in range(600):
        sample_us = 10_000 * number
        arrival_us = sample_us + (late_us if number % 30 == 29 else 0)
        event = AttitudeReceived(sample_us, (0.0, 0.0, 0.3), (0.0, 0.0, 0.0))
        known, fault = trust.watch_attitude(SETTINGS, LIMITS, known, arrival_us, event, False)
        faults.append(fault)
    assert faults == [None] * 600
