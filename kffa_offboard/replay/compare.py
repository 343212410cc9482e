"""Is what was replayed what was recorded? And with other gains: what would have been different?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.flightlog.signals import STATE_NAMES, SignalTable, table
from kffa_offboard.frame_codec import decode
from kffa_offboard.replay.engine import Replayed
from kffa_offboard.replay.recording import Frame, Recording

_SEQUENCE = 4  # position of the sequence number in a MAVLink 2 frame
CHANNELS = ("roll", "pitch", "yaw", "altitude")


@dataclass(frozen=True)
class Difference:
    """The first place where recording and replay part.

    `time_us` is the recording's; `field` names the message and its field; values are as in the message,
    or say that there is none.
    """

    time_us: int
    field: str
    recorded: Any
    replayed: Any


@dataclass(frozen=True)
class Comparison:
    """Result of an exact comparison: frames compared, frames that the link had dropped, first difference."""

    frames: int
    dropped: int
    difference: Difference | None


def compare(recording: Recording, replayed: Replayed, tolerance: float = 0.0) -> Comparison:
    """Every frame that went out, byte for byte with its time; then the controller's inner signals likewise.

    With a `tolerance` a number may differ by that much, relative or absolute, whichever is more: for logs
    from another machine, whose arithmetic may round differently.

    A frame that the link did not take is in no log, but left its gap in the sequence numbers. If the log
    breaks off, what comes after its end is not compared.
    """
    whole = recording.end is not None
    sent = _compare_frames(recording.sent, replayed.sent, whole, tolerance, may_drop=True)
    if sent.difference is not None:
        return sent
    made = replayed.signals if recording.signals else []  # a log may have been thinned out
    signals = _compare_frames(recording.signals, made, whole, tolerance, may_drop=False)
    frames = sent.frames + signals.frames
    dropped = sent.dropped
    difference = signals.difference
    if difference is None and recording.end is not None and dropped != recording.end.frames_dropped:
        difference = Difference(
            recording.end_us, "frames that the link dropped", recording.end.frames_dropped, dropped
        )
    return Comparison(frames, dropped, difference)


def _compare_frames(
    recorded: Sequence[Frame], replayed: Sequence[Frame], whole: bool, tolerance: float, *, may_drop: bool
) -> Comparison:
    position = dropped = 0
    for time_us, frame in replayed:
        if position == len(recorded):
            if whole and not may_drop:
                return Comparison(
                    position, dropped, Difference(time_us, _name(frame), "nothing", "a message")
                )
            dropped += whole
            continue
        then_us, expected = recorded[position]
        if may_drop and expected[_SEQUENCE] != frame[_SEQUENCE]:
            dropped += 1
            continue
        if (then_us, expected) != (time_us, frame):
            difference = _difference((then_us, expected), (time_us, frame), tolerance)
            if difference is not None:
                return Comparison(position, dropped, difference)
        position += 1
    if position < len(recorded):
        then_us, expected = recorded[position]
        return Comparison(position, dropped, Difference(then_us, _name(expected), "a message", "nothing"))
    return Comparison(position, dropped, None)


def _name(frame: bytes) -> str:
    number = int.from_bytes(frame[7:10], "little")
    known = mavlink.mavlink_map.get(number)
    return str(known.msgname) if known is not None else f"message {number}"


def _difference(recorded: Frame, replayed: Frame, tolerance: float) -> Difference | None:
    """Name the first field in which two frames differ by more than the tolerance."""
    time_us, expected = recorded
    if _name(expected) != _name(replayed[1]):
        return Difference(time_us, "message", _name(expected), _name(replayed[1]))
    before, after = _values(expected), _values(replayed[1])
    for name, value in before.items():
        if repr(value) != repr(after[name]) and not _close(value, after[name], tolerance):
            return Difference(time_us, f"{_name(expected)}.{name}", value, after[name])
    if time_us != replayed[0]:
        return Difference(time_us, f"time of {_name(expected)} [us]", time_us, replayed[0])
    if tolerance > 0.0:
        return None
    return Difference(time_us, f"{_name(expected)} frame", expected.hex(), replayed[1].hex())


def _close(value: Any, other: Any, tolerance: float) -> bool:
    both = isinstance(value, float) and isinstance(other, float)
    return both and tolerance > 0.0 and abs(value - other) <= tolerance * max(1.0, abs(value))


def _values(frame: bytes) -> dict[str, Any]:
    """Fields of a message; arrays entry by entry."""
    message = decode(frame)
    values: dict[str, Any] = {}
    for name in message.get_fieldnames():
        value = getattr(message, name)
        if isinstance(value, list | tuple):
            values |= {f"{name}[{index}]": entry for index, entry in enumerate(value)}
        else:
            values[name] = value
    return values


# --------------------------------------------------------------------- with another configuration


@dataclass(frozen=True)
class Change:
    """How much a signal of a channel would have been different: rms and largest difference while engaged."""

    signal: str
    channel: str
    rms: float
    largest: float
    largest_at_s: float
    recorded_rms: float


@dataclass(frozen=True)
class WhatIf:
    """What another configuration would have done with the telemetry as it was recorded.

    Attributes
    ----------
    steps : control steps in which the daemon was engaged in both
    changes : one for each signal and channel
    states : (seconds since the beginning, recorded, replayed), where the service's state differs
    recorded, replayed : all signals
    """

    steps: int
    changes: list[Change]
    states: list[tuple[float, str, str]]
    recorded: SignalTable = field(repr=False)
    replayed: SignalTable = field(repr=False)


SIGNALS = ("command", "estimate", "disturbance", "omega_c")


def what_if(recording: Recording, replayed: Replayed) -> WhatIf:
    """Compare the controller's inner signals step by step.

    The vehicle cannot answer to commands that were never sent: this is an open loop, good for what the
    law would have asked for, not for how the vehicle would have flown.
    """
    before, after = _table(recording.signals), _table(replayed.signals)
    times, first, second = np.intersect1d(before.time_us, after.time_us, return_indices=True)
    states = before.state[first], after.state[second]
    engaged = (states[0] == STATE_NAMES.index("engaged")) & (states[1] == STATE_NAMES.index("engaged"))
    seconds = (times - recording.begin_us) / 1e6
    changes = []
    for signal in SIGNALS:
        old, new = getattr(before, signal)[first][engaged], getattr(after, signal)[second][engaged]
        changes += [
            _change(signal, name, old[:, n], new[:, n], seconds[engaged])
            for n, name in enumerate(CHANNELS)
            if old.size
        ]
    differing = np.flatnonzero(states[0] != states[1])
    edges = [n for k, n in enumerate(differing) if k == 0 or differing[k - 1] != n - 1]
    told = [(float(seconds[n]), STATE_NAMES[states[0][n]], STATE_NAMES[states[1][n]]) for n in edges]
    return WhatIf(int(engaged.sum()), changes, told, before, after)


def _table(frames: Sequence[Frame]) -> SignalTable:
    return table(decode(frame) for _, frame in frames)


def _change(signal: str, channel: str, old: Any, new: Any, seconds: Any) -> Change:
    gap = np.abs(new - old)
    most = int(np.argmax(gap))
    return Change(
        signal,
        channel,
        rms=float(np.sqrt(np.mean(gap**2))),
        largest=float(gap[most]),
        largest_at_s=float(seconds[most]),
        recorded_rms=float(np.sqrt(np.mean(old**2))),
    )
