"""The step of one vehicle in plain floats is the step of the array code, bit by bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import Struct
from msgspec.structs import astuple

from kffa_offboard.config import bundled, load
from kffa_offboard.control import composition, controllers, straight
from kffa_offboard.control.controllers import ControllerInput

LADRC = load(bundled("demo-px4.toml")).service.controller
VARIANTS = {
    "demonstration": LADRC,
    "attitude": load(bundled("demo-ardupilot.toml")).service.controller,
    "position ring": load(bundled("demo-px4-position.toml")).service.position.ring.controller,
    "without Kalman filter": replace(LADRC, kalman=None),
    "without fuzzy rules": replace(LADRC, fuzzy=None),
    "without look ahead": replace(LADRC, prediction=None),
    "published rules": replace(LADRC, fuzzy=replace(LADRC.fuzzy, rules="published")),
    "loads on a rope": replace(LADRC, law=replace(LADRC.law, rejection=np.array([0.0, 0.0, 1.0, 1.0]))),
    "literal filter": replace(LADRC, kalman=replace(LADRC.kalman, model="literal")),
}


def as_batch(value, channels):
    """The same for a batch of one flight, which is never written out."""
    if isinstance(value, Struct):
        return type(value)(*(as_batch(part, channels) for part in astuple(value)))
    one_vehicle = isinstance(value, np.ndarray) and value.shape[-1:] == (channels,)
    return value[..., None] if one_vehicle else value


def initial(parameters):
    size = len(parameters.angular)
    return controllers.initial_state(parameters, np.zeros(size), np.full(size, 0.1))


@pytest.mark.parametrize("name", VARIANTS)
@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), with_rate=st.booleans(), noise=st.sampled_from([0.001, 0.1, 3.0]))
def test_the_same_numbers_as_the_array_code(leaves, name, seed, with_rate, noise):
    parameters, random = VARIANTS[name], np.random.default_rng(seed)
    state, size = initial(parameters), len(parameters.angular)
    for _ in range(25):
        dt = float(random.choice([0.004, 0.01, 0.011, 0.0371]))
        fresh = random.random(size) < 0.8
        measured, rate = noise * random.normal(size=(2, size))
        measured[~fresh] = rate[~fresh] = np.nan  # must not be read
        inputs = ControllerInput(
            random.normal(size=size), measured, fresh, rate if with_rate or name == "literal filter" else None
        )
        assert straight.is_straight(parameters, state, dt)
        batch = controllers.step(parameters, as_batch(state, size), as_batch(inputs, size), dt)
        state, output = controllers.step(parameters, state, inputs, dt)
        np.testing.assert_array_equal(leaves(output), leaves(batch[1]))
        np.testing.assert_array_equal(leaves(state), leaves(batch[0]))
        if random.random() < 0.3:
            applied = random.normal(size=size)
            state = controllers.with_applied(parameters, state, applied)
        if random.random() < 0.1:
            state = controllers.align_reference(parameters, state)


def test_models_are_worked_out_once_for_each_length_of_a_step_whatever_the_order(monkeypatch):
    worked_out = []

    def counted(parameters, state, inputs, dt):
        worked_out.append(dt)
        return composition.discretised(parameters, state, inputs, dt)

    monkeypatch.setattr(straight, "discretised", counted)
    parameters, random = replace(LADRC), np.random.default_rng(0)  # parameters that nobody else has
    state, lengths = initial(parameters), [0.003, 0.004, 0.005, 0.007, 0.009, 0.012]
    for _ in range(400):
        inputs = ControllerInput(np.zeros(4), random.normal(size=4), np.ones(4, dtype=bool), np.zeros(4))
        state, _ = controllers.step(parameters, state, inputs, float(random.choice(lengths)))
    assert sorted(worked_out) == lengths


def test_a_measurement_that_is_no_number_reaches_the_command():
    # The guard refuses it there; a bound must not make a number of it.
    state = initial(LADRC)
    measured = np.array([0.0, np.nan, 0.0, 0.0])
    inputs = ControllerInput(np.zeros(4), measured, np.ones(4, dtype=bool), np.zeros(4))
    with pytest.raises(ValueError, match="NaN"):  # the fuzzy rules have no cell for it
        controllers.step(LADRC, state, inputs, 0.01)
    without_rules = replace(LADRC, fuzzy=None)
    _, output = controllers.step(without_rules, state, inputs, 0.01)
    assert np.isnan(output.command[1]) and np.all(np.isfinite(output.command[[0, 2, 3]]))


@pytest.mark.parametrize("name", ["pid", "cascaded-pid"])
def test_the_pids_are_left_to_the_array_code(name):
    parameters = load(bundled("demo-px4.toml")).service.controller
    other = replace(parameters, pid=object())
    assert not straight.is_straight(other, initial(parameters), 0.01)


def test_rare_steps_are_left_to_the_array_code():
    state = initial(LADRC)
    assert not straight.is_straight(LADRC, state, 0.6 * LADRC.differentiator.filter_time)
    expecting = controllers.with_disturbance_step(LADRC, state, np.array([0.0, 0.0, 0.0, 3.0]), 0.1)
    assert not straight.is_straight(LADRC, expecting, 0.01)
    batch = as_batch(state, 4)
    assert not straight.is_straight(LADRC, batch, 0.01)


def test_numbers_that_are_set_in_flight_need_no_other_function(leaves):
    other = replace(
        LADRC,
        law=replace(LADRC.law, omega_c=1.2 * LADRC.law.omega_c),
        model=replace(LADRC.model, b0=0.9 * LADRC.model.b0),
        limits=replace(LADRC.limits, upper=0.8 * LADRC.limits.upper),
        fuzzy=replace(LADRC.fuzzy, error_scale=2.0 * LADRC.fuzzy.error_scale),
    )
    before, after = straight.Law(LADRC, True), straight.Law(other, True)
    assert after.function is before.function
    state = initial(LADRC)
    inputs = ControllerInput(np.full(4, 0.1), np.zeros(4), np.ones(4, dtype=bool), np.zeros(4))
    batch = controllers.step(other, as_batch(state, 4), as_batch(inputs, 4), 0.01)
    _, output = controllers.step(other, state, inputs, 0.01)
    _, unchanged = controllers.step(LADRC, state, inputs, 0.01)
    np.testing.assert_array_equal(leaves(output), leaves(batch[1]))
    assert np.all(output.command[:3] != unchanged.command[:3])
