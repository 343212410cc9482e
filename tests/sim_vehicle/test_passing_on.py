"""What one peer says to others than the autopilot reaches the other peers, as through a real autopilot."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle.config import build
from sim_vehicle.signing import Signing
from sim_vehicle.vehicle import SimulatedVehicle

NAMED = mavlink.MAVLink_named_value_float_message(5, b"ALT_EST", 4.5)


class Party:
    """A ground station (255/190) and a daemon (1/191) on two links of one vehicle; each hears what is its."""

    def __init__(self, personality, signing=None):
        sections = {
            "vehicle": {"personality": personality},
            "link": {"telemetry_delay_s": 0.0, "command_delay_s": 0.0},
        }
        self.vehicle = SimulatedVehicle(build(sections, "test"), signing)
        self.codecs = {"ground": codec(255, 190, signing), "daemon": codec(1, 191, signing)}
        for key in (*self.codecs, "silent"):
            self.vehicle.add_peer(key)
        for key in self.codecs:
            self.say(key, mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))

    def say(self, key, message):
        """Frames that each peer gets because of it, without the autopilot's own."""
        frame = bytes(message.pack(self.codecs[key]))
        self.vehicle.receive(frame, key)
        self.vehicle.advance(self.vehicle.time_us + 10_000)
        heard = {"ground": [], "daemon": [], "silent": []}
        for peer, data in self.vehicle.outgoing():
            found = mavlink.MAVLink(None).parse_buffer(bytearray(data)) or []
            heard[peer] += [bytes(m.get_msgbuf()) for m in found if is_passed_on(m)]
        assert all(passed == frame for frames in heard.values() for passed in frames)
        return {peer for peer, frames in heard.items() if frames}


def codec(system, component, signing):
    packer = mavlink.MAVLink(None, srcSystem=system, srcComponent=component)
    if signing is not None:
        packer.signing.secret_key, packer.signing.sign_outgoing = signing.key, True
        packer.signing.timestamp = 1
    return packer


def is_passed_on(message):
    return (message.get_srcSystem(), message.get_srcComponent()) != (1, 1)


@pytest.fixture(params=("px4", "ardupilot"))
def party(request):
    return Party(request.param)


def test_the_daemon_s_signals_and_heartbeat_reach_a_ground_station_on_another_link_unchanged(party):
    assert party.say("daemon", NAMED) == {"ground", "silent"}
    assert party.say("daemon", mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3)) == {"ground", "silent"}


def test_what_is_for_a_component_goes_only_where_it_was_heard(party):
    listing = mavlink.MAVLink_param_request_list_message(1, 191)
    assert party.say("ground", listing) == {"daemon"}
    assert party.say("daemon", mavlink.MAVLink_command_ack_message(92, 0, 0, 0, 255, 190)) == {"ground"}
    assert party.say("ground", mavlink.MAVLink_param_request_list_message(7, 1)) == set()


def test_a_request_to_all_components_is_answered_by_the_autopilot_and_passed_on(party):
    assert party.say("ground", mavlink.MAVLink_param_request_list_message(1, 0)) == {"daemon"}
    assert party.vehicle.server.peers["ground"].parameter_queue


def test_what_is_for_the_autopilot_alone_stays_with_it(party):
    setpoint = mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 128, [1, 0, 0, 0], 0, 0, 0, 0.4)
    assert party.say("daemon", setpoint) == set()
    command = mavlink.MAVLink_command_long_message(
        1, 1, mavlink.MAV_CMD_REQUEST_MESSAGE, 0, 0, 0, 0, 0, 0, 0, 0
    )
    assert party.say("ground", command) == set()


def test_an_echo_of_the_autopilot_itself_is_not_passed_on(party):
    party.codecs["ground"] = codec(1, 1, None)
    assert party.say("ground", NAMED) == set()


def test_a_signed_frame_is_passed_on_with_its_signature():
    assert Party("px4", Signing(b"k" * 32, clock=lambda: 0)).say("daemon", NAMED) == {"ground", "silent"}
