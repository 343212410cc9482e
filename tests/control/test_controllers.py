"""The five controllers close the loop on their plants; batch equals singles; angles take the short way."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kffa_offboard.control import actuator, controllers, covariance, observer
from kffa_offboard.control.controllers import ControllerInput
from kffa_offboard.control.design import DesignSettings, design

HOVER = 98.0 / 246.0
ALL_FRESH = np.ones(4, dtype=bool)
AIRFRAME = DesignSettings(
    b0=np.array([12.0, 12.0, 4.0, 9.8 / HOVER]),
    damping=np.array([12.0, 12.0, 4.0, 0.0]),
    omega_c=np.array([7.0, 7.0, 2.5, 8.0]),
    omega_o=np.array([30.0, 30.0, 10.0, 40.0]),
    lower=np.array([-2.0, -2.0, -1.0, 0.0]),
    upper=np.array([2.0, 2.0, 1.0, 1.0]),
    delay=np.full(4, 0.04),
    lag=np.array([0.0, 0.0, 0.0, 0.05]),
    prediction=np.full(4, 0.04),
    trim=np.array([0.0, 0.0, 0.0, HOVER]),
    acceleration=np.array([10.0, 10.0, 3.0, 5.0]),
    omega_c_range=np.array([1.5, 1.5, 0.5, 2.0]),
    error_scale=np.array([0.1, 0.1, 0.2, 0.1]),
    error_rate_scale=np.array([1.0, 1.0, 1.0, 0.5]),
    measurement_variance=np.array([1e-6, 1e-6, 1e-6, 4e-6]),
)


class Plant:
    """Four double integrators of `AIRFRAME`, with delayed and lagged command, in fine steps of 2 ms."""

    def __init__(self, settings: DesignSettings, output: np.ndarray) -> None:
        trim = settings.trim.reshape(settings.trim.shape + (1,) * (output.ndim - 1))
        self.settings, self.y, self.v = settings, output.astype(float), np.zeros_like(output, dtype=float)
        self.queue = [np.broadcast_to(trim, output.shape)] * 20
        self.felt = self.queue[0]
        self.disturbance = -(self.column(settings.b0) * trim)

    def column(self, values: np.ndarray) -> np.ndarray:
        return values.reshape(values.shape + (1,) * (self.y.ndim - 1))

    def run(self, command: np.ndarray, duration: float, h: float = 0.002) -> np.ndarray:
        lag = self.column(self.settings.lag)
        for _ in range(round(duration / h)):
            self.queue = [*self.queue[1:], command]  # 20 * 2 ms
            blend = np.where(lag > 0, -np.expm1(-h / np.where(lag > 0, lag, 1.0)), 1.0)
            self.felt = self.felt + blend * (self.queue[0] - self.felt)
            acceleration = (
                self.column(self.settings.b0) * self.felt
                - self.column(self.settings.damping) * self.v
                + self.disturbance
            )
            self.v = self.v + h * acceleration
            self.y = self.y + h * self.v
        return self.y


def fly(name, reference, duration, *, start=None, disturb=None, settings=AIRFRAME, dt=0.01):
    """Closed loop; returns outputs ``(n, 4[, N])`` and the last controller output."""
    start = np.zeros_like(reference) if start is None else start
    plant, parameters = Plant(settings, start), design(name, settings)
    state = controllers.initial_state(parameters, start, plant.queue[0])
    history, commands = [], []
    for k in range(round(duration / dt)):
        if disturb is not None:
            disturb(k * dt, plant)
        inputs = ControllerInput(
            reference, plant.y, np.broadcast_to(np.ones(1, bool), plant.y.shape), plant.v
        )
        state, out = controllers.step(parameters, state, inputs, dt)
        history.append(plant.run(out.command, dt))
        commands.append(out.command)
    return np.array(history), np.array(commands), out


@pytest.mark.parametrize("name", controllers.NAMES)
def test_every_controller_brings_every_channel_to_its_reference(name: str) -> None:
    reference = np.array([0.2, -0.2, 0.5, 1.0])
    history, _, _ = fly(name, reference, 14.0)
    np.testing.assert_allclose(history[-200:].mean(axis=0), reference, atol=0.02)


@pytest.mark.parametrize("name", ["ladrc", "fa-ladrc", "kffa-ladrc"])
def test_a_dropped_load_moves_the_adrc_family_less_than_eight_centimetres(name: str) -> None:
    def drop(t: float, plant: Plant) -> None:
        if abs(t - 2.0) < 1e-9:
            plant.disturbance = plant.disturbance + np.array([0, 0, 0, 4.9])

    history, _, out = fly(name, np.zeros(4), 6.0, disturb=drop)
    assert 0.016 < np.max(np.abs(history[:, 3])) < 0.08  # 0.016 m is the physical limit (design section 6)
    assert np.abs(history[-50:, 3]).max() < 0.01
    assert out.disturbance[3] == pytest.approx(-9.8 + 4.9, abs=0.1)


def test_the_cascade_of_px4_moves_half_a_metre_and_more() -> None:
    def drop(t: float, plant: Plant) -> None:
        if abs(t - 2.0) < 1e-9:
            plant.disturbance = plant.disturbance + np.array([0, 0, 0, 4.9])

    history, _, _ = fly("cascaded-pid", np.zeros(4), 8.0, disturb=drop)
    assert 0.5 < np.max(np.abs(history[:, 3])) < 0.8


@pytest.mark.parametrize("name", controllers.NAMES)
def test_a_yaw_reference_across_pi_takes_the_short_way(name: str) -> None:
    start, reference = np.array([0, 0, 3.0, 0.0]), np.array([0, 0, -3.0, 0.0])
    history, _, _ = fly(name, reference, 8.0, start=start)
    assert np.all(history[:, 2] > 2.9)
    assert history[-1, 2] == pytest.approx(2 * np.pi - 3.0, abs=0.05)


def test_a_yaw_measurement_that_jumps_by_a_turn_changes_nothing() -> None:
    parameters = design("kffa-ladrc", AIRFRAME)
    commands = []
    for turns in (0, 1, -3):
        state = controllers.initial_state(parameters, np.array([0, 0, 3.1, 0.0]), AIRFRAME.trim)
        for k in range(40):
            y = np.array([0.0, 0.0, 3.1 + 0.005 * k + (2 * np.pi * turns if k > 8 else 0.0), 0.0])
            state, out = controllers.step(
                parameters, state, ControllerInput(np.array([0, 0, -3.0, 0.0]), y, ALL_FRESH), 0.01
            )
        commands.append(out.command)
    np.testing.assert_allclose(commands[1], commands[0], atol=1e-9)
    np.testing.assert_allclose(commands[2], commands[0], atol=1e-9)


@pytest.mark.parametrize("name", controllers.NAMES)
def test_saturation_leaves_no_wind_up(name: str) -> None:
    # Held down for 3 s by a force that no thrust can beat, then let go: no flight to the sky.
    def hold_down(t: float, plant: Plant) -> None:
        held = 1.0 <= t < 4.0
        plant.disturbance = np.array([0, 0, 0, -9.8 - (20.0 if held else 0.0)])
        if held:
            plant.y = np.maximum(plant.y, np.array([-9.0, -9.0, -9.0, -0.5]))
            plant.v = np.where(plant.y <= -0.5, np.maximum(plant.v, 0.0), plant.v)

    history, commands, _ = fly(name, np.zeros(4), 12.0, disturb=hold_down)
    assert np.all(commands[:, 3] <= 1.0) and np.all(commands[:, 3] >= 0.0)
    assert np.max(commands[:, 3]) == 1.0
    assert np.max(history[:, 3]) < 0.6
    assert abs(history[-1, 3]) < 0.08


@pytest.mark.parametrize("name", controllers.NAMES)
@settings(max_examples=15)
@given(seed=st.integers(0, 2**16), flights=st.integers(1, 5))
def test_a_batch_of_flights_equals_the_single_flights(name: str, seed: int, flights: int) -> None:
    generator = np.random.default_rng(seed)
    reference = generator.uniform(-0.5, 0.5, (4, flights))
    batch, _, _ = fly(name, reference, 0.3)
    for n in range(flights):
        single, _, _ = fly(name, reference[:, n], 0.3)
        np.testing.assert_allclose(batch[:, :, n], single, atol=1e-12)


def test_engaging_starts_from_the_command_that_is_acting() -> None:
    parameters = design("kffa-ladrc", AIRFRAME)
    plant = Plant(AIRFRAME, np.array([0.02, -0.01, 1.0, 5.0]))
    state = controllers.initial_state(parameters, plant.y, np.array([0, 0, 0, 0.3]))
    for _ in range(200):  # in shadow: somebody else holds the hover
        inputs = ControllerInput(plant.y, plant.y, ALL_FRESH, plant.v)
        state, _ = controllers.step(parameters, state, inputs, 0.01)
        state = controllers.with_applied(parameters, state, AIRFRAME.trim)
        plant.run(AIRFRAME.trim, 0.01)
    state = controllers.align_reference(parameters, state)
    _, out = controllers.step(parameters, state, ControllerInput(plant.y, plant.y, ALL_FRESH, plant.v), 0.01)
    assert out.command[3] == pytest.approx(HOVER, rel=0.02)
    np.testing.assert_allclose(out.command[:3], 0.0, atol=0.02)


def test_a_bumpless_pid_takes_over_the_acting_command() -> None:
    parameters = design("cascaded-pid", AIRFRAME)
    state = controllers.initial_state(parameters, np.zeros(4), np.array([0, 0, 0, 0.6]))
    state = controllers.align_reference(parameters, state)
    inputs = ControllerInput(np.zeros(4), np.zeros(4), ALL_FRESH, np.zeros(4))
    _, out = controllers.step(parameters, state, inputs, 0.01)
    assert out.command[3] == pytest.approx(0.6, abs=1e-6)


def test_a_pid_that_follows_takes_over_while_the_vehicle_moves() -> None:
    """A climb at 1 m/s, seen for a while: the reference begins with that speed, and brakes."""
    parameters = design("pid", AIRFRAME)
    assert parameters.pid is not None
    parameters = replace(parameters, pid=replace(parameters.pid, follow=True))
    climb, acting = np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.0, 0.5])
    state = controllers.initial_state(parameters, np.zeros(4), acting)
    for k in range(300):
        inputs = ControllerInput(0.01 * k * climb, 0.01 * k * climb, ALL_FRESH, climb)
        state, _ = controllers.step(parameters, state, inputs, 0.01)
        state = controllers.with_applied(parameters, state, acting)
    state = controllers.align_reference(parameters, state)
    here = ControllerInput(3.0 * climb, 3.0 * climb, ALL_FRESH, climb)
    after, out = controllers.step(parameters, state, here, 0.01)
    assert after.differentiator is not None
    braking = after.differentiator.acceleration[3] / AIRFRAME.b0[3]
    assert out.command[3] == pytest.approx(0.5 + braking, abs=0.05), "without its speed it would be 0.5 more"


@given(
    dts=st.lists(st.floats(0.001, 0.2), min_size=1, max_size=25),
    values=st.lists(st.floats(-50.0, 50.0), min_size=25, max_size=25),
)
def test_commands_are_within_limits_whatever_is_measured(dts: list[float], values: list[float]) -> None:
    parameters = design("kffa-ladrc", replace(AIRFRAME, rate=np.array([20.0, 20.0, 5.0, 8.0])))
    state = controllers.initial_state(parameters, np.zeros(4), AIRFRAME.trim)
    previous = AIRFRAME.trim
    for dt, value in zip(dts, values, strict=False):
        inputs = ControllerInput(np.zeros(4), np.full(4, value), ALL_FRESH)
        state, out = controllers.step(parameters, state, inputs, dt)
        assert np.all(np.isfinite(out.command))
        assert np.all(out.command >= AIRFRAME.lower) and np.all(out.command <= AIRFRAME.upper)
        assert np.all(np.abs(out.command - previous) <= np.array([20.0, 20.0, 5.0, 8.0]) * dt + 1e-9)
        previous = out.command


def test_entries_that_are_not_fresh_are_not_read() -> None:
    parameters = design("kffa-ladrc", AIRFRAME)
    outs = []
    for stale in (0.0, np.nan):
        state = controllers.initial_state(parameters, np.zeros(4), AIRFRAME.trim)
        inputs = ControllerInput(np.zeros(4), np.array([0.01, 0.0, 0.0, stale]), np.array([1, 1, 1, 0], bool))
        _, out = controllers.step(parameters, state, inputs, 0.01)
        outs.append(out.command)
    assert np.all(np.isfinite(outs[1]))
    np.testing.assert_array_equal(outs[0], outs[1])


def test_the_exact_damping_model_beats_the_plain_one_on_a_rate_loop() -> None:
    # Design section 3: without the known damping a 10 degree step overshoots by 9-20 %.
    step = np.array([np.deg2rad(10.0), 0.0, 0.0, 0.0])
    assisted, _, _ = fly("ladrc", step, 3.0)
    assert assisted[:, 0].max() / step[0] - 1 < 0.03
    plain_design = design("ladrc", AIRFRAME)
    plain = replace(plain_design, model=observer.PlantModel(AIRFRAME.b0, np.zeros(4), np.zeros(4)))
    plant = Plant(AIRFRAME, np.zeros(4))
    state, peak = controllers.initial_state(plain, plant.y, AIRFRAME.trim), 0.0
    for _ in range(300):
        state, out = controllers.step(plain, state, ControllerInput(step, plant.y, ALL_FRESH), 0.01)
        peak = max(peak, plant.run(out.command, 0.01)[0])
    assert peak / step[0] - 1 > 0.05


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"b0": np.array([1.0, 1.0, 0.0, 1.0])}, "b0"),
        ({"omega_c": np.full(4, np.nan)}, "omega_c"),
        ({"delay": np.array([-0.01, 0, 0, 0])}, "delay"),
        ({"omega_c_range": np.full(4, 9.0)}, "omega_c_range"),
        ({"lower": np.full(4, 2.0)}, "lower must be below upper"),
    ],
)
def test_numbers_that_make_no_controller_are_refused_by_name(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        design("kffa-ladrc", replace(AIRFRAME, **change))


@pytest.mark.parametrize("dt", [0.0, -0.01, np.nan, np.inf])
def test_a_step_that_does_not_advance_time_is_refused(dt: float) -> None:
    parameters = design("ladrc", AIRFRAME)
    state = controllers.initial_state(parameters, np.zeros(4), AIRFRAME.trim)
    with pytest.raises(ValueError, match="dt must be positive"):
        controllers.step(parameters, state, ControllerInput(np.zeros(4), np.zeros(4), ALL_FRESH), dt)


# --------------------------------------------------------------- a disturbance known beforehand


KNOWN_DELAY, KNOWN_LAG, KNOWN_STEP = 0.06, 0.05, 4.9


def with_lag(name):
    return design(
        name,
        DesignSettings(
            b0=np.full(4, 24.6),
            damping=np.zeros(4),
            stiffness=np.zeros(4),
            omega_c=np.full(4, 8.0),
            omega_o=np.full(4, 40.0),
            lower=np.full(4, -2.0),
            upper=np.full(4, 2.0),
            delay=np.full(4, KNOWN_DELAY),
            lag=np.full(4, KNOWN_LAG),
            prediction=np.full(4, KNOWN_DELAY),
            trim=np.zeros(4),
            omega_c_range=np.full(4, 2.0),
        ),
    )


def deviation(parameters, announced, happens=True):
    """Largest and last deviation of the altitude when its disturbance steps; the plant has steps of 1 ms."""
    dt, start = 0.01, 0.5
    state = controllers.initial_state(parameters, np.zeros(4), np.zeros(4))
    queue = actuator.initial_state(np.zeros(4))
    height, rate, disturbance, heights = 0.0, 0.0, 0.0, []
    for k in range(400):
        inputs = controllers.ControllerInput(
            np.zeros(4), np.array([0.0, 0.0, 0.0, height]), np.ones(4, bool), np.array([0.0, 0.0, 0.0, rate])
        )
        state, output = controllers.step(parameters, state, inputs, dt)
        if announced and k == 30:
            step = np.array([0.0, 0.0, 0.0, KNOWN_STEP])
            state = controllers.with_disturbance_step(parameters, state, step, start - k * dt)
        queue = actuator.send(queue, output.command)
        for fine in range(10):
            queue, acted = actuator.step(parameters.actuator, queue, dt / 10)
            if happens and k * dt + fine * dt / 10 >= start - 1e-9:
                disturbance = KNOWN_STEP
            rate += (24.6 * acted[3] + disturbance) * dt / 10
            height += rate * dt / 10
        heights.append(abs(height))
    return max(heights), heights[-1]


@pytest.mark.parametrize("name", ["ladrc", "fa-ladrc", "kffa-ladrc"])
def test_a_disturbance_that_is_known_beforehand_hardly_moves_the_output(name):
    parameters = with_lag(name)
    surprise, _ = deviation(parameters, announced=False)
    known, left = deviation(parameters, announced=True)
    assert known <= 0.15 * surprise
    assert left <= 1e-3


def test_a_known_disturbance_that_does_not_come_is_unlearnt():
    parameters = with_lag("kffa-ladrc")
    surprise, _ = deviation(parameters, announced=False)
    phantom, left = deviation(parameters, announced=True, happens=False)
    assert phantom <= 1.1 * surprise
    assert left <= 1e-3


def test_observer_and_filter_take_a_known_step_together_and_zeros_call_it_off():
    parameters = with_lag("kffa-ladrc")
    state = controllers.initial_state(parameters, np.zeros((4, 3)), np.zeros((4, 3)))
    step = np.zeros((4, 3))
    step[3] = [1.0, 2.0, 3.0]
    now = controllers.with_disturbance_step(parameters, state, step)
    assert np.array_equal(now.observer.disturbance - state.observer.disturbance, step)
    assert np.array_equal(now.kalman.disturbance - state.kalman.disturbance, step)
    later = controllers.with_disturbance_step(parameters, state, step, 0.1)
    assert later.expected.after == 0.1 and later.observer is state.observer
    assert controllers.with_disturbance_step(parameters, later, 0.0 * step, 0.1).expected is None


def test_a_step_like_an_earlier_one_asks_filterpy_nothing(monkeypatch) -> None:
    parameters = design("kffa-ladrc", replace(AIRFRAME, rate_variance=np.full(4, 1e-4)))
    inputs = ControllerInput(np.ones(4), np.zeros(4), ALL_FRESH, np.zeros(4))
    state = controllers.initial_state(parameters, np.zeros(4), np.array([0.0, 0.0, 0.0, HOVER]))
    state, _ = controllers.step(parameters, state, inputs, 0.01)
    controllers.step(parameters, state, inputs, 0.01)
    monkeypatch.setattr(covariance, "_blank_filter", None)
    controllers.step(parameters, state, inputs, 0.01)
    with pytest.raises(TypeError):
        controllers.step(parameters, state, inputs, 0.02)
