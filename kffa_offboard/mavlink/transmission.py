"""Messages onto a link: packed, counted, and recorded when they went out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from kffa_offboard.mavlink.component import Component, Message, Route
from kffa_offboard.mavlink.rivals import RivalWatch
from kffa_offboard.mavlink.transport import Link

DATAGRAM_LIMIT = 512
"""Bytes of unsigned frames that may share a datagram; of one, PX4 on a flight controller reads 1,000."""


class FrameRecorder(Protocol):
    """What a transmission needs of a flight log."""

    def write(self, time_us: int, frame: bytes) -> None:
        """Record one MAVLink frame."""


@dataclass(slots=True)
class Counters:
    """What has gone by. Telemetry: messages of the target. Commands: SET_ATTITUDE_TARGET."""

    telemetry_received: int = 0
    commands_sent: int = 0
    frames_sent: int = 0
    frames_dropped: int = 0


class Transmission:
    """Sends what one side of a conversation says; `rivals` are told, to know our own frames again."""

    def __init__(self, link: Link, route: Route, rivals: RivalWatch, recorder: FrameRecorder | None) -> None:
        self._link = link
        self._component = Component(route)
        self._rivals = rivals
        self._recorder = recorder
        self.counters = Counters()

    def send(self, time_us: int, message: Message) -> bool:
        """Send one message; False if the link did not take it."""
        return self._send(time_us, [self._component.pack(message)])

    def send_together(self, time_us: int, messages: Sequence[Message]) -> None:
        """Send messages of one moment, several in a datagram: for graphs there are some twenty."""
        frames = [self._component.pack(message) for message in messages]
        for group in grouped(frames, DATAGRAM_LIMIT if self._link.keeps_frames_whole else 0):
            self._send(time_us, group)

    def _send(self, time_us: int, frames: list[bytes]) -> bool:
        self._rivals.note_sent(frames)
        if not self._link.send(b"".join(frames)):
            self.counters.frames_dropped += len(frames)
            return False
        self.counters.frames_sent += len(frames)
        if self._recorder is not None:
            for frame in frames:
                self._recorder.write(time_us, frame)
        return True


def grouped(frames: Sequence[bytes], limit: int) -> list[list[bytes]]:
    """The same frames in the same order, together as many as have `limit` bytes at most, or one."""
    groups: list[list[bytes]] = []
    size = limit
    for frame in frames:
        size += len(frame)
        if size > limit or not groups:
            groups.append([])
            size = len(frame)
        groups[-1].append(frame)
    return groups
