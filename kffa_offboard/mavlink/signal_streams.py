"""The controller's inner signals on the wire, thinned to a set rate, for ground stations to graph.

DEBUG_FLOAT_ARRAY has everything, in the layout of `flightlog/signals.py` (array_id 1 tells it from the log's
own, which has every step); NAMED_VALUE_FLOAT has the most wanted values one by one. DEBUG_VECT has three
values of one channel, for ground stations that plot only numbers with a field of their own. Values are in
the controller's axes and units.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from operator import attrgetter

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.frame_codec import Outgoing
from kffa_offboard.mavlink.component import Message
from kffa_offboard.offboard.events import Signals

DEBUG_FLOAT_ARRAY = mavlink.MAVLINK_MSG_ID_DEBUG_FLOAT_ARRAY
NAMED_VALUE_FLOAT = mavlink.MAVLINK_MSG_ID_NAMED_VALUE_FLOAT
DEBUG_VECT = mavlink.MAVLINK_MSG_ID_DEBUG_VECT

CHANNEL_NAMES = ("ROLL", "PITCH", "YAW", "ALT")
SIGNAL_NAMES = {
    "REF": "reference",
    "EST": "estimate",
    "DIST": "disturbance",
    "WC": "omega_c",
    "CMD": "command",
}
"""Ending of a name on the wire -> field of `Signals`; with the channel before it 10 characters at most."""

_NAMES = [*(f"{channel}_{ending}" for ending in SIGNAL_NAMES for channel in CHANNEL_NAMES), "LATENCY_S"]
_WIRE_NAMES = [name.encode() for name in _NAMES]
_blocks = attrgetter(*SIGNAL_NAMES.values())

ToArray = Callable[[Signals], Message]
"""Packs signals as DEBUG_FLOAT_ARRAY; it belongs to the log, which this layer does not know."""


def named_values(signals: Signals) -> list[tuple[str, float]]:
    """Names and values: ``ROLL_REF``, ..., ``ALT_CMD``, and ``LATENCY_S``."""
    return list(zip(_NAMES, _values(signals), strict=True))


def _values(signals: Signals) -> list[float]:
    return [*chain.from_iterable(_blocks(signals)), signals.latency_s]


def named_messages(signals: Signals) -> list[Message]:
    """One NAMED_VALUE_FLOAT for each of `named_values`; `time_boot_ms` is our own clock's."""
    kind, time_ms = mavlink.MAVLink_named_value_float_message, signals.time_us // 1000 % 2**32
    return [
        Outgoing(kind, (time_ms, value, name))
        for name, value in zip(_WIRE_NAMES, _values(signals), strict=True)
    ]


def vector_message(signals: Signals, channel: int) -> Message:
    """DEBUG_VECT named as the channel: x reference, y estimate, z disturbance."""
    values = signals.reference[channel], signals.estimate[channel], signals.disturbance[channel]
    return mavlink.MAVLink_debug_vect_message(CHANNEL_NAMES[channel].encode(), signals.time_us, *values)


class SignalStreams:
    """Which signals go out, and when.

    Parameters
    ----------
    rate_hz
        Rate of each stream until somebody asks for another; 0 for none.
    to_array
        See `ToArray`; None for no DEBUG_FLOAT_ARRAY.
    vector
        Channel of DEBUG_VECT; None for no DEBUG_VECT.

    """

    def __init__(self, rate_hz: float, to_array: ToArray | None, vector: int | None = None) -> None:
        self._default_us = round(1e6 / rate_hz) if rate_hz > 0.0 else -1
        self._packers: dict[int, Callable[[Signals], list[Message]]] = {NAMED_VALUE_FLOAT: named_messages}
        if to_array is not None:
            self._packers[DEBUG_FLOAT_ARRAY] = lambda signals: [to_array(signals)]
        if vector is not None:
            self._packers[DEBUG_VECT] = lambda signals: [vector_message(signals, vector)]
        self._interval_us = dict.fromkeys(self._packers, self._default_us)
        self._due_us: dict[int, int] = {}
        self._next_us = 0  # before that none is due
        self._last: Signals | None = None

    @property
    def message_ids(self) -> frozenset[int]:
        """The streams that there are."""
        return frozenset(self._packers)

    def interval_us(self, message_id: int) -> int:
        """Present interval; -1 if the stream is off."""
        return self._interval_us[message_id]

    def set_interval(self, message_id: int, interval_us: int) -> None:
        """As MAV_CMD_SET_MESSAGE_INTERVAL: 0 is the default rate, -1 is off."""
        self._interval_us[message_id] = self._default_us if interval_us == 0 else interval_us
        self._due_us.pop(message_id, None)
        self._next_us = 0

    def latest(self, message_id: int) -> list[Message]:
        """The last signals once; none before the first control step."""
        return [] if self._last is None else self._packers[message_id](self._last)

    def take(self, signals: Signals) -> list[Message]:
        """What is to be sent of one control step. Intervals keep their grid: none is lost to rounding."""
        self._last = signals
        if signals.time_us < self._next_us:
            return []
        messages: list[Message] = []
        for message_id, pack in self._packers.items():
            interval_us = self._interval_us[message_id]
            due_us = self._due_us.get(message_id, signals.time_us)
            if interval_us < 0 or signals.time_us < due_us:
                continue
            late = signals.time_us - due_us > interval_us
            self._due_us[message_id] = (signals.time_us if late else due_us) + interval_us
            messages += pack(signals)
        on = [due_us for message_id, due_us in self._due_us.items() if self._interval_us[message_id] >= 0]
        self._next_us = min(on, default=signals.time_us)
        return messages
