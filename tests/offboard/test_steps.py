"""How far each number may go at once in flight, and that a hair more is refused."""

from dataclasses import replace

import numpy as np
import pytest

from kffa_offboard.control.design import DesignSettings, design
from kffa_offboard.offboard import events
from kffa_offboard.offboard.service import State
from kffa_offboard.offboard.steps import too_far

ONES = np.ones(4)
ROLL, YAW, ALTITUDE = 0, 2, 3
NUMBERS = DesignSettings(
    b0=10.0 * ONES,
    omega_c=6.0 * ONES,
    omega_o=25.0 * ONES,
    lower=-2.0 * ONES,
    upper=2.0 * ONES,
    damping=12.0 * ONES,
    delay=0.1 * ONES,
    lag=0.1 * ONES,
    omega_c_range=0.01 * ONES,
    measurement_variance=1e-4 * ONES,
    rate_variance=1e-4 * ONES,
    cascade_gains=np.array([[6.5, 6.5, 2.8, 1.0], [0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 0.0, 4.0]]),
    pid_gains=np.outer([30.0, 40.0, 10.0], ONES),
)
STIFF = 64.0 * np.array([1.0, 1.0, 1.0, 0.0])  # output = "attitude"


def refused(fake, name, before, after):
    """What is said of a change from one design to another."""
    flown, wanted = (fake.settings(controller=design(name, numbers)) for numbers in (before, after))
    return too_far(flown, wanted, flown)


def scaled(numbers, key, times, channel):
    values = np.array(getattr(numbers, key), dtype=float)
    values[..., channel] *= times
    return replace(numbers, **{key: values})


@pytest.mark.parametrize(
    ("key", "times"),
    [
        ("b0", 1.5),
        ("b0", 1 / 1.5),
        ("damping", 1.5),
        ("damping", 1 / 1.5),
        ("delay", 1.5),
        ("delay", 1 / 1.5),
        ("lag", 1.5),
        ("lag", 1 / 1.5),
        ("measurement_variance", 3.0**2),
        ("measurement_variance", 1 / 3.0**2),
        ("rate_variance", 3.0**2),
        ("rate_variance", 1 / 3.0**2),
        ("disturbance_intensity", 10.0),
        ("disturbance_intensity", 1 / 10.0),
        ("omega_c", 2.0),
    ],
)
@pytest.mark.parametrize("channel", [ROLL, ALTITUDE])
def test_a_number_goes_as_far_as_its_step_and_no_farther(fake, key, times, channel):
    step = scaled(NUMBERS, key, times, channel)
    assert refused(fake, "kffa-ladrc", NUMBERS, step) is None
    beyond = scaled(step, key, 1.01 if times > 1.0 else 0.99, channel)
    assert refused(fake, "kffa-ladrc", NUMBERS, beyond).startswith(("roll", "altitude")[channel == ALTITUDE])


@pytest.mark.parametrize(("key", "least"), [("damping", 1.0), ("delay", 0.02), ("lag", 0.02)])
@pytest.mark.parametrize("start", [0.0, 1e-3])
def test_a_number_of_the_plant_that_is_nearly_nothing_may_become_a_little(fake, key, least, start):
    """1/s of damping, s of delay and lag, whatever share of the present one that is; and back."""
    before, little, more = (
        replace(NUMBERS, **{key: (start + added) * ONES}) for added in (0.0, least, 1.01 * least)
    )
    for first, second in ((before, little), (little, before)):
        assert refused(fake, "ladrc", first, second) is None
    for first, second in ((before, more), (more, before)):
        assert refused(fake, "ladrc", first, second).startswith(f"roll: {key} from")


@pytest.mark.parametrize("times", [1.5, 1 / 1.5])
def test_a_natural_frequency_goes_in_the_steps_of_the_plant_and_is_squared_in_b0(fake, times):
    before = replace(NUMBERS, stiffness=STIFF)
    step = scaled(before, "b0", times**2, ROLL)
    assert refused(fake, "ladrc", before, step) is None
    beyond = scaled(step, "b0", 1.01 if times > 1.0 else 0.99, ROLL)
    assert refused(fake, "ladrc", before, beyond).endswith("go in steps of 1.5 times at most")


@pytest.mark.parametrize(
    ("stiffness", "channel", "times", "flown"),
    [
        (0.0 * STIFF, ROLL, 0.01, True),
        (0.0 * STIFF, YAW, 100.0, True),  # turns about an axis along which nobody tilts
        (0.0 * STIFF, YAW, 0.01, True),
        (STIFF, ROLL, 0.5, True),
        (STIFF, ROLL, 0.49, False),
        (STIFF, YAW, 0.49, False),
        (STIFF, YAW, 2.0, True),
        (STIFF, YAW, 2.02, False),
        (STIFF, ALTITUDE, 0.01, True),  # nothing of the autopilot's works against it
    ],
)
def test_a_bandwidth_may_fall_at_once_but_beside_the_autopilots_own_loop(
    fake, stiffness, channel, times, flown
):
    before = replace(NUMBERS, stiffness=stiffness)
    said = refused(fake, "ladrc", before, scaled(before, "omega_c", times, channel))
    assert (said is None) == flown
    assert flown or said.endswith("go in steps of 2 times at most")


@pytest.mark.parametrize(
    ("name", "key", "channel", "gain", "bandwidth_power"),
    [
        ("pid", "pid_gains", ROLL, "p", 2),
        ("pid", "pid_gains", ROLL, "i", 3),
        ("pid", "pid_gains", ROLL, "d", 1),
        ("cascaded-pid", "cascade_gains", ROLL, "p", 1),
        ("cascaded-pid", "cascade_gains", ALTITUDE, "p", 1),
        ("cascaded-pid", "cascade_gains", ALTITUDE, "i", 2),
        ("cascaded-pid", "cascade_gains", ALTITUDE, "d", 1),
    ],
)
@pytest.mark.parametrize("factor", [2.0, 0.5])
def test_a_gain_goes_as_far_as_doubles_or_halves_the_bandwidth(
    fake, name, key, channel, gain, bandwidth_power, factor
):
    """In parallel form a bandwidth w has gains of w^2, w^3 and w; in a cascade of w, w^2 and w."""

    def times(share):
        gains = np.array(getattr(NUMBERS, key))
        gains["pid".index(gain), channel] *= share
        return replace(NUMBERS, **{key: gains})

    share = factor**bandwidth_power
    assert refused(fake, name, NUMBERS, times(share)) is None
    beyond = refused(fake, name, NUMBERS, times(share * (1.01 if factor > 1.0 else 0.99)))
    assert f": PID {gain} from" in beyond
    assert beyond.endswith(f"go in steps of {2**bandwidth_power:g} times at most")


def test_a_gain_that_was_zero_may_become_a_fifth(fake):
    before, little, more = (
        replace(NUMBERS, pid_gains=np.outer([30.0, integral, 10.0], ONES)) for integral in (0.0, 0.2, 0.21)
    )
    assert refused(fake, "pid", before, little) is None and refused(fake, "pid", little, before) is None
    assert refused(fake, "pid", before, more) == "roll: PID i from 0 to 0.21; go in steps of 8 times at most"


# ---------------------------------------------------------------------- another plant in flight


def with_plant(settings, times=1.0, damping=1.0, delay_s=0.0):
    """The same with b0 and damping of roll so many times as large, and more delay."""
    parameters = settings.controller
    roll = np.array([1.0, 0.0, 0.0, 0.0])
    b0, damped = (
        value * (1.0 + (factor - 1.0) * roll)
        for value, factor in zip(
            (parameters.model.b0, parameters.model.damping), (times, damping), strict=True
        )
    )
    model = replace(parameters.model, b0=b0, damping=damped)
    acting = replace(parameters.actuator, delay=parameters.actuator.delay + delay_s * roll)
    return replace(settings, controller=replace(parameters, model=model, actuator=acting))


def plant(settings):
    model, actuator = settings.controller.model, settings.controller.actuator
    return model.b0, model.damping, actuator.delay


def asked(fake, output="rates", **changes):
    """What an engaged service says of such a change, and whether it flies with it."""
    flight = fake.Lockstep(fake.settings(output), fake.airborne()).run_to(State.ENGAGED)
    wanted = with_plant(fake.settings(output), **changes)
    flight.give(events.SettingsChanged(wanted))
    said = [refused.reason for _, refused in flight.sent(events.RequestRefused)]
    return said, all(map(np.array_equal, plant(flight.service.settings), plant(wanted)))


@pytest.mark.parametrize(
    ("output", "changes"),
    [
        ("rates", {"times": 1.5}),
        ("rates", {"times": 1 / 1.5}),
        ("attitude", {"times": 2.25, "damping": 1.5}),
        ("rates", {"delay_s": 0.02}),
    ],
)
def test_a_plant_that_is_a_step_away_is_flown(fake, output, changes):
    assert asked(fake, output, **changes) == ([], True)


@pytest.mark.parametrize(
    ("output", "changes", "reason"),
    [
        ("rates", {"times": 1.6}, "roll: b0 from 12 to 19.2; go in steps of 1.5 times at most"),
        ("rates", {"times": 0.6}, "roll: b0 from 12 to 7.2; go in steps of 1.5 times at most"),
        ("attitude", {"times": 2.5}, "roll: b0 from 64 to 160; go in steps of 1.5 times at most"),
        ("rates", {"damping": 2.5}, "roll: damping from 12 to 30; go in steps of 1.5 times at most"),
        ("rates", {"delay_s": 0.03}, "roll: delay from 0.01 to 0.04; go in steps of 1.5 times at most"),
    ],
)
def test_a_plant_that_is_farther_away_is_refused_in_flight(fake, output, changes, reason):
    assert asked(fake, output, **changes) == ([reason], False)


@pytest.mark.parametrize(
    ("output", "omega_c", "said"),
    [
        ("attitude", 2.4, ["roll: omega_c from 6 to 2.4; go in steps of 2 times at most"]),
        ("attitude", 12.5, ["roll: omega_c from 6 to 12.5; go in steps of 2 times at most"]),
        ("attitude", 3.1, []),
        ("rates", 2.4, []),
    ],
)
def test_beside_the_autopilots_own_hold_a_bandwidth_goes_in_steps(fake, output, omega_c, said):
    """A quarter, or 2.7 times as much, swung the vehicle by 0.4 rad if the natural frequency was off, too."""
    flight = fake.Lockstep(fake.settings(output), fake.airborne()).run_to(State.ENGAGED)
    controller = flight.service.settings.controller
    law = replace(controller.law, omega_c=np.array([omega_c, *controller.law.omega_c[1:]]))
    changed = replace(flight.service.settings, controller=replace(controller, law=law))
    flight.give(events.SettingsChanged(changed))
    assert [refused.reason for _, refused in flight.sent(events.RequestRefused)] == said


def test_back_to_what_the_run_began_with_it_goes_at_once(fake):
    flight = fake.Lockstep(fake.settings(), fake.airborne()).run_to(State.ENGAGED)
    for times in (1.4, 1.9, 2.6, 1.0):
        flight.give(events.SettingsChanged(with_plant(fake.settings(), times)))
        flight.run(0.1)
    assert not flight.sent(events.RequestRefused)


def test_before_flight_any_plant_may_be_set(fake):
    flight = fake.Lockstep(fake.settings(engage=False), fake.airborne()).run_to(State.READY)
    flight.give(events.SettingsChanged(with_plant(fake.settings(engage=False), 3.0)))
    assert not flight.sent(events.RequestRefused)
