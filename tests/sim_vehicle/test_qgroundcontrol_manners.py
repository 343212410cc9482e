"""What QGroundControl 4 asks a vehicle at connect, and what it makes of the answers.

Read in its source (master of May 2023): the state machine of the first connection, the parameter manager, the
setup pages. What it does not find there it complains about in a window.
"""

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
OPEN_FILE, NAK, NO_SUCH_FILE = 4, 129, 10
PX4_LOOKS_AT = """
    SYS_AUTOSTART MAV_SYS_ID CAL_GYRO0_ID CAL_ACC0_ID CAL_MAG0_ID CAL_MAG1_ID CAL_MAG2_ID
    SYS_HAS_MAG COM_RC_IN_MODE RC_MAP_ROLL RC_MAP_PITCH RC_MAP_YAW RC_MAP_THROTTLE RC_MAP_FLTMODE
    RC_MAP_FLAPS RC_MAP_AUX1 RC_MAP_AUX2 COM_FLTMODE1 COM_FLTMODE2 COM_FLTMODE3 COM_FLTMODE4
    COM_FLTMODE5 COM_FLTMODE6 BAT1_N_CELLS BAT1_V_CHARGED BAT1_V_EMPTY COM_LOW_BAT_ACT COM_RC_LOSS_T
    NAV_RCL_ACT NAV_DLL_ACT RTL_RETURN_ALT RTL_DESCEND_ALT RTL_LAND_DELAY MIS_TAKEOFF_ALT SYS_HITL
"""
COPTER_LOOKS_AT = """
    FRAME_CLASS FRAME_TYPE RCMAP_ROLL RCMAP_PITCH RCMAP_YAW RCMAP_THROTTLE RC1_MIN RC1_MAX RC1_TRIM
    RC2_MIN RC2_MAX RC2_TRIM RC3_MIN RC3_MAX RC3_TRIM RC4_MIN RC4_MAX RC4_TRIM COMPASS_DEV_ID
    COMPASS_DEV_ID2 COMPASS_DEV_ID3 COMPASS_USE COMPASS_USE2 COMPASS_USE3 COMPASS_OFS_X
    COMPASS_OFS_Y COMPASS_OFS_Z INS_ACCOFFS_X INS_ACCOFFS_Y INS_ACCOFFS_Z FLTMODE1 FLTMODE2 FLTMODE3
    FLTMODE4 FLTMODE5 FLTMODE6 ARMING_CHECK BATT_MONITOR FENCE_ENABLE FENCE_TYPE FENCE_ACTION
    FS_GCS_ENABLE FS_THR_ENABLE FS_THR_VALUE FS_CRASH_CHECK FS_EKF_ACTION FS_EKF_THRESH RTL_ALT
"""


def crc32_of(data, state=0):
    """CRC-32 bit by bit, without the inversions at both ends."""
    for byte in data:
        state ^= byte
        for _ in range(8):
            state = state >> 1 ^ (0xEDB88320 if state & 1 else 0)
    return state


def parameters_of(pilot):
    """Bytes on the wire of every parameter, by name."""
    pilot.send(mavlink.MAVLink_param_request_list_message(1, 0))
    pilot.run(1.5)
    return {m.param_id: struct.pack("<f", m.param_value) for m in pilot.messages("PARAM_VALUE")}


@pytest.mark.parametrize(("name", "looks_at"), [("px4", PX4_LOOKS_AT), ("copter", COPTER_LOOKS_AT)])
def test_no_parameter_that_it_looks_at_is_missing(name, looks_at, request):
    assert not set(looks_at.split()) - set(parameters_of(request.getfixturevalue(name)))


def test_nothing_is_left_to_be_set_up_on_a_px4(px4):
    values = px4.vehicle.firmware.parameters
    for name in (
        "SYS_AUTOSTART",
        "CAL_GYRO0_ID",
        "CAL_ACC0_ID",
        "CAL_MAG0_ID",
        "RC_MAP_FLTMODE",
        "BAT1_N_CELLS",
    ):
        assert values[name] != 0
    for stick in ("ROLL", "PITCH", "YAW", "THROTTLE"):
        assert values[f"RC_MAP_{stick}"] != 0


def test_nothing_is_left_to_be_set_up_on_an_arducopter(copter):
    values = copter.vehicle.firmware.parameters
    for axis in "XYZ":
        assert values[f"COMPASS_OFS_{axis}"] != 0
        assert values[f"INS_ACCOFFS_{axis}"] != 0
    for stick in ("ROLL", "PITCH", "YAW", "THROTTLE"):
        assert values[f"RC{values[f'RCMAP_{stick}']:.0f}_MIN"] not in (0, 1100)  # 1100: never calibrated


def test_px4s_checksum_is_that_of_the_parameters_in_its_cache(px4):
    found = parameters_of(px4)
    reported = struct.unpack("<I", found.pop("_HASH_CHECK"))[0]
    state = 0
    for name, value in sorted(found.items()):
        state = crc32_of(name.encode() + value, state)
    assert reported == state


def test_px4_stops_its_list_when_told_that_the_cache_has_them(px4):
    px4.send(mavlink.MAVLink_param_request_list_message(1, 0))
    px4.run(0.05)
    px4.send(mavlink.MAVLink_param_set_message(1, 1, b"_HASH_CHECK", 0.0, mavlink.MAV_PARAM_TYPE_UINT32))
    px4.run(0.05)
    sent = len(px4.messages("PARAM_VALUE"))
    px4.run(1.0)
    assert 0 < sent == len(px4.messages("PARAM_VALUE")) < len(px4.vehicle.firmware.parameters.names)
    assert not px4.texts()


def test_of_an_arducopter_it_wants_a_file_of_parameters_first_and_lists_them_at_once_if_there_is_none(copter):
    payload = bytearray(251)
    payload[0:6] = (5, 0, 0, OPEN_FILE, len(path := b"@PARAM/param.pck"), 0)
    payload[12 : 12 + len(path)] = path
    copter.send(mavlink.MAVLink_file_transfer_protocol_message(0, 1, 1, payload))
    copter.run(0.05)
    (answer,) = copter.messages("FILE_TRANSFER_PROTOCOL")
    assert bytes(answer.payload)[0:6] == bytes((6, 0, 0, NAK, 1, OPEN_FILE))
    assert answer.payload[12] == NO_SUCH_FILE
