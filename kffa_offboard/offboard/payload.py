"""What the vehicle carries: estimate, pick-up and drop in words, reports at a steady rate.

A pure step function around `control.payload`. Mass is estimated only while the daemon's own thrust flies
the vehicle freely: not on the ground, in the thrust ramps or in the last metre of a landing, where the ground
takes part of the weight.

The estimate lives on thrust and climb rate that fit together. When they do not (thrust swings on a link that
is too slow), changes are found that cannot be: a drop without a load, a load that no thrust lifts. From the
first of these on nothing is said until no change has been found for `CALM_S`; then, what is carried. The same
after a silence, or samples that came late.
"""

from __future__ import annotations

from math import cos, exp, isfinite, isinf

from msgspec import Struct
from msgspec.structs import replace

from kffa_offboard.control import payload
from kffa_offboard.offboard.events import Announce, Output, PayloadReport, Severity, Vector3
from kffa_offboard.offboard.payload_settings import PayloadSettings
from kffa_offboard.offboard.sequence import microseconds

_SURE = 3.0  # standard deviations

CALM_S = 2.0
"""Without a change for so long, changes are believed again."""

TOLD_MEMORY_S = 1.0
"""Time constant with which the load that is known follows its estimate: batteries sag, winds change."""


class PayloadSample(Struct, frozen=True, gc=False):
    """One control step as payload awareness sees it.

    Attributes
    ----------
    time_us, dt : arrival time, us, and time since the last step, s
    thrust : collective thrust that goes out at this moment
    attitude : measured roll, pitch, yaw, rad
    climb_rate : measured, m/s
    fresh : the climb rate is new
    flying : the daemon's thrust flies the vehicle freely
    swinging : thrust swings, so that changes of the load are not to be believed
    untimed : the step ends a silence, or its sample came late: which thrust acted when is not known
    """

    time_us: int
    dt: float
    thrust: float
    attitude: Vector3
    climb_rate: float
    fresh: bool
    flying: bool
    swinging: bool = False
    untimed: bool = False


class Load(Struct, frozen=True, gc=False):
    """Mass of the load and its standard deviation, kg."""

    mass: float
    std: float


class Change(Struct, frozen=True, gc=False):
    """A change that is named when its mass is exact: when it was noticed, and the load before, kg.

    A drop of all is not, since what was carried is known.
    """

    since_us: int
    before: float


class ExpectedDrop(Struct, frozen=True, gc=False):
    """A release that the daemon has commanded: the load, kg, and when it should show in the measurements."""

    load: float
    moment_us: int
    begun: bool = False


class Awareness(Struct, frozen=True, gc=False):
    """What is known of the load.

    Attributes
    ----------
    estimator : `control.payload`
    flying_since_us : None while the estimator rests
    load : None until the estimate has settled
    reported_us : last report
    change : a pick-up, or a drop of a part, that is noticed and not yet named
    expected : commanded release whose outcome is open
    heavy : too heavy a load has been announced
    told : kg, the load according to what was last announced; it follows the estimate while that is quiet
    unrest_us : the last change that was not believed; None while changes are
    """

    estimator: payload.PayloadState
    flying_since_us: int | None = None
    load: Load | None = None
    reported_us: int | None = None
    change: Change | None = None
    expected: ExpectedDrop | None = None
    heavy: bool = False
    told: float = 0.0
    unrest_us: int | None = None


def begin_awareness(sample: PayloadSample) -> Awareness:
    """Start with the thrust that acts now."""
    return Awareness(payload.initial_state(sample.thrust, sample.climb_rate))


def step_awareness(
    settings: PayloadSettings, state: Awareness, sample: PayloadSample
) -> tuple[Awareness, tuple[Output, ...]]:
    """One control step: the new state, announcements and reports."""
    outputs: tuple[Output, ...] = ()
    if sample.flying:
        state, outputs = _estimate(settings, state, sample)
    else:
        resting = payload.advance(settings.estimator, state.estimator, sample.dt)
        state = Awareness(resting)
    return replace(state, estimator=payload.send(state.estimator, sample.thrust)), outputs


def expect_drop(state: Awareness, load: float, moment_us: int) -> Awareness:
    """The daemon has commanded the release of `load` kg, which should show at `moment_us`."""
    return replace(state, expected=ExpectedDrop(load, moment_us))


def weigh_anew(state: Awareness) -> Awareness:
    """Another hover thrust gives another mass, which nobody picked up: begin as when flight begins.

    The outcome of a commanded release is waited for first.
    """
    return state if state.expected is not None else Awareness(state.estimator, reported_us=state.reported_us)


def call_off_drop(settings: PayloadSettings, state: Awareness) -> Awareness:
    """The release will not happen: the load is what it was."""
    expected = state.expected
    if expected is not None and expected.begun:
        ratio = expected.load / settings.estimator.vehicle_mass
        opening = settings.estimator.detection.opening
        again = payload.reset(state.estimator, state.estimator.rate, ratio, opening)
        state = replace(state, estimator=payload.accept(settings.estimator, again))
    return replace(state, expected=None)


def _estimate(
    settings: PayloadSettings, state: Awareness, sample: PayloadSample
) -> tuple[Awareness, tuple[Output, ...]]:
    rate = sample.climb_rate
    if state.flying_since_us is None:
        fresh = payload.reset(state.estimator, rate, 0.0, 0.5)
        state = replace(state, estimator=fresh, flying_since_us=sample.time_us)
    since_us = sample.time_us if state.flying_since_us is None else state.flying_since_us
    expected = state.expected
    if expected is not None and not expected.begun and sample.time_us >= expected.moment_us:
        opening = settings.estimator.detection.opening
        empty = payload.reset(state.estimator, rate, 0.0, opening)
        state = replace(state, estimator=empty, expected=replace(expected, begun=True), change=None)
    tilt_factor = cos(sample.attitude[0]) * cos(sample.attitude[1])
    estimator, estimate = payload.step(
        settings.estimator, state.estimator, rate, tilt_factor, sample.fresh, sample.dt
    )
    load = Load(float(estimate.mass), float(estimate.std))
    if state.load is None and sample.time_us - since_us < microseconds(settings.settle_s):
        if isfinite(estimator.suspected) or sample.untimed:  # it has just changed: begin anew
            estimator = payload.accept(settings.estimator, estimator)
            state = replace(state, flying_since_us=sample.time_us)
        return replace(state, estimator=estimator), ()
    first = state.load is None
    state = replace(state, estimator=estimator, load=load)
    outputs: list[Output] = []
    if first:
        outputs += _carrying(settings, load)
        state = replace(state, told=load.mass)
    if state.expected is not None:
        state, said = _watch_release(settings, state, load, sample.time_us)
    else:
        state, said = _watch_changes(settings, state, load, float(estimate.change), sample)
    state, warned = _watch_limit(settings, state, load)
    state, reports = _report(settings, state, load, sample.time_us)
    return state, (*outputs, *said, *warned, *reports)


def _clear(settings: PayloadSettings, load: Load) -> bool:
    """There is a load."""
    return load.mass > max(settings.estimator.detection.minimum, _SURE * load.std)


def _rest(settings: PayloadSettings, load: Load) -> bool:
    """Something is left after a drop; the first tenth of a second has to show it as clearly as any change."""
    detection = settings.estimator.detection
    return load.mass > max(detection.minimum, detection.confidence * load.std)


def has_load(settings: PayloadSettings, state: Awareness) -> bool:
    """The vehicle carries a load, and how heavy it is is known."""
    known = state.load is not None and state.change is None and state.unrest_us is None
    return known and state.load is not None and _clear(settings, state.load)


def _carrying(settings: PayloadSettings, load: Load) -> list[Output]:
    if not _clear(settings, load):
        return []
    return [Announce(Severity.INFO, f"carrying {load.mass:.1f} kg")]


_Told = tuple[Awareness, tuple[Output, ...]]


def _watch_changes(
    settings: PayloadSettings, state: Awareness, load: Load, change: float, sample: PayloadSample
) -> _Told:
    """Put pick-up and drop into words."""
    time_us = sample.time_us
    doubtful = state.unrest_us is not None or sample.swinging
    unbelieved = change != 0.0 and (doubtful or not _believable(settings, state, load, change))
    if unbelieved or sample.untimed:
        return replace(state, unrest_us=time_us, change=None), ()
    if state.unrest_us is not None:
        return _watch_unrest(settings, state, load, time_us)
    if change > 0.0 or (change < 0.0 and _rest(settings, load)):
        before = load.mass - change if state.change is None else state.change.before
        return replace(state, change=Change(time_us, before)), ()
    if change < 0.0:
        return _named(settings, state, load, 0.0, load.mass - change)
    pending = state.change
    if pending is None and isinf(state.estimator.suspected):
        told = load.mass + (state.told - load.mass) * exp(-sample.dt / TOLD_MEMORY_S)
        return replace(state, told=told), ()
    if pending is None or time_us - pending.since_us < microseconds(settings.announce_s):
        return state, ()
    return _named(settings, state, load, load.mass if _clear(settings, load) else 0.0, pending.before)


def _named(settings: PayloadSettings, state: Awareness, load: Load, left: float, before: float) -> _Told:
    """The load, `before` of it, has become what is `left`, kg; nothing to say if that is the same.

    So it is after a jerk: a rope that a winch brakes.
    """
    if abs(left - before) < 0.5 * settings.estimator.detection.minimum:
        return replace(state, change=None, told=load.mass), ()
    word = "picked up" if left > before else "dropped"
    said = Announce(Severity.NOTICE, f"{word} {abs(left - before):.1f} kg")
    return replace(state, change=None, told=load.mass), (said,)


def _believable(settings: PayloadSettings, state: Awareness, load: Load, change: float) -> bool:
    """The load was what was told, no less than nothing is left, and no more than thrust can lift."""
    estimator = settings.estimator
    least = estimator.detection.minimum
    slack = max(2.0 * least, _SURE * load.std)
    before = load.mass - change
    known = state.told if state.change is None else before
    most = estimator.vehicle_mass * (1.0 / estimator.hover_thrust - 1.0)
    return abs(before - known) < slack and -slack < load.mass < most and (change > 0.0 or before > least)


def _watch_unrest(settings: PayloadSettings, state: Awareness, load: Load, time_us: int) -> _Told:
    """Say what is carried when changes can be believed again, if that is news."""
    assert state.unrest_us is not None
    if time_us - state.unrest_us < microseconds(CALM_S):
        return state, ()
    news = abs(load.mass - state.told) > max(2.0 * settings.estimator.detection.minimum, _SURE * load.std)
    state = replace(state, unrest_us=None, told=load.mass if news else state.told)
    if not news:
        return state, ()
    if _clear(settings, load):
        return state, tuple(_carrying(settings, load))
    return state, (Announce(Severity.INFO, "carrying no load"),)


def _watch_release(settings: PayloadSettings, state: Awareness, load: Load, time_us: int) -> _Told:
    """Has the commanded release happened?"""
    expected = state.expected
    assert expected is not None
    elapsed = (time_us - expected.moment_us) * 1e-6
    if elapsed < settings.estimator.detection.settle:
        return state, ()
    if load.mass < 0.5 * expected.load and load.std < 0.25 * expected.load:
        text = Announce(Severity.NOTICE, f"dropped {expected.load:.1f} kg")
        return replace(state, expected=None, told=load.mass), (text,)
    if elapsed < settings.release_timeout_s:
        return state, ()
    text = Announce(Severity.WARNING, f"release not seen: still {load.mass:.1f} kg")
    return replace(state, expected=None), (text,)


def _watch_limit(settings: PayloadSettings, state: Awareness, load: Load) -> _Told:
    """Say once that a load is too heavy, when that is sure, and again only after it was not."""
    limit = settings.max_load_kg
    waits = state.change is not None or state.expected is not None or state.unrest_us is not None
    if limit is None or waits:
        return state, ()
    if not state.heavy and min(load.mass, state.told) - 2.0 * load.std > limit:
        text = f"load of {load.mass:.1f} kg is above the limit of {limit:.1f} kg"
        return replace(state, heavy=True), (Announce(Severity.WARNING, text),)
    if state.heavy and load.mass <= limit:
        state = replace(state, heavy=False)
    return state, ()


def _report(settings: PayloadSettings, state: Awareness, load: Load, time_us: int) -> _Told:
    period_us = microseconds(1.0 / settings.report_hz)
    if state.reported_us is not None and time_us - state.reported_us < period_us:
        return state, ()
    std = load.std if state.unrest_us is None else max(load.std, abs(load.mass - state.told))
    report = PayloadReport(time_us, load.mass, std)
    return replace(state, reported_us=time_us), (report,)
