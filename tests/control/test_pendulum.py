"""A load on a rope under the position ring: predicted and simulated, damped and driven."""

import numpy as np
import pytest

from kffa_offboard.control import position
from kffa_offboard.control.pendulum import damped_frequencies, damped_ropes, lead_of

GRAVITY = 9.8
DT = 0.02
LINK_S = 0.02
"""Of telemetry; what the ring is told of the attitude loop has the other half."""


def growth_rates(name, numbers, ropes, ratio, seconds=40.0):
    """Of the swing [1/s], for each rope: ring, attitude loop and both bodies along one axis, small angles."""
    length = np.array(ropes)
    ring = position.design_ring(name, numbers)
    x, v, w, a = (np.zeros(length.size) for _ in range(4))
    q = 0.05 * length
    state = position.initial_state(ring, np.zeros((2, length.size)), np.zeros((2, length.size)))
    commands = [a] * (round((numbers.delay - LINK_S) / DT) + 1)
    seen = [(x, v, a)] * (round(LINK_S / DT) + 1)
    sizes = []
    for _ in range(round(seconds / DT)):
        seen_x, seen_v, seen_a = (np.stack([value, 0.0 * value]) for value in seen.pop(0))
        inputs = position.PositionInput(
            np.zeros_like(seen_x), seen_x, np.ones(seen_x.shape, bool), np.zeros(length.size), seen_v, seen_a
        )
        state, output = position.step(ring, state, inputs, DT)
        commands.append(output.ring.command[0])
        wanted = commands.pop(0)
        for _ in range(10):
            h = DT / 10
            a = a + h * (wanted - a) / numbers.lag
            pull = GRAVITY / length * q
            moved = (1.0 + ratio) * a + ratio * pull
            w = w + h * (-pull - moved)
            q = q + h * w
            v = v + h * moved
            x = x + h * v
        seen.append((x, v, a))
        sizes.append(np.hypot(q, w / np.sqrt(GRAVITY / length * (1.0 + ratio))))
    quarter = len(sizes) // 4
    early, late = (np.max(sizes[k : k + quarter], axis=0) for k in (quarter, 3 * quarter))
    return np.log(late / early) / (0.5 * seconds)


def predicted(name, numbers, ratio):
    return damped_ropes(position.answer_of(name, numbers), numbers.delay, numbers.lag, ratio, numbers.gravity)


@pytest.mark.parametrize("name", ["pid", "cascaded-pid"])
@pytest.mark.parametrize("ratio", [0.1, 0.67])
def test_what_is_predicted_to_be_damped_is_damped(name, ratio):
    numbers = position.PositionDesign()
    shortest, longest = predicted(name, numbers, ratio)
    rates = growth_rates(name, numbers, np.geomspace(shortest, min(longest, 30.0), 12), ratio)
    assert (rates < 0.0).all(), rates


@pytest.mark.parametrize(("delay", "frequency"), [(0.1, 5.48), (0.3, 2.44)])
def test_a_rope_that_is_much_shorter_is_driven(delay, frequency):
    """There kp = 0.75, ki = 0.125, kd = 1.5 lead by 85 and 78 degrees, of which 65 and 58 are lost."""
    numbers = position.PositionDesign(delay=delay)
    shortest, _ = predicted("pid", numbers, 0.67)
    assert growth_rates("pid", numbers, [0.3 * shortest], 0.67) > 0.0
    assert shortest == pytest.approx(1.67 * numbers.gravity / frequency**2, rel=0.01)


def test_a_rope_that_is_much_longer_is_driven_by_the_integral():
    numbers = position.PositionDesign(omega_c=8.0, delay=0.02, lag=0.02)
    _, longest = predicted("pid", numbers, 0.67)
    rates = growth_rates("pid", numbers, [0.5 * longest, 4.0 * longest], 0.67, seconds=80.0)
    assert rates[0] < 0.0 < rates[1]


@pytest.mark.parametrize("name", ["ladrc", "kffa-ladrc"])
def test_the_law_with_an_observer_drives_short_and_long_ropes(name):
    """Why there is another ring for them. In between, at 3 m, it damps."""
    numbers = position.PositionDesign(velocity_noise=0.02)
    rates = growth_rates(name, numbers, [0.5, 3.0, 10.0, 20.0], 0.5)
    assert (rates[[0, 2, 3]] > 0.003).all() and rates[1] < -0.03
    assert (growth_rates("pid", numbers, [0.5, 3.0, 10.0, 20.0], 0.5) < -0.03).all()


def test_an_answer_leads_by_its_rate_and_lags_by_its_integral_and_its_delay():
    frequency = np.array([0.5, 1.0, 2.0])
    assert lead_of((1.0, 0.0, 0.0), 0.0, 0.0, frequency) == pytest.approx([0.0] * 3)
    assert lead_of((1.0, 0.0, 1.0), 0.0, 0.0, frequency) == pytest.approx(np.arctan(frequency))
    assert lead_of((1.0, 1.0, 0.0), 0.0, 0.0, frequency) == pytest.approx(-np.arctan(1.0 / frequency))
    assert lead_of((1.0, 0.0, 0.0), 0.2, 0.3, frequency) == pytest.approx(
        -0.2 * frequency - np.arctan(0.3 * frequency)
    )


def test_an_integral_alone_damps_nothing():
    assert damped_frequencies((1.0, 1.0, 0.0), 0.1, 0.1) is None
    assert damped_ropes((1.0, 1.0, 0.0), 0.1, 0.1, 0.5, GRAVITY) is None


def test_a_later_attitude_damps_no_more_ropes():
    numbers = [position.PositionDesign(delay=delay) for delay in (0.05, 0.1, 0.2, 0.4)]
    ranges = [predicted("pid", each, 0.5) for each in numbers]
    assert [shortest for shortest, _ in ranges] == sorted(shortest for shortest, _ in ranges)
    assert [longest for _, longest in ranges] == sorted((longest for _, longest in ranges), reverse=True)
