"""A link is silent for a moment, and what was on its way comes at once: no load is announced for that."""

from dataclasses import dataclass, replace

import pytest

from kffa_offboard.faults.faults import Fault, Lose
from kffa_offboard.offboard.segments import Step


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


def stepping(fault_flight, personality, height_m, seconds, loaded_kg):
    """Up and down, on a link that may be silent for two seconds; 0.1 s before the vehicle turns at 3.0 s."""
    steps = (Step("altitude", height_m, seconds), Step("altitude", -height_m, seconds)) * 5
    flight = fault_flight(personality, settle_s=0.2, scenario=steps).prepare()
    silent = replace(
        flight.settings.telemetry, timeout_s=2.0, position_timeout_s=2.0, heartbeat_timeout_s=5.0
    )
    flight.settings = flight.service.settings = replace(flight.settings, telemetry=silent)
    if loaded_kg > 0.0:
        flight.vehicle.set_load(loaded_kg)
    return flight.go_on(lambda: (flight.engaged_s or 1e9) + 2.9 <= flight.vehicle.time_us * 1e-6)


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
    flight = stepping(fault_flight, personality, 2.0, 3.0, 5.0)
    quiet = flight.fly_on(3.5).heights
    for start_s in (0.3, 0.5):
        gone = flight.fly_on(3.5, down=[Lose(start_s=start_s, duration_s=0.5)])
        assert gone.released_s is None, gone.texts
        assert max(abs(one - other) for one, other in zip(gone.heights, quiet, strict=True)) < 0.8


@pytest.mark.parametrize("loaded_kg", [0.0, 5.0])
def test_silences_in_a_row_do_not_swing_the_height(fault_flight, loaded_kg):
    """After each the filter took noise for a load: thrust from end to end, until control was given up."""
    flight = stepping(fault_flight, "px4", 0.0, 100.0, loaded_kg)
    quiet = flight.fly_on(3.0).heights
    silences = [Lose(start_s=0.4 + 0.45 * k, duration_s=0.3) for k in range(5)]
    gone = flight.fly_on(3.0, down=silences)
    assert gone.released_s is None, gone.texts
    assert max(abs(one - other) for one, other in zip(gone.heights, quiet, strict=True)) < 0.3
