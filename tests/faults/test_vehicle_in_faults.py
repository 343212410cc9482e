"""What breaks on the vehicle, in flight: control is kept, and the vehicle stays within these bounds."""

import pytest

AT = 3.2
ROPE = {"payload": {"clock": "boot", "rope_length_m": 2.0, "schedule": [{"time_s": AT, "mass_kg": 4.0}]}}
HEAVY = {"payload": {"clock": "boot", "schedule": [{"time_s": AT, "mass_kg": 6.73}]}}
CASES = {  # vehicle, bounds of height [m] and tilt [rad]
    "thrust-saturated": (
        {"faults": {"thrust_limit": [{"start_s": AT, "duration_s": 2.0, "share": 0.35}]}},
        (2.2, 6.3),
        0.2,
    ),
    "weak-motor": ({"faults": {"weak_motor": [{"start_s": AT}]}}, (4.9, 5.1), 0.15),
    "battery-sag": ({"faults": {"battery_sag": [{"start_s": AT, "loss_per_s": 0.05}]}}, (4.9, 5.1), 0.05),
    "heavy-load": (HEAVY, (4.85, 5.15), 0.05),
    "gust": (
        {"vehicle": {"drag_n_s_m": 1.0}, "faults": {"gust": [{"start_s": AT, "duration_s": 2.0}]}},
        (4.9, 5.1),
        0.05,
    ),
    "swinging-load": (ROPE, (4.85, 5.15), 0.1),
}


def push(vehicle):
    """The load is given 1 m/s."""
    rope = vehicle.plant._rope
    rope._state.velocity[0] += 1.0


@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("way", ["in_process", "over_udp"])
def test_the_vehicle_stays_within_its_bounds(fault_flight, name, way):
    changes, (lowest, highest), most = CASES[name]
    acts = {AT + 0.3: push} if name == "swinging-load" else {}
    seconds = 8.0 if name == "thrust-saturated" else 6.0
    flight = fault_flight(vehicle_changes=changes, acts=acts, seconds=seconds)
    flight = flight.fly() if way == "in_process" else flight.fly_over_udp()
    assert flight.engaged_s is not None and flight.released_s is None, flight.texts
    assert flight.violations == []
    assert lowest < min(flight.heights) and max(flight.heights) < highest
    assert max(flight.tilts) < most
    assert abs(flight.heights[-1] - 5.0) < 0.3
