"""What a simulated autopilot does with the last setpoint when the daemon gives up in the middle of a roll."""

from dataclasses import replace
from math import degrees, hypot

import pytest

from kffa_offboard.offboard import session
from kffa_offboard.offboard.segments import Hold, Step, Takeoff
from kffa_offboard.offboard.service import State

SCENARIO = (Takeoff(2.0, 1.5), Hold(0.5), Step("roll", 0.35, 5.0))


def silenced(flight):
    """Fly until the vehicle rolls fast, then let nothing arrive; returns the largest tilt after that, deg."""
    slow = replace(flight.daemon.service.sequence, resend_s=0.5)  # a level setpoint of its own while blind
    service = replace(flight.daemon.service, scenario=SCENARIO, failsafe_action="stop", sequence=slow)
    flight.daemon = replace(flight.daemon, service=service)
    link_class = flight.link_to

    class DeafLink(link_class):
        deaf = False

        def receive(self, timeout_s):
            state = self.vehicle.state.rigid
            self.deaf = self.deaf or (state[2] > 1.5 and abs(state[9]) > 0.6)
            arrived = super().receive(timeout_s)
            return arrived[-1:] if self.deaf else arrived

    flight.link_to = DeafLink
    flight.fly()
    assert flight.session.service.state is State.FAILSAFE
    largest, vehicle = 0.0, flight.vehicle
    for _ in range(150):
        vehicle.advance(vehicle.time_us + 20_000)
        roll, pitch = vehicle.state.rigid[6:8]
        largest = max(largest, degrees(hypot(roll, pitch)))
    return largest


@pytest.mark.parametrize(
    ("personality", "timeout"), [("ardupilot", "GUID_TIMEOUT"), ("px4", "COM_OF_LOSS_T")]
)
def test_an_autopilot_with_a_long_timeout_levels_at_the_farewell(
    lock_step_flight, monkeypatch, personality, timeout
):
    def flight():
        made = lock_step_flight(personality)
        made.vehicle.firmware.parameters.set(timeout, 2.0)
        return made

    assert silenced(flight()) < 40.0
    monkeypatch.setattr(session, "farewell", lambda *arguments: ())
    assert silenced(flight()) > 60.0
