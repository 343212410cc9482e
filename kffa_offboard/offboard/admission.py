"""Whether what is known allows control: the link's speed against the bandwidths, battery and fence.

Rules of thumb, with the numbers that the simulated vehicle gives (docs/safety.md):

- an observer with bandwidth omega_o wants a sample every 2.5 / omega_o at least;
- a law with bandwidth omega_c bears a latency of 1 / omega_c (57 degrees of phase); in flight 1.2 / omega_c
  ends control;
- an observer with bandwidth omega_o bears a latency that is 1.5 / omega_o longer than the delay that it is
  told of; in flight 2 / omega_o ends control. So much more makes the demonstration's height swing by 0.2 m.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, hypot, isnan

import numpy as np

from kffa_offboard.control import vehicle
from kffa_offboard.control.blocks import ControllerParameters
from kffa_offboard.control.observer import ObserverParameters
from kffa_offboard.offboard import doubt, telemetry
from kffa_offboard.offboard.course import course_problem
from kffa_offboard.offboard.events import BatteryReported, LinkMeasured
from kffa_offboard.offboard.loop import LoopState
from kffa_offboard.offboard.settings import LimitSettings, ServiceSettings
from kffa_offboard.offboard.telemetry import Telemetry, rate_hz, slower

SAMPLES_PER_RADIAN = 0.4
"""Samples in the time 1 / omega_o, at least."""

SPARE_SAMPLES = 1.03
"""Times what an observer wants must arrive for it to be set in flight: seconds have a sample more or less."""


@dataclass(frozen=True, slots=True)
class Bearable:
    """Largest omega_c times latency, and largest omega_o times what of it the observer is not told of."""

    law: float
    observer: float


LATENCY_TO_ENGAGE = Bearable(1.0, 1.5)
LATENCY_IN_FLIGHT = Bearable(1.2, 2.0)

CARRYING_MARGIN = 1.05
"""More than the thrust that carries the vehicle by so much is needed to keep it where it is."""


SETTLED_RAD, SETTLED_M, SETTLED_M_S = 0.1, 0.3, 1.0
"""How far estimates of angle, height and climb rate may be from what is measured."""


def refusal(
    settings: ServiceSettings,
    known: Telemetry,
    loop: LoopState | None,
    link: LinkMeasured | None,
    battery: BatteryReported | None,
    time_us: int,
) -> str | None:
    """Why control must not be taken, or None."""
    return (
        telemetry.not_ready(settings.telemetry, known, time_us)
        or doubted(settings, known, time_us)
        or unsettled(known, loop)
        or slow(settings, known, time_us)
        or late(settings, telemetry.latency_on_arrival_s(known, link, time_us), link, LATENCY_TO_ENGAGE)
        or empty(settings.limits, battery)
    )


def doubted(settings: ServiceSettings, known: Telemetry, time_us: int, for_s: float = 0.0) -> str | None:
    """What control needs and the autopilot has called invalid for `for_s` at least."""
    return doubt.doubted(known.doubt, time_us, for_s, needs_position=settings.position is not None)


def unsettled(known: Telemetry, loop: LoopState | None) -> str | None:
    """The observers do not agree with what is measured yet."""
    if loop is None or known.attitude is None or known.position is None:
        return None
    (roll, pitch, _, _), (_, _, _, climb_rate), _ = vehicle.estimates(loop.controller)
    angle = max(abs(roll - known.attitude.attitude[0]), abs(pitch - known.attitude.attitude[1]))
    height = abs(loop.altitude - known.position.position[2])
    rate = abs(climb_rate - known.position.velocity[2])
    for name, off, most, unit in (
        ("attitude", angle, SETTLED_RAD, "rad"),
        ("height", height, SETTLED_M, "m"),
        ("climb rate", rate, SETTLED_M_S, "m/s"),
    ):
        if off > most:
            return f"estimates are settling: {name} off by {off:.2g} {unit}"
    return None


def leaves_limits(settings: ServiceSettings, loop: LoopState, grounded: bool) -> str | None:
    """Where the scenario would lead out of the limits from here, or None."""
    return course_problem(settings.scenario, settings.limits.bounds, 0.0 if grounded else loop.hold_altitude)


@lru_cache(maxsize=16)
def _needed(observer: ObserverParameters, spare: float) -> tuple[tuple[float, int], tuple[float, int]]:
    """Bandwidth, rad/s, and samples a second that it needs: quickest of all channels, and the altitude."""
    channels = observer.fastest.tolist()
    quickest, vertical = max(channels), channels[3]
    samples = [ceil(spare * SAMPLES_PER_RADIAN * bandwidth) for bandwidth in (quickest, vertical)]
    return (quickest, samples[0]), (vertical, samples[1])


def slow(settings: ServiceSettings, known: Telemetry, time_us: int, spare: float = 1.0) -> str | None:
    """Too few samples for the observers, counted over the last second; `spare` times as many are wanted."""
    observer = settings.controller.observer
    if observer is None:
        return None
    attitude, position = known.attitude_stream, known.position_stream
    (quickest, of_attitude), (vertical, of_position) = _needed(observer, spare)
    if slower(attitude, of_attitude, time_us):
        return _slow_text("attitude", rate_hz(attitude, time_us), quickest, spare)
    if slower(position, of_position, time_us):
        return _slow_text("position", rate_hz(position, time_us), vertical, spare)
    return None


def _slow_text(name: str, seen: float, bandwidth: float, spare: float) -> str:
    needed = SAMPLES_PER_RADIAN * bandwidth
    wanted = needed if seen < needed else spare * needed
    return f"{name} at {seen:.0f} Hz; omega_o = {bandwidth:g} needs {wanted:.0f}"


def late(
    settings: ServiceSettings, latency_s: float, link: LinkMeasured | None, most: Bearable
) -> str | None:
    """Latency, as far as it is measured (NaN: not), above what law and observer bear.

    It is the round trip at least, of which half is an underestimate when commands alone come late.
    """
    if link is None or isnan(latency_s):
        return None
    latency_s = max(latency_s, link.round_trip_s)
    for name, bandwidth, limit in _borne(settings.controller, most):
        if latency_s > limit:
            return f"latency {1e3 * latency_s:.0f} ms; {name} = {bandwidth:g} bears {1e3 * limit:.0f}"
    return None


@lru_cache(maxsize=16)
def _borne(controller: ControllerParameters, most: Bearable) -> tuple[tuple[str, float, float], ...]:
    """What bounds the latency: name of a bandwidth, what it is, rad/s, and the latency that it bears, s."""
    law, observer = controller.law, controller.observer
    if law is None or observer is None:
        return ()
    omega_c = float(np.max(law.omega_c))
    omega_o = np.abs(observer.poles).max(axis=0)
    told = controller.actuator.delay + most.observer / omega_o
    channel = int(np.argmin(told))
    return (
        ("omega_c", omega_c, most.law / omega_c),
        ("omega_o", float(omega_o[channel]), float(told[channel])),
    )


def unbearable(
    before: ServiceSettings,
    after: ServiceSettings,
    known: Telemetry,
    latency_s: float,
    link: LinkMeasured | None,
    time_us: int,
) -> str | None:
    """Why bandwidths must not be changed from `before` to `after` in flight: the link does not bear them.

    What would end control is never borne; what only forbids engaging, or just suffices, is if it was so
    before.
    """
    spare = SPARE_SAMPLES if slow(before, known, time_us, SPARE_SAMPLES) is None else 1.0

    def found(settings: ServiceSettings, most: Bearable) -> str | None:
        return slow(settings, known, time_us, spare) or late(settings, latency_s, link, most)

    most = LATENCY_TO_ENGAGE if found(before, LATENCY_TO_ENGAGE) is None else LATENCY_IN_FLIGHT
    return found(after, most)


def too_weak(limits: LimitSettings, thrust: float | None) -> str | None:
    """The vehicle would fall: `thrust` carries it, as far as is known, and the guard lets less through."""
    if thrust is None or thrust * CARRYING_MARGIN <= limits.thrust_max:
        return None
    return f"thrust {thrust:.2f} carries the vehicle; thrust_max = {limits.thrust_max:g}"


def empty(limits: LimitSettings, battery: BatteryReported | None) -> str | None:
    """The battery is low, if the autopilot knows."""
    if battery is None or battery.remaining_percent >= limits.battery_min_percent:
        return None
    return f"battery at {battery.remaining_percent:g} %, {limits.battery_min_percent:g} needed"


def outside_fence(limits: LimitSettings, known: Telemetry, centre: tuple[float, float] | None) -> str | None:
    """The vehicle is farther than the fence allows from `centre`, m: where control was taken.

    Where it is cannot be told while the autopilot calls its position invalid.
    """
    if centre is None or known.position is None or known.doubt.position_us is not None:
        return None
    x, y, _ = known.position.position
    away = hypot(x - centre[0], y - centre[1])
    return f"{away:.1f} m away, fence at {limits.fence_radius_m:g}" if away > limits.fence_radius_m else None


def grounded(settings: ServiceSettings, known: Telemetry, time_us: int) -> bool | None:
    """Is the vehicle on the ground? None if that cannot be told: then there is no engaging.

    Without a landed state little thrust alone does not tell: a vehicle that falls has it, too.
    """
    if known.heartbeat is None or known.position is None:
        return None
    if not known.heartbeat.armed:
        return True
    thrust = telemetry.reported_thrust(settings.telemetry, known, time_us)
    little = settings.flight.touchdown_thrust_fraction * settings.hover_thrust
    on_ground = telemetry.reported_landed(settings.telemetry, known, time_us)
    if on_ground is None and thrust is not None:
        moves = abs(known.position.velocity[2]) >= settings.flight.touchdown_climb_rate_m_s
        return False if thrust >= little else None if moves else True
    if on_ground and thrust is not None and thrust >= little:
        return None
    return on_ground
