"""Another sender of setpoints in flight, and a stranger at another address: what is done, and logged."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config_log import config_of
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.offboard.events import Announce, AttitudeTarget, IntrusionNoticed
from kffa_offboard.replay.compare import compare
from kffa_offboard.replay.engine import replay
from kffa_offboard.replay.recording import read_recording

STRANGER_US, RIVAL_US, END_US = 5_000_000, 6_000_000, 7_000_000
PERIOD_US = 50_000  # 20 Hz, as offboard controllers send


def test_another_sender_of_setpoints_ends_control_and_the_log_shows_it(lock_step_flight, tmp_path):
    flight = lock_step_flight()
    flight.log = tmp_path / "rival.tlog"
    rival, impostor = mavlink.MAVLink(None, 255, 190), mavlink.MAVLink(None, 1, 1)

    def before_slot():
        now_us = flight.vehicle.time_us
        if now_us == STRANGER_US:
            beat = bytes(mavlink.MAVLink_heartbeat_message(2, 12, 128, 0, 4, 3).pack(impostor))
            flight.session.read(Datagram(now_us, beat, ("10.0.0.7", 9999), stranger=True))
        if now_us >= RIVAL_US and now_us % PERIOD_US == 0:
            target = mavlink.MAVLink_set_attitude_target_message(1, 1, 1, 128, [1, 0, 0, 0], 0, 0, 0, 0.9)
            flight.link.from_ground.append(bytes(target.pack(rival)))

    flight.before_slot = before_slot
    flight.fly(lambda vehicle: vehicle.time_us >= END_US)

    said = [(time_us, item.text) for time_us, item in flight.heard if isinstance(item, Announce)]
    texts = [text for _, text in said]
    assert "another vehicle is 1/1: 10.0.0.7:9999" in texts
    assert "failsafe: 255/190 sends setpoints to the vehicle" in texts
    ended_us = next(time_us for time_us, text in said if text.startswith("failsafe"))
    assert RIVAL_US + 2 * PERIOD_US <= ended_us <= RIVAL_US + 2 * PERIOD_US + 20_000
    sent_us = [time_us for time_us, item in flight.heard if isinstance(item, AttitudeTarget)]
    assert max(sent_us) <= ended_us

    recording = read_recording(flight.log)
    assert [item for _, item in recording.incoming if isinstance(item, IntrusionNoticed)] == [
        IntrusionNoticed("another vehicle is 1/1: 10.0.0.7:9999", "forbids")
    ]
    assert compare(recording, replay(recording, config_of(recording.header, flight.log))).difference is None


@pytest.mark.parametrize(
    ("personality", "output", "period_us", "noticed"),
    [
        ("ardupilot", "rates", 20_000, True),
        ("ardupilot", "attitude", 70_000, True),
        ("px4", "attitude", 20_000, True),
        ("px4", "rates", 20_000, False),  # whose ATTITUDE_TARGET says nothing then
        ("ardupilot", "rates", None, False),
        ("px4", "attitude", None, False),
    ],
)
def test_a_sender_of_setpoints_on_another_link_shows_in_what_the_autopilot_follows(
    lock_step_flight, personality, output, period_us, noticed
):
    """Level, and with the thrust that carries: the vehicle flies on, so that nobody would see it."""
    flight = lock_step_flight(personality, output=output)
    flight.vehicle.add_peer("rival")
    rival = mavlink.MAVLink(None, 246, 191)

    def before_slot():
        now_us = flight.vehicle.time_us
        if period_us is not None and now_us >= 8_500_000 and now_us % period_us == 0:
            target = mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 7, [1, 0, 0, 0], 0, 0, 0, 0.4)
            flight.vehicle.receive(bytes(target.pack(rival)), "rival")

    flight.before_slot = before_slot
    flight.fly(lambda vehicle: vehicle.time_us >= 12_000_000)
    assert flight.texts.count("somebody else's setpoints reach the vehicle") == noticed
    assert "engaged" in flight.texts
