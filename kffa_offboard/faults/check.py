"""What must hold in every flight, whatever is broken: judged from what was sent and said, not by the guard.

- every setpoint is finite, within limits, and no farther from the one before than its limit of change allows;
- none leaves after control was given up, but for the one level setpoint that ends it (to PX4 under body
  rates behind one of no rates);
- while setpoints leave, telemetry is no older than its timeouts;
- why control was given up is on the wire (STATUSTEXT), which the log records.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, hypot, isfinite, pi

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.faults.edit import message_id, number_of
from kffa_offboard.offboard.events import (
    Announce,
    AttitudeReceived,
    AttitudeTarget,
    Event,
    HeartbeatReceived,
    Output,
    PositionReceived,
)
from kffa_offboard.offboard.settings import LimitSettings, ServiceSettings

Heard = Sequence[tuple[int, Event | Output]]
"""Events before and outputs after the service, with their times [us]: what an observer is told."""

Sent = Sequence[tuple[int, bytes]]
"""Frames that the daemon sent, with their times [us]."""

ENDINGS = ("failsafe: ", "control given up: ", "released: ")
"""How the announcement begins that control was given up."""

_SETPOINT = number_of("SET_ATTITUDE_TARGET")
_STATUS = number_of("STATUSTEXT")
_MASKS = (
    mavlink.ATTITUDE_TARGET_TYPEMASK_ATTITUDE_IGNORE,
    mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_ROLL_RATE_IGNORE
    | mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_PITCH_RATE_IGNORE
    | mavlink.ATTITUDE_TARGET_TYPEMASK_BODY_YAW_RATE_IGNORE,
)
_ROUNDING = 1e-5  # single precision on the wire
_SLOT_US = 10_000  # all that arrived between two barriers counts as arriving at the second


def violations(settings: ServiceSettings, heard: Heard, sent: Sent, *, airborne: bool = True) -> list[str]:
    """What went wrong, in words; empty if nothing did. `airborne`: it never was on the ground."""
    return [
        *bad_frames(settings.limits, sent, airborne),
        *sudden_changes(settings.limits, heard),
        *after_release(heard),
        *blind(settings, heard),
        *unsaid(heard, sent),
    ]


def bad_frames(limits: LimitSettings, sent: Sent, airborne: bool) -> list[str]:
    """Setpoints on the wire that are no numbers or beyond a limit."""
    found: list[str] = []
    parser = mavlink.MAVLink(None)
    for time_us, frame in sent:
        if message_id(frame) != _SETPOINT:
            continue
        message = parser.decode(bytearray(frame))
        rates = (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
        where = f"{time_us * 1e-6:.2f} s: "
        if not all(map(isfinite, (message.thrust, *rates, *message.q))):
            found.append(where + "not finite")
            continue
        if message.type_mask not in _MASKS:
            found.append(where + f"type mask {message.type_mask}")
        lowest = limits.thrust_min if airborne else 0.0
        if not lowest - _ROUNDING <= message.thrust <= limits.thrust_max + _ROUNDING:
            found.append(where + f"thrust {message.thrust:.3f}")
        bounds = limits.body_rate_max_rad_s
        if any(abs(rate) > most + _ROUNDING for rate, most in zip(rates, bounds, strict=True)):
            found.append(where + f"body rates {rates}")
        if message.type_mask != _MASKS[0] and _tilt(message.q) > limits.tilt_max_rad + 1e-3:
            found.append(where + f"tilt {_tilt(message.q):.3f} rad")
    return found


def _tilt(quaternion: Sequence[float]) -> float:
    """Angle between the body's vertical axis and the world's, rad."""
    w, x, y, z = quaternion
    horizontal = 2.0 * hypot(x * z + w * y, y * z - w * x)
    return atan2(horizontal, w * w - x * x - y * y + z * z)


def sudden_changes(limits: LimitSettings, heard: Heard) -> list[str]:
    """Setpoints that differ from the one before by more than their limit of change allows.

    What has passed between two is the time on our clock or on the autopilot's, whichever is more: samples
    that come in a bunch are answered in a bunch. Bounds go before changes: thrust may go to its lower
    bound at once, and beyond the largest tilt a rate that tilts further ends at once. The level setpoint
    that ends control is of another kind and has its thrust at once, and so has one that ends all turning at
    the same moment before it.
    """
    ended_us = {time_us for time_us, item in heard if isinstance(item, AttitudeTarget) and item.attitude}
    found: list[str] = []
    last: tuple[int, int, AttitudeTarget] | None = None
    attitude: AttitudeReceived | None = None
    for time_us, item in heard:
        if isinstance(item, AttitudeReceived):
            attitude = item
        elif isinstance(item, Announce) and item.text.startswith("engaging "):
            last = None
        if not isinstance(item, AttitudeTarget) or attitude is None:
            continue
        sample_us = attitude.sample_time_us
        ends = time_us in ended_us and item.body_rates == (0.0, 0.0, 0.0)
        if last is not None and (last[2].attitude is None) == (item.attitude is None) and not ends:
            dt = max(time_us - last[0], sample_us - last[1], 0) * 1e-6
            steep = hypot(*attitude.attitude[:2]) > limits.tilt_max_rad
            found += [
                f"{time_us * 1e-6:.2f} s: {what}" for what in _too_fast(limits, last[2], item, dt, steep)
            ]
        last = (time_us, sample_us, item)
    return found


def _too_fast(
    limits: LimitSettings, before: AttitudeTarget, after: AttitudeTarget, dt: float, steep: bool
) -> list[str]:
    found = []
    change = abs(after.thrust - before.thrust)
    raised = after.thrust == limits.thrust_min and before.thrust < after.thrust
    if change > limits.thrust_rate_max_per_s * dt + _ROUNDING and not raised:
        found.append(f"thrust changed by {change:.3f} in {dt:.3f} s")
    if before.body_rates is not None and after.body_rates is not None and not steep:
        most = max(abs(b - a) for a, b in zip(before.body_rates, after.body_rates, strict=True))
        if most > limits.body_rate_change_max_rad_s2 * dt + _ROUNDING:
            found.append(f"a body rate changed by {most:.3f} in {dt:.3f} s")
    if before.attitude is not None and after.attitude is not None:
        turns = [
            abs((b - a + pi) % (2.0 * pi) - pi) for a, b in zip(before.attitude, after.attitude, strict=True)
        ]
        bounds = limits.body_rate_max_rad_s
        if any(turn > most * dt + _ROUNDING for turn, most in zip(turns, bounds, strict=True)):
            found.append(f"attitude changed by {max(turns):.3f} rad in {dt:.3f} s")
    return found


def after_release(heard: Heard) -> list[str]:
    """Setpoints that left although control was given up, and not asked for again since."""
    found, released = [], True
    for time_us, item in heard:
        if isinstance(item, Announce):
            if item.text.startswith("engaging "):
                released = False
            elif item.text.startswith((*ENDINGS, "not engaged: ")):
                released = True
        elif isinstance(item, AttitudeTarget) and released:
            found.append(f"{time_us * 1e-6:.2f} s: a setpoint after release")
    return found


def blind(settings: ServiceSettings, heard: Heard) -> list[str]:
    """Setpoints that left although telemetry had been silent for longer than its timeout."""
    telemetry = settings.telemetry
    limits_us = {
        AttitudeReceived: telemetry.timeout_s * 1e6,
        PositionReceived: telemetry.position_timeout_s * 1e6,
        HeartbeatReceived: telemetry.heartbeat_timeout_s * 1e6,
    }
    last: dict[type, int] = {}
    found = []
    for time_us, item in heard:
        if isinstance(item, AttitudeTarget):
            for kind, limit_us in limits_us.items():
                if kind not in last or time_us - last[kind] > limit_us + _SLOT_US:
                    found.append(f"{time_us * 1e-6:.2f} s: a setpoint without {kind.__name__}")
        elif type(item) in limits_us:
            last[type(item)] = time_us
    return found


def unsaid(heard: Heard, sent: Sent) -> list[str]:
    """Endings of control that were announced but are not on the wire."""
    parser = mavlink.MAVLink(None)
    texts = "".join(parser.decode(bytearray(frame)).text for _, frame in sent if message_id(frame) == _STATUS)
    ends = [item.text for _, item in heard if isinstance(item, Announce) and item.text.startswith(ENDINGS)]
    return [f"not said on the wire: {text}" for text in ends if text not in texts]
