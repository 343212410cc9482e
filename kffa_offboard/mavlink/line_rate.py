"""Does a serial line carry what a flight needs? What is too much waits in a queue, and control with it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.frame_codec import OVERHEAD
from kffa_offboard.mavlink.address import LinkAddress, SerialAddress
from kffa_offboard.mavlink.signal_streams import CHANNEL_NAMES, SIGNAL_NAMES
from kffa_offboard.offboard.settings import TelemetrySettings

BITS_OF_A_BYTE = 10
"""With start and stop bit."""

MOST_SHARE = 0.85
"""Of a line; what comes in bursts must not wait long, and there are parameters and texts."""

RATES = (57600, 115200, 230400, 460800, 921600, 1500000, 3000000)
"""What autopilots offer, bit/s."""

_SIGNATURE = 13
_NAMED_VALUES = len(CHANNEL_NAMES) * len(SIGNAL_NAMES) + 1
_RATE_IS_IGNORED = ("ttyACM", "cu.usbmodem", "tty.usbmodem")  # an autopilot's own USB port


class LineLoad(NamedTuple):
    """Bytes a second from the vehicle and to it."""

    received: float
    sent: float


def line_load(telemetry: TelemetrySettings, signals_hz: float, *, signed: bool) -> LineLoad:
    """What is asked for and sent in flight, each frame at its longest."""
    extra = OVERHEAD + (_SIGNATURE if signed else 0)

    def rate(hz: float, *kinds: type[mavlink.MAVLink_message]) -> float:
        return float(hz * sum(kind.unpacker.size + extra for kind in kinds))

    received = (
        rate(telemetry.attitude_hz, mavlink.MAVLink_attitude_message)
        + rate(telemetry.position_hz, mavlink.MAVLink_local_position_ned_message)
        + rate(telemetry.target_hz, mavlink.MAVLink_attitude_target_message)
        + rate(telemetry.status_hz, mavlink.MAVLink_vfr_hud_message)
        + rate(telemetry.status_hz, mavlink.MAVLink_extended_sys_state_message)
        + rate(telemetry.status_hz, mavlink.MAVLink_estimator_status_message)
        + rate(telemetry.heartbeat_hz, mavlink.MAVLink_heartbeat_message)
    )
    named = [mavlink.MAVLink_named_value_float_message] * _NAMED_VALUES
    signals = rate(signals_hz, mavlink.MAVLink_debug_float_array_message, *named)
    return LineLoad(
        received, rate(telemetry.attitude_hz, mavlink.MAVLink_set_attitude_target_message) + signals
    )


def too_slow(
    address: LinkAddress, telemetry: TelemetrySettings, signals_hz: float, *, signed: bool
) -> str | None:
    """Why a serial line is too slow for a flight, with a rate that will do; None if it is not.

    An autopilot's own USB port ignores the rate.
    """
    if not isinstance(address, SerialAddress):
        return None
    if Path(address.device).resolve().name.startswith(_RATE_IS_IGNORED):
        return None
    load = line_load(telemetry, signals_hz, signed=signed)
    if _needed(load) <= address.baud:
        return None
    remedy = f"use {next((rate for rate in RATES if rate >= _needed(load)), RATES[-1])} baud"
    if _needed(line_load(telemetry, 0.0, signed=signed)) <= address.baud:
        remedy += " or a lower signals.rate_hz"
    return (
        f"{address.url} carries {address.baud / BITS_OF_A_BYTE / 1e3:.1f} kB/s, and the flight takes "
        f"{load.received / 1e3:.1f} from the vehicle and {load.sent / 1e3:.1f} to it: what is too much "
        f"delays control; {remedy}"
    )


def _needed(load: LineLoad) -> float:
    """Rate of a line that carries it, bit/s."""
    return max(load) / MOST_SHARE * BITS_OF_A_BYTE
