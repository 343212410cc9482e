"""The firmware that behaves as PX4 does (modules/commander, mc_att_control, mc_rate_control).

Modes are `main << 16 | sub << 24`. Sticks, which nobody holds here, count as centred.
Where PX4 waits for its commander task, so does this: see `COMMANDER_PERIOD_US`.
"""

from __future__ import annotations

import math

from sim_vehicle import airframe, attitude_loop
from sim_vehicle.attitude_loop import Quaternion, Vector3, limit
from sim_vehicle.attitude_mask import YAW_RATE_IGNORE
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
from sim_vehicle.flight_modes import Px4Mode
from sim_vehicle.guidance import Estimate, Guidance
from sim_vehicle.parameters import ParameterStore
from sim_vehicle.personality_px4_gains import guidance, rate_gains
from sim_vehicle.px4_offboard import OffboardSetpoints
from sim_vehicle.rate_loop import RateGains

COMMANDER_PERIOD_US = 20_000
"""How often mode changes and failsafes are looked at; with it a resumed stream is back in 50 ms."""

LOSS_REACTION_S = 0.06
"""OFFBOARD is left this much later than COM_OF_LOSS_T; measured 1.07 to 1.09 s for 1.0 s, link included."""

_STICKS = (Px4Mode.MANUAL, Px4Mode.STABILIZED, Px4Mode.ACRO)
_NEED_POSITION = (Px4Mode.POSCTL, Px4Mode.TAKEOFF, Px4Mode.LOITER, Px4Mode.RTL, Px4Mode.LAND)
_LOSS_ACTIONS = {
    0: Px4Mode.POSCTL,
    1: Px4Mode.ALTCTL,
    2: Px4Mode.STABILIZED,
    3: Px4Mode.RTL,
    4: Px4Mode.LAND,
    5: Px4Mode.LOITER,
}
_LOSS_TERMINATE, _LOSS_DISARM = 6, 7


class Px4Firmware(Firmware):
    """PX4's behaviour; see the head of this file."""

    autopilot = 12
    mode: Px4Mode
    land_mode, return_mode, hold_mode = Px4Mode.LAND, Px4Mode.RTL, Px4Mode.LOITER
    reckoning_s = 4.0  # from EKF2_GPS_CTRL 0 to an invalid position, measured

    def __init__(
        self, parameters: ParameterStore, body: airframe.AirframeParameters, readiness: Readiness
    ) -> None:
        super().__init__(parameters, body, readiness)
        self.mode = Px4Mode.LOITER
        self.intended = Px4Mode.LOITER
        self.terminated = False
        self.setpoints = OffboardSetpoints()
        self._next_commander_us = 0
        self._attitude_thrust = 0.0
        self._takeoff_height = parameters["MIS_TAKEOFF_ALT"]
        self._climbing = False
        self._returning = False

    # ----------------------------------------------------------------------------- telemetry

    @property
    def base_mode(self) -> int:
        """`base_mode` of HEARTBEAT: custom 1, auto 4, guided 8, stabilised 16, manual 64, armed 128."""
        flags = 1 | (128 if self.armed else 0)
        if self.mode in (Px4Mode.MANUAL, Px4Mode.ACRO):
            return flags | 64
        if self.mode in (Px4Mode.STABILIZED, Px4Mode.ALTCTL, Px4Mode.POSCTL):
            return flags | 64 | 16
        return flags | 4 | 8 | 16

    @property
    def taking_off(self) -> bool:
        """PX4 takes off in a mode of its own."""
        return self.mode == Px4Mode.TAKEOFF

    def reported_target(self) -> tuple[int, Quaternion, Vector3, float]:
        """ATTITUDE_TARGET as PX4 fills it: mask 0 and, in rate mode too, the *attitude* setpoint's thrust."""
        return 0, self.target_attitude, self.target_rates, self._attitude_thrust

    # ------------------------------------------------------------------------------ commands

    @property
    def stream_alive(self) -> bool:
        """An offboard setpoint came within COM_OF_LOSS_T."""
        came_us = self.setpoints.came_us
        return came_us is not None and self.since(came_us) <= self.parameters["COM_OF_LOSS_T"]

    def set_custom_mode(self, custom_mode: int) -> Result:
        """Change the flight mode; TEMPORARILY_REJECTED if its needs are not met."""
        if custom_mode not in Px4Mode.__members__.values():
            return Result.DENIED
        mode = Px4Mode(custom_mode)
        if not self._possible(mode):
            self._announce(Severity.CRITICAL, f"Switching to {mode.label} not possible")
            return Result.TEMPORARILY_REJECTED
        self.intended, self.in_failsafe = mode, False
        self._switch(mode)
        return Result.ACCEPTED

    def _possible(self, mode: Px4Mode) -> bool:
        if mode == Px4Mode.OFFBOARD:
            return self.stream_alive and self.attitude_ready
        if mode == Px4Mode.MISSION:
            return False  # missions are stored, not flown
        return self.position_ready if mode in _NEED_POSITION else self.attitude_ready

    def arm(self, force: bool) -> Result:
        """Arm; TEMPORARILY_REJECTED before the estimator is ready, or if the mode cannot run."""
        if self.armed:
            return Result.ACCEPTED
        reason = ""
        if not self._possible(self.mode):
            reason = "no offboard signal" if self.mode == Px4Mode.OFFBOARD else "estimator not ready"
        elif self.mode in _STICKS:
            reason = "throttle above center"
        if reason and not force:
            self._announce(Severity.CRITICAL, f"Arming denied: {reason}")
            return Result.TEMPORARILY_REJECTED
        self.terminated = self.in_failsafe = False
        self._set_armed(True, "by external command")
        self._switch(self.mode)
        return Result.ACCEPTED

    def disarm(self, force: bool) -> Result:
        """Disarm; TEMPORARILY_REJECTED while not landed, unless forced."""
        if self.armed and not self.land.landed and not force:
            self._announce(Severity.CRITICAL, "Disarming denied: not landed")
            return Result.TEMPORARILY_REJECTED
        self._disarm("by external command")
        return Result.ACCEPTED

    def take_off(self, height: float) -> Result:
        """Climb to `height` above home [m], or MIS_TAKEOFF_ALT, and hold."""
        result = self.set_custom_mode(Px4Mode.TAKEOFF)
        if result == Result.ACCEPTED:
            usual = self.parameters["MIS_TAKEOFF_ALT"]
            self._takeoff_height = height if math.isfinite(height) else usual
        return result

    def reposition(self, place: tuple[float, float] | None, height: float) -> Result:
        """Hold there, at the speeds of the autopilot's own flights."""
        result = self.loiter()
        if result == Result.ACCEPTED and math.isfinite(height):
            base = self.home[2] if self.home else 0.0
            self.guidance.climb_to(base + height, self.parameters["MPC_Z_VEL_MAX_UP"])
        if result == Result.ACCEPTED and place is not None:
            self.guidance.fly_to(*place, self.parameters["MPC_XY_CRUISE"])
        return result

    def gripper(self, action: GripperAction) -> list[tuple[float, Result]] | None:
        """IN_PROGRESS, then ACCEPTED after PD_GRIPPER_TO; no answer at all if not enabled."""
        if self.parameters["PD_GRIPPER_EN"] < 1:
            return None
        self.grip(action)
        return [(0.0, Result.IN_PROGRESS), (self.parameters["PD_GRIPPER_TO"], Result.ACCEPTED)]

    def accept_setpoint(self, setpoint: AttitudeSetpoint) -> None:
        """SET_ATTITUDE_TARGET."""
        self.setpoints.accept(self.time_us, setpoint)

    # --------------------------------------------------------------------------- supervision

    def _supervise(self, estimate: Estimate, dt: float) -> None:
        if self.time_us >= self._next_commander_us:
            self._next_commander_us = self.time_us + COMMANDER_PERIOD_US
            self.setpoints.look_up(self.time_us)
            self._watch_stream()
            self._watch_position()
            self._auto_disarm()
        if self.mode == Px4Mode.TAKEOFF and self._climbing and self._takeoff_done(estimate):
            self._finish_takeoff()

    def _watch_stream(self) -> None:
        if self.mode == Px4Mode.OFFBOARD:
            if self.since(self.setpoints.came_us or 0) > self.parameters["COM_OF_LOSS_T"] + LOSS_REACTION_S:
                self._lose_stream()
        elif self.in_failsafe and self.intended == Px4Mode.OFFBOARD and self.stream_alive:
            self.in_failsafe = False
            self._announce(Severity.INFO, "Offboard signal regained", "offboard regained")
            self._switch(Px4Mode.OFFBOARD)

    def _watch_position(self) -> None:
        """What needs a position descends without one; OFFBOARD by attitudes or rates needs none."""
        lost = self.mode in _NEED_POSITION and self.settled and not self.position_ready
        if lost and self.armed and not self.in_failsafe:
            self.in_failsafe = True
            self._announce(Severity.CRITICAL, "Failsafe activated: position lost", "position lost")
            self._switch(Px4Mode.LAND)

    def _lose_stream(self) -> None:
        self.in_failsafe = True
        self._announce(Severity.CRITICAL, "Failsafe activated: offboard signal lost", "offboard lost")
        action = int(self.parameters["COM_OBL_RC_ACT"])
        if not self.armed:
            self._switch(Px4Mode.LOITER)
        elif action == _LOSS_TERMINATE:
            self.terminated = True
            self._switch(Px4Mode.LOITER)
        elif action == _LOSS_DISARM:
            self._disarm("by failsafe")
            self._switch(Px4Mode.LOITER)
        else:
            wanted = _LOSS_ACTIONS.get(action, Px4Mode.LAND)
            self._switch(wanted if self._possible(wanted) else Px4Mode.LAND)

    def _auto_disarm(self) -> None:
        if not (self.armed and self.land.landed):
            return
        name, start = "COM_DISARM_PRFLT", self.armed_at_us
        if self.flown:
            name, start = "COM_DISARM_LAND", self.landed_at_us
        delay = self.parameters[name]
        if delay > 0.0 and self.since(start) >= delay and self.thrust < self._low_thrust():
            self._disarm("by landing" if self.flown else "by auto preflight disarming")

    def _low_thrust(self) -> float:
        return self.low_thrust_share * self.guidance.vertical_gains.hover_thrust

    def _disarm(self, reason: str) -> None:
        self._set_armed(False, reason)
        if self.mode in (Px4Mode.LAND, Px4Mode.RTL, Px4Mode.TAKEOFF):
            self._switch(Px4Mode.LOITER)
            if self.intended != Px4Mode.OFFBOARD:
                self.intended = Px4Mode.LOITER

    def _switch(self, mode: Px4Mode) -> None:
        if mode != self.mode:
            self.events.append(f"mode {mode.label}")
            self._takeoff_height = self.parameters["MIS_TAKEOFF_ALT"]
        self.mode = mode
        self.setpoints.look_up(self.time_us, now=True)
        self._climbing = self._returning = False
        estimate = self.estimate
        self.guidance.engage(estimate, self._mean_thrust)
        if mode == Px4Mode.LAND:
            self.guidance.climb_at(-self.parameters["MPC_LAND_SPEED"])
        elif mode == Px4Mode.RTL and self.home is not None:
            distance = math.hypot(estimate.position[0] - self.home[0], estimate.position[1] - self.home[1])
            self._returning = True
            if distance > self.parameters["RTL_MIN_DIST"]:
                height = self.home[2] + self.parameters["RTL_RETURN_ALT"]
                self.guidance.climb_to(max(height, estimate.position[2]), self.parameters["MPC_Z_VEL_MAX_UP"])

    # --------------------------------------------------------------------------------- flying

    def _fly(self, estimate: Estimate, dt: float) -> RateDemand:
        if self.terminated:
            return IDLE
        if self.mode == Px4Mode.OFFBOARD:
            return self._fly_offboard(estimate)
        if self.mode == Px4Mode.TAKEOFF and not self._climbing:
            self._start_takeoff(estimate)
        if self.land.landed and not self._climbing:
            self.guidance.engage(estimate, self._mean_thrust)
            return IDLE
        if self.mode == Px4Mode.RTL:
            self._advance_return(estimate)
        if self.mode == Px4Mode.LAND:
            self.guidance.climb_at(-self._land_speed())
        if self.mode in _STICKS:
            thrust = self._tilt_compensated(self.parameters["MPC_THR_HOVER"])
            level = attitude_loop.from_euler(0.0, 0.0, estimate.euler[2])
            return self._fly_attitude(estimate, level, thrust)
        thrust = self._tilt_compensated(self.guidance.height_step(estimate, dt))
        if self.mode == Px4Mode.ALTCTL or not self.position_ready:
            level = attitude_loop.from_euler(0.0, 0.0, self.guidance.yaw)
            return self._fly_attitude(estimate, level, thrust)
        return self._fly_attitude(estimate, self.guidance.attitude_step(estimate, dt), thrust)

    def _fly_offboard(self, estimate: Estimate) -> RateDemand:
        if not self.setpoints.attitude_counts:
            return self.setpoints.rates or IDLE
        setpoint = self.setpoints.attitude
        assert setpoint is not None
        given = not setpoint.type_mask & YAW_RATE_IGNORE and math.isfinite(setpoint.body_rates[2])
        yaw_rate = setpoint.body_rates[2] if given else 0.0
        return self._fly_attitude(estimate, setpoint.attitude, setpoint.thrust, yaw_rate)

    def _fly_attitude(
        self, estimate: Estimate, attitude: Quaternion, thrust: float, yaw_rate: float = 0.0
    ) -> RateDemand:
        """Proportional attitude loop, limited to MC_ROLLRATE_MAX and so on [deg/s]."""
        p = self.parameters
        self.target_attitude, self._attitude_thrust = attitude, thrust
        x, y, z = attitude_loop.error(estimate.attitude, attitude)
        rates = (
            limit(p["MC_ROLL_P"] * x, math.radians(p["MC_ROLLRATE_MAX"])),
            limit(p["MC_PITCH_P"] * y, math.radians(p["MC_PITCHRATE_MAX"])),
            limit(p["MC_YAW_P"] * z + yaw_rate, math.radians(p["MC_YAWRATE_MAX"])),
        )
        return RateDemand(rates, thrust)

    def _start_takeoff(self, estimate: Estimate) -> None:
        """Climb, once the motors are up; never down (navigator/takeoff.cpp)."""
        base = self.home[2] if self.home else estimate.position[2]
        height = base + self._takeoff_height
        if height < estimate.position[2]:
            self._announce(Severity.CRITICAL, "Already higher than takeoff altitude")
            self._finish_takeoff()
            return
        if self.land.landed and self.since(self.armed_at_us) < self.parameters["COM_SPOOLUP_TIME"]:
            return
        self._climbing = True
        self.guidance.engage(estimate, self._mean_thrust)
        self.guidance.climb_to(height, self.parameters["MPC_TKO_SPEED"])

    def _takeoff_done(self, estimate: Estimate) -> bool:
        base = self.home[2] if self.home else 0.0
        return not self.land.landed and estimate.position[2] > base + self._takeoff_height - 0.3

    def _finish_takeoff(self) -> None:
        """Takeoff ends in Hold at the height aimed at, without starting the height loop afresh."""
        self.mode = self.intended = Px4Mode.LOITER
        self._climbing = False
        self.events.append("mode HOLD")

    def _land_speed(self) -> float:
        if self.height_above_home > self.parameters["MPC_LAND_ALT2"]:
            return self.parameters["MPC_Z_VEL_MAX_DN"]
        return self.parameters["MPC_LAND_SPEED"]

    def _advance_return(self, estimate: Estimate) -> None:
        """RTL: climb, fly home, land there."""
        if self.home is None:
            return
        distance = math.hypot(estimate.position[0] - self.home[0], estimate.position[1] - self.home[1])
        if not self._returning or distance < 1.0:
            self._returning = False
            self.guidance.climb_at(-self._land_speed())
        elif distance <= self.parameters["RTL_MIN_DIST"] or self._high_enough(estimate):
            self.guidance.fly_to(self.home[0], self.home[1], self.parameters["MPC_XY_CRUISE"])

    def _high_enough(self, estimate: Estimate) -> bool:
        return self.height_above_home > self.parameters["RTL_RETURN_ALT"] - 1.0

    # ---------------------------------------------------------------------------------- gains

    def _rate_gains(self) -> RateGains:
        return rate_gains(self.parameters)

    def _make_guidance(self) -> Guidance:
        return guidance(self.parameters, self.body.gravity)

    def _thrust_curve(self) -> float:
        return self.parameters["THR_MDL_FAC"]
