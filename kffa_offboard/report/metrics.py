"""The figures of a flight's table, from its signals alone: no truth is known here."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan

import numpy as np

from kffa_offboard.report.flight import CHANNELS, Array, Channel, Flight, FlightEvent, Line, Quantity

BEFORE_EVENT_S, AFTER_EVENT_S = 1.0, 5.0
"""The stretch around the announcement of a pick-up or drop (which comes after it) that is judged."""

GAP_FACTOR = 3.0
"""A pause of more than this many median intervals is a gap."""


@dataclass(frozen=True)
class LoadResponse:
    """How far the height strayed from its reference around a pick-up or drop.

    Attributes
    ----------
    event : the announcement
    peak_m, iae_m_s : of reference less measurement, noise included
    peak_estimate_m : of reference less estimate
    """

    event: FlightEvent
    peak_m: float
    peak_estimate_m: float
    iae_m_s: float


@dataclass(frozen=True)
class StreamMetrics:
    """Arrival of one telemetry stream.

    Attributes
    ----------
    rate_hz : messages over time
    jitter_s : standard deviation of the intervals, gaps left out
    gaps : intervals longer than three median ones
    longest_s : longest interval
    """

    rate_hz: float
    jitter_s: float
    gaps: int
    longest_s: float


@dataclass(frozen=True)
class Metrics:
    """What the table says of a flight; NaN or None where the log does not tell.

    Attributes
    ----------
    duration_s, engaged_s : of the log; of control by the daemon
    tracking_rms : of reference less measurement while engaged, by channel, rad and m
    saturated_share : of the engaged steps, by channel
    loads : each announced pick-up or drop
    streams : by name
    latency_p50_s, latency_p99_s : from sample to command, while engaged; over the whole log if it never was
    """

    duration_s: float
    engaged_s: float
    tracking_rms: dict[Channel, float]
    saturated_share: dict[Channel, float]
    loads: tuple[LoadResponse, ...]
    streams: dict[str, StreamMetrics]
    latency_p50_s: float
    latency_p99_s: float
    frames_dropped: int | None


def judge(flight: Flight) -> Metrics:
    """All figures of a flight."""
    latency = _latencies(flight)
    return Metrics(
        duration_s=flight.duration_s,
        engaged_s=sum(end - begin for begin, end in flight.engaged),
        tracking_rms={channel: _tracking_rms(flight, channel) for channel in CHANNELS},
        saturated_share=_saturated_share(flight),
        loads=tuple(_load_responses(flight)),
        streams={
            name: found
            for name, times in flight.arrivals.items()
            if (found := stream_metrics(times)) is not None
        },
        latency_p50_s=float(np.percentile(latency, 50.0)) if len(latency) else nan,
        latency_p99_s=float(np.percentile(latency, 99.0)) if len(latency) else nan,
        frames_dropped=flight.frames_dropped,
    )


def tracking_error(flight: Flight, channel: Channel, actual: Quantity = "measured") -> Line | None:
    """Reference less measurement (or estimate), yaw the short way round; None if either is missing."""
    reference = flight.lines.get(("reference", channel))
    measured = flight.lines.get((actual, channel))
    if reference is None or measured is None:
        return None
    known = np.isfinite(measured.values)
    if not known.any():
        return None
    values = measured.values[known]
    values = np.unwrap(values) if channel == "yaw" else values
    error = reference.values - np.interp(reference.time_s, measured.time_s[known], values, nan, nan)
    if channel == "yaw":
        error = (error + np.pi) % (2.0 * np.pi) - np.pi
    return Line(reference.time_s, error)


def stream_metrics(arrival_s: Array) -> StreamMetrics | None:
    """Judge a stream by its times of arrival (n,); None for fewer than three messages."""
    if len(arrival_s) < 3 or arrival_s[-1] <= arrival_s[0]:
        return None
    intervals = np.diff(arrival_s)
    gaps = intervals > GAP_FACTOR * np.median(intervals)
    rate = len(intervals) / float(arrival_s[-1] - arrival_s[0])
    return StreamMetrics(rate, float(np.std(intervals[~gaps])), int(gaps.sum()), float(intervals.max()))


def _engaged(flight: Flight, time_s: Array) -> Array:
    """Whether the daemon was in control at each time (n,), as a mask."""
    inside = np.zeros(len(time_s), dtype=bool)
    for begin, end in flight.engaged:
        inside |= (time_s >= begin) & (time_s <= end)
    return inside


def _tracking_rms(flight: Flight, channel: Channel) -> float:
    error = tracking_error(flight, channel)
    if error is None:
        return nan
    chosen = error.values[_engaged(flight, error.time_s) & np.isfinite(error.values)]
    return float(np.sqrt(np.mean(chosen**2))) if len(chosen) else nan


def _saturated_share(flight: Flight) -> dict[Channel, float]:
    command = flight.lines.get(("command", "altitude"))
    if flight.saturated is None or command is None:
        return dict.fromkeys(CHANNELS, nan)
    rows = flight.saturated[_engaged(flight, command.time_s)]
    if not len(rows):
        return dict.fromkeys(CHANNELS, nan)
    return {channel: float(rows[:, column].mean()) for column, channel in enumerate(CHANNELS)}


def _load_responses(flight: Flight) -> list[LoadResponse]:
    measured = tracking_error(flight, "altitude")
    estimate = tracking_error(flight, "altitude", "estimate")
    responses = []
    for event in flight.events:
        if event.kind == "load":
            peak, area = _peak_and_area(measured, event.time_s)
            responses.append(LoadResponse(event, peak, _peak_and_area(estimate, event.time_s)[0], area))
    return responses


def _peak_and_area(error: Line | None, event_s: float) -> tuple[float, float]:
    """Greatest size and integral of the size around an event; NaN without samples there."""
    if error is None:
        return nan, nan
    begin, end = event_s - BEFORE_EVENT_S, event_s + AFTER_EVENT_S
    chosen = (error.time_s >= begin) & (error.time_s <= end) & np.isfinite(error.values)
    sizes = np.abs(error.values[chosen])
    if len(sizes) < 2:
        return nan, nan
    return float(sizes.max()), float(np.trapezoid(sizes, error.time_s[chosen]))


def _latencies(flight: Flight) -> Array:
    if flight.latency is None:
        return np.zeros(0)
    known = np.isfinite(flight.latency.values)
    engaged = known & _engaged(flight, flight.latency.time_s)
    return flight.latency.values[engaged if engaged.any() else known]
