"""What a service that has control would say last, as bytes that somebody else can send in its place."""

from __future__ import annotations

from typing import Protocol

from kffa_offboard.mavlink.commands import EncodingError, attitude_target
from kffa_offboard.mavlink.component import Component, Route
from kffa_offboard.mavlink.transport import Clock, Link, Posting
from kffa_offboard.offboard.events import AttitudeTarget


class Controlling(Protocol):
    """What this needs of `offboard.service.Service`."""

    @property
    def has_control(self) -> bool:
        """Setpoints may be what flies the vehicle."""

    def last_setpoints(self) -> tuple[AttitudeTarget, ...]:
        """Those to end with, if the end were now."""


class FramedLastWords:
    """The last setpoints (`offboard.farewell`), framed but not sent; `clock` is that of their events."""

    def __init__(self, service: Controlling, link: Link, route: Route, clock: Clock) -> None:
        self._service = service
        self._link = link
        self._route = route
        self._clock = clock
        self._component = Component(route)  # sequence numbers of its own

    @property
    def has_control(self) -> bool:
        """Setpoints may be what flies the vehicle."""
        return self._service.has_control

    def posting(self) -> Posting | None:
        """The setpoints, together, and their way; None if there is nothing to say, or nobody to say it to."""
        targets = self._service.last_setpoints()
        try:
            messages = [attitude_target(self._route, target, self._clock()) for target in targets]
        except EncodingError:
            return None  # the session would not send it either
        frames = b"".join(self._component.pack(message) for message in messages)
        return self._link.posting(frames) if frames else None
