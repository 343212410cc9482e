"""Who else is on the link: a second sender of setpoints, a second vehicle or daemon with the same id."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import ClassVar

from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.offboard.events import IntrusionNoticed

SETPOINTS = frozenset(
    (
        "SET_ATTITUDE_TARGET",
        "SET_POSITION_TARGET_LOCAL_NED",
        "SET_POSITION_TARGET_GLOBAL_INT",
        "SET_ACTUATOR_CONTROL_TARGET",
    )
)

BACK_MS = 250
"""Telemetry that is older than the one before by more than this was not merely overtaken."""

BACK_COUNT = 5
BACK_WINDOW_US = 2_000_000
"""So often in so long, it comes from two senders by turns; a restart goes back once."""

SENT_KEPT = 256
"""So many frames of ours are remembered, to tell an echo from a second daemon."""


class RivalWatch:
    """Looks at every message, and decides from messages alone, so that a replayed flight notices the same."""

    MESSAGES: ClassVar = SETPOINTS | {"ATTITUDE", "HEARTBEAT", "SETUP_SIGNING"}
    """What `watch` looks at."""

    def __init__(self, route: Route) -> None:
        self._route = route
        self._boot_ms: int | None = None
        self._backs_us: deque[int] = deque(maxlen=BACK_COUNT)
        self._identity: tuple[int, int] | None = None
        self._sent: deque[bytes] = deque(maxlen=SENT_KEPT)

    def note_sent(self, frames: Iterable[bytes]) -> None:
        """Remember frames of ours."""
        self._sent.extend(frames)

    def is_impostor(self, message: Message) -> bool:
        """True for a message under our own ids that is no echo of what we sent."""
        return bytes(message.get_msgbuf()) not in self._sent

    def watch(self, time_us: int, message: Message) -> IntrusionNoticed | None:
        """What is wrong about a message, or None; there is nothing wrong about others than `MESSAGES`."""
        kind = message.msgname
        if self._route.from_target(message):
            if kind == "ATTITUDE":
                return self._watch_time(time_us, message.time_boot_ms)
            return self._watch_identity(message) if kind == "HEARTBEAT" else None
        if kind in SETPOINTS and self._commands_vehicle(message):
            return IntrusionNoticed(f"{_sender(message)} sends setpoints to the vehicle", "ends")
        if kind == "SETUP_SIGNING" and self._route.addresses_us(
            message.target_system, message.target_component
        ):
            return IntrusionNoticed(f"SETUP_SIGNING of {_sender(message)} ignored", "said")
        return None

    def _commands_vehicle(self, message: Message) -> bool:
        route = self._route
        system, component = message.target_system, message.target_component
        if (system, component) == (route.own_system, route.own_component):
            return False  # that is for us
        return system in (0, route.target_system) and component in (0, route.target_component)

    def _watch_time(self, time_us: int, boot_ms: int) -> IntrusionNoticed | None:
        before_ms, self._boot_ms = self._boot_ms, boot_ms
        if before_ms is None or boot_ms >= before_ms - BACK_MS:
            return None
        self._backs_us.append(time_us)
        if len(self._backs_us) < BACK_COUNT or time_us - self._backs_us[0] > BACK_WINDOW_US:
            return None
        return IntrusionNoticed(f"two vehicles are {self._target}, or old telemetry", "ends")

    def _watch_identity(self, heartbeat: Message) -> IntrusionNoticed | None:
        identity = (heartbeat.autopilot, heartbeat.type)
        if self._identity is None:
            self._identity = identity
        if identity == self._identity:
            return None
        return IntrusionNoticed(f"two vehicles are {self._target}", "forbids")

    @property
    def _target(self) -> str:
        return f"{self._route.target_system}/{self._route.target_component}"


def _sender(message: Message) -> str:
    return f"{message.get_srcSystem()}/{message.get_srcComponent()}"
