"""MAVLink messages that mean the same from every firmware -> events.

Samples are passed on as they come, duplicates, reordered ones and NaN included: what they are worth
is the service's to judge.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink import frames
from kffa_offboard.mavlink.component import Message
from kffa_offboard.offboard.events import (
    AttitudeReceived,
    BatteryReported,
    EstimateReported,
    Event,
    LandedStateReported,
    PositionReceived,
    StatusReceived,
    TargetReported,
    ThrottleReported,
)

Decoder: TypeAlias = Callable[[Message], list[Event]]
"""Events of one message of a type."""

_BOOT_CLOCK_RANGE_MS = 2**32
_UNIT_NORM_TOLERANCE = 0.01
_TEXT_SIZE = 50
_IGNORE_RATES = (
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
    | mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
    | mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE
)
_SOME_HEIGHT = mavlink.ESTIMATOR_POS_VERT_ABS | mavlink.ESTIMATOR_POS_VERT_AGL
_SOME_PLACE = mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS


class BootClock:
    """The autopilot's `time_boot_ms`, which starts again from 0 after 49.7 days, as steady microseconds."""

    def __init__(self) -> None:
        self._latest_ms: int | None = None

    def unwrap(self, time_boot_ms: int) -> int:
        """Microseconds since boot; the reading nearest to the one before, so a late sample stays late."""
        if self._latest_ms is None:
            self._latest_ms = time_boot_ms
        half = _BOOT_CLOCK_RANGE_MS // 2
        self._latest_ms += (time_boot_ms - self._latest_ms + half) % _BOOT_CLOCK_RANGE_MS - half
        return self._latest_ms * 1000


class TextAssembler:
    """Joins STATUSTEXT chunks (up to 50 characters each) into whole texts.

    A text that lost a chunk is given out with "..." in its place when the next text begins.
    """

    def __init__(self) -> None:
        self._id = 0
        self._severity = 0
        self._chunks: dict[int, str] = {}

    def add(self, message: Message) -> list[StatusReceived]:
        """Take one STATUSTEXT; return the texts that are complete with it."""
        finished: list[StatusReceived] = []
        if self._chunks and message.id != self._id:
            finished.append(self._take())
        if message.id == 0:
            finished.append(StatusReceived(message.severity, _printable(message.text)))
            return finished
        self._id, self._severity = message.id, message.severity
        self._chunks[message.chunk_seq] = message.text
        last = max(self._chunks)
        if len(self._chunks[last]) < _TEXT_SIZE and len(self._chunks) == last + 1:
            finished.append(self._take())
        return finished

    def _take(self) -> StatusReceived:
        parts = [self._chunks.get(number, "...") for number in range(max(self._chunks) + 1)]
        self._chunks.clear()
        return StatusReceived(self._severity, _printable("".join(parts)))


def _printable(text: str) -> str:
    """Keep control characters of a vehicle out of people's terminals."""
    return "".join(character if character.isprintable() else "?" for character in text)


class TelemetryDecoder:
    """Decodes what needs no knowledge of the firmware. One per vehicle: it remembers clock and chunks.

    Attributes
    ----------
    decoders : by the type of the message

    """

    def __init__(self) -> None:
        self._clock = BootClock()
        self._texts = TextAssembler()
        self.decoders: dict[str, Decoder] = {
            "ATTITUDE": self._attitude,
            "LOCAL_POSITION_NED": self._position,
            "ATTITUDE_TARGET": self._target,
            "VFR_HUD": throttle,
            "EXTENDED_SYS_STATE": landed_state,
            "SYS_STATUS": battery,
            "ESTIMATOR_STATUS": estimate,
            "EKF_STATUS_REPORT": estimate,
            "STATUSTEXT": self._status_text,
        }

    def decode(self, message: Message) -> list[Event]:
        """Events of one message; none for types that do not concern control."""
        decoder = self.decoders.get(message.msgname)
        return [] if decoder is None else decoder(message)

    def _status_text(self, message: Message) -> list[Event]:
        return list(self._texts.add(message))

    def _attitude(self, message: Message) -> list[Event]:
        return [
            AttitudeReceived(
                self._clock.unwrap(message.time_boot_ms),
                frames.euler_from_ned(message.roll, message.pitch, message.yaw),
                frames.body_rates_from_frd(message.rollspeed, message.pitchspeed, message.yawspeed),
            )
        ]

    def _position(self, message: Message) -> list[Event]:
        return [
            PositionReceived(
                self._clock.unwrap(message.time_boot_ms),
                frames.vector_from_ned(message.x, message.y, message.z),
                frames.vector_from_ned(message.vx, message.vy, message.vz),
            )
        ]

    def _target(self, message: Message) -> list[Event]:
        """Only what the type mask declares valid; a quaternion that is none (all zero) is left out too."""
        mask = message.type_mask
        w, x, y, z = message.q
        attitude = None
        not_a_rotation = abs(w * w + x * x + y * y + z * z - 1.0) > _UNIT_NORM_TOLERANCE
        if not mask & mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE and not not_a_rotation:
            attitude = frames.euler_from_quaternion(frames.quaternion_from_ned((w, x, y, z)))
        body_rates = None
        if not mask & _IGNORE_RATES:
            body_rates = frames.body_rates_from_frd(
                message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate
            )
        has_thrust = not mask & mavlink.ATTITUDE_TARGET_TYPEMASK_THROTTLE_IGNORE
        return [
            TargetReported(
                self._clock.unwrap(message.time_boot_ms),
                message.thrust if has_thrust else None,
                body_rates,
                attitude,
            )
        ]


def throttle(message: Message) -> list[Event]:
    """What the motors get."""
    return [ThrottleReported(message.throttle / 100.0)]


def battery(message: Message) -> list[Event]:
    """What is left in the battery; nothing if the autopilot does not know."""
    return [BatteryReported(float(message.battery_remaining))] if message.battery_remaining >= 0 else []


def estimate(message: Message) -> list[Event]:
    """Of PX4's ESTIMATOR_STATUS or ArduPilot's EKF_STATUS_REPORT, which have these flags in common.

    PX4 clears the horizontal ones when it has reckoned without satellites (or a camera) for EKF2_NOAID_TOUT.
    """
    flags = message.flags
    return [
        EstimateReported(
            attitude=bool(flags & mavlink.ESTIMATOR_ATTITUDE),
            height=bool(flags & mavlink.ESTIMATOR_VELOCITY_VERT and flags & _SOME_HEIGHT),
            position=bool(flags & mavlink.ESTIMATOR_VELOCITY_HORIZ and flags & _SOME_PLACE),
        )
    ]


def landed_state(message: Message) -> list[Event]:
    """On the ground or not; nothing if the autopilot does not know."""
    if message.landed_state == mavlink.MAV_LANDED_STATE_UNDEFINED:
        return []
    return [LandedStateReported(message.landed_state == mavlink.MAV_LANDED_STATE_ON_GROUND)]
