"""MAVLink 2 message signing: signatures made and checked, frame by frame; time comes with the call.

As https://mavlink.io/en/guide/message_signing.html says; PX4, ArduPilot and pymavlink do so on the wire.
pymavlink's own check is not used: it remembers the time of a frame before it has checked the frame, so
that one forged frame shuts the true sender out; its table of senders grows with forged ones; its time stands
still between frames; and messages that it does not know pass unchecked.
"""

from __future__ import annotations

import hashlib
import hmac
from enum import Enum

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.frame_codec import checksum
from kffa_offboard.mavlink.signing_key import SigningKey

EPOCH_US = 1_420_070_400_000_000
"""2015-01-01 UTC, from where timestamps count, in UNIX time."""

UNITS_PER_SECOND = 100_000
"""A timestamp counts 10 us."""

NEW_SENDER_WINDOW = 60 * UNITS_PER_SECOND
"""The first frame of a sender may be this much older than our own time."""

SIGNATURE_SIZE = 13
"""Link id, 6 bytes of timestamp, 6 bytes of signature."""

_LARGEST = (1 << 48) - 1

LATEST = _LARGEST - 365 * 86_400 * UNITS_PER_SECOND
"""In 2103, a year before timestamps end: whoever goes on from a later one has soon none left."""

_MARKER_V1, _MARKER_V2 = 0xFE, 0xFD
_OVERHEAD_V1, _OVERHEAD_V2 = 8, 12
_HASH_SIZE = 6


class Verdict(Enum):
    """What is to be thought of a frame."""

    GENUINE = "genuine"
    UNSIGNED = "not signed"
    FORGED = "wrong signature"
    REPLAYED = "older than its sender's last"
    OUTDATED = "more than a minute old"
    ENDLESS = "timestamp of the year 2103"


def timestamp_at(time_us: int) -> int:
    """Timestamp of a UNIX time, us; 0 before 2015."""
    return min(max((time_us - EPOCH_US) // 10, 0), _LARGEST)


def frame_size(head: bytes | bytearray) -> int | None:
    """Length of the frame that begins with these 3 bytes; None if none can."""
    marker, payload_size, flags = head
    if marker == _MARKER_V1:
        return _OVERHEAD_V1 + int(payload_size)
    if marker != _MARKER_V2 or flags & ~mavlink.MAVLINK_IFLAG_SIGNED:
        return None
    return _OVERHEAD_V2 + int(payload_size) + (SIGNATURE_SIZE if flags else 0)


def message_id(frame: bytes) -> int:
    """Number of a frame's message type."""
    return frame[5] if frame[0] == _MARKER_V1 else int.from_bytes(frame[7:10], "little")


def sender(frame: bytes) -> tuple[int, int]:
    """System and component that a frame says it comes from."""
    return (frame[3], frame[4]) if frame[0] == _MARKER_V1 else (frame[5], frame[6])


def checksum_fits(frame: bytes) -> bool:
    """True if a whole frame arrived undamaged; of an unknown message type that cannot be told."""
    known = mavlink.mavlink_map.get(message_id(frame))
    if known is None:
        return False
    signed = frame[0] == _MARKER_V2 and bool(frame[2])
    end = len(frame) - 2 - (SIGNATURE_SIZE if signed else 0)
    return checksum(frame[1:end], bytes((known.crc_extra,))) == frame[end : end + 2]


class Signer:
    """The signatures of one link.

    Times are UNIX microseconds. Our own timestamp follows the clock, never goes back, and keeps up with
    genuine frames that are ahead of it, so that a computer with a late clock is understood as soon as it
    has heard somebody.

    Attributes
    ----------
    timestamp : the newest one made or accepted
    """

    def __init__(self, key: SigningKey, link_id: int = 0, timestamp: int = 0) -> None:
        self._key = key
        self._link_id = bytes((link_id,))
        self._newest: dict[tuple[int, int, int], int] = {}
        self.timestamp = timestamp

    def beside(self) -> Signer:
        """The same key on another link: neither one's timestamps make the other's look old."""
        return Signer(self._key, (self._link_id[0] + 128) % 256, self.timestamp)

    def sign(self, frame: bytes, time_us: int) -> bytes:
        """The frame with a signature. It must be a whole unsigned MAVLink 2 frame of a known message."""
        self.timestamp = min(max(timestamp_at(time_us), self.timestamp + 1), _LARGEST)
        head = frame[1:2] + bytes((frame[2] | mavlink.MAVLINK_IFLAG_SIGNED,)) + frame[3:-2]
        crc_extra = bytes((mavlink.mavlink_map[message_id(frame)].crc_extra,))
        signed = frame[:1] + head + checksum(head, crc_extra) + self._link_id
        signed += self.timestamp.to_bytes(6, "little")
        signed += self._signature(signed)
        self._newest[_stream(signed)] = self.timestamp  # what comes back of ours later is a recording
        return signed

    def check(self, frame: bytes, time_us: int) -> Verdict:
        """Judge a whole frame; one that is genuine is so only once."""
        if frame[0] != _MARKER_V2 or not frame[2] & mavlink.MAVLINK_IFLAG_SIGNED:
            return Verdict.UNSIGNED
        if not hmac.compare_digest(self._signature(frame[:-_HASH_SIZE]), frame[-_HASH_SIZE:]):
            return Verdict.FORGED
        timestamp, stream = _timestamp(frame), _stream(frame)
        if timestamp > LATEST:
            return Verdict.ENDLESS
        now = max(timestamp_at(time_us), self.timestamp)
        if stream not in self._newest and timestamp + NEW_SENDER_WINDOW < now:
            return Verdict.OUTDATED
        if self.knows_newer(frame):
            return Verdict.REPLAYED
        self._newest[stream] = timestamp
        self.timestamp = max(self.timestamp, timestamp)
        return Verdict.GENUINE

    def knows_newer(self, frame: bytes) -> bool:
        """True if a signed frame is not newer than the last one of its sender and link id."""
        newest = self._newest.get(_stream(frame))
        return newest is not None and _timestamp(frame) <= newest

    def _signature(self, covered: bytes) -> bytes:
        return hashlib.sha256(self._key.reveal() + covered).digest()[:_HASH_SIZE]


def _timestamp(frame: bytes) -> int:
    return int.from_bytes(frame[-12:-6], "little")


def _stream(frame: bytes) -> tuple[int, int, int]:
    """Link id, system and component of a signed frame: what has a time of its own."""
    return frame[-SIGNATURE_SIZE], frame[5], frame[6]


def without_signature(frame: bytes) -> bytes | None:
    """A signed frame as it would be without: nobody who asks for signatures takes it again.

    None for an unknown message type, whose checksum cannot be made.
    """
    known = mavlink.mavlink_map.get(message_id(frame))
    if known is None:
        return None
    head = frame[1:2] + b"\0" + frame[3 : -SIGNATURE_SIZE - 2]
    return frame[:1] + head + checksum(head, bytes((known.crc_extra,)))
