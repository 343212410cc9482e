"""Which model a vehicle's channels have: b0, lag and delay from recorded commands and answers.

A window of `WINDOW_S` counts as excited if the command moves by `EXCITATION` (standard deviation about a
straight line); a channel is identified if `NEEDED_S` of flight is excited, the model explains `EXPLAINED` of
the answer and b0 is known to `UNCERTAINTY`. Otherwise the reason is given, and what to fly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kffa_offboard.control.rotation import wrap_angle
from kffa_offboard.loganalysis.fit import Estimate, Fit, fit
from kffa_offboard.loganalysis.record import Array, FlightRecord, Series
from kffa_offboard.loganalysis.response import MODELS, Kind, Window, make_window

GRAVITY = 9.80665
AXES = ("roll", "pitch", "yaw")
CHANNELS = (*(f"{kind}.{axis}" for kind in ("rates", "attitude") for axis in AXES), "altitude")

WINDOW_S = 4.0
NEEDED_S = 8.0
EXPLAINED = 0.6
UNCERTAINTY = 0.3
EXCITATION: dict[Kind, float] = {"rates": 0.15, "attitude": 0.03, "altitude": 0.03}
"""Least standard deviation of the command in a window: rad/s, rad, share of full thrust."""
_UNITS: dict[Kind, str] = {"rates": "rad/s", "attitude": "rad", "altitude": "of full thrust"}
_LEAST_RATE_HZ = 10.0
_LONGEST_GAP_S = 0.25
_ADVICE: dict[str, str] = {
    "roll": "roll doublets of 5 to 10 degrees, 0.3 to 1 s long",
    "pitch": "pitch doublets of 5 to 10 degrees, 0.3 to 1 s long",
    "yaw": "yaw doublets of 20 to 30 degrees, 0.8 to 1.5 s long",
    "altitude": "altitude doublets of 0.5 m, 0.4 to 0.7 s long",
}


@dataclass(frozen=True)
class Channel:
    """An identified channel.

    Attributes
    ----------
    name : "rates.roll" ... "altitude"
    b0 : output acceleration per unit of command
    parameters : by name, as in the configuration
    sample_age_s : how old the newest sample is, on the median, when a command is sent; part of the
        `delay_s` that the configuration wants, as the observer counts from the sample
    explained, excited_s, windows : how well, and on how much
    """

    name: str
    b0: Estimate
    parameters: dict[str, Estimate]
    sample_age_s: float
    explained: float
    excited_s: float
    windows: int

    @property
    def delay(self) -> Estimate:
        """From the command to the answer, s."""
        return self.parameters["delay_s"]


@dataclass(frozen=True)
class NotIdentified:
    """A channel about which the flights do not say enough, and why; one line with the remedy."""

    name: str
    reason: str


@dataclass(frozen=True)
class Identification:
    """What the flights say; `whole_loop`: delays are those of telemetry, command and vehicle together."""

    channels: tuple[Channel, ...]
    missing: tuple[NotIdentified, ...]
    whole_loop: bool


def identify(records: list[FlightRecord]) -> Identification:
    """Identify every channel that the flights excite enough."""
    channels: list[Channel] = []
    missing: list[NotIdentified] = []
    for name in CHANNELS:
        found = _identify(name, records)
        if isinstance(found, Channel):
            channels.append(found)
        elif found is not None:
            missing.append(found)
    return Identification(tuple(channels), tuple(missing), all(record.commands_sent for record in records))


def kind_of(name: str) -> Kind:
    """The model of a channel: "rates", "attitude" or "altitude"."""
    head = name.partition(".")[0]
    return "rates" if head == "rates" else "attitude" if head == "attitude" else "altitude"


def _identify(name: str, records: list[FlightRecord]) -> Channel | NotIdentified | None:
    """None if no flight commands this channel at all."""
    kind, axis = kind_of(name), name.rpartition(".")[2]
    usable = [record for record in records if _command(record, kind) and _output(record, kind)]
    if not usable:
        if kind == "altitude":
            return NotIdentified(name, "no thrust and climb rate in the log; log or send both")
        return None
    windows: list[Window] = []
    strongest = 0.0
    for record in usable:
        found, level = excited_windows(record, name)
        windows += found
        strongest = max(strongest, level)
    excited = WINDOW_S * len(windows)
    fly = f"fly {_ADVICE[axis]} (the scenario of configs/identify-px4.toml has them)"
    if excited < NEEDED_S:
        return NotIdentified(
            name,
            f"{excited:.0f} s of excitation, {NEEDED_S:.0f} s needed: the command moves by {strongest:.3g} "
            f"{_UNITS[kind]} at most, {EXCITATION[kind]:g} needed; {fly}",
        )
    fitted = fit(MODELS[kind], windows)
    if fitted.explained < EXPLAINED:
        return NotIdentified(
            name,
            f"the model explains {100.0 * max(fitted.explained, 0.0):.0f} % of the answer, "
            f"{100.0 * EXPLAINED:.0f} % "
            f"needed: wind, contact or another controller acts; {fly} in calm air",
        )
    channel = _channel(name, kind, fitted, windows, usable)
    if channel.b0.half_width > UNCERTAINTY * channel.b0.value:
        return NotIdentified(
            name,
            f"b0 = {channel.b0.value:.3g} +- {channel.b0.half_width:.2g} is not certain enough; "
            f"{fly}, and longer",
        )
    return channel


def _channel(
    name: str, kind: Kind, fitted: Fit, windows: list[Window], records: list[FlightRecord]
) -> Channel:
    model = MODELS[kind]
    parameters = {key: fitted.estimate(index) for index, key in enumerate(model.names)}
    first, std = float(fitted.parameters[0]), float(np.sqrt(fitted.covariance[0, 0]))
    if kind == "rates":
        b0 = fitted.of(1.0 / first, std / first**2)
    elif kind == "attitude":
        b0 = fitted.of(first**2, 2.0 * first * std)
    else:
        b0 = parameters.pop("b0")
        parameters["hover_thrust"] = fitted.of(GRAVITY / first, GRAVITY * std / first**2)
    excited = WINDOW_S * len(windows)
    age = float(np.median([_sample_age(record, kind) for record in records]))
    return Channel(name, b0, parameters, age, fitted.explained, excited, len(windows))


def _command(record: FlightRecord, kind: Kind) -> Series:
    if kind == "rates":
        return record.rates_setpoint
    return record.attitude_setpoint if kind == "attitude" else record.thrust


def _output(record: FlightRecord, kind: Kind) -> Series:
    if kind == "rates":
        return record.body_rates
    return record.attitude if kind == "attitude" else record.velocity


def _sample_age(record: FlightRecord, kind: Kind) -> float:
    """Age of the newest sample of the output when a command goes out, s; 0 where commands are not ours."""
    samples, commands = _output(record, kind), _command(record, kind)
    if not record.commands_sent or samples.arrival_s is None or record.clock_offset_s is None:
        return 0.0
    known_s = samples.arrival_s - record.clock_offset_s
    # A sample that arrives with the command, but after it, was not known to it.
    index = np.searchsorted(known_s, commands.time_s - 1e-4, side="right") - 1
    if kind != "altitude":  # the sample that starts a step arrives at the moment of its command
        index = np.searchsorted(known_s, commands.time_s + 1e-4, side="right") - 1
    age = commands.time_s - samples.time_s[np.clip(index, 0, len(samples) - 1)]
    return max(float(np.median(age[index >= 0])), 0.0) if np.any(index >= 0) else 0.0


def flying(record: FlightRecord, time_s: Array) -> Array:
    """1 where the vehicle is armed and in the air (or the log does not say), else 0; ``(n,)``."""
    air = np.ones(len(time_s))
    if record.armed:
        air *= record.armed.held(time_s)[:, 0] != 0.0
    if record.landed:
        air *= record.landed.held(time_s)[:, 0] == 0.0
    elif record.position:
        height = record.position.interpolated(time_s)[:, 2]
        air *= height > np.min(record.position.values[:, 2]) + 0.5
    return air


def excited_windows(record: FlightRecord, name: str) -> tuple[list[Window], float]:
    """Windows of a flight that excite a channel, and the strongest movement of its command in any window."""
    kind, axis = kind_of(name), name.rpartition(".")[2]
    column = AXES.index(axis) if axis in AXES else 0
    command, output = _command(record, kind), _output(record, kind)
    if kind == "attitude":
        command, output = _unwrapped(command), _unwrapped(output)
    tilt = _tilt(record) if kind == "altitude" else None
    measured = 2 if kind == "altitude" else column
    windows: list[Window] = []
    strongest = 0.0
    begin = max(command.time_s[0] + 1.5, output.time_s[0])
    end = min(command.time_s[-1], output.time_s[-1])
    for start in np.arange(begin, end - WINDOW_S, WINDOW_S):
        part = output.between(start, start + WINDOW_S)
        given = command.between(start, start + WINDOW_S)
        if not _dense(part) or not _dense(given) or not np.all(flying(record, part.time_s)):
            continue
        moved = _movement(given.time_s, given.values[:, column])
        strongest = max(strongest, moved)
        if moved >= EXCITATION[kind]:
            windows.append(make_window(part.time_s, part.values[:, measured], command, column, tilt))
    return windows, strongest


def _unwrapped(angles: Series) -> Series:
    return Series(angles.time_s, np.unwrap(wrap_angle(angles.values), axis=0), angles.arrival_s)


def _tilt(record: FlightRecord) -> Series:
    roll, pitch = record.attitude.values[:, 0], record.attitude.values[:, 1]
    return Series(record.attitude.time_s, (np.cos(roll) * np.cos(pitch))[:, None])


def _dense(part: Series) -> bool:
    """Enough samples, and no gap in them."""
    if len(part) < _LEAST_RATE_HZ * WINDOW_S:
        return False
    return bool(np.max(np.diff(part.time_s)) <= _LONGEST_GAP_S and np.ptp(part.time_s) > 0.8 * WINDOW_S)


def _movement(time_s: Array, values: Array) -> float:
    """Standard deviation about a straight line."""
    since = time_s - time_s.mean()
    slope = float(since @ values) / max(float(since @ since), 1e-12)
    return float(np.std(values - slope * since))
