"""Somebody else who flies this vehicle, or takes its place: what is said, and what is no longer done."""

from __future__ import annotations

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.offboard.events import IntrusionNoticed

FORBID_US = 5_000_000
"""For so long after it was last seen, a rival forbids engaging."""

END_COUNT = 3
END_WINDOW_US = 2_000_000
"""So many in so long end control: a single stray setpoint does not, a stream of them does."""

REPEAT_US = 30_000_000
"""The same is said again after so long."""

PAUSE_US = 1_000_000
"""Nothing else is said so soon after; a flood of inventions must not become one of ours."""

MOST_TEXTS = 8


class Rivals(Struct, frozen=True, gc=False):
    """What was noticed: the last that forbids engaging, when control was fought over, what was said when."""

    text: str = ""
    seen_us: int | None = None
    fights_us: tuple[int, ...] = ()
    said: tuple[tuple[str, int], ...] = ()


def notice(rivals: Rivals, time_us: int, event: IntrusionNoticed) -> tuple[Rivals, bool]:
    """Take note; True if people are to be told now."""
    if event.consequence != "said":
        rivals = replace(rivals, text=event.text, seen_us=time_us)
    if event.consequence == "ends":
        rivals = replace(rivals, fights_us=(*rivals.fights_us[1 - END_COUNT :], time_us))
    last_us = rivals.said[-1][1] if rivals.said else None
    if last_us is not None and time_us - last_us < PAUSE_US:
        return rivals, False
    before_us = dict(rivals.said).get(event.text)
    if before_us is not None and time_us - before_us < REPEAT_US:
        return rivals, False
    others = tuple(entry for entry in rivals.said if entry[0] != event.text)
    return replace(rivals, said=(*others[1 - MOST_TEXTS :], (event.text, time_us))), True


def forbids(rivals: Rivals, time_us: int) -> str | None:
    """Why control must not be taken, or None."""
    if rivals.seen_us is None or time_us - rivals.seen_us > FORBID_US:
        return None
    return rivals.text


def fought_over(rivals: Rivals, time_us: int) -> bool:
    """True if somebody keeps on commanding the vehicle or speaking for it."""
    return len(rivals.fights_us) == END_COUNT and time_us - rivals.fights_us[0] <= END_WINDOW_US
