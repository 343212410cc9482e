"""Messages out of what a link received: those of others than ourselves, once it is tied to the vehicle."""

from __future__ import annotations

from typing import Literal

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.mavlink.component import FrameParser, Message, Route
from kffa_offboard.mavlink.rivals import RivalWatch
from kffa_offboard.mavlink.transport import Datagram, Link
from kffa_offboard.offboard.events import IntrusionNoticed

MOST_NOTICES = 16
"""So many of the link's own observations wait to be told at most."""

MOVED_US = 3_000_000
"""A vehicle that was silent for so long may come back from another address: control has long ended then."""


class Reception:
    """Finds the messages of one link, and ties it to the vehicle.

    Attributes
    ----------
    bytes_received : all that came, whatever it was
    heard : system and component of everybody who has said something

    """

    def __init__(self, link: Link, route: Route, rivals: RivalWatch) -> None:
        self._link = link
        self._route = route
        self._rivals = rivals
        self._parser = FrameParser(link.keeps_frames_whole)
        self._notices: list[IntrusionNoticed] = []
        self._heard_us: int | None = None
        self._signs = False
        self.bytes_received = 0
        self.heard: set[tuple[int, int]] = set()

    @property
    def damaged_bytes(self) -> int:
        """Bytes received that were no part of a valid frame."""
        return self._parser.damaged_bytes

    def take_notices(self) -> list[IntrusionNoticed]:
        """What was noticed about the link itself since the last call."""
        if not self._notices:
            return []
        notices, self._notices = self._notices, []
        return notices

    def read(self, datagram: Datagram) -> list[Message]:
        """Messages in a datagram. The first one of the target ties the link to its sender.

        What comes under our own ids is left out, and whatever strangers say; but a vehicle that has been
        silent for `MOVED_US` may be one of them: it or a router was started again. A vehicle that signs, on a
        link that does not, is announced: it hears nothing that we send.
        """
        self.bytes_received += len(datagram.data)
        if datagram.notice:
            self._notice(datagram.notice, "said")
        messages = self._parser.parse(datagram)
        if datagram.stranger:
            self._look_at_stranger(datagram, messages)
            return []
        self._heard_us = datagram.time_us
        route, ours = self._route, False
        for message in messages:
            header = message.get_header()
            sender = header.srcSystem, header.srcComponent
            if sender not in self.heard and sender != (0, 0):  # what pymavlink cannot decode has no sender
                self.heard.add(sender)
            if sender == (route.target_system, route.target_component):
                self._link.lock(datagram.source)
                if header.incompat_flags & mavlink.MAVLINK_IFLAG_SIGNED and not self._signs:
                    self._signs = True  # a signing link has taken the signature off
                    self._notice("vehicle signs messages: give [signing] key_file", "said")
            ours = ours or sender == (route.own_system, route.own_component)
        return self._without_own(messages) if ours else messages

    def _notice(self, text: str, consequence: Literal["said", "forbids", "ends"]) -> None:
        if len(self._notices) < MOST_NOTICES:
            self._notices.append(IntrusionNoticed(text, consequence))

    def _look_at_stranger(self, datagram: Datagram, messages: list[Message]) -> None:
        """A vehicle with the same id beside the one that the link is tied to, or in its place."""
        if not any(self._route.from_target(message) for message in messages):
            return
        source = datagram.source
        place = f"{source[0]}:{source[1]}" if isinstance(source, tuple) else str(source)
        ids = f"{self._route.target_system}/{self._route.target_component}"
        if self._heard_us is not None and datagram.time_us - self._heard_us < MOVED_US:
            self._notice(f"another vehicle is {ids}: {place}", "forbids")
            return
        self._link.lock(source)
        self._heard_us = datagram.time_us
        self._notice(f"vehicle {ids} is now at {place}", "forbids")

    def _without_own(self, messages: list[Message]) -> list[Message]:
        """Leave out what is under our own ids: an echo, or a second daemon. The log takes it for ours."""
        own = (self._route.own_system, self._route.own_component)
        others = []
        for message in messages:
            if (message.get_srcSystem(), message.get_srcComponent()) != own:
                others.append(message)
            elif self._rivals.is_impostor(message):
                self._notice(f"somebody else is {own[0]}/{own[1]}: a second daemon?", "forbids")
        return others
