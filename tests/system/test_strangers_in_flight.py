"""What others say on the network while the daemon flies: what is not for it or senseless changes nothing."""

from math import inf, nan

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.offboard.events import AttitudeTarget, SetArmed, SetGripper, SetMode

BEGIN_US, END_US = 4_000_000, 7_000_000
PERIOD_US = 100_000

GROUND, OTHER = (255, 190), (254, 190)
US = (245, 191)


def heartbeat(kind=2, autopilot=12, armed=False, custom_mode=3 << 16):
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, 129 if armed else 1, custom_mode, 4, 3)


def command(number, *parameters, to=US, again=0):
    padded = (*parameters, *[0.0] * (7 - len(parameters)))
    return mavlink.MAVLink_command_long_message(*to, number, again, *padded)


def command_int(number, first, frame, place=(0, 0, 0.0)):
    return mavlink.MAVLink_command_int_message(*US, frame, number, 0, 0, first, 0, 0, 0, *place)


HEARTBEATS = [
    ((1, 154), heartbeat(26, 8)),  # a gimbal of the vehicle
    ((1, 100), heartbeat()),  # another component that says it is a disarmed PX4
    ((2, 1), heartbeat()),
    ((1, 1), heartbeat(kind=1)),  # a plane with the vehicle's ids
    ((1, 1), heartbeat(autopilot=3)),
    ((1, 1), heartbeat(autopilot=8)),
    (US, heartbeat(18, 8)),
    ((245, 1), heartbeat()),
    ((0, 0), heartbeat()),
    *(((system, 190), heartbeat(6, 8)) for system in range(200, 255)),
]
ODD_COMMANDS = [
    (OTHER, command(number, value, value, to=to))
    for number in (92, 211, 245, 176, 400)
    for value in (0.0, 1.0)
    for to in ((0, 0), (245, 0), (0, 191), (245, 1), (1, 191))
]
SENSELESS = [
    (OTHER, command(number, value, value, again=again))
    for number in (92, 211, 245)
    for value in (nan, inf, -1.0, 0.5)
    for again in (0, 3)
] + [
    (OTHER, command_int(92, nan, 255, (2**31 - 1, -(2**31), nan))),
    (OTHER, command_int(211, 0.5, 200)),
]
UNKNOWN = [(GROUND, command(number, 1.0, 21196.0)) for number in (176, 185, 246, 400, 42_650)]
PARAMETERS = [
    (GROUND, mavlink.MAVLink_param_request_list_message(*US)),
    (OTHER, mavlink.MAVLink_param_request_list_message(245, 0)),
    (OTHER, mavlink.MAVLink_param_request_read_message(*US, b"", 30_000)),
    (GROUND, mavlink.MAVLink_param_set_message(*US, b"ALT_OMEGA_C", nan, 9)),
    (GROUND, mavlink.MAVLink_param_set_message(*US, b"ALT_OMEGA_C", 9.0, 6)),
    (GROUND, mavlink.MAVLink_param_set_message(0, 0, b"ALT_OMEGA_C", 9.0, 9)),
    (GROUND, mavlink.MAVLink_param_set_message(*US, b"NO_SUCH", 9.0, 9)),
    (GROUND, mavlink.MAVLink_param_ext_set_message(*US, b"ALT_OMEGA_C", b"9", 9)),
    (GROUND, mavlink.MAVLink_param_ext_request_list_message(*US)),
]
OF_OTHERS = [
    ((2, 1), mavlink.MAVLink_attitude_message(1, 1, 1, 1, 1, 1, 1)),
    ((1, 2), mavlink.MAVLink_attitude_message(1, 1, 1, 1, 1, 1, 1)),
    ((1, 191), mavlink.MAVLink_local_position_ned_message(1, 99, 0, 99, 0, 0, 0)),
    ((2, 1), mavlink.MAVLink_extended_sys_state_message(0, 1)),
    (GROUND, mavlink.MAVLink_command_ack_message(400, 4, 0, 0, *US)),
    (GROUND, mavlink.MAVLink_timesync_message(5, 10**15)),
    (GROUND, mavlink.MAVLink_setup_signing_message(*US, [7] * 32, 1)),
    (GROUND, mavlink.MAVLink_set_attitude_target_message(0, *US, 71, [nan] * 4, 0, 0, 0, 0)),
]
STRANGERS = [*HEARTBEATS, *ODD_COMMANDS, *SENSELESS, *UNKNOWN, *PARAMETERS, *OF_OTHERS]


def flown(flight, strangers=()):
    packers = {}

    def before_slot():
        if flight.vehicle.time_us >= BEGIN_US and flight.vehicle.time_us % PERIOD_US == 0:
            for ids, message in strangers:
                packer = packers.setdefault(ids, mavlink.MAVLink(None, *ids))
                flight.link.from_ground.append(bytes(message.pack(packer)))
                packer.seq = (packer.seq + 1) % 256

    flight.before_slot = before_slot
    flight.fly(lambda vehicle: vehicle.time_us >= END_US)
    wanted = AttitudeTarget | SetMode | SetArmed | SetGripper
    return [(time_us, item) for time_us, item in flight.heard if isinstance(item, wanted)]


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_a_flight_among_strangers_is_the_quiet_one_to_the_last_bit(lock_step_flight, personality):
    kind = 12 if personality == "px4" else 3
    strangers = [
        (ids, message)
        for ids, message in STRANGERS
        if (ids, getattr(message, "autopilot", None), getattr(message, "type", None)) != ((1, 1), kind, 2)
    ]
    quiet = flown(lock_step_flight(personality))
    among = lock_step_flight(personality)
    assert flown(among, strangers) == quiet
    assert sum(isinstance(item, AttitudeTarget) for _, item in quiet) > 200
    answers = [frame for frame in among.link.sent if frame[7] == mavlink.MAVLINK_MSG_ID_COMMAND_ACK]
    results = {mavlink.MAVLink(None).parse_buffer(frame)[0].result for frame in answers}
    assert results == {mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_UNSUPPORTED}
    assert {"two vehicles are 1/1", "somebody else is 245/191: a second daemon?"} & set(among.texts)
