"""Yaw by body rates on a real ArduCopter with stock gains: margins and steps with `compare-ardupilot.toml`.

The model has ArduCopter's own structure: rates are added up to a target angle and fed forward, an angle loop
(4.5/s) and a filtered rate loop (0.18, 0.018) follow it. Torque, drag, filter and delay were fitted to a step
flight of ArduCopter 4.7-dev (2598e9d4), which it explains to 0.07 degrees rms.
"""

from __future__ import annotations

import tomllib

import numpy as np
import pytest
from scipy.linalg import expm

from kffa_offboard.config import bundled
from kffa_offboard.control import controllers
from kffa_offboard.loganalysis.loop_model import (
    LinearController,
    LinearSystem,
    closed_loop,
    frequency_response,
    is_stable,
    open_loop,
)
from kffa_offboard.loganalysis.margins import Wanted, frequencies, margins
from kffa_offboard.loganalysis.tune import parameters_of
from kffa_offboard.loganalysis.tune_command import control_of

PERIOD_S = 0.01
YAW = 2
ANGLE_P, RATE_P, RATE_I = 4.5, 0.18, 0.018
TORQUE, DRAG, FILTER_RAD_S, MOTORS_S = 13.6, 0.235, 2 * np.pi * 2.44, 0.05
DELAY_PERIODS = 6
"""Commands, link and telemetry together: 0.058 s."""


def arducopter_yaw(torque: float = TORQUE) -> LinearSystem:
    """Rate command and disturbance -> yaw and its rate."""
    # Target, yaw, rate, what the motors give, filtered rate error, its integral; then the two inputs.
    a = np.zeros((8, 8))
    a[0, 6] = a[1, 2] = a[2, 7] = 1.0
    a[2, 2], a[2, 3] = -DRAG, torque
    a[3, 3], a[3, 4], a[3, 5] = -1.0 / MOTORS_S, RATE_P / MOTORS_S, 1.0 / MOTORS_S
    a[4] = FILTER_RAD_S * np.array([ANGLE_P, -ANGLE_P, -1.0, 0.0, -1.0, 0.0, 1.0, 0.0])
    a[5, 4] = RATE_I
    discrete = expm(a * PERIOD_S)
    size = 6 + DELAY_PERIODS
    states, inputs = np.eye(size, k=-1), np.zeros((size, 2))
    states[:7] = 0.0
    states[:6, :6], states[:6, -1] = discrete[:6, :6], discrete[:6, 6]
    inputs[:6, 1], inputs[6, 0] = discrete[:6, 7], 1.0
    return LinearSystem(states, inputs, np.eye(2, size, k=1), np.zeros((2, 2)), PERIOD_S)


def configured() -> controllers.ControllerParameters:
    """The controller of compare-ardupilot.toml, commanding body rates."""
    given = tomllib.loads(bundled("compare-ardupilot.toml").read_text(encoding="utf-8"))["control"]
    control, _ = control_of(given | {"output": "rates"}, "compare-ardupilot.toml")
    return parameters_of(control)


@pytest.mark.parametrize(
    ("torque", "wanted"), [(TORQUE, Wanted(7.0, 50.0, 0.1)), (0.75 * TORQUE, Wanted(5.0, 50.0, 0.1))]
)
def test_the_yaw_loop_keeps_its_margins_and_a_quarter_of_the_torque_may_be_missing(
    torque: float, wanted: Wanted
) -> None:
    loop = LinearController.of(configured(), PERIOD_S).system(YAW)
    vehicle = arducopter_yaw(torque)
    omega = frequencies(PERIOD_S)
    assert is_stable(closed_loop(loop, vehicle))
    assert margins(omega, frequency_response(open_loop(loop, vehicle), omega)).meet(wanted)


@pytest.mark.parametrize("degrees", [30.0, -30.0])
def test_a_yaw_step_of_30_degrees_is_there_after_5_2_s_without_turning_back(
    degrees: float,
) -> None:
    parameters, vehicle = configured(), arducopter_yaw()
    zero, every = np.zeros(4), np.ones(4, dtype=bool)
    state = controllers.initial_state(parameters, zero, zero)
    channel = np.arange(4) == YAW
    reference = np.radians(degrees) * channel
    x, response = np.zeros(len(vehicle.a)), []
    for _ in range(round(8.0 / PERIOD_S)):
        yaw, rate = vehicle.c @ x
        inputs = controllers.ControllerInput(reference, yaw * channel, every, rate * channel)
        state, output = controllers.step(parameters, state, inputs, PERIOD_S)
        x = vehicle.a @ x + vehicle.b[:, 0] * output.command[YAW]
        response.append(x[1] / reference[YAW])
    assert max(response) < 1.02
    assert np.max(np.maximum.accumulate(response) - response) < 0.01
    assert np.abs(np.array(response[round(5.2 / PERIOD_S) :]) - 1.0).max() < 0.05
