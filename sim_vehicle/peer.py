"""One MAVLink peer of the simulated vehicle: its parser, its sequence numbers, its streams, its transfers."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Mapping
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle import stream_rates
from sim_vehicle.signing import SignedMavlink, Signing
from sim_vehicle.telemetry import Message

MAX_DATAGRAM = 1200
"""Frames of one instant share datagrams of at most this many bytes."""

BARRIER_LINK_ID = 255
"""Link id in the signatures of lock-step's TIMESYNC requests; those of peers are below."""

COMPONENT_ID = 1
"""MAV_COMP_ID_AUTOPILOT1."""


def _is_one_frame(data: bytes) -> bool:
    """As most datagrams are: one frame of MAVLink 2, not signed."""
    unsigned = len(data) > 2 and data[0] == mavlink.PROTOCOL_MARKER_V2 and data[2] == 0
    return unsigned and len(data) == data[1] + 12


class Stream:
    """One message at a steady rate. Times and intervals in us of simulated time."""

    __slots__ = ("interval_us", "next_us")

    def __init__(self, interval_us: int, now_us: int) -> None:
        self.interval_us = interval_us
        self.next_us = (now_us // interval_us + 1) * interval_us

    def due(self, now_us: int, slowdown: int) -> bool:
        """Is it time? If so the next time is set, on the average exactly one interval later."""
        if now_us < self.next_us:
            return False
        interval = self.interval_us * slowdown
        self.next_us += interval * max(1, (now_us - self.next_us) // interval)
        return True


class Peer:
    """State of the conversation with one peer."""

    def __init__(
        self,
        key: Hashable | None,
        system_id: int,
        defaults: Mapping[int, float],
        now_us: int,
        signing: Signing | None = None,
        link_id: int = 0,
    ) -> None:
        self.key = key
        self.defaults = defaults
        self.codec: Any = mavlink.MAVLink(file=None, srcSystem=system_id, srcComponent=COMPONENT_ID)
        if signing is not None:
            self.codec = SignedMavlink(system_id, COMPONENT_ID, signing, link_id)
        self._signed = signing is not None
        self.codec.robust_parsing = True
        self.streams: dict[int, Stream] = {}
        self.parameter_queue: deque[str] = deque()
        self.upload: list[Message | None] = []
        self.upload_type = 0
        self.heard: set[tuple[int, int]] = set()
        self._next_us = 0
        self._frames: list[bytes] = []
        for message_id, rate in defaults.items():
            self.set_interval(message_id, stream_rates.interval_of(rate), now_us)

    def parse(self, data: bytes) -> list[Message]:
        """Whole messages in `data` and what was left from before; garbage is skipped, and what is refused."""
        if self._signed:
            self.codec.keep_time()
        elif _is_one_frame(data) and self.codec.buf_len() == 0:
            return self._decode(data)
        messages = self.codec.parse_buffer(data) or []
        return [message for message in messages if message.get_type() != "BAD_DATA"]

    def _decode(self, frame: bytes) -> list[Message]:
        """What `parse_buffer` makes of a whole frame, without looking for where it begins and ends."""
        try:
            return [self.codec.decode(bytearray(frame))]
        except mavlink.MAVError:
            return []

    def set_interval(self, message_id: int, interval_us: int, now_us: int) -> None:
        """Send a message every `interval_us` from now on; 0 or less stops it."""
        if interval_us <= 0:
            self.streams.pop(message_id, None)
        else:
            self.streams[message_id] = Stream(interval_us, now_us)
        self._next_us = 0

    def restore_default(self, message_id: int, now_us: int) -> None:
        """Send a message at its default rate, or not at all if it has none."""
        rate = self.defaults.get(message_id, 0.0)
        self.set_interval(message_id, stream_rates.interval_of(rate) if rate > 0.0 else 0, now_us)

    def has_work(self, now_us: int) -> bool:
        """Something is due, queued or half sent."""
        return now_us >= self._next_us or bool(self._frames) or bool(self.parameter_queue)

    def due_messages(self, now_us: int, slowdown: int) -> list[int]:
        """Ids of the streams that are due, in a fixed order."""
        if now_us < self._next_us:
            return []
        due = [message_id for message_id, stream in self.streams.items() if stream.due(now_us, slowdown)]
        self._next_us = min((stream.next_us for stream in self.streams.values()), default=1 << 62)
        return due

    def pack(self, message: Message) -> bytes:
        """A frame with this peer's next sequence number, signed if need be."""
        if self._signed:
            self.codec.keep_time()
        frame = bytes(message.pack(self.codec))
        self.codec.seq = (self.codec.seq + 1) % 256
        return frame

    def pack_ahead(self, message: Message) -> bytes:
        """A frame that overtakes those on their way: signed as on another link, or they would be too old."""
        if not self._signed:
            return self.pack(message)
        own, self.codec.signing.link_id = self.codec.signing.link_id, BARRIER_LINK_ID
        frame = self.pack(message)
        self.codec.signing.link_id = own
        return frame

    def send(self, message: Message) -> None:
        """Queue a message for the next datagram."""
        self._frames.append(self.pack(message))

    def leads_to(self, system: int, component: int) -> bool:
        """Is that component, or one of that system (component 0), behind this peer? Everybody (0) is."""
        return system == 0 or any(system == s and component in (0, c) for s, c in self.heard)

    def pass_on(self, frame: bytes) -> None:
        """Queue another's frame as it is."""
        self._frames.append(frame)

    def take_datagrams(self) -> list[bytes]:
        """What was queued, as few datagrams as possible."""
        if not self._frames:
            return []
        datagrams = [b""]
        for frame in self._frames:
            if datagrams[-1] and len(datagrams[-1]) + len(frame) > MAX_DATAGRAM:
                datagrams.append(b"")
            datagrams[-1] += frame
        self._frames = []
        return datagrams
