"""The control law against answers that are known without it."""

from __future__ import annotations

from itertools import product

import numpy as np

from kffa_offboard.config import bundled, load
from kffa_offboard.control import Array, controllers, fuzzy
from kffa_offboard.control import tracking_differentiator as td
from kffa_offboard.control.design import DesignSettings, design
from kffa_offboard.selftest.result import Row, at_most

GROUP = "law"
DT = 0.002


def run_law() -> list[Row]:
    """Step response, disturbance, differentiator and rules."""
    return [_step_response(), _disturbance(), _differentiator(), _rules()]


def _channel(omega_c: float, omega_o: float) -> controllers.ControllerParameters:
    """LADRC without differentiator on four equal double integrators, b0 = 2."""
    four = np.ones(4)
    settings = DesignSettings(
        b0=2.0 * four,
        omega_c=omega_c * four,
        omega_o=omega_o * four,
        lower=-1e6 * four,
        upper=1e6 * four,
        use_differentiator=False,
        omega_c_range=0.0 * four,
    )
    return design("ladrc", settings)


def _fly(parameters: controllers.ControllerParameters, disturbance: float, seconds: float) -> Array:
    """Positions (steps, 4) of double integrators, exactly integrated, after a step of the reference by 1."""
    position, rate = np.zeros(4), np.zeros(4)
    state = controllers.initial_state(parameters, position, np.zeros(4))
    rows = []
    for _ in range(round(seconds / DT)):
        inputs = controllers.ControllerInput(np.ones(4), position, np.ones(4, dtype=bool))
        state, output = controllers.step(parameters, state, inputs, DT)
        acceleration = 2.0 * output.command + disturbance
        position = position + rate * DT + 0.5 * acceleration * DT**2
        rate = rate + acceleration * DT
        rows.append(position)
    return np.array(rows)


def _step_response() -> Row:
    """Both poles at -omega_c: 1 - (1 + omega_c t) exp(-omega_c t)."""
    omega_c = 4.0
    flown = _fly(_channel(omega_c, 200.0), 0.0, 3.0)[:, 0]
    t = DT * np.arange(1, flown.size + 1)
    known = 1.0 - (1.0 + omega_c * t) * np.exp(-omega_c * t)
    return at_most(
        GROUP, "step response beside its formula", np.abs(flown - known).max(), 0.02, "of the step"
    )


def _disturbance() -> Row:
    """A constant disturbance leaves no error."""
    flown = _fly(_channel(4.0, 40.0), -5.0, 6.0)[-1, 0]
    return at_most(GROUP, "error that a constant disturbance leaves", abs(flown - 1.0), 1e-3, "of the step")


def _differentiator() -> Row:
    """Time-optimal: a step by 1 with acceleration r takes 2 sqrt(1 / r)."""
    acceleration = 4.0
    parameters = td.TrackingDifferentiatorParameters(np.array([acceleration]), 5.0 * DT)
    zero = np.zeros(1)
    state, steps = td.TrackingDifferentiatorState(zero, zero, zero), 0
    while abs(1.0 - state.position[0]) > 0.005 and steps < 10_000:
        state, steps = td.step(parameters, state, np.ones(1), DT), steps + 1
    late = abs(steps * DT - 2.0 * (1.0 / acceleration) ** 0.5)
    return at_most(GROUP, "tracking differentiator beside time-optimal", late, 0.1, "s")


def _rules() -> Row:
    """Whatever the error, the rules move omega_c by no more than they may."""
    parameters = load(bundled("demo-px4.toml")).service.controller.fuzzy
    assert parameters is not None
    grid = np.linspace(-2.0, 2.0, 41)
    pairs = list(product(grid, grid))
    errors = np.array([[e] * 4 for e, _ in pairs]).T
    rates = np.array([[r] * 4 for _, r in pairs]).T
    corrections = fuzzy.bandwidth_correction(parameters, errors, rates)
    excess = float(np.max(np.abs(corrections).max(axis=1) - parameters.omega_c_range))
    return at_most(GROUP, "fuzzy correction beyond its range", max(excess, 0.0), 1e-9, "rad/s")
