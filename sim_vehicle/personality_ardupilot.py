"""The firmware that behaves as ArduCopter does (ArduCopter/mode_guided.cpp, AC_AttitudeControl, AP_Motors).

Modes are ArduCopter's numbers. Sticks, which nobody holds here, count as centred in flight and as low on
the ground.
Attitude and body-rate setpoints move a *target attitude* with limited acceleration; the vehicle follows it.
"""

from __future__ import annotations

import math

from sim_vehicle import airframe, attitude_loop
from sim_vehicle.attitude_loop import LEVEL, Quaternion, Vector3
from sim_vehicle.attitude_mask import ATTITUDE_IGNORE, RATES_IGNORE, THROTTLE_IGNORE
from sim_vehicle.firmware import (
    IDLE,
    AttitudeSetpoint,
    Firmware,
    GripperAction,
    RateDemand,
    Readiness,
    Result,
    Severity,
)
from sim_vehicle.flight_modes import CopterMode
from sim_vehicle.guidance import Estimate, Guidance
from sim_vehicle.parameters import ParameterStore
from sim_vehicle.personality_ardupilot_gains import attitude_gains, guidance, rate_gains
from sim_vehicle.rate_loop import ZERO, RateGains

ARMING_DELAY_S = 2.0
"""After arming the outputs stay low this long, then MOT_SPOOL_TIME follows (ARMING_DELAY_SEC)."""

EKF_CHECKS_S = 1.0
"""Ten checks in a row have to find no position (ekf_check.cpp)."""

SHORTEST_TIMEOUT_S = 0.1
"""Least value of GUID_TIMEOUT that is heeded."""

GRIPPER_TEXT_DELAY_S = 0.5
"""STATUSTEXT about the gripper comes this much after the command's answer."""

QUATERNION_TOLERANCE = 1e-3
"""A quaternion whose length is further from 1 than this is refused."""

TARGET_LEAD = 0.6
"""The target attitude runs at most this angle [rad] ahead of the vehicle."""

NEAR_HOME = 5.0
"""RTL lands without climbing or flying within this distance of home [m]."""

USE_THRUST_OPTION = 8
"""Bit of GUID_OPTIONS: SET_ATTITUDE_TARGET carries thrust, not climb rate."""

_GUIDED = (CopterMode.GUIDED, CopterMode.GUIDED_NOGPS)
_NEED_POSITION = (CopterMode.GUIDED, CopterMode.LOITER, CopterMode.RTL, CopterMode.BRAKE)
_NOT_ARMABLE = (CopterMode.AUTO, CopterMode.RTL, CopterMode.LAND, CopterMode.BRAKE)


class ArduCopterFirmware(Firmware):
    """ArduCopter's behaviour; see the head of this file."""

    autopilot = 3
    mode: CopterMode
    land_mode, return_mode, hold_mode = CopterMode.LAND, CopterMode.RTL, CopterMode.LOITER
    reckoning_s = 7.0  # from SIM_GPS1_ENABLE 0 to an invalid position, measured

    def __init__(
        self, parameters: ParameterStore, body: airframe.AirframeParameters, readiness: Readiness
    ) -> None:
        self._attitude_gains = attitude_gains(parameters)
        super().__init__(parameters, body, readiness)
        self.mode = CopterMode.STABILIZE
        self._angle: AttitudeSetpoint | None = None
        self._angle_at_us = 0
        self._height_engaged = False
        self._taking_off = False
        self._takeoff_height = 0.0
        self._returning = False
        self._spool = 0.0
        self._target: Quaternion = LEVEL
        self._target_rates: Vector3 = ZERO
        self._gripper_text: tuple[int, str] | None = None

    # ----------------------------------------------------------------------------- telemetry

    @property
    def base_mode(self) -> int:
        """`base_mode` of HEARTBEAT: custom 1, guided 8, stabilised 16, manual input 64, armed 128."""
        guided = self.mode not in (CopterMode.STABILIZE, CopterMode.ALT_HOLD, CopterMode.LAND)
        return 1 | 16 | 64 | (8 if guided else 0) | (128 if self.armed else 0)

    @property
    def taking_off(self) -> bool:
        """GUIDED climbs to the height that was asked for."""
        return self._taking_off

    def reported_target(self) -> tuple[int, Quaternion, Vector3, float]:
        """ATTITUDE_TARGET: what is really being followed."""
        return 0, self.target_attitude, self.target_rates, self.thrust

    # ------------------------------------------------------------------------------ commands

    def set_custom_mode(self, custom_mode: int) -> Result:
        """Change the flight mode; FAILED if it is unknown or its needs are not met."""
        if custom_mode not in CopterMode.__members__.values():
            self._announce(Severity.WARNING, f"No such mode {custom_mode}")
            return Result.FAILED
        mode = CopterMode(custom_mode)
        if mode == CopterMode.AUTO or (mode in _NEED_POSITION and not self.position_ready):
            reason = "no mission that could fly" if mode == CopterMode.AUTO else "requires position"
            self._announce(Severity.WARNING, f"Mode change to {mode.label} failed: {reason}")
            return Result.FAILED
        self._switch(mode)
        return Result.ACCEPTED

    def arm(self, force: bool) -> Result:
        """Arm; FAILED before the estimator is ready, or in a mode that cannot be armed in."""
        if self.armed:
            return Result.ACCEPTED
        reason = ""
        if self.mode in _NOT_ARMABLE:
            reason = f"{self.mode.label} mode not armable"
        elif self.mode in _NEED_POSITION and not self.position_ready:
            reason = "Need Position Estimate"
        elif not self.attitude_ready:
            reason = "AHRS: waiting for attitude"
        if reason and not force:
            self._announce(Severity.CRITICAL, f"Arm: {reason}")
            return Result.FAILED
        self._set_armed(True, "")
        self._spool = 0.0
        self._switch(self.mode)
        return Result.ACCEPTED

    def disarm(self, force: bool) -> Result:
        """Disarm; FAILED in flight, unless forced."""
        if self.armed and not self.land.landed and not force:
            return Result.FAILED
        self._set_armed(False, "")
        return Result.ACCEPTED

    def take_off(self, height: float) -> Result:
        """Climb to `height` above home [m] from the ground, in GUIDED; in GUIDED_NOGPS nothing happens."""
        possible = self.armed and self.mode in _GUIDED and self.land.landed
        if not possible or not height > 0.0:
            return Result.FAILED
        self._taking_off = self.mode == CopterMode.GUIDED
        self._takeoff_height = height
        return Result.ACCEPTED

    def gripper(self, action: GripperAction) -> list[tuple[float, Result]] | None:
        """ACCEPTED at once and a text half a second later; FAILED if not enabled."""
        if self.parameters["GRIP_ENABLE"] < 1:
            return [(0.0, Result.FAILED)]
        self.grip(action)
        done = "released" if action == "release" else "grabbed"
        self._gripper_text = self.time_us + round(GRIPPER_TEXT_DELAY_S * 1e6), f"Gripper load {done}"
        return [(0.0, Result.ACCEPTED)]

    def accept_setpoint(self, setpoint: AttitudeSetpoint) -> None:
        """SET_ATTITUDE_TARGET: ignored outside the guided modes; misuse re-initialises the mode."""
        if self.mode not in _GUIDED:
            return
        mask = setpoint.type_mask
        length = math.hypot(*setpoint.attitude)
        crooked = not mask & ATTITUDE_IGNORE and not abs(length - 1.0) <= QUATERNION_TOLERANCE
        mixed = mask & RATES_IGNORE not in (0, RATES_IGNORE)
        if mask & THROTTLE_IGNORE or crooked or mixed or not math.isfinite(setpoint.thrust):
            self._switch(self.mode)
            return
        rates = ZERO if mask & RATES_IGNORE else setpoint.body_rates
        if not all(math.isfinite(value) for value in rates):
            self._switch(self.mode)
            return
        self._angle = setpoint._replace(body_rates=rates, thrust=min(1.0, max(-1.0, setpoint.thrust)))
        self._angle_at_us = self.time_us
        self._taking_off = False

    # --------------------------------------------------------------------------- supervision

    def _supervise(self, estimate: Estimate, dt: float) -> None:
        if self._gripper_text and self.time_us >= self._gripper_text[0]:
            self._announce(Severity.INFO, self._gripper_text[1])
            self._gripper_text = None
        self._watch_position()
        if not self.armed or not self.land.landed:
            return
        quiet_since = max(self.armed_at_us, self.landed_at_us) if self.flown else self.armed_at_us
        landing = self.mode in (CopterMode.LAND, CopterMode.RTL)
        delay = self.parameters["DISARM_DELAY"]
        waited = delay > 0.0 and self.since(quiet_since) >= delay and self.thrust <= 0.0
        if (landing and self.flown) or waited:
            self._set_armed(False, "")

    def _watch_position(self) -> None:
        """FS_EKF_ACTION 1: what needs a position lands without one (ekf_check.cpp)."""
        lost = self.settled and self.since(self._satellites_us) > self.reckoning_s + EKF_CHECKS_S
        if lost and self.armed and self.mode in _NEED_POSITION and self.parameters["FS_EKF_ACTION"] >= 1.0:
            self._announce(Severity.CRITICAL, "EKF failsafe: changed to LAND Mode", "position lost")
            self._switch(CopterMode.LAND)

    def _switch(self, mode: CopterMode) -> None:
        """Enter `mode`, or the present one afresh."""
        if mode != self.mode:
            self.events.append(f"mode {mode.label}")
        self.mode = mode
        self._taking_off = self._returning = False
        self._angle = None
        self._height_engaged = False
        if mode == CopterMode.GUIDED_NOGPS:
            self._angle = AttitudeSetpoint(RATES_IGNORE, LEVEL, ZERO, 0.0)
            self._angle_at_us = -(10**12)  # long ago: level, no climb
        self._engage(self.estimate)
        if mode == CopterMode.RTL and self.home is not None and self._distance_home() > NEAR_HOME:
            self._returning = True
            height = max(self.estimate.position[2], self.home[2] + 0.01 * self.parameters["RTL_ALT"])
            self.guidance.climb_to(height, self._climb_speed)

    def _engage(self, estimate: Estimate) -> None:
        self.guidance.engage(estimate, self._mean_thrust)
        self._target, self._target_rates = estimate.attitude, ZERO

    # --------------------------------------------------------------------------------- flying

    def _fly(self, estimate: Estimate, dt: float) -> RateDemand:
        if self.land.landed and not self._lift_wanted():
            self._spool = max(0.0, self._spool - dt / self._spool_time)
            return self._rest(estimate)
        if self._spool < 1.0:
            if self.since(self.armed_at_us) >= ARMING_DELAY_S:
                self._spool += dt / self._spool_time
            return self._rest(estimate)
        if self._taking_off:
            self._climb_out(estimate)
        if self._angle is not None:
            return self._fly_angle(self._angle, estimate, dt)
        if self.mode == CopterMode.STABILIZE:
            level = attitude_loop.from_euler(0.0, 0.0, self.guidance.yaw)
            return self._follow(estimate, level, ZERO, self._boosted(self.parameters["MOT_THST_HOVER"]), dt)
        self._steer(estimate)
        thrust = self._tilt_compensated(self.guidance.height_step(estimate, dt))
        if self.mode == CopterMode.ALT_HOLD or not self.position_ready:
            attitude = attitude_loop.from_euler(0.0, 0.0, self.guidance.yaw)
        else:
            attitude = self.guidance.attitude_step(estimate, dt)
        return self._follow(estimate, attitude, ZERO, thrust, dt)

    def _rest(self, estimate: Estimate) -> RateDemand:
        """Stand on the ground with all targets at what is measured."""
        self._engage(estimate)
        self._height_engaged = False
        self.target_attitude = self._target
        return IDLE

    def _lift_wanted(self) -> bool:
        if self._angle is None:
            return self._taking_off
        return not self._timed_out() and self._climb_or_thrust(self._angle)[0] > 0.0

    def _timed_out(self) -> bool:
        timeout = max(SHORTEST_TIMEOUT_S, self.parameters["GUID_TIMEOUT"])
        return self.since(self._angle_at_us) > timeout

    def _climb_or_thrust(self, setpoint: AttitudeSetpoint) -> tuple[float, bool]:
        """Value, and whether it is a thrust (0..1) rather than a climb rate [m/s]."""
        if int(self.parameters["GUID_OPTIONS"]) & USE_THRUST_OPTION:
            return setpoint.thrust, True
        offset = 2.0 * (min(1.0, max(0.0, setpoint.thrust)) - 0.5)
        name = "WPNAV_SPEED_UP" if offset > 0.0 else "WPNAV_SPEED_DN"
        return 0.01 * self.parameters[name] * offset, False

    def _fly_angle(self, setpoint: AttitudeSetpoint, estimate: Estimate, dt: float) -> RateDemand:
        """Guided attitude or body rates; after GUID_TIMEOUT level, no climb, no horizontal hold."""
        value, is_thrust = self._climb_or_thrust(setpoint)
        mask, attitude, rates = setpoint.type_mask, setpoint.attitude, setpoint.body_rates
        if self._timed_out():
            value, is_thrust, mask, rates = 0.0, False, RATES_IGNORE, ZERO
            attitude = attitude_loop.from_euler(0.0, 0.0, attitude_loop.yaw_of(self._target))
        if is_thrust:
            self._height_engaged = False
            thrust = self._boosted(max(0.0, value))
        else:
            if not self._height_engaged:
                self.guidance.engage(estimate, self._mean_thrust)
                self._height_engaged = True
            self.guidance.climb_at(value)
            thrust = self._tilt_compensated(self.guidance.height_step(estimate, dt))
        if mask & ATTITUDE_IGNORE:
            return self._pursue(estimate, rates, thrust, dt)
        return self._follow(estimate, attitude_loop.normalised(attitude), rates, thrust, dt)

    def _boosted(self, thrust: float) -> float:
        return self._tilt_compensated(thrust) if self.parameters["ATC_ANGLE_BOOST"] >= 1 else thrust

    def _follow(
        self, estimate: Estimate, attitude: Quaternion, rates: Vector3, thrust: float, dt: float
    ) -> RateDemand:
        """Attitude setpoint: let the target attitude close in on it, with `rates` [rad/s] in advance."""
        gains = self._attitude_gains
        gap = attitude_loop.error(self._target, attitude)
        closing = [
            attitude_loop.square_root_rate(gap[axis], gains.input_gain, gains.acceleration[axis])
            + rates[axis]
            for axis in range(3)
        ]
        return self._pursue(estimate, (closing[0], closing[1], closing[2]), thrust, dt)

    def _pursue(self, estimate: Estimate, wanted: Vector3, thrust: float, dt: float) -> RateDemand:
        """Turn the target attitude with `wanted` body rates [rad/s], within limits, and follow it."""
        gains = self._attitude_gains
        moving = []
        for axis in range(3):
            top = gains.rate_max[axis]
            bounded = attitude_loop.limit(wanted[axis], top) if top > 0.0 else wanted[axis]
            moving.append(
                attitude_loop.shape_rate(self._target_rates[axis], bounded, gains.acceleration[axis], dt)
            )
        self._target_rates = moving[0], moving[1], moving[2]
        self._target = attitude_loop.advanced(self._target, self._target_rates, dt)
        gap = attitude_loop.error(estimate.attitude, self._target)
        if math.hypot(*gap) > TARGET_LEAD:
            self._target = attitude_loop.towards(estimate.attitude, self._target, TARGET_LEAD)
            gap = attitude_loop.error(estimate.attitude, self._target)
        self.target_attitude = self._target
        ahead = self._target_rates if gains.feed_forward else ZERO
        rates = [
            ahead[axis]
            + attitude_loop.square_root_rate(gap[axis], gains.gain[axis], 0.5 * gains.acceleration[axis])
            for axis in range(3)
        ]
        return RateDemand((rates[0], rates[1], rates[2]), thrust)

    # ------------------------------------------------------------------------ own flight modes

    @property
    def _spool_time(self) -> float:
        return max(0.05, self.parameters["MOT_SPOOL_TIME"])

    @property
    def _climb_speed(self) -> float:
        return 0.01 * self.parameters["WPNAV_SPEED_UP"]

    def _distance_home(self) -> float:
        if self.home is None:
            return 0.0
        x, y, _ = self.estimate.position
        return math.hypot(x - self.home[0], y - self.home[1])

    def _climb_out(self, estimate: Estimate) -> None:
        height = self._takeoff_height + (self.home[2] if self.home else 0.0)
        self.guidance.climb_to(height, self._climb_speed)
        if not self.land.landed and abs(estimate.position[2] - height) < 0.2:
            self._taking_off = False

    def _steer(self, estimate: Estimate) -> None:
        """Targets of LAND and RTL."""
        if self.mode == CopterMode.RTL and self._returning and self.home is not None:
            if self._distance_home() < 1.0:
                self._returning = False
            elif self.height_above_home > 0.01 * self.parameters["RTL_ALT"] - 1.0:
                self.guidance.fly_to(self.home[0], self.home[1], 0.01 * self.parameters["WPNAV_SPEED"])
        elif self.mode in (CopterMode.LAND, CopterMode.RTL):
            high = self.height_above_home > 0.01 * self.parameters["LAND_ALT_LOW"]
            self.guidance.climb_at(-0.01 * self.parameters["WPNAV_SPEED_DN" if high else "LAND_SPEED"])

    # ---------------------------------------------------------------------------------- gains

    def _rate_gains(self) -> RateGains:
        self._attitude_gains = attitude_gains(self.parameters)
        return rate_gains(self.parameters)

    def _make_guidance(self) -> Guidance:
        return guidance(self.parameters, self.body.gravity)

    def _thrust_curve(self) -> float:
        return self.parameters["MOT_THST_EXPO"]
