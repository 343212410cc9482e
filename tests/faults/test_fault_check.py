"""What judges the flights is judged: each thing that must not be is found."""

from math import nan

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.faults.check import bad_frames, violations
from kffa_offboard.faults.edit import edited, message_id
from kffa_offboard.faults.faults import Lose
from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import AttitudeTarget

SETPOINT = 82


@pytest.fixture(scope="module")
def flown(fault_flight):
    """A flight whose link is lost at 2.3 s."""
    flight = fault_flight("ardupilot", down=(Lose(2.3),), seconds=2.8, settle_s=0.2).fly()
    assert flight.violations == [] and flight.released_s is not None
    return flight


@pytest.mark.parametrize(
    ("change", "found"),
    [
        ({"thrust": nan}, "not finite"),
        ({"thrust": 0.96}, "thrust 0.960"),
        ({"thrust": 0.04}, "thrust 0.040"),
        ({"body_pitch_rate": -3.6}, "body rates"),
        ({"type_mask": 0}, "type mask 0"),
        ({"type_mask": 7, "q": [0.94, 0.342, 0.0, 0.0]}, "tilt 0.698 rad"),
    ],
)
def test_a_bad_frame_is_found(flown, change, found):
    index = next(k for k, (_, frame) in enumerate(flown.recorder.sent) if message_id(frame) == SETPOINT)
    time_us, frame = flown.recorder.sent[index]

    def spoil(message):
        for name, value in change.items():
            setattr(message, name, value)

    (what,) = bad_frames(flown.settings.limits, [(time_us, edited(frame, spoil))], airborne=True)
    assert found in what


def test_setpoints_that_must_not_be_are_found(flown):
    heard, sent = list(flown.heard), flown.recorder.sent
    at = next(k for k, (_, item) in enumerate(heard) if isinstance(item, AttitudeTarget)) + 1
    time_us, target = heard[at - 1]
    rates = target.body_rates
    for wrong, found in (
        (AttitudeTarget(target.thrust + 0.3, rates), "thrust changed by 0.300 in 0.010 s"),
        (AttitudeTarget(target.thrust, (rates[0] + 2.1, *rates[1:])), "a body rate changed by 2.100"),
    ):
        told = violations(flown.settings, [*heard[:at], (time_us + 10_000, wrong)], sent)
        assert any(found in what for what in told), told
    last = (heard[-1][0] + 100_000, target)
    told = violations(flown.settings, [*heard, last], sent)
    assert any("a setpoint after release" in what for what in told)
    assert any("a setpoint without AttitudeReceived" in what for what in told)


def test_an_ending_that_is_not_on_the_wire_is_found(flown):
    silent = [(time_us, frame) for time_us, frame in flown.recorder.sent if message_id(frame) != 253]
    told = violations(flown.settings, flown.heard, silent)
    assert told and all(what.startswith("not said on the wire: ") for what in told)
    assert any(isinstance(item, events.Announce) for _, item in flown.heard)


def test_a_copy_of_a_flight_is_commanded_alone(settled_flight):
    """What happens to it does not happen to the flight that it is a copy of."""
    land = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_NAV_LAND, 0, *[0.0] * 7)
    frame = bytes(land.pack(mavlink.MAVLink(None, 245, 191)))
    asks = {0.1: lambda vehicle: vehicle.receive(frame, "daemon")}
    original = settled_flight("px4")
    mode = original.vehicle.firmware.mode
    flown = original.fly_on(0.5, acts=asks)
    assert flown.vehicle.firmware.mode == flown.vehicle.firmware.land_mode != mode
    assert original.vehicle.firmware.mode == mode
