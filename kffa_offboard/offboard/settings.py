"""Every number of the offboard service, with its unit and its default.

All records are frozen. Suffixes give units: `_s`, `_us`, `_hz`, `_m`, `_m_s`, `_m_s2`, `_rad`, `_rad_s`,
`_rad_s2`; thrust is normalised collective thrust 0..1.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import degrees, inf, isfinite, pi
from typing import Literal, TypeAlias

from kffa_offboard.control.controllers import ControllerParameters
from kffa_offboard.control.position import PositionParameters
from kffa_offboard.offboard.course import Bounds
from kffa_offboard.offboard.payload_settings import PayloadSettings
from kffa_offboard.offboard.scenario_fits import check_fits
from kffa_offboard.offboard.segments import Segment

FailsafeAction: TypeAlias = Literal["stop", "hold", "land"]
OutputKind: TypeAlias = Literal["rates", "attitude"]


def _require(record: object, owner: str, lower: float = 0.0) -> None:
    """Refuse a number that is not finite or is below `lower`, naming it."""
    for item in fields(record):  # type: ignore[arg-type]
        value = getattr(record, item.name)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            continue
        if not isfinite(value) or value < lower:
            raise ValueError(f"{owner}.{item.name} = {value}: must be finite and at least {lower:g}")


@dataclass(frozen=True, slots=True)
class TelemetrySettings:
    """What is asked of the autopilot's telemetry, and when its silence is a fault.

    Attributes
    ----------
    attitude_hz, position_hz, target_hz, status_hz, heartbeat_hz : rates that are asked for
    minimum_attitude_hz, minimum_position_hz : `rate_fraction` of these must arrive before "ready"
    timeout_s, position_timeout_s, heartbeat_timeout_s : longest silence, by arrival time
    settle_time_s : unbroken telemetry needed for the observers to settle
    request_interval_s, request_limit : repetition of the request while too little arrives
    report_timeout_s : age at which the autopilot's reported target or throttle counts no more
    repeated_samples_max : samples in a row whose clock does not advance
    frozen_time_s : longest time in the air without any change of a value while the clock goes on
    late_max_s : how much later samples may come than they lately did
    estimate_invalid_s : how long the autopilot may call a part of its own estimate invalid
    """

    attitude_hz: float = 100.0
    position_hz: float = 100.0
    target_hz: float = 20.0
    status_hz: float = 5.0
    heartbeat_hz: float = 5.0
    minimum_attitude_hz: float = 50.0
    minimum_position_hz: float = 25.0
    rate_fraction: float = 0.8
    timeout_s: float = 0.25
    position_timeout_s: float = 0.25
    heartbeat_timeout_s: float = 3.0
    settle_time_s: float = 1.0
    request_interval_s: float = 1.0
    request_limit: int = 10
    report_timeout_s: float = 0.5
    repeated_samples_max: int = 20
    frozen_time_s: float = 0.5
    late_max_s: float = 0.15
    estimate_invalid_s: float = 1.0

    def __post_init__(self) -> None:
        _require(self, "telemetry")
        for name in (
            "timeout_s",
            "position_timeout_s",
            "heartbeat_timeout_s",
            "request_interval_s",
            "frozen_time_s",
            "late_max_s",
        ):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"telemetry.{name} = {getattr(self, name)}: must be positive")


@dataclass(frozen=True, slots=True)
class LimitSettings:
    """What may be sent (the guard) and what may be seen (the failsafe).

    Attributes
    ----------
    tilt_max_rad : of an attitude setpoint; beyond it a rate setpoint may not tilt further
    body_rate_max_rad_s : of each body rate (roll, pitch, yaw)
    body_rate_change_max_rad_s2 : change of a body-rate setpoint; of an attitude setpoint the change
        is limited to `body_rate_max_rad_s`
    thrust_min, thrust_max : in flight; on the ground the lower bound is zero
    thrust_rate_max_per_s : change of thrust
    tilt_failsafe_rad, altitude_min_m, altitude_max_m : measured; beyond them is a failsafe
    attitude_jump_rad, attitude_rate_max_rad_s : a change between two samples of more than
        jump + rate * dt is impossible
    altitude_jump_m, climb_rate_max_m_s : the same for altitude; also the largest measured rates
    climb_rate_setpoint_max_m_s : fastest change of the height that a scenario or anybody asks for
    fence_radius_m : farthest from where control was taken; places that are asked for must lie
        `fence_margin_m` inside
    battery_min_percent : below it control is not taken
    tilt_compensation_max_rad : thrust is divided by cos(roll) cos(pitch) down to this angle's cosine
    """

    tilt_max_rad: float = pi / 6.0
    body_rate_max_rad_s: tuple[float, float, float] = (3.5, 3.5, 1.5)
    body_rate_change_max_rad_s2: float = 200.0
    thrust_min: float = 0.05
    thrust_max: float = 0.95
    thrust_rate_max_per_s: float = 20.0
    tilt_failsafe_rad: float = pi / 3.0
    altitude_min_m: float = -3.0
    altitude_max_m: float = 50.0
    attitude_jump_rad: float = 0.2
    attitude_rate_max_rad_s: float = 10.0
    altitude_jump_m: float = 0.5
    climb_rate_max_m_s: float = 10.0
    climb_rate_setpoint_max_m_s: float = 5.0
    fence_radius_m: float = 100.0
    battery_min_percent: float = 20.0
    tilt_compensation_max_rad: float = pi / 3.0

    def __post_init__(self) -> None:
        _require(self, "limits", lower=-inf)
        if not 0.0 <= self.thrust_min < self.thrust_max <= 1.0:
            raise ValueError(
                f"limits.thrust_min = {self.thrust_min}, thrust_max = {self.thrust_max}: "
                "must be 0 <= thrust_min < thrust_max <= 1"
            )
        if not 0.0 < self.tilt_max_rad <= self.tilt_failsafe_rad <= 0.5 * pi:
            raise ValueError(
                f"limits.tilt_max_rad = {self.tilt_max_rad:.3f} (tilt_max_deg = "
                f"{degrees(self.tilt_max_rad):g}): must be positive and at most tilt_failsafe_rad = "
                f"{self.tilt_failsafe_rad:.3f} (tilt_failsafe_deg = {degrees(self.tilt_failsafe_rad):g}), "
                "which must be at most pi/2"
            )
        if self.altitude_min_m >= self.altitude_max_m:
            raise ValueError(
                f"limits.altitude_min_m = {self.altitude_min_m}: must be below "
                f"altitude_max_m = {self.altitude_max_m}"
            )
        for name in ("fence_radius_m", "climb_rate_setpoint_max_m_s"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"limits.{name} = {getattr(self, name)}: must be positive")
        if not 0.0 < self.tilt_compensation_max_rad < pi / 2.0:
            raise ValueError(
                f"limits.tilt_compensation_max_rad = {self.tilt_compensation_max_rad:.3f} (tilt_compensation_"
                f"max_deg = {degrees(self.tilt_compensation_max_rad):g}): must be in (0, pi/2)"
            )
        for rate in (*self.body_rate_max_rad_s, self.body_rate_change_max_rad_s2, self.thrust_rate_max_per_s):
            if not isfinite(rate) or rate <= 0.0:
                raise ValueError(f"limits: rate limit {rate} must be positive and finite")

    @property
    def bounds(self) -> Bounds:
        """What a scenario may ask for."""
        return Bounds(
            self.altitude_min_m,
            self.altitude_max_m,
            self.climb_rate_setpoint_max_m_s,
            self.fence_radius_m,
            self.fence_radius_m - self.fence_margin_m,
        )

    @property
    def fence_margin_m(self) -> float:
        """How far inside the fence a place must lie, m: what a vehicle may overshoot at the end of a move."""
        return min(1.0, 0.1 * self.fence_radius_m)


@dataclass(frozen=True, slots=True)
class SequenceSettings:
    """Timing of getting and giving back control.

    Attributes
    ----------
    stream_time_s : setpoints before the mode is asked for (PX4 wants about 0.3 s)
    mode_retry_s, mode_timeout_s : asking for OFFBOARD
    arm_retry_s, arm_timeout_s : asking to arm (long: EKF and pre-arm checks)
    person_arm_timeout_s : waiting for a person to arm, when the daemon may not
    hold_retry_s, hold_timeout_s : asking for HOLD or LAND when giving back control
    disarm_retry_s, disarm_timeout_s : asking to disarm after touch-down
    confirm_grace_s : a heartbeat this soon after an accepted command may still show the old state
    gripper_timeout_s : a gripper command unanswered this long is announced
    resend_s : when no new setpoint was made for so long, one that is level or the last one is sent (PX4 wants
        2 Hz): thrust answers a climb rate with 2 omega_c, and held for longer than 1 / omega_c it overshoots
    own_heartbeat_s : period of the daemon's own heartbeat
    blend_time_s : time constant with which thrust goes from the autopilot's to the controller's
    """

    stream_time_s: float = 0.3
    mode_retry_s: float = 0.5
    mode_timeout_s: float = 5.0
    arm_retry_s: float = 1.0
    arm_timeout_s: float = 30.0
    person_arm_timeout_s: float = 60.0
    hold_retry_s: float = 0.5
    hold_timeout_s: float = 2.0
    disarm_retry_s: float = 0.5
    disarm_timeout_s: float = 10.0
    confirm_grace_s: float = 0.3
    gripper_timeout_s: float = 5.0
    resend_s: float = 0.1
    own_heartbeat_s: float = 1.0
    blend_time_s: float = 0.3

    def __post_init__(self) -> None:
        _require(self, "sequence", lower=1e-3)


@dataclass(frozen=True, slots=True)
class FlightSettings:
    """Take-off, profiles and landing.

    Attributes
    ----------
    px4_spool_time_s, ardupilot_spool_time_s : from arming until thrust reaches the motors
        (COM_SPOOLUP_TIME; 2 s low output + MOT_SPOOL_TIME)
    ramp_rate_per_s : growth of thrust until lift-off
    liftoff_climb_rate_m_s, liftoff_height_m : either of them is lift-off, once the ramp has reached
        `liftoff_thrust_fraction` of hover thrust (an estimate that drifts on the ground is none)
    liftoff_timeout_s : longest ramp; then thrust is taken back and the flight is given up
    acceleration_m_s2 : of the profiles of altitude and of moves
    arrival_tolerance_m, arrival_time_s : a take-off has arrived within this, for this long
    arrival_timeout_s : longest wait for that after the profile's end
    slow_height_m, slow_descent_rate_m_s : descent near the ground
    landing_lead_m : the descending reference is never further below the vehicle
    touchdown_thrust_fraction, touchdown_climb_rate_m_s, touchdown_time_s : vertical thrust below this
        fraction of hover thrust (or the autopilot says "on ground") and slower than this, for so long
    touchdown_ramp_s : thrust to zero after touch-down
    setpoint_speed_m_s, setpoint_climb_rate_m_s : on the way to a position that is asked for from outside
    setpoint_timeout_s : an attitude that is asked for from outside lasts so long
    """

    px4_spool_time_s: float = 1.0
    ardupilot_spool_time_s: float = 2.6
    ramp_rate_per_s: float = 0.35
    liftoff_climb_rate_m_s: float = 0.15
    liftoff_height_m: float = 0.08
    liftoff_thrust_fraction: float = 0.5
    liftoff_timeout_s: float = 6.0
    acceleration_m_s2: float = 1.0
    arrival_tolerance_m: float = 0.1
    arrival_time_s: float = 0.5
    arrival_timeout_s: float = 10.0
    slow_height_m: float = 1.0
    slow_descent_rate_m_s: float = 0.3
    landing_lead_m: float = 1.0
    touchdown_thrust_fraction: float = 0.5
    touchdown_climb_rate_m_s: float = 0.15
    touchdown_time_s: float = 0.4
    touchdown_ramp_s: float = 0.3
    setpoint_speed_m_s: float = 2.0
    setpoint_climb_rate_m_s: float = 1.0
    setpoint_timeout_s: float = 0.5

    def __post_init__(self) -> None:
        _require(self, "flight")
        for name in ("ramp_rate_per_s", "acceleration_m_s2", "slow_descent_rate_m_s", "touchdown_ramp_s"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"flight.{name} = {getattr(self, name)}: must be positive")


@dataclass(frozen=True, slots=True)
class PositionSettings:
    """The position ring (outer loop of x and y).

    Attributes
    ----------
    ring : from `control.position.design_ring`
    damping : the ring that takes its place where a load swings on a rope; None if `ring` damps a swing itself
    on_rope : loads are known to hang on one
    sway_rad_s : with which they swing on it, 0 without
    tilt_max_rad : largest tilt that the ring commands
    braking_m_s2 : deceleration that is reckoned with when the place to stop is captured
    error_max_m : distance between set point and estimate that is a failsafe
    jump_m, speed_max_m_s : a change of position between two samples of more than
        jump + speed * dt is impossible; also the largest measured speed
    """

    ring: PositionParameters
    tilt_max_rad: float
    braking_m_s2: float = 1.0
    error_max_m: float = 5.0
    jump_m: float = 1.0
    speed_max_m_s: float = 20.0
    damping: PositionParameters | None = None
    on_rope: bool = False
    sway_rad_s: float = 0.0

    def __post_init__(self) -> None:
        _require(self, "position")
        for name in ("tilt_max_rad", "braking_m_s2", "error_max_m", "speed_max_m_s"):
            if getattr(self, name) <= 0.0:
                raise ValueError(f"position.{name} = {getattr(self, name)}: must be positive")


@dataclass(frozen=True, slots=True)
class ServiceSettings:
    """All that the service is told before it starts.

    Attributes
    ----------
    controller : from `control.design.design`
    output : what roll, pitch and yaw of the controller command; must fit its design
    hover_thrust : normalised thrust that carries the empty vehicle
    scenario : what is flown after engaging; empty: hold until released
    engage : engage by itself, once, as soon as ready
    arm : the daemon may arm (and then disarms after landing)
    interrupted : an earlier run had control in this flight; do not engage by itself if it still goes on
    shadow : observe only; neither setpoints nor modes nor arming are ever sent
    failsafe_action : what happens to the vehicle when the service gives up
    position : the position ring, which then commands roll and pitch; None: attitude and altitude only
    payload : payload awareness; None: loads are a disturbance only
    """

    controller: ControllerParameters
    hover_thrust: float
    output: OutputKind = "rates"
    scenario: tuple[Segment, ...] = ()
    engage: bool = False
    arm: bool = False
    shadow: bool = False
    interrupted: bool = False
    failsafe_action: FailsafeAction = "stop"
    telemetry: TelemetrySettings = field(default_factory=TelemetrySettings)
    limits: LimitSettings = field(default_factory=LimitSettings)
    sequence: SequenceSettings = field(default_factory=SequenceSettings)
    flight: FlightSettings = field(default_factory=FlightSettings)
    position: PositionSettings | None = None
    payload: PayloadSettings | None = None

    def __post_init__(self) -> None:
        if not self.limits.thrust_min < self.hover_thrust < self.limits.thrust_max:
            raise ValueError(
                f"hover_thrust = {self.hover_thrust}: must lie between limits.thrust_min = "
                f"{self.limits.thrust_min} and thrust_max = {self.limits.thrust_max}"
            )
        touchdown = self.flight.touchdown_thrust_fraction * self.hover_thrust
        if self.limits.thrust_min >= touchdown:
            raise ValueError(
                f"limits.thrust_min = {self.limits.thrust_min}: touch-down is noticed below thrust "
                f"{touchdown:.3f}; set thrust_min lower"
            )
        check_fits(self.scenario, self.limits, self.flight, self.position)

    @property
    def reference_lag_s(self) -> float:
        """How far the tracking differentiator follows behind a ramp, s: twice its filter time (eq 16).

        A reference that is to go on with the present speed must begin this much ahead, or the
        differentiator brakes first.
        """
        differentiator = self.controller.differentiator
        return 0.0 if differentiator is None else 2.0 * differentiator.filter_time
