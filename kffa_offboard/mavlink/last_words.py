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

    def last_setpoint(self) -> AttitudeTarget | None:
        """The one to end with, if the end were now."""


class FramedLastWords:
    """The last setpoint (`offboard.farewell`), framed but not sent; `clock` is that of its events."""

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
        """The setpoint and its way; None if there is nothing to say, or nobody to say it to."""
        target = self._service.last_setpoint()
        if target is None:
            return None
        try:
            message = attitude_target(self._route, target, self._clock())
        except EncodingError:
            return None  # the session would not send it either
        return self._link.posting(self._component.pack(message))
