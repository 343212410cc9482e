"""The last check of every setpoint before it leaves, independent of the controller that made it.

It knows nothing of controllers: plain numbers in, a setpoint within the limits out. What it
changed is reported, so that the service can tell the observer what was really applied. A number
that is not finite is not repaired: it has no safe value, the service must give up control.
"""

from __future__ import annotations

from math import cos, hypot, isfinite, pi

from msgspec import Struct

from kffa_offboard.offboard.events import AttitudeTarget, Vector3
from kffa_offboard.offboard.settings import LimitSettings


class Checked(Struct, frozen=True, gc=False):
    """Result of a check.

    Attributes
    ----------
    target : what may be sent; None if nothing may
    changed : it is not what was asked for
    fault : why nothing may be sent
    """

    target: AttitudeTarget | None
    changed: bool = False
    fault: str | None = None


class Wish(Struct, frozen=True, gc=False):
    """What the controller is to follow.

    Attributes
    ----------
    roll, pitch : rad
    altitude : m above the ground level
    place : m, x and y from where control was taken; None if no place is held
    """

    roll: float
    pitch: float
    altitude: float
    place: tuple[float, float] | None = None


def check_wish(
    limits: LimitSettings, wish: Wish, previous: Wish | None, dt: float
) -> tuple[Wish, str | None]:
    """Bring what is to be followed within tilt, height, climb rate and fence; and what was changed, in words.

    `previous` is what was followed `dt` s before; None: the height may begin anywhere. What is not finite is
    left to `check_target`, which sends nothing then.
    """
    roll, pitch, altitude, place = wish.roll, wish.pitch, wish.altitude, wish.place
    changed = None
    roll, pitch = _within_tilt(limits, roll, pitch)
    if previous is not None:
        altitude = _slew(altitude, previous.altitude, limits.climb_rate_setpoint_max_m_s * max(dt, 0.0))
    bounded = _clip(altitude, limits.altitude_min_m, limits.altitude_max_m)
    if bounded < altitude:
        changed = f"set point held at {bounded:g} m of height"
    if place is not None:
        away, reach = hypot(*place), limits.fence_radius_m - limits.fence_margin_m
        if away > reach:
            place = place[0] * reach / away, place[1] * reach / away
            changed = "set point held at the fence"
    return Wish(roll, pitch, bounded, place), changed


def _clip(value: float, lower: float, upper: float) -> float:
    return lower if value < lower else upper if value > upper else value


def _slew(value: float, previous: float, change: float) -> float:
    lower, upper = previous - change, previous + change
    return lower if value < lower else upper if value > upper else value


def tilt(attitude: Vector3) -> float:
    """Approximate angle [rad] between body z and world z: never less than the true one below 90 degrees."""
    return hypot(attitude[0], attitude[1])


def tilt_factor(limits: LimitSettings, attitude: Vector3) -> float:
    """cos(roll) cos(pitch), held above its value at `limits.tilt_compensation_max_rad`.

    Vertical thrust is collective thrust times this factor (eq 14-15).
    """
    factor, least = cos(attitude[0]) * cos(attitude[1]), cos(limits.tilt_compensation_max_rad)
    return least if least > factor else factor


def check_target(
    limits: LimitSettings,
    target: AttitudeTarget,
    previous: AttitudeTarget | None,
    attitude: Vector3,
    dt: float,
    airborne: bool,
) -> Checked:
    """Bring a setpoint within the limits.

    Parameters
    ----------
    target : what the controller wants
    previous : what was sent last; None for the first one of an engagement
    attitude : measured roll, pitch, yaw, rad
    dt : time since `previous`, s
    airborne : False allows thrust below `limits.thrust_min`
    """
    numbers = (target.thrust, *(target.body_rates or ()), *(target.attitude or ()), *attitude, dt)
    if not isfinite(sum(numbers)) and not all(map(isfinite, numbers)):  # a finite sum says so at once
        return Checked(None, fault="setpoint is not a finite number")
    if (target.body_rates is None) == (target.attitude is None):
        return Checked(None, fault="setpoint needs either body rates or attitude")
    dt = dt if dt > 0.0 else 0.0
    thrust = _check_thrust(limits, target.thrust, previous, dt, airborne)
    if target.body_rates is not None:
        last_rates = previous.body_rates if previous is not None else None
        rates = _check_rates(limits, target.body_rates, last_rates, attitude, dt)
        safe = AttitudeTarget(thrust, body_rates=rates)
    else:
        assert target.attitude is not None
        last_attitude = previous.attitude if previous is not None else None
        safe = AttitudeTarget(thrust, attitude=_check_attitude(limits, target.attitude, last_attitude, dt))
    return Checked(safe, changed=safe != target)


def _check_thrust(
    limits: LimitSettings, thrust: float, previous: AttitudeTarget | None, dt: float, airborne: bool
) -> float:
    """Bounds win over the rate of change, so that leaving the ground regime is not delayed."""
    if previous is not None:
        thrust = _slew(thrust, previous.thrust, limits.thrust_rate_max_per_s * dt)
    return _clip(thrust, limits.thrust_min if airborne else 0.0, limits.thrust_max)


def _check_rates(
    limits: LimitSettings, rates: Vector3, previous: Vector3 | None, attitude: Vector3, dt: float
) -> Vector3:
    """Bound rates and their change; beyond `tilt_max_rad` take away the part that tilts further."""
    if previous is not None:
        change = limits.body_rate_change_max_rad_s2 * dt
        (p, q, r), (last_p, last_q, last_r) = rates, previous
        rates = (_slew(p, last_p, change), _slew(q, last_q, change), _slew(r, last_r, change))
    angle = tilt(attitude)
    if angle > limits.tilt_max_rad:
        away = (attitude[0] / angle, attitude[1] / angle)
        outward = max(0.0, rates[0] * away[0] + rates[1] * away[1])
        rates = (rates[0] - outward * away[0], rates[1] - outward * away[1], rates[2])
    (p, q, r), (most_p, most_q, most_r) = rates, limits.body_rate_max_rad_s
    if -most_p <= p <= most_p and -most_q <= q <= most_q and -most_r <= r <= most_r:
        return rates
    return _clip(p, -most_p, most_p), _clip(q, -most_q, most_q), _clip(r, -most_r, most_r)


def _check_attitude(limits: LimitSettings, wanted: Vector3, previous: Vector3 | None, dt: float) -> Vector3:
    """Bound the tilt, then its change and that of the heading (taken the short way).

    Tilt goes straight towards what is wanted, so that it stays within its limit on the way.
    """
    roll, pitch, yaw = wanted
    if abs(yaw) > pi:
        yaw = (yaw + pi) % (2.0 * pi) - pi
    roll, pitch = _within_tilt(limits, roll, pitch)
    if previous is not None:
        bounds = limits.body_rate_max_rad_s
        share = 1.0
        for new, old, bound in ((roll, previous[0], bounds[0]), (pitch, previous[1], bounds[1])):
            if abs(new - old) > bound * dt:
                share = min(share, bound * dt / abs(new - old))
        if share < 1.0:
            roll = previous[0] + share * (roll - previous[0])
            pitch = previous[1] + share * (pitch - previous[1])
            roll, pitch = _within_tilt(limits, roll, pitch)
        turn = (yaw - previous[2] + pi) % (2.0 * pi) - pi
        if abs(turn) > bounds[2] * dt:
            yaw = previous[2] + _clip(turn, -bounds[2] * dt, bounds[2] * dt)
            yaw = (yaw + pi) % (2.0 * pi) - pi
    return (roll, pitch, yaw)


def _within_tilt(limits: LimitSettings, roll: float, pitch: float) -> tuple[float, float]:
    angle = hypot(roll, pitch)
    if angle <= limits.tilt_max_rad:
        return roll, pitch
    return roll * limits.tilt_max_rad / angle, pitch * limits.tilt_max_rad / angle
