"""Who may command the daemon: MAVLink ids as people write them, and whether a message comes from them."""

from __future__ import annotations

from typing import TypeAlias

from kffa_offboard.mavlink.component import Message

Sender: TypeAlias = tuple[int, int | None]
"""System and component; no component stands for all of the system."""

_LARGEST_ID = 255


def parse_sender(text: str) -> Sender | None:
    """Read "255" or "255/190"; None if it is neither."""
    numbers = text.split("/")
    if len(numbers) > 2 or not all(number.isascii() and number.isdigit() for number in numbers):
        return None
    ids = [int(number[:4]) for number in numbers]
    if not all(1 <= number <= _LARGEST_ID for number in ids):
        return None
    return ids[0], ids[1] if len(ids) == 2 else None


def is_allowed(allowed: tuple[Sender, ...] | None, message: Message) -> bool:
    """True if a message is from one of `allowed`; None allows everybody."""
    if allowed is None:
        return True
    system, component = message.get_srcSystem(), message.get_srcComponent()
    return (system, None) in allowed or (system, component) in allowed
