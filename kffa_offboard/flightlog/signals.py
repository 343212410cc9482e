"""The controller's inner signals as DEBUG_FLOAT_ARRAY messages, and back as arrays for plotting.

Layout of `data` (name "kffa", array_id 0): nine blocks of four in channel order roll, pitch, yaw,
altitude (`BLOCKS`), then the index of the state in `STATE_NAMES`, dt [s], and four saturation flags; 1 and
the position ring's x and y references [m] if there is a ring, else zeros; the last entry is the latency [s].
What goes out live, thinned, has array_id 1.
Values are float32 on the wire; `time_usec` is exact. Reading them from a file: `tlog.read_signals`.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.frame_codec import Outgoing, is_whole
from kffa_offboard.offboard.events import Signals

NAME = "kffa"
ARRAY_ID = 0
LIVE_ARRAY_ID = 1
CHANNELS = 4
BLOCKS = (
    "reference",
    "reference_rate",
    "measurement",
    "estimate",
    "estimate_rate",
    "disturbance",
    "omega_c",
    "command",
    "applied",
)
LATEST_US = 1 << 63
"""Times in a log are before this, what 64 bits with a sign can hold; a damaged one may say anything."""

STATE_NAMES = ("waiting", "ready", "engaging", "engaged", "releasing", "failsafe")
"""`offboard.service.State` in the order of its numbers on the wire."""

_STATE = CHANNELS * len(BLOCKS)
_DT = _STATE + 1
_SATURATED = _DT + 1
_PLACE = _SATURATED + CHANNELS
_SIZE = 58
_LATENCY = _SIZE - 1
_NAME = NAME.encode()
_NO_PLACE = (0.0, 0.0, 0.0)
_SPARE = _LATENCY - _PLACE - len(_NO_PLACE)
_DATA = struct.Struct(f"<{_LATENCY - _SPARE}f{4 * _SPARE}xf")
_HEAD = struct.Struct(f"<QH10s{4 * _STATE}xf")  # time, array_id, name, and the state behind the blocks
_HEAD_SIZE = _HEAD.size
_blocks, _chained = attrgetter(*BLOCKS), chain.from_iterable
_SIZES = [CHANNELS] * len(BLOCKS)
_STATE_NUMBERS = {name: number for number, name in enumerate(STATE_NAMES)}


@dataclass(frozen=True, slots=True)
class SignalTable:
    """Signals of a flight, one row for each control step, channels in order roll, pitch, yaw, altitude.

    `time_us` (n,) int64; each block (n, 4): angles [rad], altitude [m], their rates [1/s], `disturbance`
    in the second derivative of the channel, `omega_c` [rad/s], `command` and `applied` in the unit of the
    channel's command; `state` (n,) index into `STATE_NAMES`; `dt` (n,) [s]; `latency_s` (n,) [s], NaN while
    it is not known; `saturated` (n, 4); `position_reference` (n, 2) [m], NaN without a position ring.
    """

    time_us: NDArray[np.int64]
    reference: NDArray[np.float64]
    reference_rate: NDArray[np.float64]
    measurement: NDArray[np.float64]
    estimate: NDArray[np.float64]
    estimate_rate: NDArray[np.float64]
    disturbance: NDArray[np.float64]
    omega_c: NDArray[np.float64]
    command: NDArray[np.float64]
    applied: NDArray[np.float64]
    state: NDArray[np.int64]
    dt: NDArray[np.float64]
    saturated: NDArray[np.bool_]
    latency_s: NDArray[np.float64]
    position_reference: NDArray[np.float64]

    @property
    def time_s(self) -> NDArray[np.float64]:
        """Seconds since the first row, (n,)."""
        first = self.time_us[0] if self.time_us.size else 0
        return np.asarray((self.time_us - first) / 1e6, dtype=float)


def to_message(signals: Signals, array_id: int = ARRAY_ID) -> Outgoing:
    """Signals as a DEBUG_FLOAT_ARRAY message.

    Raises ValueError for a block that has not four values or a state without a number.
    """
    blocks = _blocks(signals)
    sizes = [*map(len, blocks)]
    if sizes != _SIZES:
        wrong = next(k for k, size in enumerate(sizes) if size != CHANNELS)
        raise ValueError(f"signals.{BLOCKS[wrong]} has {sizes[wrong]} values; {CHANNELS} channels are needed")
    if signals.state not in _STATE_NUMBERS:
        raise ValueError(f"signals.state {signals.state!r} is none of {', '.join(STATE_NAMES)}")
    place = _NO_PLACE if signals.position_reference is None else (1.0, *signals.position_reference)
    state = _STATE_NUMBERS[signals.state], signals.dt, *signals.saturated
    numbers = (*_chained(blocks), *state, *place, signals.latency_s)
    try:
        data = _DATA.pack(*numbers)
    except OverflowError:
        data = _DATA.pack(*array("f", numbers))  # what float32 cannot hold is logged as infinite
    return Outgoing(mavlink.MAVLink_debug_float_array_message, (signals.time_us, array_id, _NAME, data))


def is_signals(message: Any, array_id: int = ARRAY_ID) -> bool:
    """True if `message` carries signals of this program, with a state and a time that there can be."""
    return bool(
        message.get_type() == "DEBUG_FLOAT_ARRAY"
        and message.name == NAME
        and message.array_id == array_id
        and 0.0 <= message.data[_STATE] < len(STATE_NAMES)
        and message.time_usec < LATEST_US
    )


def is_signal_frame(frame: bytes) -> bool:
    """`is_signals` for a frame, without decoding it; False for a frame that is damaged or signed."""
    if not is_whole(frame, mavlink.MAVLink_debug_float_array_message):
        return False
    time_us, array_id, name, state = _HEAD.unpack(frame[10:-2][:_HEAD_SIZE].ljust(_HEAD_SIZE, b"\0"))
    of_log = array_id == ARRAY_ID and name.rstrip(b"\0") == _NAME
    return bool(of_log and 0.0 <= state < len(STATE_NAMES) and time_us < LATEST_US)


def from_message(message: Any) -> Signals:
    """Undo `to_message`, up to float32 rounding."""
    data = message.data
    blocks = {
        name: tuple(data[CHANNELS * number : CHANNELS * (number + 1)]) for number, name in enumerate(BLOCKS)
    }
    return Signals(
        time_us=message.time_usec,
        state=STATE_NAMES[int(data[_STATE])],
        saturated=tuple(value != 0.0 for value in data[_SATURATED : _SATURATED + CHANNELS]),
        dt=data[_DT],
        latency_s=data[_LATENCY],
        position_reference=(data[_PLACE + 1], data[_PLACE + 2]) if data[_PLACE] != 0.0 else None,
        **blocks,
    )


class SignalRows:
    """Signal messages of a flight as they come: 240 bytes each, as many as on the wire."""

    def __init__(self) -> None:
        self._times = array("q")
        self._data = array("f")

    def __len__(self) -> int:
        return len(self._times)

    def add(self, message: Any) -> None:
        """One more control step."""
        self._times.append(message.time_usec)
        self._data.extend(message.data)

    def table(self) -> SignalTable:
        """All of them; none give arrays without rows."""
        data = np.array(self._data, dtype=float).reshape(len(self), _SIZE)
        blocks = {
            name: data[:, CHANNELS * number : CHANNELS * (number + 1)] for number, name in enumerate(BLOCKS)
        }
        place = data[:, _PLACE + 1 : _PLACE + 3]
        return SignalTable(
            time_us=np.array(self._times, dtype=np.int64),
            state=data[:, _STATE].astype(np.int64),
            dt=data[:, _DT],
            latency_s=data[:, _LATENCY],
            saturated=data[:, _SATURATED : _SATURATED + CHANNELS] != 0.0,
            position_reference=np.where(data[:, _PLACE, None] != 0.0, place, np.nan),
            **blocks,
        )


def table(messages: Iterable[Any]) -> SignalTable:
    """Collect signal messages into arrays; no messages give arrays without rows."""
    rows = SignalRows()
    for message in messages:
        rows.add(message)
    return rows.table()
