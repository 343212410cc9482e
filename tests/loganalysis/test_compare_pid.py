"""The PID beside the law in the comparison on real autopilots is the best of its kind, not a straw man."""

from __future__ import annotations

import tomllib

import numpy as np
import pytest

from kffa_offboard.config import bundled
from kffa_offboard.control import controllers
from kffa_offboard.control.design import design
from kffa_offboard.loganalysis.loop_model import (
    LinearSystem,
    PlantNumbers,
    closed_loop,
    frequency_response,
    is_stable,
    open_loop,
    plant,
    step_response,
)
from kffa_offboard.loganalysis.margins import Margins, Wanted, frequencies, margins
from kffa_offboard.loganalysis.record import Array
from kffa_offboard.loganalysis.tune_altitude import DROP_M_S2
from kffa_offboard.loganalysis.tune_command import control_of
from kffa_offboard.offboard.settings import LimitSettings

PERIOD_S = 0.01
GRID = np.array([5.0, 20.0, 1.0])
CASES = [
    ("compare-ardupilot.toml", 0.028, Wanted(4.0, 24.0, 0.021)),
    ("compare-px4.toml", 0.02, Wanted(4.8, 29.0, 0.025)),
]
"""Configuration, delay of the motors, and the margins that `test_tune` holds the law itself to."""


def loop(gains: Array, b0: float) -> LinearSystem:
    """Measured height and climb rate -> command; the integral moves after it."""
    kp, ki, kd = gains
    return LinearSystem(
        np.eye(1),
        np.array([[-ki * PERIOD_S, 0.0]]),
        np.array([[1.0 / b0]]),
        np.array([[-kp / b0, -kd / b0]]),
        PERIOD_S,
    )


def judged(gains: Array, b0: float, vehicle: LinearSystem) -> tuple[Margins, float]:
    """Margins, and the IAE in the 5 s after a drop [m s]; infinite if it is not stable."""
    omega, controller = frequencies(PERIOD_S), loop(gains, b0)
    found = margins(omega, frequency_response(open_loop(controller, vehicle), omega))
    closed = closed_loop(controller, vehicle)
    if not is_stable(closed):
        return found, np.inf
    return found, float(PERIOD_S * DROP_M_S2 * np.abs(step_response(closed, 5.0)).sum())


def test_the_loop_of_this_test_is_the_pid_that_flies() -> None:
    given = tomllib.loads(bundled("compare-px4.toml").read_text(encoding="utf-8"))["control"]
    control, _ = control_of(given, "compare-px4.toml")
    parameters = design("pid", control.settings(LimitSettings()))
    state = controllers.initial_state(parameters, np.zeros(4), parameters.pid.trim)
    system = loop(
        np.array([parameters.pid.kp[3], parameters.pid.ki[3], parameters.pid.kd[3]]), 9.80665 / 0.398
    )
    integral = np.zeros(1)
    for y in np.random.default_rng(0).normal(0.0, 1e-3, (20, 2)):
        measured, rate = np.zeros((2, 4))
        measured[3], rate[3] = y
        inputs = controllers.ControllerInput(np.zeros(4), measured, np.ones(4, dtype=bool), rate)
        state, output = controllers.step(parameters, state, inputs, PERIOD_S)
        (expected,) = system.c @ integral + system.d @ y
        integral = system.a @ integral + system.b @ y
        assert output.command[3] - parameters.pid.trim[3] == pytest.approx(expected, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize(("file", "delay_s", "least"), CASES)
def test_it_has_the_margins_of_the_law_and_no_neighbour_with_them_has_less_error(
    file: str, delay_s: float, least: Wanted
) -> None:
    given = tomllib.loads(bundled(file).read_text(encoding="utf-8"))["control"]
    control, _ = control_of(given, file)
    settings = control.settings(LimitSettings())
    assert settings.pid_gains is not None
    gains, b0 = settings.pid_gains[:, 3], float(settings.b0[3])
    vehicle = plant(PlantNumbers(b0, 0.0, 0.0, delay_s, 0.05), PERIOD_S)
    found, error = judged(gains, b0, vehicle)
    assert found.meet(least)
    for step in np.diag(GRID):
        for neighbour in (gains + step, gains - step):
            other, its_error = judged(neighbour, b0, vehicle)
            assert its_error > error or not other.meet(least), neighbour


@pytest.mark.parametrize(("file", "delay_s", "least"), CASES)
def test_without_gains_of_its_own_it_would_be_at_the_edge_of_stability(
    file: str, delay_s: float, least: Wanted
) -> None:
    given = tomllib.loads(bundled(file).read_text(encoding="utf-8"))["control"]
    del given["pid"]
    control, _ = control_of(given, file)
    settings = control.settings(LimitSettings())
    assert settings.pid_gains is not None
    b0 = float(settings.b0[3])
    assert settings.pid_gains[:, 3] == pytest.approx([3 * 7.0**2, 7.0**3, 3 * 7.0])
    found, _ = judged(
        settings.pid_gains[:, 3], b0, plant(PlantNumbers(b0, 0.0, 0.0, delay_s, 0.05), PERIOD_S)
    )
    assert found.gain_db < 2.0 or found.phase_deg < 6.0
