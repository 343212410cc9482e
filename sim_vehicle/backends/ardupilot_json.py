"""ArduPilot's JSON simulator interface on the wire: servo packets in, JSON answers out. No sockets.

Source: libraries/SITL/SIM_JSON.h and SIM_JSON.cpp of ArduPilot (firmware started with ``--model JSON``).
The firmware's parser is not a JSON parser: it wants a newline before and after the object, the named keys
without blanks after the colon, and booleans as numbers.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass

from sim_vehicle.backends.sensors import ImuSample, Pose

CHANNELS_OF_MAGIC = {18458: 16, 29569: 32}
"""Servo outputs in a packet by its first number; 32 with SERVO_32_ENABLE."""

HEAD = struct.Struct("<HHI")


@dataclass(frozen=True, slots=True)
class ServoPacket:
    """One frame's outputs.

    Attributes
    ----------
    frame_rate : steps per simulated second that the firmware wants [Hz]
    frame_count : answers that the firmware has taken; the same again if none came, from 0 after a restart
    pwm : pulse widths [us], 16 or 32; 0 for an output without pulses
    """

    frame_rate: int
    frame_count: int
    pwm: tuple[int, ...]


def parse_servo_packet(data: bytes) -> ServoPacket:
    """Take a datagram apart. Raises ValueError, for people, if it is not a servo packet."""
    if len(data) < HEAD.size:
        raise ValueError(f"{len(data)} bytes are too few for a servo packet of 40 or 72")
    magic, frame_rate, frame_count = HEAD.unpack_from(data)
    channels = CHANNELS_OF_MAGIC.get(magic)
    if channels is None:
        raise ValueError(f"magic {magic} is neither 18458 (16 channels) nor 29569 (32 channels)")
    expected = HEAD.size + 2 * channels
    if len(data) != expected:
        raise ValueError(f"{len(data)} bytes where {channels} channels take {expected}")
    return ServoPacket(frame_rate, frame_count, struct.unpack_from(f"<{channels}H", data, HEAD.size))


def encode_servo_packet(packet: ServoPacket) -> bytes:
    """Datagram of a packet of 16 or 32 channels: what the firmware sends."""
    magic = next(magic for magic, channels in CHANNELS_OF_MAGIC.items() if channels == len(packet.pwm))
    head = HEAD.pack(magic, packet.frame_rate, packet.frame_count)
    return head + struct.pack(f"<{len(packet.pwm)}H", *packet.pwm)


def encode_answer(timestamp_s: float, sample: ImuSample, pose: Pose, no_time_sync: bool) -> bytes:
    """Datagram that answers a servo packet.

    Parameters
    ----------
    timestamp_s : simulated time since the firmware's start; the firmware advances by the difference
    no_time_sync : the physics keeps to the clock and the firmware takes time as it comes

    Raises
    ------
    ValueError
        if a value is not finite
    """
    values: dict[str, object] = {
        "timestamp": round(timestamp_s, 6),
        "imu": {"gyro": sample.body_rates.tolist(), "accel_body": sample.specific_force.tolist()},
        "position": pose.position.tolist(),
        "velocity": pose.velocity.tolist(),
        "quaternion": pose.quaternion.tolist(),
        "no_time_sync": int(no_time_sync),
    }
    return f"\n{json.dumps(values, separators=(',', ':'), allow_nan=False)}\n".encode("ascii")
