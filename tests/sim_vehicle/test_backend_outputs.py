"""Servo outputs, pacing and the watch over a silent firmware."""

from __future__ import annotations

import numpy as np
import pytest

from sim_vehicle.backends.pacing import Pacer, StallWatch
from sim_vehicle.backends.servo_outputs import (
    GripperServo,
    GripperState,
    MotorOutputs,
    follow_gripper,
    motor_commands,
)
from sim_vehicle.errors import SimulatorError


def test_channels_are_taken_in_the_order_front_left_rear_right():
    outputs = MotorOutputs(channels=(3, 2, 4, 1), pwm_min=1000, pwm_max=2000)
    commands = motor_commands(outputs, [1400, 1200, 1100, 1300])
    np.testing.assert_allclose(commands, [0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize(("width", "command"), [(0, 0.0), (900, 0.0), (1000, 0.0), (2000, 1.0), (2300, 1.0)])
def test_commands_stay_between_nothing_and_all(width, command):
    assert motor_commands(MotorOutputs((1, 2, 3, 4), 1000, 2000), [width] * 4).tolist() == [command] * 4


def actions(servo: GripperServo, widths: list[int], each_us: int = 100_000) -> list[str | None]:
    """What the gripper does at each pulse width, one every `each_us`."""
    state, done = GripperState(), []
    for number, width in enumerate(widths):
        state, action = follow_gripper(servo, state, width, number * each_us)
        done.append(action)
    return done


@pytest.mark.parametrize("servo", [GripperServo(9, 1900, 1100), GripperServo(9, 1100, 1900)])
def test_a_move_to_an_end_acts_once(servo):
    parked = [1500] * 6
    moves = [servo.grab_pwm, servo.grab_pwm, 1500, servo.grab_pwm, servo.release_pwm, servo.release_pwm]
    assert actions(servo, parked + moves) == [None] * 6 + ["grab", None, None, "grab", "release", None]


def test_an_end_is_the_last_quarter_of_the_travel():
    servo = GripperServo(9, 1900, 1100)
    assert actions(servo, [1500] * 6 + [1699, 1700, 1301, 1300])[6:] == [None, "grab", None, "release"]


def test_an_output_that_pauses_keeps_the_gripper_where_it_is():
    assert actions(GripperServo(9, 1900, 1100), [1500] * 6 + [1900, 0, 1900])[6:] == ["grab", None, None]


# -------------------------------------------------------------------------------------- the clock


def test_simulated_time_keeps_to_its_factor():
    pacer = Pacer(2.0)
    assert pacer.wait(0, now_s=100.0) == 0.0
    assert pacer.wait(1_000_000, now_s=100.1) == pytest.approx(0.4)
    assert pacer.wait(1_000_000, now_s=100.5) == pytest.approx(0.0)


def test_small_lag_is_caught_up_and_large_lag_is_let_go():
    pacer = Pacer(1.0)
    pacer.wait(0, now_s=0.0)
    assert pacer.wait(10_000, now_s=0.09) == 0.0
    assert pacer.wait(100_000, now_s=0.09) == pytest.approx(0.01)
    assert pacer.wait(110_000, now_s=5.0) == 0.0
    assert pacer.wait(120_000, now_s=5.0) == pytest.approx(0.01)


def test_factor_nought_never_waits():
    pacer = Pacer(0.0)
    assert [pacer.wait(t, now_s=0.0) for t in (0, 10**6, 10**9)] == [0.0, 0.0, 0.0]


def watch(timeout_s: float = 0.0) -> StallWatch:
    return StallWatch("who", "packet", "start it", warning_s=5.0, timeout_s=timeout_s, now_s=100.0)


def test_silence_is_said_at_the_warning_and_at_each_doubling():
    silent = watch()
    said = {s: line for s in range(0, 50) if (line := silent.check(100.0 + s, 0))}
    assert list(said) == [5, 10, 20, 40]
    assert said[5] == "who: no packet for 5 s, still waiting; start it"


def test_the_end_of_an_announced_silence_is_said_and_a_short_one_is_not():
    silent = watch()
    assert silent.heard(103.0) is None
    assert silent.check(108.0, 2_500_000) == (
        "who: no packet for 5 s at 2.50 s of simulated time, still waiting; start it"
    )
    assert silent.heard(109.5) == "who: packets are coming again after 6.5 s"
    assert silent.heard(109.6) is None
    assert silent.check(114.5, 0) is None
    assert silent.check(114.7, 0) is not None


def test_waiting_ends_after_the_configured_time():
    silent = watch(timeout_s=8.0)
    assert silent.check(105.0, 0) is not None
    assert silent.check(107.9, 0) is None
    with pytest.raises(SimulatorError, match=r"^who: no packet for 8 s; start it$"):
        silent.check(108.0, 0)
