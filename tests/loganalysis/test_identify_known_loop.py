"""The simulated autopilot's own rate loop, of which the poles are known: b0 within 5 %, delay within 10 ms.

Only its proportional gain acts here, through ideal motors (the simulator's `paper` profile), so that loop and
rigid body are of first order, and of second with the attitude's proportional gain around them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from kffa_offboard.loganalysis.identify import Channel, identify
from kffa_offboard.loganalysis.record import FlightRecord, Series, empty
from sim_vehicle import rate_loop

Array = NDArray[np.float64]

DELAY_S = 0.04
LOOP_GAIN = (11.0, 14.0, 2.5)  # 1/s: proportional gain times full torque over moment of inertia
ATTITUDE_GAIN = (4.0, 5.0, 1.5)  # 1/s
AXES = ("roll", "pitch", "yaw")
DT = 0.0025
FULL_TORQUE = 80.0  # rad/s^2
PROPORTIONAL = (LOOP_GAIN[0] / FULL_TORQUE, LOOP_GAIN[1] / FULL_TORQUE, LOOP_GAIN[2] / FULL_TORQUE)
GAINS = rate_loop.RateGains(PROPORTIONAL, (0.0,) * 3, (0.0,) * 3, (0.0,) * 3, False, 0.0, (0.0,) * 3)


def doublets(seconds: float, size: float) -> Array:
    """Steps up and down of 0.3 to 1.2 s, each axis with its own timing; (n, 3)."""
    random = np.random.default_rng(5)
    commands = np.zeros((round(seconds / DT), 3))
    for axis in range(3):
        at, sign = 0.0, 1.0
        while at < seconds:
            length = random.uniform(0.3, 1.2)
            commands[round(at / DT) : round((at + length) / DT), axis] = sign * size
            at, sign = at + length, -sign
    return commands


def flown(commands: Array, attitude_gain: tuple[float, float, float] | None) -> FlightRecord:
    """A vehicle that follows `commands` (rates, or attitude with a gain) `DELAY_S` late; logged at 100 Hz."""
    late, random = round(DELAY_S / DT), np.random.default_rng(6)
    state, angle, rate = rate_loop.RateState(), np.zeros(3), np.zeros(3)
    angles, rates = [], []
    for k in range(len(commands)):
        wanted = commands[k - late] if k >= late else np.zeros(3)
        if attitude_gain is not None:
            wanted = np.array(attitude_gain) * (wanted - angle)
        state, demand = rate_loop.step(GAINS, state, tuple(wanted), tuple(rate), (0.0,) * 3, True, DT)
        angle = angle + DT * (rate + 0.5 * DT * FULL_TORQUE * np.array(demand))
        rate = rate + DT * FULL_TORQUE * np.array(demand)
        angles.append(angle)
        rates.append(rate)
    every = slice(0, None, 4)
    time_s = DT * np.arange(1, len(commands) + 1)[every]
    measured = [
        np.array(rows)[every] + 0.002 * random.standard_normal((len(time_s), 3)) for rows in (angles, rates)
    ]
    given = Series(time_s - DT, commands[every])
    return FlightRecord(
        path=Path("known.tlog"),
        source="tlog",
        attitude=Series(time_s, measured[0]),
        body_rates=Series(time_s, measured[1]),
        rates_setpoint=given if attitude_gain is None else empty(3),
        attitude_setpoint=empty(3) if attitude_gain is None else given,
        commands_sent=True,
    )


@pytest.fixture(scope="module")
def rates() -> dict[str, Channel]:
    return channels(flown(doublets(30.0, 0.2), None))


@pytest.fixture(scope="module")
def attitudes() -> dict[str, Channel]:
    return channels(flown(doublets(30.0, 0.1), ATTITUDE_GAIN))


@pytest.mark.parametrize("axis", range(3))
def test_b0_and_delay_of_body_rates_are_those_of_the_known_loop(rates: dict[str, Channel], axis: int) -> None:
    found = rates[f"rates.{AXES[axis]}"]
    assert found.b0.value == pytest.approx(LOOP_GAIN[axis], rel=0.05)
    assert found.delay.value == pytest.approx(DELAY_S, abs=0.01)


@pytest.mark.parametrize("axis", range(3))
def test_b0_and_delay_of_attitude_are_those_of_the_known_loop(
    attitudes: dict[str, Channel], axis: int
) -> None:
    found = attitudes[f"attitude.{AXES[axis]}"]
    assert found.b0.value == pytest.approx(LOOP_GAIN[axis] * ATTITUDE_GAIN[axis], rel=0.05)
    assert found.delay.value == pytest.approx(DELAY_S, abs=0.01)
    damping = 0.5 * (LOOP_GAIN[axis] / ATTITUDE_GAIN[axis]) ** 0.5
    assert found.parameters["damping_ratio"].value == pytest.approx(damping, rel=0.05)


def channels(record: FlightRecord) -> dict[str, Channel]:
    return {channel.name: channel for channel in identify([record]).channels}
