"""Telemetry that flows and is no single impossible sample, but does not fit together all the same.

`telemetry.py` judges a sample against the one before. Here, over some time:

- values that stand still to the last bit while their clock goes on: an estimator or a gateway that hangs;
- samples that come later and later: a link whose buffers fill;
- a climb rate that jumps as no vehicle can: samples are passed over, as if they were lost, until one fits;
- a rate that is not the derivative of its quantity, in attitude and in height: with a wrong body rate or
  climb rate the observers push the vehicle away at full authority while the position looks right at first.

Of the last there are two memories. The quick one bounds what one sample can add, so that an estimator may
set its angle or height anew (one step, with rates that fit before and after); the slow one takes all.

Pure functions over a frozen `Trust`; a fault is a line for people.
"""

from __future__ import annotations

from math import cos, exp, hypot, sin, tan

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.offboard.events import AttitudeReceived, PositionReceived, Vector3
from kffa_offboard.offboard.sequence import microseconds
from kffa_offboard.offboard.settings import LimitSettings, TelemetrySettings
from kffa_offboard.offboard.telemetry import Telemetry

DELAY_WINDOW_US = 1_000_000
"""The smallest delay of the last one to two of these is what a sample's delay is compared with."""

ANGLE_MEMORY_S = 0.5
ANGLE_MISMATCH_RAD = 0.5
HEIGHT_MEMORY_S = 1.0
HEIGHT_MISMATCH_M = 2.0
"""How much a quantity and its integrated rate may differ, in a memory that fades with this time constant: a
rate that is wrong by e shows as e times the memory."""

QUICK_ANGLE_MEMORY_S = 0.2
QUICK_ANGLE_MISMATCH_RAD = 0.2
QUICK_ANGLE_RATE_RAD_S, QUICK_ANGLE_STEP_RAD = 6.0, 0.1
ANGLE_STEP_RAD, ANGLE_STEP_RATE_RAD_S = 0.17, 1.0
"""What an attitude may differ from its integrated rates in one sample: an estimator sets its angle anew, and
what a rate does between two samples. A vehicle with a load overshoots such a step by two thirds."""

QUICK_HEIGHT_MEMORY_S = 0.3
QUICK_HEIGHT_MISMATCH_M = 0.3
QUICK_HEIGHT_RATE_M_S, QUICK_HEIGHT_STEP_M = 6.0, 0.2
"""The same, quick: one sample adds no more than this rate over its step, and no more than this step."""

CLIMB_RATE_JUMP_M_S = 1.0
CLIMB_ACCELERATION_M_S2, CLIMB_ACCELERATION_TIME_S = 15.0, 0.1
"""What the climb rate may change by from one sample to the next: touch-down or a reset of the estimator at
once, and an acceleration for the time between them, of which no more counts than this."""

PASSED_OVER_MAX_S = 0.15
"""For how long no climb rate may fit."""

SILENCE_S = 0.15
ACCELERATIONS_M_S2, ANGULAR_ACCELERATIONS_RAD_S2 = 25.0, 40.0
"""From the least of a sound vehicle to the greatest: free fall and full thrust; rolled one way and the other.
After so long without a sample the climb rate may have changed for all that time, and what a rate was between
two samples is not known: its integral is, but for the time squared over 8 times this (it had the least first,
then the greatest)."""

_STEEPEST_RAD = 1.2  # Euler rates grow beyond bounds towards 90 degrees of pitch


class Still(Struct, frozen=True, gc=False):
    """Values and when they arrived first, us."""

    values: tuple[float, ...] = ()
    since_us: int = 0


class Delay(Struct, frozen=True, gc=False):
    """Arrival time less sample time, us: smallest of this and of the former window; since when late."""

    window_us: int | None = None
    smallest_us: int = 0
    former_us: int = 0
    late_since_us: int | None = None


class AttitudeTrust(Struct, frozen=True, gc=False):
    """What is remembered of the attitude.

    Attributes
    ----------
    last : sample
    still : since when the values are the same
    delay : of the samples
    slow, quick : rad, roll and pitch less their integrated rates, fading
    rates : rad/s, of roll and pitch in the last sample
    """

    last: AttitudeReceived | None = None
    still: Still = Still()
    delay: Delay = Delay()
    slow: tuple[float, float] = (0.0, 0.0)
    quick: tuple[float, float] = (0.0, 0.0)
    rates: tuple[float, float] = (0.0, 0.0)


class PositionTrust(Struct, frozen=True, gc=False):
    """What is remembered of the position.

    Attributes
    ----------
    last, still : as of the attitude
    slow, quick : m, height less its integrated rate, fading
    odd_since_us : sample time since when no climb rate fits; None if the last one did
    """

    last: PositionReceived | None = None
    still: Still = Still()
    slow: float = 0.0
    quick: float = 0.0
    odd_since_us: int | None = None


class Trust(Struct, frozen=True, gc=False):
    """What is remembered of telemetry for judging it."""

    attitude: AttitudeTrust = AttitudeTrust()
    position: PositionTrust = PositionTrust()


def watch_attitude(
    settings: TelemetrySettings,
    limits: LimitSettings,
    trust: Trust,
    time_us: int,
    event: AttitudeReceived,
    flying: bool,
) -> tuple[Trust, str | None]:
    """Take in an accepted attitude; `flying`: in our hands and in the air."""
    (p, q, r), most = event.body_rates, limits.attitude_rate_max_rad_s
    if abs(p) > most or abs(q) > most or abs(r) > most:
        fastest = max(abs(p), abs(q), abs(r))
        return trust, f"body rate {fastest:.3g} rad/s, {most:g} possible"
    before = trust.attitude
    delay, fault = _follow_delay(settings, before.delay, time_us, event.sample_time_us)
    still = _stand_still(before.still, (*event.attitude, *event.body_rates), time_us)
    rates = _euler_rates(event)
    slow, quick, stepped = _angle_mismatch(before, event, rates)
    trust = Trust(AttitudeTrust(event, still, delay, slow, quick, rates), trust.position)
    if fault is not None:
        return trust, fault
    if flying and time_us - still.since_us > microseconds(settings.frozen_time_s):
        return trust, f"attitude stands still for {settings.frozen_time_s:g} s"
    if stepped or hypot(*slow) > ANGLE_MISMATCH_RAD or hypot(*quick) > QUICK_ANGLE_MISMATCH_RAD:
        return trust, "body rates do not fit the attitude"
    return trust, None


def watch_position(
    settings: TelemetrySettings,
    limits: LimitSettings,
    trust: Trust,
    time_us: int,
    event: PositionReceived,
    flying: bool,
) -> tuple[Trust, bool, str | None]:
    """Take in an accepted position, or pass it over (the second is then False): its climb rate cannot be.

    `flying`: in our hands and in the air.
    """
    climb_rate = abs(event.velocity[2])
    if climb_rate > limits.climb_rate_max_m_s:
        return trust, True, f"climb rate {climb_rate:.3g} m/s, {limits.climb_rate_max_m_s:g} allowed"
    before = trust.position
    odd = _climb_rate_jump(before, event)
    if odd is not None:
        since_us = event.sample_time_us if before.odd_since_us is None else before.odd_since_us
        lasts = event.sample_time_us - since_us >= microseconds(PASSED_OVER_MAX_S)
        trust = Trust(trust.attitude, replace(before, odd_since_us=since_us))
        return trust, False, odd if lasts else None
    still = _stand_still(before.still, (*event.position, *event.velocity), time_us)
    slow, quick = _height_mismatch(before, event)
    trust = Trust(trust.attitude, PositionTrust(event, still, slow, quick))
    if flying and time_us - still.since_us > microseconds(settings.frozen_time_s):
        return trust, True, f"position stands still for {settings.frozen_time_s:g} s"
    if abs(slow) > HEIGHT_MISMATCH_M or abs(quick) > QUICK_HEIGHT_MISMATCH_M:
        return trust, True, "climb rate does not fit the altitude"
    return trust, True, None


def pass_over(known: Telemetry) -> Telemetry:
    """What is known, with one position sample more that was dropped."""
    stream = known.position_stream
    return replace(known, position_stream=replace(stream, dropped=stream.dropped + 1))


def _stand_still(still: Still, values: tuple[float, ...], time_us: int) -> Still:
    return still if values == still.values else Still(values, time_us)


def _follow_delay(
    settings: TelemetrySettings, state: Delay, time_us: int, sample_us: int
) -> tuple[Delay, str | None]:
    """Late: more than `late_max_s` beyond the smallest delay lately, for longer than `timeout_s`."""
    delay_us = time_us - sample_us
    if state.window_us is None:
        return Delay(time_us, delay_us, delay_us), None
    excess_us = _excess_us(state, delay_us)
    if excess_us > microseconds(settings.late_max_s):
        since_us = time_us if state.late_since_us is None else state.late_since_us
        fault = None
        if time_us - since_us >= microseconds(settings.timeout_s):
            fault = f"attitude comes {excess_us * 1e-6:.2f} s later than before"
        return replace(state, late_since_us=since_us), fault
    if time_us - state.window_us >= DELAY_WINDOW_US:
        return Delay(time_us, delay_us, state.smallest_us), None
    if delay_us >= state.smallest_us:
        return state if state.late_since_us is None else replace(state, late_since_us=None), None
    return Delay(state.window_us, delay_us, state.former_us), None


def lateness_s(trust: Trust, time_us: int) -> float:
    """How much later than lately the last attitude came, which arrived at `time_us`, s."""
    last, state = trust.attitude.last, trust.attitude.delay
    if last is None:
        return 0.0
    return _excess_us(state, time_us - last.sample_time_us) * 1e-6


def _excess_us(state: Delay, delay_us: int) -> int:
    smallest_us, former_us = state.smallest_us, state.former_us  # `min` takes five times as long
    return delay_us - (smallest_us if smallest_us < former_us else former_us)


def _euler_rates(event: AttitudeReceived) -> tuple[float, float]:
    """Rates of roll and pitch, rad/s (eq 6 solved for them)."""
    (roll, pitch, _), (p, q, r) = event.attitude, event.body_rates
    sine, cosine = sin(roll), cos(roll)
    return p + tan(pitch) * (q * sine + r * cosine), q * cosine - r * sine


def _angle_mismatch(
    before: AttitudeTrust, event: AttitudeReceived, now: tuple[float, float]
) -> tuple[tuple[float, float], tuple[float, float], bool]:
    """Slow and quick, of roll and pitch, and whether this sample alone is too far off; `now`: its rates."""
    last, then = before.last, before.rates
    if last is None or _tilt(last.attitude) > _STEEPEST_RAD or _tilt(event.attitude) > _STEEPEST_RAD:
        return (0.0, 0.0), (0.0, 0.0), False
    dt = (event.sample_time_us - last.sample_time_us) * 1e-6
    roll = event.attitude[0] - last.attitude[0] - 0.5 * dt * (then[0] + now[0])
    pitch = event.attitude[1] - last.attitude[1] - 0.5 * dt * (then[1] + now[1])
    if dt > SILENCE_S:
        unseen = 0.125 * ANGULAR_ACCELERATIONS_RAD_S2 * dt * dt
        roll, pitch = roll - _bounded(roll, unseen), pitch - _bounded(pitch, unseen)
    keep, keep_quick = exp(-dt / ANGLE_MEMORY_S), exp(-dt / QUICK_ANGLE_MEMORY_S)
    most = min(QUICK_ANGLE_RATE_RAD_S * dt, QUICK_ANGLE_STEP_RAD)
    slow, quick = before.slow, before.quick
    return (
        (keep * slow[0] + roll, keep * slow[1] + pitch),
        (keep_quick * quick[0] + _bounded(roll, most), keep_quick * quick[1] + _bounded(pitch, most)),
        hypot(roll, pitch) > ANGLE_STEP_RAD + ANGLE_STEP_RATE_RAD_S * dt,
    )


def _tilt(attitude: Vector3) -> float:
    roll, pitch = abs(attitude[0]), abs(attitude[1])
    return pitch if pitch > roll else roll


def _bounded(value: float, most: float) -> float:
    return -most if value < -most else most if most < value else value


def _height_mismatch(before: PositionTrust, event: PositionReceived) -> tuple[float, float]:
    """Slow and quick."""
    last = before.last
    if last is None:
        return 0.0, 0.0
    dt = (event.sample_time_us - last.sample_time_us) * 1e-6
    reckoned = 0.5 * dt * (last.velocity[2] + event.velocity[2])
    off = event.position[2] - last.position[2] - reckoned
    if dt > SILENCE_S:
        off -= _bounded(off, 0.125 * ACCELERATIONS_M_S2 * dt * dt)
    most = min(QUICK_HEIGHT_RATE_M_S * dt, QUICK_HEIGHT_STEP_M)
    return (
        exp(-dt / HEIGHT_MEMORY_S) * before.slow + off,
        exp(-dt / QUICK_HEIGHT_MEMORY_S) * before.quick + _bounded(off, most),
    )


def _climb_rate_jump(before: PositionTrust, event: PositionReceived) -> str | None:
    """Name a change of the climb rate that no sound vehicle shows.

    After a silence it has all that time, but not the time in which samples come and do not fit.
    """
    last = before.last
    if last is None:
        return None
    change = abs(event.velocity[2] - last.velocity[2])
    dt = (event.sample_time_us - last.sample_time_us) * 1e-6
    first_us = event.sample_time_us if before.odd_since_us is None else before.odd_since_us
    silent = (first_us - last.sample_time_us) * 1e-6
    counts = silent if silent > SILENCE_S else min(dt, CLIMB_ACCELERATION_TIME_S)
    possible = CLIMB_RATE_JUMP_M_S + CLIMB_ACCELERATION_M_S2 * counts
    if change <= possible:
        return None
    return f"climb rate does not fit: changed by {change:.1f} m/s in {dt:.2f} s, {possible:.1f} possible"
