"""What is drawn: panels, the curves in them, and the units at this edge (degrees for angles)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kffa_offboard.report.flight import Channel, Flight, Line, Quantity
from kffa_offboard.report.thinning import with_gaps, without_turns

SIGNALS = ("reference", "measured", "estimate", "events")
"""Curves that can be hidden on their own; the others stand alone in their panels."""

_SENSES = {"pitch": ", nose down positive", "yaw": ", left positive", "roll": ", right positive"}


@dataclass(frozen=True)
class Curve:
    """One line of a flight in the panel's unit, against seconds since the flight's time 0.

    `signal` is one of `SIGNALS`, or "" where there is only one; `spread` is a standard deviation around it.
    """

    flight: int
    signal: str
    line: Line
    spread: Line | None = None


@dataclass(frozen=True)
class Panel:
    """A plot: `key` is unique, `section` the heading above it, `unit` that of the values."""

    key: str
    section: str
    title: str
    unit: str
    curves: tuple[Curve, ...]


@dataclass(frozen=True)
class _Kind:
    """What a panel shows of a channel, and how a value becomes one in the panel's unit."""

    key: str
    quantities: tuple[Quantity, ...]
    title: str
    unit: str
    factor: float = 1.0


_DEGREES = float(np.degrees(1.0))
_TRACKED: tuple[Quantity, ...] = ("measured", "estimate", "reference")
_OMEGA_C = _Kind("omega_c", ("omega_c",), "Bandwidth ω_c", "rad/s")
_POSITION: dict[Channel, _Kind] = {
    "north": _Kind("tracking", ("measured", "reference"), "North", "m"),
    "east": _Kind("tracking", ("measured", "reference"), "East", "m"),
}
_ALTITUDE = (
    _Kind("tracking", _TRACKED, "Altitude", "m"),
    _Kind("command", ("command",), "Vertical thrust commanded", "of full thrust"),
    _Kind("disturbance", ("disturbance",), "Disturbance estimate, altitude", "m/s²"),
    _OMEGA_C,
)


def panels(flights: Sequence[Flight], zeros_s: Sequence[float]) -> list[Panel]:
    """Every panel for which at least one flight has something, in reading order.

    `zeros_s` is time 0 of each flight in seconds since its log began.
    """
    found = [
        _panel(flights, zeros_s, channel, kind)
        for channel in ("altitude", "roll", "pitch", "yaw")
        for kind in (_ALTITUDE if channel == "altitude" else _angle_kinds(channel))
    ]
    found += [_panel(flights, zeros_s, channel, kind) for channel, kind in _POSITION.items()]
    found += [_load(flights, zeros_s), _latency(flights, zeros_s)]
    found += [
        _arrivals(flights, zeros_s, name) for name in dict.fromkeys(n for f in flights for n in f.arrivals)
    ]
    return [panel for panel in found if panel.curves]


def _angle_kinds(channel: Channel) -> tuple[_Kind, ...]:
    name = channel.capitalize()
    return (
        _Kind("tracking", _TRACKED, f"{name}{_SENSES[channel]}", "deg", _DEGREES),
        _Kind("command-rates", ("command",), f"{name} rate commanded", "deg/s", _DEGREES),
        _Kind("command-attitude", ("command",), f"{name} commanded", "deg", _DEGREES),
        _Kind("disturbance", ("disturbance",), f"Disturbance estimate, {channel}", "deg/s²", _DEGREES),
        _OMEGA_C,
    )


def _panel(flights: Sequence[Flight], zeros_s: Sequence[float], channel: Channel, kind: _Kind) -> Panel:
    section = "Position" if channel in _POSITION else channel.capitalize()
    title = f"{kind.title}, {channel}" if kind is _OMEGA_C else kind.title
    curves = tuple(_curves(flights, zeros_s, channel, kind))
    return Panel(f"{channel}-{kind.key}", section, title, kind.unit, curves)


def _curves(
    flights: Sequence[Flight], zeros_s: Sequence[float], channel: Channel, kind: _Kind
) -> Iterator[Curve]:
    for number, (flight, zero_s) in enumerate(zip(flights, zeros_s, strict=True)):
        if kind.key == f"command-{'attitude' if flight.origin.command_kind == 'rates' else 'rates'}":
            continue
        for quantity in kind.quantities:
            line = flight.lines.get((quantity, channel))
            if line is None or not _worth_drawing(quantity, line):
                continue
            if channel == "yaw" and kind.unit == "deg":
                line = without_turns(line.time_s, line.values)
            line = with_gaps(Line(line.time_s - zero_s, line.values * kind.factor))
            yield Curve(number, quantity if quantity in SIGNALS else "", line)


def _worth_drawing(quantity: Quantity, line: Line) -> bool:
    """A controller without a bandwidth (PID) has omega_c = 0 throughout."""
    known = line.values[np.isfinite(line.values)]
    return bool(known.size) and not (quantity == "omega_c" and not known.any())


def _load(flights: Sequence[Flight], zeros_s: Sequence[float]) -> Panel:
    curves = []
    for number, (flight, zero_s) in enumerate(zip(flights, zeros_s, strict=True)):
        if flight.load is None:
            continue
        mass = with_gaps(Line(flight.load.time_s - zero_s, flight.load.values))
        std = flight.load_std
        spread = None if std is None else Line(std.time_s - zero_s, std.values)
        curves.append(Curve(number, "", mass, spread))
    return Panel("load", "Load", "Estimated mass of the load, ± 2 standard deviations", "kg", tuple(curves))


def _latency(flights: Sequence[Flight], zeros_s: Sequence[float]) -> Panel:
    curves = [
        Curve(number, "", with_gaps(Line(flight.latency.time_s - zero_s, 1e3 * flight.latency.values)))
        for number, (flight, zero_s) in enumerate(zip(flights, zeros_s, strict=True))
        if flight.latency is not None
    ]
    return Panel("latency", "Link", "Latency from sample to command", "ms", tuple(curves))


def _arrivals(flights: Sequence[Flight], zeros_s: Sequence[float], name: str) -> Panel:
    """Pauses to the microsecond, in which arrivals are recorded: what is finer is the rounding of sums."""
    curves = [
        Curve(number, "", Line(times[1:] - zero_s, 1e3 * np.round(np.diff(times), 6)))
        for number, (flight, zero_s) in enumerate(zip(flights, zeros_s, strict=True))
        if len(times := flight.arrivals.get(name, np.zeros(0))) > 1
    ]
    return Panel(f"arrival-{name}", "Link", f"Time since the last {name} message", "ms", tuple(curves))
