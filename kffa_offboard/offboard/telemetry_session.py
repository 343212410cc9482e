"""What is asked of the vehicle's telemetry, and what it says beside its samples.

Part of the offboard service, beside `session.py` and `service.py`.
"""

from __future__ import annotations

from kffa_offboard.offboard import admission, events, telemetry
from kffa_offboard.offboard.events import Severity
from kffa_offboard.offboard.falling import NO_FALL, shows, watch_fall
from kffa_offboard.offboard.flight import AIR
from kffa_offboard.offboard.sequence import microseconds
from kffa_offboard.offboard.session import Session
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.state import CONTROLLING, IDLE, SENDING, State


class TelemetrySession(Session):
    """The part of the service that asks for telemetry and watches it; use `service.Service`."""

    __slots__ = ()

    def __init__(self, settings: ServiceSettings) -> None:
        super().__init__(settings)
        self._asked_again, self._asked_again_us = 0, 0

    # ---------------------------------------------------------------------- what is asked for

    def _check_rates(self, time_us: int) -> None:
        """While not flying, ask again if too little arrives; say so when asking has not helped."""
        wanted = self.settings.telemetry
        self._request_us = time_us + microseconds(wanted.request_interval_s)
        if self.state not in IDLE or not telemetry.too_slow(wanted, self._known, time_us):
            return
        if self._requests < wanted.request_limit:
            self._request_rates(time_us)
            return
        self._say_once(Severity.WARNING, telemetry.too_slow_text(wanted, self._known, time_us))

    def _may_ask_again(self) -> bool:
        """For message rates in flight: a ground station behind the same router may have changed them."""
        return self.state in CONTROLLING and self._asked_again < self.settings.telemetry.request_limit

    def _ask_again(self, time_us: int) -> None:
        """Telemetry becomes slow in flight: it would end control within a second."""
        self._asked_again += 1
        self._asked_again_us = time_us + microseconds(self.settings.telemetry.request_interval_s)
        self._say_once(Severity.WARNING, "telemetry slows down: asked for it again")
        self._emit_rates()

    def _request_rates(self, time_us: int) -> None:
        self._requests += 1
        self._request_us = time_us + microseconds(self.settings.telemetry.request_interval_s)
        self._emit_rates()

    def _emit_rates(self) -> None:
        wanted = self.settings.telemetry
        self._emit(
            events.RequestMessageRates(
                wanted.attitude_hz,
                wanted.position_hz,
                wanted.target_hz,
                wanted.status_hz,
                wanted.heartbeat_hz,
            )
        )

    # ------------------------------------------------------------------------- what it says

    def _on_estimate(self, time_us: int, reported: events.EstimateReported) -> None:
        """What the autopilot itself does not believe is not flown."""
        self._known = telemetry.receive_estimate(self._known, time_us, reported)
        long_s = self.settings.telemetry.estimate_invalid_s
        doubt = admission.doubted(self.settings, self._known, time_us, long_s)
        if doubt is not None and self.state in SENDING:
            self._failsafe(time_us, doubt)
        elif doubt is not None and self.state is State.READY:
            self.state = State.WAITING
            self._say(Severity.WARNING, f"not ready: {doubt}")
        elif self._known.doubt.position_us is not None and self._nothing_holds_the_place():
            self._say_once(Severity.WARNING, "position invalid: the fence is not watched")

    def _nothing_holds_the_place(self) -> bool:
        """In our hands, without the ring; with it control ends when its position stays invalid."""
        return self.state in SENDING and self.settings.position is None

    def _watch_fall(self, event: events.PositionReceived) -> None:
        loop, hover = self._loop, self.settings.hover_thrust
        if loop is None or loop.sent is None or not self._flying():
            self._fall = NO_FALL
        else:
            self._fall = watch_fall(self._fall, event, loop.sent.thrust, hover, loop.carrying)

    def _fallen(self, ground: float) -> str | None:
        """An estimator may not notice the impact: PX4's fell on for 3 m."""
        position = self._known.position
        below = position is not None and position.position[2] < ground
        return "fell to the ground" if below and shows(self._fall) else None

    def _flying(self) -> bool:
        """In our hands and in the air."""
        return self.state in SENDING and self._flight is not None and self._flight.phase is AIR
