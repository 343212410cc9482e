"""What the autopilot does not believe of its own estimate is not flown.

An estimator without sensors goes on guessing, and PX4 goes on sending what it guesses: OFFBOARD with body
rates or attitudes asks for no position, so that its own failsafe does not act. Unmodified PX4 that had lost
its satellites, under the position ring, flew in swings of 10 m half a minute later; it had called its
position invalid after 4 s.
"""

from __future__ import annotations

from msgspec import Struct

from kffa_offboard.offboard.events import EstimateReported
from kffa_offboard.offboard.sequence import microseconds


class Doubt(Struct, frozen=True, gc=False):
    """Since when [us] the autopilot has called a part of its own estimate invalid.

    None for a part that is valid, or of which it says nothing.
    """

    attitude_us: int | None = None
    height_us: int | None = None
    position_us: int | None = None


NO_DOUBT = Doubt()


def hear(doubt: Doubt, time_us: int, reported: EstimateReported) -> Doubt:
    """Take in what the autopilot says at `time_us`."""

    def since(valid: bool, before_us: int | None) -> int | None:
        return None if valid else time_us if before_us is None else before_us

    return Doubt(
        since(reported.attitude, doubt.attitude_us),
        since(reported.height, doubt.height_us),
        since(reported.position, doubt.position_us),
    )


def doubted(doubt: Doubt, time_us: int, for_s: float = 0.0, *, needs_position: bool) -> str | None:
    """What has been invalid for `for_s` [s] at least and control needs, or None.

    Attitude and height are always needed, the position with the ring that holds it.
    """
    for name, since_us in (
        ("attitude", doubt.attitude_us),
        ("height", doubt.height_us),
        ("position", doubt.position_us if needs_position else None),
    ):
        if since_us is not None and time_us - since_us >= microseconds(for_s):
            return f"autopilot calls its {name} invalid"
    return None
