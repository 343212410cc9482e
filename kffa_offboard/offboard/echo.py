"""Whether the autopilot follows our setpoints, as far as it tells: ATTITUDE_TARGET has their thrust.

A second sender of setpoints on another of the vehicle's links is not heard here. But what the autopilot
reports is then our thrust at one time and somebody else's at another. Real ArduCopter repeats thrust to the
last bits of a float32 (14,500 reports of 13 flights: 3e-7, one 5e-5); what an autopilot reports that alters
it is never ours, and it is left alone.
"""

from __future__ import annotations

from itertools import chain

from msgspec import Struct
from msgspec.structs import replace

KEPT_US, BLOCK, BLOCKS = 1_000_000, 16, 16
"""What was sent so long ago may be what is reported; so many of it are kept, in so many blocks."""

SAME, OTHER = 2e-6, 1e-4
"""Of full thrust: what is so near to a setpoint of ours is one; what is so far from all of them is not."""

REPORTS, ENOUGH = 60, 5
"""Of so many reports so many must be ours, and so many somebody else's."""

SETTLED_US = 2_000_000
"""The first reports in the air are not judged."""


class Echo(Struct, frozen=True, gc=False):
    """What was sent and reported.

    Attributes
    ----------
    latest, former : time, us, and thrust of setpoints, in blocks, so that one more copies the last block only
    since_us : since when reports are looked at
    ours : which of the last reports are
    """

    latest: tuple[tuple[int, float], ...] = ()
    former: tuple[tuple[tuple[int, float], ...], ...] = ()
    since_us: int | None = None
    ours: tuple[bool | None, ...] = ()


def send(echo: Echo, time_us: int, thrust: float) -> Echo:
    """Take note of a setpoint of ours."""
    if len(echo.latest) < BLOCK:
        return replace(echo, latest=(*echo.latest, (time_us, thrust)))
    return replace(echo, latest=((time_us, thrust),), former=(*echo.former[1 - BLOCKS :], echo.latest))


def forget_reports(echo: Echo) -> Echo:
    """The vehicle is not in the air under our control."""
    return echo if echo.since_us is None else replace(echo, since_us=None, ours=())


def report(echo: Echo, time_us: int, thrust: float) -> tuple[Echo, bool]:
    """Take in a reported thrust; True if not all that reaches the vehicle is ours."""
    if echo.since_us is None:
        return replace(echo, since_us=time_us), False
    if time_us - echo.since_us < SETTLED_US:
        return echo, False
    sent = chain(echo.latest, *echo.former)
    away = min((abs(thrust - one) for at_us, one in sent if time_us - at_us <= KEPT_US), default=0.0)
    ours = True if away <= SAME else False if away >= OTHER else None
    echo = replace(echo, ours=(*echo.ours[1 - REPORTS :], ours))
    return echo, echo.ours.count(True) >= ENOUGH and echo.ours.count(False) >= ENOUGH
