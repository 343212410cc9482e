"""What QGroundControl 4 asks a vehicle at connect, and what it makes of the answers.

Recorded from one built from its master of May 2023 (after 4.2), and read in its source: what it asks at
connect, which parameters connection and setup pages look at (a missing one opens a window), what its
buttons send.
"""

import struct

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

ACCEPTED = mavlink.MAV_RESULT_ACCEPTED
OPEN_FILE, NAK, NO_SUCH_FILE = 4, 129, 10
PX4_LOOKS_AT = """
    SYS_AUTOSTART SYS_AUTOCONFIG MAV_SYS_ID CAL_GYRO0_ID CAL_ACC0_ID CAL_MAG0_ID CAL_MAG1_ID CAL_MAG2_ID
    SYS_HAS_MAG COM_RC_IN_MODE RC_MAP_ROLL RC_MAP_PITCH RC_MAP_YAW RC_MAP_THROTTLE RC_MAP_FLTMODE
    RC_MAP_FLAPS RC_MAP_AUX1 RC_MAP_AUX2 COM_FLTMODE1 COM_FLTMODE2 COM_FLTMODE3 COM_FLTMODE4
    COM_FLTMODE5 COM_FLTMODE6 BAT1_N_CELLS BAT1_V_CHARGED BAT1_V_EMPTY COM_LOW_BAT_ACT COM_RC_LOSS_T
    NAV_RCL_ACT NAV_DLL_ACT RTL_RETURN_ALT RTL_DESCEND_ALT RTL_LAND_DELAY MIS_TAKEOFF_ALT SYS_HITL
"""
COPTER_LOOKS_AT = """
    FRAME_CLASS FRAME_TYPE RCMAP_ROLL RCMAP_PITCH RCMAP_YAW RCMAP_THROTTLE RC1_MIN RC1_MAX RC1_TRIM
    RC2_MIN RC2_MAX RC2_TRIM RC3_MIN RC3_MAX RC3_TRIM RC4_MIN RC4_MAX RC4_TRIM COMPASS_DEV_ID
    COMPASS_DEV_ID2 COMPASS_DEV_ID3 COMPASS_USE COMPASS_USE2 COMPASS_USE3 COMPASS_OFS_X
    COMPASS_OFS_Y COMPASS_OFS_Z COMPASS_OFS2_X COMPASS_OFS2_Y COMPASS_OFS2_Z COMPASS_OFS3_X
    COMPASS_OFS3_Y COMPASS_OFS3_Z COMPASS_DEC INS_ACCOFFS_X INS_ACCOFFS_Y INS_ACCOFFS_Z
    FLTMODE1 FLTMODE2 FLTMODE3
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


@pytest.mark.parametrize("message_id", [395, 397])  # COMPONENT_INFORMATION, COMPONENT_METADATA
def test_what_a_vehicle_does_not_have_is_refused_at_once(px4, copter, message_id):
    for pilot in (px4, copter):
        refused = pilot.ask(mavlink.MAV_CMD_REQUEST_MESSAGE, message_id)
        assert refused in (mavlink.MAV_RESULT_DENIED, mavlink.MAV_RESULT_FAILED)


# --------------------------------------------------------------------------- buttons of the Fly view

NAN = float("nan")
STILL_S = 1.3
"""So long it waits for a HEARTBEAT with the mode that it asked for, three times."""


def height_above_sea(pilot):
    return pilot.messages("GLOBAL_POSITION_INT")[-1].alt * 1e-3


def taken_off(px4, height):
    """The Takeoff button for a PX4: the command first, arming once it was accepted."""
    px4.run(1.0)
    above_sea = height_above_sea(px4) + height
    assert px4.ask(mavlink.MAV_CMD_NAV_TAKEOFF, -1, 0, 0, NAN, NAN, NAN, above_sea) == ACCEPTED
    assert px4.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    px4.run(10.0)
    assert (px4.height, px4.mode) == (pytest.approx(height, abs=0.2), "HOLD")


def test_takeoff_of_a_px4_is_commanded_before_it_is_armed(px4):
    taken_off(px4, 5.0)


def test_takeoff_of_an_arducopter_follows_its_armed_heartbeat_within_a_second(copter):
    copter.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    copter.run(STILL_S)
    assert copter.messages("HEARTBEAT")[-1].custom_mode == 4
    assert copter.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == ACCEPTED
    copter.run(1.0)
    assert copter.messages("HEARTBEAT")[-1].base_mode & mavlink.MAV_MODE_FLAG_SAFETY_ARMED
    assert copter.ask(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0) == ACCEPTED
    copter.run(12.0)
    assert copter.height == pytest.approx(5.0, abs=0.2)


def test_pause_change_of_height_and_go_there_are_one_command_of_a_px4(px4):
    taken_off(px4, 5.0)
    change_mode = mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE
    reposition = mavlink.MAV_CMD_DO_REPOSITION
    assert px4.ask(reposition, -1, change_mode, 0, NAN, NAN, NAN, NAN) == ACCEPTED
    px4.run(STILL_S)
    assert px4.height == pytest.approx(5.0, abs=0.2)
    home = px4.messages("HOME_POSITION")[-1].altitude * 1e-3
    assert px4.ask(reposition, -1, change_mode, 0, NAN, NAN, NAN, home + 8.0) == ACCEPTED
    px4.run(6.0)
    assert px4.height == pytest.approx(8.0, abs=0.2)
    here = px4.messages("GLOBAL_POSITION_INT")[-1]
    px4.send(
        mavlink.MAVLink_command_int_message(
            1,
            1,
            mavlink.MAV_FRAME_GLOBAL,
            reposition,
            0,
            0,
            -1,
            change_mode,
            0,
            NAN,
            here.lat + 900,
            here.lon,
            home + 8.0,
        )
    )
    px4.run(12.0)
    there = px4.messages("GLOBAL_POSITION_INT")[-1]
    assert (there.lat - here.lat, there.lon - here.lon) == (
        pytest.approx(900, abs=40),
        pytest.approx(0, abs=40),
    )
    assert px4.vehicle.state.rigid[0] == pytest.approx(10.0, abs=0.5)
    assert px4.height == pytest.approx(8.0, abs=0.2)


def test_an_arducopter_that_cannot_go_there_says_so(copter):
    copter.take_off(5.0)
    go = mavlink.MAV_CMD_DO_REPOSITION
    assert copter.ask(go, -1, 1, 0, NAN, 47.4, 8.5, 500.0) == mavlink.MAV_RESULT_UNSUPPORTED
