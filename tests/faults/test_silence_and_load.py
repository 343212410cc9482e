"""A link is silent for a moment, and what was on its way comes at once: no load is announced for that."""

import math
from dataclasses import dataclass, replace

import pytest

from kffa_offboard.faults.faults import Fault, Lose
from kffa_offboard.offboard.segments import Hold, Sine, Step


@dataclass
class Burst(Fault):
    """What comes in that time is kept until its end."""

    def change(self, frame, generator):
        return [frame._replace(time_us=round((self.start_s + self.duration_s) * 1e6))]


def said_of_loads(flight):
    words = ("picked up", "dropped", "carrying", "load")
    return [text for text in flight.texts if text.startswith(words)]


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_samples_that_come_in_a_burst_after_a_silence_are_no_drop(settled_flight, personality):
    """Which thrust acted when is not known then; 1.5 to 2.5 kg were said to be dropped, which stayed."""
    for phase in range(6):
        burst = Burst(start_s=1.0 + 0.05 * phase, duration_s=0.21)
        flight = settled_flight(personality, 5.0).fly_on(3.0, down=[burst])
        assert flight.released_s is None, flight.texts
        assert [text[:8] for text in said_of_loads(flight)] == ["carrying"]


def on_a_silent_link(fault_flight, personality, scenario, loaded_kg=0.0, resend_s=0.1):
    """A flight on a link that may be silent for two seconds, 2.9 s after it began.

    After `resend_s` without telemetry the vehicle is told to be level.
    """
    flight = fault_flight(personality, settle_s=0.2, scenario=scenario).prepare()
    silent = replace(
        flight.settings.telemetry, timeout_s=2.0, position_timeout_s=2.0, heartbeat_timeout_s=5.0
    )
    sequence = replace(flight.settings.sequence, resend_s=resend_s)
    flight.settings = flight.service.settings = replace(flight.settings, telemetry=silent, sequence=sequence)
    if loaded_kg > 0.0:
        flight.vehicle.set_load(loaded_kg)
    return flight.go_on(lambda: (flight.engaged_s or 1e9) + 2.9 <= flight.vehicle.time_us * 1e-6)


def stepping(fault_flight, personality, height_m, seconds, loaded_kg, resend_s=0.1):
    """Up and down; 0.1 s before the vehicle turns at 3.0 s."""
    steps = (Step("altitude", height_m, seconds), Step("altitude", -height_m, seconds)) * 5
    return on_a_silent_link(fault_flight, personality, steps, loaded_kg, resend_s)


@pytest.mark.parametrize("loaded_kg", [0.0, 5.0])
def test_a_silence_while_thrust_changes_is_no_load(fault_flight, loaded_kg):
    """It is told to be level meanwhile, with another thrust than the last; 3 kg were said to drop."""
    flight = stepping(fault_flight, "px4", 0.7, 1.5, loaded_kg)
    said = said_of_loads(flight)
    for start_s in (0.01, 0.11, 0.21, 0.31):
        gone = flight.fly_on(2.5, down=[Lose(start_s=start_s, duration_s=0.65)])
        assert said_of_loads(gone) == said


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_a_silence_on_the_way_to_another_height_leaves_it_with_the_thrust_that_carries(
    fault_flight, personality
):
    """The mean of the setpoints held the acceleration: 4 m away from the flight without it, or no control."""
    flight = stepping(fault_flight, personality, 2.0, 3.0, 5.0, resend_s=0.2)
    quiet = flight.fly_on(3.5).heights
    for start_s in (0.3, 0.5):
        gone = flight.fly_on(3.5, down=[Lose(start_s=start_s, duration_s=0.5)])
        assert gone.released_s is None, gone.texts
        assert max(abs(one - other) for one, other in zip(gone.heights, quiet, strict=True)) < 0.8


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_a_silence_on_the_way_to_another_height_does_not_end_control_whenever_it_begins(
    fault_flight, personality
):
    """A setpoint of level after 0.1 s.

    Where thrust would have begun to brake, at up to 4 m/s, the vehicle flies on with that for the silence and
    the 0.11 s of link and motors: 2.7 m, whatever the setpoint is. Elsewhere it is far less: in half of the
    moments below 0.8 m.
    """
    flight = stepping(fault_flight, personality, 2.0, 3.0, 5.0)
    quiet, away = flight.fly_on(6.5).heights, []
    for start_s in (0.1 + 0.3 * k for k in range(8)):
        gone = flight.fly_on(6.5, down=[Lose(start_s=start_s, duration_s=0.5)])
        assert gone.released_s is None, gone.texts
        away.append(max(abs(one - other) for one, other in zip(gone.heights, quiet, strict=True)))
    assert max(away) < 2.7
    assert sorted(away)[len(away) // 2 - 1] < 0.8


MOMENTS_S = [0.4 + 0.13 * k for k in range(8)]
SILENT_S, HEARD_S = 0.3, 0.15


def silences_in_a_row(flight, start_s):
    """Five, 67 % of the time."""
    every = SILENT_S + HEARD_S
    silences = [Lose(start_s=start_s + every * k, duration_s=SILENT_S) for k in range(5)]
    return flight.fly_on(start_s + 5 * every + 0.5, down=silences)


def swings(flight):
    """How far such a flight leaves the height of one without silences, for each moment; none ends control."""
    quiet = flight.fly_on(MOMENTS_S[-1] + 5 * (SILENT_S + HEARD_S) + 0.5).heights
    for start_s in MOMENTS_S:
        gone = silences_in_a_row(flight, start_s)
        assert gone.released_s is None, gone.texts
        yield max(abs(one - other) for one, other in zip(gone.heights, quiet, strict=False))


HOVER = (Hold(1000.0),)
VEHICLES = pytest.mark.parametrize(
    ("personality", "loaded_kg"), [("px4", 0.0), ("px4", 5.0), ("ardupilot", 0.0)]
)


@VEHICLES
def test_silences_in_a_row_do_not_end_control_whenever_they_begin(fault_flight, personality, loaded_kg):
    """In a third of all moments a climb rate "did not fit" that did.

    The height may swing by what a setpoint of all or no thrust does that holds for 0.2 s and is braked again:
    thrust answers a climb rate with 2 omega_c = 16 times as much acceleration, and whatever holds for more
    than 2 / 16 s of that turns the climb rate round faster than it was.
    """
    mass, full = 10.0 + loaded_kg, 246.0
    flight = on_a_silent_link(fault_flight, personality, HOVER, loaded_kg, resend_s=0.2)
    limits = flight.settings.limits
    up, down = limits.thrust_max * full / mass - 9.8, 9.8 - limits.thrust_min * full / mass
    unseen_s = SILENT_S - 0.2 + 0.11  # and until the next thrust is there: link and motors
    worst = max(
        0.5 * pushed * 0.2**2 + 0.2 * pushed * unseen_s + 0.5 * (0.2 * pushed) ** 2 / braked
        for pushed, braked in ((up, down), (down, up))
    )
    assert max(swings(flight)) < worst


@VEHICLES
def test_a_last_setpoint_that_holds_for_a_tenth_of_a_second_does_not_swing_the_height(
    fault_flight, personality, loaded_kg
):
    """Thrust has a noise of 1 m/s^2 in hover: three times that for 0.1 s, and 0.3 s unseen, make 0.12 m.

    It swung by up to 0.55 m while the Kalman filter believed what it had predicted over the silence.
    """
    flight = on_a_silent_link(fault_flight, personality, HOVER, loaded_kg)
    assert max(swings(flight)) < 0.15


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
@pytest.mark.parametrize("resend_s", [0.1, 0.2])
def test_silences_in_a_swing_do_not_end_control_whenever_they_begin(fault_flight, personality, resend_s):
    """In half of all moments body rates "did not fit" that did.

    A last body rate that holds for 0.1 s leaves the vehicle within the tilt that may be asked for.
    """
    swing = (Sine("roll", math.radians(25.0), 2.0, 1000.0),)
    flight = on_a_silent_link(fault_flight, personality, swing, resend_s=resend_s)
    limits = flight.settings.limits
    for start_s in MOMENTS_S:
        gone = silences_in_a_row(flight, start_s)
        assert gone.released_s is None, gone.texts
        most = limits.tilt_max_rad if resend_s == 0.1 else limits.tilt_failsafe_rad
        assert max(gone.tilts[len(flight.tilts) :]) < most


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_what_happened_in_a_silence_is_answered_at_once_when_it_is_over(fault_flight, personality):
    """A load leaves 0.2 s before its end. PX4 went back to body rates up to 0.5 s late, and rose by 2 m."""
    flight = on_a_silent_link(fault_flight, personality, HOVER, 5.0)
    for start_s in (1.0, 1.1, 1.2, 1.3, 1.4):
        leaves = {start_s + 0.3: lambda vehicle: vehicle.set_load(0.0)}
        silence = [Lose(start_s=start_s, duration_s=0.5)]
        before, *heights = flight.fly_on(start_s + 2.5, down=silence, acts=leaves).heights[-250:]
        assert max(heights) - before < 0.5
