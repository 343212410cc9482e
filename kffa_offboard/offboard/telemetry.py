"""What is known of the vehicle from its telemetry, and whether that can be trusted.

Pure functions over a frozen `Telemetry`. The autopilot's sample time gives the steps of the
controller; the arrival time decides about rates and silence. A sample whose clock does not advance
is dropped and counted; that a frozen stream is no telemetry follows, because only accepted
samples count as arrived.
"""

from __future__ import annotations

from bisect import bisect_right
from math import ceil, cos, isfinite, nan, pi

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.offboard.doubt import NO_DOUBT, Doubt, hear
from kffa_offboard.offboard.events import (
    AttitudeReceived,
    EstimateReported,
    HeartbeatReceived,
    LandedStateReported,
    LinkMeasured,
    PositionReceived,
    TargetReported,
    ThrottleReported,
)
from kffa_offboard.offboard.sequence import microseconds
from kffa_offboard.offboard.settings import LimitSettings, TelemetrySettings

_WINDOW_US = 1_000_000  # over which rates are measured
_LATELY_US = 250_000
LONGEST_LATENCY_S = 10.0


class Stream(Struct, frozen=True, gc=False):
    """Arrival of one kind of sample.

    Attributes
    ----------
    sample_us : autopilot's clock of the last accepted sample
    arrival_us : when it arrived
    arrivals : arrival times within the last second
    repeats : dropped samples in a row
    dropped : dropped samples in all
    """

    sample_us: int | None = None
    arrival_us: int | None = None
    arrivals: tuple[int, ...] = ()
    repeats: int = 0
    dropped: int = 0


class Telemetry(Struct, frozen=True, gc=False):
    """The last of everything, and since when it has been flowing without a break."""

    attitude: AttitudeReceived | None = None
    position: PositionReceived | None = None
    attitude_stream: Stream = Stream()
    position_stream: Stream = Stream()
    heartbeat: HeartbeatReceived | None = None
    heartbeat_us: int = 0
    armed_since_us: int | None = None
    target: TargetReported | None = None
    target_us: int = 0
    throttle: float | None = None
    throttle_us: int = 0
    on_ground: bool | None = None
    landed_us: int = 0
    doubt: Doubt = NO_DOUBT
    steady_since_us: int | None = None
    invalid: int = 0


class Sample(Struct, frozen=True, gc=False):
    """Outcome of one sample: accepted with the step `dt` [s] (0 for the first), dropped, or a fault."""

    accepted: bool
    dt: float = 0.0
    fault: str | None = None


_FIRST = Sample(True)


def rate_hz(stream: Stream, now_us: int) -> float:
    """Accepted samples in the second before `now_us`."""
    return float(len(stream.arrivals) - bisect_right(stream.arrivals, now_us - _WINDOW_US))


def _accept(stream: Stream, sample_us: int, arrival_us: int) -> Stream:
    first = bisect_right(stream.arrivals, arrival_us - _WINDOW_US)
    return Stream(sample_us, arrival_us, stream.arrivals[first:] + (arrival_us,), 0, stream.dropped)  # noqa: RUF005 - a copy less


def _sample(
    settings: TelemetrySettings, stream: Stream, sample_us: int, arrival_us: int, gap_s: float
) -> tuple[Stream, Sample]:
    """Accept a sample into its stream if its clock advances."""
    if stream.sample_us is None:
        return _accept(stream, sample_us, arrival_us), _FIRST
    dt = (sample_us - stream.sample_us) * 1e-6
    if dt <= 0.0:
        stream = replace(stream, repeats=stream.repeats + 1, dropped=stream.dropped + 1)
        if stream.repeats > settings.repeated_samples_max:
            return stream, Sample(False, fault=f"{stream.repeats} samples with a standing clock")
        return stream, Sample(False)
    if dt > gap_s:
        return stream, Sample(False, fault=f"{dt:.2f} s between samples, {gap_s:.2f} allowed")
    return _accept(stream, sample_us, arrival_us), Sample(True, dt)


def _finite(values: tuple[float, ...]) -> bool:
    """All of them; a sum that is finite says so at once."""
    return isfinite(sum(values)) or all(map(isfinite, values))


def _turn(angle: float) -> float:
    return (angle + pi) % (2.0 * pi) - pi


def _attitude_fault(
    limits: LimitSettings, last: AttitudeReceived, new: AttitudeReceived, dt: float
) -> str | None:
    (roll, pitch, yaw), (new_roll, new_pitch, new_yaw) = last.attitude, new.attitude
    roll, pitch, yaw = new_roll - roll, new_pitch - pitch, new_yaw - yaw
    allowed = limits.attitude_jump_rad + limits.attitude_rate_max_rad_s * dt
    if abs(roll) <= allowed and abs(pitch) <= allowed and abs(yaw) <= allowed:
        return None  # without a look at whole turns
    jump = max(abs(_turn(roll)), abs(_turn(pitch)), abs(_turn(yaw)))
    if jump > allowed:
        return f"attitude jumped {jump:.2f} rad, {allowed:.2f} possible"
    return None


def receive_attitude(
    settings: TelemetrySettings,
    limits: LimitSettings,
    known: Telemetry,
    time_us: int,
    event: AttitudeReceived,
) -> tuple[Telemetry, Sample]:
    """Take in one attitude sample."""
    if not _finite(event.attitude + event.body_rates):
        return replace(known, invalid=known.invalid + 1), Sample(False, fault="attitude is not finite")
    stream, sample = _sample(
        settings, known.attitude_stream, event.sample_time_us, time_us, settings.timeout_s
    )
    if sample.accepted and known.attitude is not None and sample.dt > 0.0:
        fault = _attitude_fault(limits, known.attitude, event, sample.dt)
        if fault is not None:
            return known, Sample(False, fault=fault)
    steady_us = _steady_since(settings, known, time_us)
    newest = event if sample.accepted else known.attitude
    return replace(known, attitude=newest, attitude_stream=stream, steady_since_us=steady_us), sample


def receive_position(
    settings: TelemetrySettings,
    limits: LimitSettings,
    known: Telemetry,
    time_us: int,
    event: PositionReceived,
) -> tuple[Telemetry, Sample]:
    """Take in one position sample."""
    if not _finite(event.position + event.velocity):
        return replace(known, invalid=known.invalid + 1), Sample(False, fault="position is not finite")
    stream, sample = _sample(
        settings, known.position_stream, event.sample_time_us, time_us, settings.position_timeout_s
    )
    if sample.accepted and known.position is not None and sample.dt > 0.0:
        jump = abs(event.position[2] - known.position.position[2])
        allowed = limits.altitude_jump_m + limits.climb_rate_max_m_s * sample.dt
        if jump > allowed:
            return known, Sample(False, fault=f"altitude jumped {jump:.2f} m, {allowed:.2f} possible")
    steady_us = _steady_since(settings, known, time_us)
    newest = event if sample.accepted else known.position
    return replace(known, position=newest, position_stream=stream, steady_since_us=steady_us), sample


def altitude_now(settings: TelemetrySettings, known: Telemetry) -> float:
    """Altitude at the time of the attitude sample, m: the position's, carried there by its climb rate.

    The two are sampled at times of their own. In a climb at 1 m/s an altitude that is by turns 8 and 12 ms
    older than the attitude moves by 4 mm from step to step, which the law answers with a tenth of hover
    thrust. A position that is off by more than `late_max_s` is taken as it is.
    """
    assert known.attitude is not None and known.position is not None
    altitude, age_us = (
        known.position.position[2],
        known.attitude.sample_time_us - known.position.sample_time_us,
    )
    if abs(age_us) > microseconds(settings.late_max_s):
        return altitude
    return altitude + known.position.velocity[2] * age_us * 1e-6


def before_silence(settings: TelemetrySettings, known: Telemetry, dt: float) -> bool:
    """The position is from before a silence that the attitude, `dt` s after the last one, has just ended.

    Where the vehicle was then is not where it is now.
    """
    if known.attitude is None or known.position is None or dt <= settings.late_max_s:
        return False
    age_us = known.attitude.sample_time_us - known.position.sample_time_us
    return age_us > microseconds(settings.late_max_s)


def _steady_since(settings: TelemetrySettings, known: Telemetry, time_us: int) -> int | None:
    """Begin, keep or restart the unbroken stretch of telemetry: since when it lasts."""
    attitude_us, position_us = known.attitude_stream.arrival_us, known.position_stream.arrival_us
    if attitude_us is None or position_us is None:
        return known.steady_since_us
    silent = time_us - attitude_us >= microseconds(settings.timeout_s)
    if silent or time_us - position_us >= microseconds(settings.position_timeout_s):
        return time_us
    return known.steady_since_us if known.steady_since_us is not None else time_us


def forget_samples(known: Telemetry) -> Telemetry:
    """Begin anew after a fault outside flight; counts and everything but the samples stay."""
    return replace(
        known,
        attitude=None,
        position=None,
        attitude_stream=Stream(dropped=known.attitude_stream.dropped),
        position_stream=Stream(dropped=known.position_stream.dropped),
        steady_since_us=None,
    )


def forget_heartbeat(known: Telemetry) -> Telemetry:
    """The autopilot is silent: mode and arming state are unknown."""
    return replace(known, heartbeat=None, armed_since_us=None, doubt=NO_DOUBT)


def receive_landed(known: Telemetry, time_us: int, event: LandedStateReported) -> Telemetry:
    """Take in the landed state."""
    return replace(known, on_ground=event.on_ground, landed_us=time_us)


def receive_estimate(known: Telemetry, time_us: int, event: EstimateReported) -> Telemetry:
    """Take in what the autopilot says of its estimate."""
    return replace(known, doubt=hear(known.doubt, time_us, event))


def receive_heartbeat(known: Telemetry, time_us: int, event: HeartbeatReceived) -> Telemetry:
    """Take in a heartbeat; notes since when the vehicle is armed."""
    since = known.armed_since_us if known.armed_since_us is not None else time_us
    return replace(
        known, heartbeat=event, heartbeat_us=time_us, armed_since_us=since if event.armed else None
    )


def _is_thrust(value: float) -> bool:
    """Normalised; NaN is none."""
    return 0.0 <= value <= 1.0


def receive_target(known: Telemetry, time_us: int, event: TargetReported) -> Telemetry:
    """Take in what the autopilot commands; parts that are not finite, or no thrust, are not to be trusted."""
    thrust = event.thrust if event.thrust is not None and _is_thrust(event.thrust) else None
    rates = (
        event.body_rates if event.body_rates is not None and all(map(isfinite, event.body_rates)) else None
    )
    attitude = event.attitude if event.attitude is not None and all(map(isfinite, event.attitude)) else None
    repaired = TargetReported(event.sample_time_us, thrust, rates, attitude)
    invalid = known.invalid + (0 if repaired == event else 1)
    return replace(known, target=repaired, target_us=time_us, invalid=invalid)


def receive_throttle(known: Telemetry, time_us: int, event: ThrottleReported) -> Telemetry:
    """Take in the throttle; one that cannot be is counted and ignored."""
    if not _is_thrust(event.throttle):
        return replace(known, invalid=known.invalid + 1)
    return replace(known, throttle=event.throttle, throttle_us=time_us)


def reported_target(settings: TelemetrySettings, known: Telemetry, time_us: int) -> TargetReported | None:
    """The autopilot's own target, unless it is too old."""
    fresh = time_us - known.target_us <= microseconds(settings.report_timeout_s)
    return known.target if fresh else None


def reported_thrust(settings: TelemetrySettings, known: Telemetry, time_us: int) -> float | None:
    """Thrust that the autopilot applies: its target's, else the throttle, else None."""
    target = reported_target(settings, known, time_us)
    if target is not None and target.thrust is not None:
        return target.thrust
    fresh = time_us - known.throttle_us <= microseconds(settings.report_timeout_s)
    return known.throttle if fresh else None


def reported_landed(settings: TelemetrySettings, known: Telemetry, time_us: int) -> bool | None:
    """The autopilot's landed state, unless it is older than a heartbeat may be."""
    fresh = time_us - known.landed_us <= microseconds(settings.heartbeat_timeout_s)
    return known.on_ground if fresh else None


def not_ready(settings: TelemetrySettings, known: Telemetry, time_us: int) -> str | None:
    """Why the service is not ready, or None if it is."""
    if known.heartbeat is None:
        return "no heartbeat"
    if known.heartbeat.killed:
        return "kill switch is on"
    for name, stream, minimum in (
        ("attitude", known.attitude_stream, settings.minimum_attitude_hz),
        ("position", known.position_stream, settings.minimum_position_hz),
    ):
        rate, needed = rate_hz(stream, time_us), settings.rate_fraction * minimum
        if rate < needed:
            return f"{name} telemetry {rate:.0f} Hz, {needed:.0f} needed"
    if known.steady_since_us is None or time_us - known.steady_since_us < microseconds(
        settings.settle_time_s
    ):
        return "estimates are settling"
    return None


def too_slow(settings: TelemetrySettings, known: Telemetry, time_us: int) -> bool:
    """Telemetry is below `rate_fraction` of what was asked for."""
    return (
        rate_hz(known.attitude_stream, time_us) < settings.rate_fraction * settings.attitude_hz
        or rate_hz(known.position_stream, time_us) < settings.rate_fraction * settings.position_hz
    )


def slowed_down(settings: TelemetrySettings, known: Telemetry, time_us: int) -> bool:
    """Far less than what is needed has come lately."""
    share, since_us = settings.rate_fraction * _LATELY_US * 1e-6, time_us - _LATELY_US
    return _fewer(known.attitude_stream, share * settings.minimum_attitude_hz, since_us) or _fewer(
        known.position_stream, share * settings.minimum_position_hz, since_us
    )


def _fewer(stream: Stream, count: float, since_us: int) -> bool:
    """Fewer than so many samples have come after `since_us`."""
    least, arrivals = ceil(count), stream.arrivals
    return least > 0 and (len(arrivals) < least or arrivals[-least] <= since_us)


def slower(stream: Stream, samples: int, now_us: int) -> bool:
    """Is `rate_hz` below so many (one at least)? Without counting."""
    arrivals = stream.arrivals
    return len(arrivals) < samples or arrivals[-samples] <= now_us - _WINDOW_US


def too_slow_text(settings: TelemetrySettings, known: Telemetry, time_us: int) -> str:
    """Which stream is missing, or which is slow, in steps of 10 Hz so that it is not news every second."""
    for name, stream, wanted in (
        ("attitude", known.attitude_stream, settings.attitude_hz),
        ("position", known.position_stream, settings.position_hz),
    ):
        seen = rate_hz(stream, time_us)
        if seen == 0.0:
            return f"no {name} comes; has the autopilot an estimate, and the link room?"
        if seen < settings.rate_fraction * wanted:
            return f"{name} stays at about {10.0 * round(seen / 10.0):g} Hz, {wanted:g} asked for"
    return "telemetry is slow"


def outside_limits(limits: LimitSettings, known: Telemetry, ground: float) -> str | None:
    """Name the measured quantity that is out of its limits; altitude counts from `ground` [m]."""
    if known.attitude is not None:
        roll, pitch, _ = known.attitude.attitude
        if abs(roll) > 0.5 * pi or cos(roll) * cos(pitch) < cos(limits.tilt_failsafe_rad):
            return f"tilt beyond {limits.tilt_failsafe_rad:.2f} rad"
    if known.position is not None:
        altitude = known.position.position[2] - ground
        if not limits.altitude_min_m <= altitude <= limits.altitude_max_m:
            bounds = f"{limits.altitude_min_m:.1f} .. {limits.altitude_max_m:.1f}"
            return f"altitude {altitude:.1f} m outside {bounds}"
    return None


def latency_s(known: Telemetry, link: LinkMeasured | None, time_us: int) -> float:
    """From taking the attitude sample until a command that leaves at `time_us` is there, s.

    The sample's age and half a round trip. NaN if clocks were not compared, or the answer makes no sense
    (the autopilot was restarted).
    """
    if link is None or known.attitude is None:
        return nan
    age_us = time_us - (known.attitude.sample_time_us - link.clock_offset_us)
    latency = age_us * 1e-6 + 0.5 * link.round_trip_s
    return latency if 0.0 <= latency <= LONGEST_LATENCY_S else nan


def latency_on_arrival_s(known: Telemetry, link: LinkMeasured | None, time_us: int) -> float:
    """`latency_s` of a command that answers the last attitude sample at once; silence is judged elsewhere."""
    arrived_us = known.attitude_stream.arrival_us
    return latency_s(known, link, time_us if arrived_us is None else arrived_us)
