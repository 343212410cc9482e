"""Autopilot parameters on the wire: the float field of PARAM_VALUE and PARAM_SET, and requests by name.

One float carries every type. PX4 puts the bytes of an integer there (AUTOPILOT_VERSION capability
PARAM_ENCODE_BYTEWISE), ArduPilot the number itself (PARAM_ENCODE_C_CAST).
"""

from __future__ import annotations

import math
import struct
from typing import Literal, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink import commands
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.offboard.events import Firmware

Encoding: TypeAlias = Literal["bytewise", "c-cast"]

_INTEGERS = {
    mavlink.MAV_PARAM_TYPE_UINT8: "<Bxxx",
    mavlink.MAV_PARAM_TYPE_INT8: "<bxxx",
    mavlink.MAV_PARAM_TYPE_UINT16: "<Hxx",
    mavlink.MAV_PARAM_TYPE_INT16: "<hxx",
    mavlink.MAV_PARAM_TYPE_UINT32: "<I",
    mavlink.MAV_PARAM_TYPE_INT32: "<i",
}


def encoding_of(firmware: Firmware, capabilities: int | None) -> Encoding:
    """What AUTOPILOT_VERSION.capabilities say; the firmware's custom where they are silent or unknown."""
    if capabilities is not None and capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE:
        return "bytewise"
    if capabilities is not None and capabilities & mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_C_CAST:
        return "c-cast"
    return "bytewise" if firmware == "px4" else "c-cast"


def decode_value(field: float, kind: int, encoding: Encoding) -> float:
    """Number that a PARAM_VALUE of MAV_PARAM_TYPE `kind` means."""
    layout = _INTEGERS.get(kind)
    if encoding == "c-cast" or layout is None:
        return field
    return float(struct.unpack(layout, struct.pack("<f", field))[0])


def encode_value(value: float, kind: int, encoding: Encoding) -> float:
    """The float field of PARAM_SET for a parameter of MAV_PARAM_TYPE `kind`.

    Raises ValueError if `value` is not finite or does not fit an integer parameter.
    """
    layout = _INTEGERS.get(kind)
    if not math.isfinite(value):
        raise ValueError(f"{value} is not a finite number")
    if layout is None:
        return value
    if value != int(value):
        raise ValueError(f"{value:g} is not a whole number, which this parameter takes")
    try:
        packed = struct.pack(layout, int(value))
    except struct.error as error:
        raise ValueError(f"{value:g} does not fit this parameter") from error
    return value if encoding == "c-cast" else float(struct.unpack("<f", packed)[0])


def same_value(one: float, other: float) -> bool:
    """Equal as far as the 32-bit float of the wire can tell."""
    return math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-9)


def name_of(message: Message) -> str:
    """Parameter name in a PARAM_VALUE or PARAM_ERROR."""
    return str(message.param_id).rstrip("\x00")


def read_request(route: Route, name: str) -> Message:
    """Ask for one parameter by name. A firmware that has none of that name does not answer."""
    return mavlink.MAVLink_param_request_read_message(
        route.target_system, route.target_component, name.encode(), -1
    )


def set_request(route: Route, name: str, field: float, kind: int) -> Message:
    """PARAM_SET; the autopilot answers with the value that it then has."""
    return mavlink.MAVLink_param_set_message(
        route.target_system, route.target_component, name.encode(), field, kind
    )


def version_request(route: Route) -> Message:
    """Ask for AUTOPILOT_VERSION."""
    return commands.command_long(
        route, mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    )
