"""What the telemetry link of a flight was like, and which bandwidths it allows.

The rule. With dead time = delay of the whole loop + half a telemetry period (a sample is that old on the
mean when it is used) + how much later than usual telemetry comes, all in s,

    omega_c <= 0.1 / (dead - 0.017), at most 6 rad/s,    omega_o <= 2 / dead, at most 60 rad/s.

It is a fit to what `tune.allowed_bandwidths` finds for the altitude channel with motors that lag by 50 ms,
margins of
6 dB and 30 degrees, delays of 30 to 200 ms at 100 and 20 Hz; there omega_c stays within 10 % of the rule or
above it. Mass and thrust of the vehicle cancel. An altitude loop at omega_c = 1 rad/s lets a load of half the
vehicle's mass move
it by 0.7 m: below that the link is not good enough. `tune` gives the exact figures for a vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kffa_offboard.loganalysis.record import Array, FlightRecord, Series

GAP_FACTOR = 3.0
"""A pause of more than this many median periods is a gap."""

OMEGA_C_SCALE, DEAD_TIME_SHIFT_S, OMEGA_C_MOST = 0.1, 0.017, 6.0
OMEGA_O_DEAD, OMEGA_O_MOST = 2.0, 60.0
LEAST_OMEGA_C = 1.0
LONGEST_GAP_S = 0.5
"""The daemon's own default for telemetry that has failed."""

_CORRELATION_STEP_S = 0.005
_CORRELATION_RANGE_S = 0.5
_LEAST_CORRELATION = 0.3


@dataclass(frozen=True)
class StreamQuality:
    """One telemetry stream.

    Attributes
    ----------
    rate_hz : samples over time
    period_s : median interval of the samples' own times
    jitter_s : standard deviation of arrival - sample time, of the interval where there are no arrival times
    gaps, longest_gap_s : pauses of more than three periods
    delay_spread_s : 99th percentile less least of arrival - sample; None without arrival times
    """

    rate_hz: float
    period_s: float
    jitter_s: float
    gaps: int
    longest_gap_s: float
    delay_spread_s: float | None


@dataclass(frozen=True)
class Verdict:
    """Whether the link is good enough, for which bandwidths [rad/s], and why (one line each)."""

    good_enough: bool
    omega_c: float
    omega_o: float
    dead_time_s: float
    reasons: tuple[str, ...]


def stream_quality(samples: Series) -> StreamQuality | None:
    """Judge a stream; None if it has fewer than three samples."""
    if len(samples) < 3:
        return None
    intervals = np.diff(samples.time_s)
    period = float(np.median(intervals))
    gaps = intervals > GAP_FACTOR * period
    spread = None
    jitter = float(np.std(intervals[~gaps]))
    if samples.arrival_s is not None:
        delay = samples.arrival_s - samples.time_s
        jitter = float(np.std(delay))
        spread = float(np.percentile(delay, 99.0) - np.min(delay))
    rate = (len(samples) - 1) / float(samples.time_s[-1] - samples.time_s[0])
    return StreamQuality(rate, period, jitter, int(gaps.sum()), float(intervals.max()), spread)


def response_delay(command: Series, output: Series, column: int, measured: int) -> float | None:
    """Delay of the answer by cross-correlation of command and output, both as changes over 50 ms, s.

    It contains the lag of the channel. None if the two do not resemble each other (correlation below 0.3).
    """
    if len(command) < 20 or len(output) < 20:
        return None
    begin, end = max(command.time_s[0], output.time_s[0]), min(command.time_s[-1], output.time_s[-1])
    if end - begin < 4.0 * _CORRELATION_RANGE_S:
        return None
    grid = np.arange(begin, end, _CORRELATION_STEP_S)
    given = _changes(command.held(grid)[:, column])
    answered = _changes(output.interpolated(grid)[:, measured])
    lags = round(_CORRELATION_RANGE_S / _CORRELATION_STEP_S)
    size = float(np.linalg.norm(given) * np.linalg.norm(answered))
    if size <= 0.0 or not np.isfinite(size):
        return None
    products = [float(given[: len(given) - lag] @ answered[lag:]) for lag in range(lags)]
    best = int(np.argmax(products))
    return best * _CORRELATION_STEP_S if products[best] / size > _LEAST_CORRELATION else None


def _changes(values: Array) -> Array:
    width = 10
    changes = values[width:] - values[:-width]
    return np.asarray(changes - changes.mean())


def loop_delays(record: FlightRecord) -> dict[str, float]:
    """Delay from command to answer of every channel that the flight moves enough."""
    found: dict[str, float] = {}
    for index, axis in enumerate(("roll", "pitch", "yaw")):
        delay = response_delay(record.rates_setpoint, record.body_rates, index, index)
        if delay is not None:
            found[f"rates.{axis}"] = delay
    if record.thrust and record.velocity:
        steps = record.velocity.time_s
        rate = np.diff(record.velocity.values[:, 2]) / np.diff(steps)
        climb = Series(0.5 * (steps[1:] + steps[:-1]), rate[:, None])
        delay = response_delay(record.thrust, climb, 0, 0)
        if delay is not None:
            found["altitude"] = delay
    return found


def verdict(
    attitude: StreamQuality | None, position: StreamQuality | None, delay_s: float | None, spread_s: float
) -> Verdict:
    """Judge the link.

    `delay_s` is that of the whole loop if the log tells it, else None (50 ms are assumed and said);
    `spread_s` is how much later than usual telemetry may come, which counts as delay.
    """
    reasons: list[str] = []
    if attitude is None or position is None:
        missing = "attitude" if attitude is None else "position"
        return Verdict(False, 0.0, 0.0, np.inf, (f"no {missing} in the log",))
    slowest = max(attitude.period_s, position.period_s)
    if delay_s is None:
        delay_s = 0.05
        reasons.append("the log does not tell the link's delay; 50 ms are assumed")
    dead = delay_s + 0.5 * slowest + spread_s
    rate = min(attitude.rate_hz, position.rate_hz)
    room = max(dead - DEAD_TIME_SHIFT_S, OMEGA_C_SCALE / OMEGA_C_MOST)
    omega_c = OMEGA_C_SCALE / room
    omega_o = min(OMEGA_O_DEAD / dead, OMEGA_O_MOST)
    good = True
    longest = max(attitude.longest_gap_s, position.longest_gap_s)
    if longest > LONGEST_GAP_S:
        good = False
        reasons.append(
            f"a gap of {longest:.2f} s: the daemon lets go after {LONGEST_GAP_S:g} s; mend the link"
        )
    if omega_c < LEAST_OMEGA_C:
        good = False
        reasons.append(
            f"omega_c {omega_c:.1f} rad/s at most, {LEAST_OMEGA_C:g} needed: dead time {1e3 * dead:.0f} ms, "
            f"{rate:.0f} Hz; ask for 50 Hz or more (SET_MESSAGE_INTERVAL) over a wired link"
        )
    return Verdict(good, float(omega_c), float(omega_o), float(dead), tuple(reasons))
