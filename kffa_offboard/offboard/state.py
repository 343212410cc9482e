"""Where the service is, and how it ends."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class State(Enum):
    """Where the service is."""

    WAITING = "waiting"
    READY = "ready"
    ENGAGING = "engaging"
    ENGAGED = "engaged"
    RELEASING = "releasing"
    FAILSAFE = "failsafe"


WAITING, READY, ENGAGING, ENGAGED, RELEASING, FAILSAFE = State
"""The same; Python 3.11 takes a tenth of a microsecond to find `State.ENGAGED`."""

CONTROLLING = (ENGAGING, ENGAGED)
SENDING = (ENGAGING, ENGAGED, RELEASING)
IDLE = (WAITING, READY)

KEPT = (
    "settings", "_original", "state", "finished", "_now_us", "_outputs", "_known", "_parameters", "_loop",
    "_flight", "_engagement", "_retry", "_outcome", "_leaving", "_armed_here", "_offboard_mode",
    "_auto_engage", "_interrupted", "_capture", "_said", "_own_heartbeat_us", "_request_us", "_requests",
    "_gripper_us", "_link", "_latency_s", "_battery", "_trust", "_rivals", "_echo", "_centre", "_followed",
    "_fall", "_stay", "_external", "_awareness", "_release_plan", "_position_us", "_flown", "_stepped",
    "_earliest", "_asked_again", "_asked_again_us",
)  # fmt: skip
"""Attributes of a service: more than the 30 that CPython finds quickly without `__slots__`."""


@dataclass(frozen=True, slots=True)
class Finished:
    """The service has done what it was started for, or has given up; it will not take control again."""

    successful: bool
    reason: str


LANDED = Finished(True, "scenario done, landed")
REFUSED = Finished(False, "disarming was refused")
UNCONFIRMED = Finished(False, "disarming was not confirmed")
