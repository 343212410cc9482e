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


SENDING = (State.ENGAGING, State.ENGAGED, State.RELEASING)
IDLE = (State.WAITING, State.READY)


@dataclass(frozen=True, slots=True)
class Finished:
    """The service has done what it was started for, or has given up; it will not take control again."""

    successful: bool
    reason: str


LANDED = Finished(True, "scenario done, landed")
REFUSED = Finished(False, "disarming was refused")
UNCONFIRMED = Finished(False, "disarming was not confirmed")
