"""A small autopilot: what both personalities share.

Sans-I/O: fed with estimates and commands, it returns motor commands. The personalities
(`personality_px4`, `personality_ardupilot`) add modes, arming rules, setpoint semantics and failsafes.
Everything is in the paper's axes, SI units and radians; nothing here knows MAVLink, except that results,
mode numbers and states carry MAVLink's numbers.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from enum import IntEnum
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from sim_vehicle import airframe, land_detector, rate_loop
from sim_vehicle.attitude_loop import LEVEL, Quaternion, Vector3
from sim_vehicle.flight_modes import FlightMode
from sim_vehicle.guidance import Estimate, Guidance
from sim_vehicle.parameters import ParameterStore
from sim_vehicle.rate_loop import ZERO, RateGains, RateState

GripperAction: TypeAlias = Literal["release", "grab"]

MEAN_THRUST_TIME = 1.0
"""Time constant [s] of the mean thrust that seeds the height loop when a mode takes over."""

MIN_TILT_COSINE = 0.5
"""Thrust is raised against tilt only down to this cosine (60 degrees)."""


class Result(IntEnum):
    """MAV_RESULT."""

    ACCEPTED = 0
    TEMPORARILY_REJECTED = 1
    DENIED = 2
    UNSUPPORTED = 3
    FAILED = 4
    IN_PROGRESS = 5


class LandedState(IntEnum):
    """MAV_LANDED_STATE."""

    ON_GROUND = 1
    IN_AIR = 2
    TAKEOFF = 3
    LANDING = 4


class Severity(IntEnum):
    """The MAV_SEVERITY values that the firmware uses."""

    CRITICAL = 2
    WARNING = 4
    NOTICE = 5
    INFO = 6


class AttitudeSetpoint(NamedTuple):
    """SET_ATTITUDE_TARGET in the paper's axes: type mask as sent, attitude, body rates [rad/s], thrust."""

    type_mask: int
    attitude: Quaternion
    body_rates: Vector3
    thrust: float


class RateDemand(NamedTuple):
    """What a flight mode asks for: body rates [rad/s] and collective thrust 0..1; idle on the ground."""

    body_rates: Vector3
    thrust: float
    idle: bool = False


IDLE = RateDemand(ZERO, 0.0, True)


class Readiness(NamedTuple):
    """When the estimator is ready after power-up [us]: attitude first, position later."""

    attitude_us: int
    position_us: int


class Firmware(ABC):
    """One autopilot. `step` once per control period; commands in between.

    `killed` is its pilot's kill switch (ArduCopter's emergency stop): armed, and motors that stand still.
    """

    autopilot: int
    """MAV_AUTOPILOT."""
    mode: FlightMode
    """The present flight mode."""
    land_mode: FlightMode
    """LAND."""
    return_mode: FlightMode
    """Return to home and land."""
    hold_mode: FlightMode
    """Hold position."""
    low_thrust_share: float = 0.5
    """Thrust below this share of hover thrust counts as low for the land detector."""
    reckoning_s: float
    """How long the estimator believes its own reckoning when there are no satellites [s]."""

    def __init__(
        self, parameters: ParameterStore, body: airframe.AirframeParameters, readiness: Readiness
    ) -> None:
        self.parameters = parameters
        self.body = body
        self.readiness = readiness
        self.time_us = 0
        self.armed = False
        self.armed_at_us = 0
        self.flown = False
        self.landed_at_us = 0
        self.in_failsafe = False
        self.killed = False
        self._satellites_us = 0
        self.home: Vector3 | None = None
        self.estimate = Estimate(0, ZERO, ZERO, ZERO, ZERO, 0.0)
        self.land = land_detector.LandState()
        self.texts: list[tuple[Severity, str]] = []
        self.events: list[str] = []
        self.gripper_requests: list[GripperAction] = []
        self.thrust = 0.0
        self.motor_commands = [0.0, 0.0, 0.0, 0.0]
        self.target_attitude: Quaternion = LEVEL
        self.target_rates: Vector3 = ZERO
        self._rates = RateState()
        self._saturation: Vector3 = ZERO
        self._revision = -1
        self._gains = self._rate_gains()
        self.guidance = self._make_guidance()
        self._mean_thrust = self.guidance.vertical_gains.hover_thrust
        newton = body.motor_max_thrust
        self._full_torque: Vector3 = (
            body.arm * newton,
            body.arm * newton,
            2.0 * body.yaw_moment_per_thrust * newton,
        )

    # ------------------------------------------------------------------ what personalities add

    @property
    @abstractmethod
    def base_mode(self) -> int:
        """`base_mode` of HEARTBEAT."""

    @property
    @abstractmethod
    def taking_off(self) -> bool:
        """A take-off of the firmware's own is under way."""

    @abstractmethod
    def set_custom_mode(self, custom_mode: int) -> Result:
        """Change the flight mode by its `custom_mode` number."""

    @abstractmethod
    def arm(self, force: bool) -> Result:
        """Arm, if the rules allow it."""

    @abstractmethod
    def disarm(self, force: bool) -> Result:
        """Disarm; refused in flight unless forced."""

    @abstractmethod
    def take_off(self, height: float) -> Result:
        """MAV_CMD_NAV_TAKEOFF: `height` above home [m], NaN for the firmware's own default."""

    @abstractmethod
    def accept_setpoint(self, setpoint: AttitudeSetpoint) -> None:
        """SET_ATTITUDE_TARGET."""

    @abstractmethod
    def reported_target(self) -> tuple[int, Quaternion, Vector3, float]:
        """ATTITUDE_TARGET: type mask, attitude, body rates [rad/s], thrust."""

    @abstractmethod
    def _supervise(self, estimate: Estimate, dt: float) -> None:
        """Timeouts, failsafes and automatic mode changes, once per step."""

    @abstractmethod
    def _fly(self, estimate: Estimate, dt: float) -> RateDemand:
        """What the present flight mode asks for; called while armed."""

    @abstractmethod
    def _rate_gains(self) -> RateGains:
        """Gains of the rate loop from the parameters."""

    @abstractmethod
    def _make_guidance(self) -> Guidance:
        """Height and position cascades with gains from the parameters."""

    @abstractmethod
    def _thrust_curve(self) -> float:
        """Share of the square in the assumed thrust curve, 0..1 (THR_MDL_FAC, MOT_THST_EXPO)."""

    # ------------------------------------------------------------------------------- one step

    def step(self, estimate: Estimate, dt: float) -> list[float]:
        """Motor commands (4) 0..1 for the next `dt` seconds."""
        self.estimate = estimate
        self.time_us = estimate.time_us
        if self.parameters.revision != self._revision:
            self._refresh()
        if estimate.satellites:
            self._satellites_us = estimate.time_us
        if self.home is None and self.position_ready:
            self.home = estimate.position
        self._supervise(estimate, dt)
        if not self.armed:
            self._rates, self.thrust, self.target_rates = RateState(), 0.0, ZERO
            self.motor_commands = [0.0, 0.0, 0.0, 0.0]
            return self.motor_commands
        demand = self._fly(estimate, dt)
        self._watch_ground(estimate, demand, dt)
        self.motor_commands = self._motors(demand, estimate, dt)
        if self.killed:
            self.motor_commands = [0.0, 0.0, 0.0, 0.0]
        return self.motor_commands

    def _refresh(self) -> None:
        """Take over changed parameters."""
        self._revision = self.parameters.revision
        self._gains = self._rate_gains()
        fresh = self._make_guidance()
        self.guidance.vertical_gains = fresh.vertical_gains
        self.guidance.horizontal_gains = fresh.horizontal_gains

    def _motors(self, demand: RateDemand, estimate: Estimate, dt: float) -> list[float]:
        self.thrust, self.target_rates = demand.thrust, demand.body_rates
        if demand.idle:
            self._rates = RateState()
            return [0.0, 0.0, 0.0, 0.0]
        self._rates, share = rate_loop.step(
            self._gains,
            self._rates,
            demand.body_rates,
            estimate.body_rates,
            self._saturation,
            not self.land.landed,
            dt,
        )
        full = self._full_torque
        torque = np.array([share[0] * full[0], share[1] * full[1], share[2] * full[2]])
        front, left, rear, right = airframe.mix(self.body, demand.thrust, torque).tolist()
        self._saturation = (
            share[0] - (left - right),
            share[1] - (rear - front),
            share[2] - 0.5 * (front - left + rear - right),
        )
        self._saturation = _without_rounding(self._saturation)
        curve = self._thrust_curve()
        commands = [front, left, rear, right]
        return commands if curve <= 0.0 else [inverse_thrust_curve(value, curve) for value in commands]

    def _watch_ground(self, estimate: Estimate, demand: RateDemand, dt: float) -> None:
        hover = self.guidance.vertical_gains.hover_thrust
        before = self.land.landed
        self.land = land_detector.step(
            self.land,
            demand.thrust,
            self.low_thrust_share * hover,
            estimate.position[2],
            estimate.velocity[2],
            math.hypot(estimate.velocity[0], estimate.velocity[1]),
            dt,
        )
        if self.land.landed:
            self._mean_thrust = hover
            if not before:
                self.landed_at_us = self.time_us
                self._announce(Severity.INFO, "Landing detected", "landed")
        else:
            vertical = demand.thrust * math.cos(estimate.euler[0]) * math.cos(estimate.euler[1])
            share = min(1.0, dt / MEAN_THRUST_TIME)
            self._mean_thrust += share * (vertical - self._mean_thrust)
            if before:
                self.flown = True
                self._announce(Severity.INFO, "Takeoff detected", "takeoff")

    # --------------------------------------------------------------------------------- shared

    @property
    def custom_mode(self) -> int:
        """`custom_mode` of HEARTBEAT."""
        return int(self.mode)

    @property
    def mode_name(self) -> str:
        """Name of the flight mode, as the firmware's users know it."""
        return self.mode.label

    @property
    def landed_state(self) -> LandedState:
        """`landed_state` of EXTENDED_SYS_STATE."""
        if self.land.landed:
            return LandedState.ON_GROUND
        if self.taking_off:
            return LandedState.TAKEOFF
        return LandedState.LANDING if self.mode == self.land_mode else LandedState.IN_AIR

    def land_here(self) -> Result:
        """MAV_CMD_NAV_LAND."""
        return self.set_custom_mode(self.land_mode)

    def return_home(self) -> Result:
        """MAV_CMD_NAV_RETURN_TO_LAUNCH."""
        return self.set_custom_mode(self.return_mode)

    def loiter(self) -> Result:
        """MAV_CMD_NAV_LOITER_UNLIM, and the pause of MAV_CMD_DO_PAUSE_CONTINUE."""
        return self.set_custom_mode(self.hold_mode)

    def reposition(self, place: tuple[float, float] | None, height: float) -> Result:
        """MAV_CMD_DO_REPOSITION: to `place` x, y [m] (None: here), `height` above home [m] (NaN: as now)."""
        return Result.UNSUPPORTED if place is not None else self.loiter()

    @property
    def attitude_ready(self) -> bool:
        """The estimator has an attitude."""
        return self.time_us >= self.readiness.attitude_us

    @property
    def settled(self) -> bool:
        """The estimator has a height, and has had a position: it is sent, whatever becomes of it."""
        return self.time_us >= self.readiness.position_us

    @property
    def position_ready(self) -> bool:
        """The estimator has a position, and has not reckoned without satellites for too long."""
        return self.settled and self.since(self._satellites_us) <= self.reckoning_s

    @property
    def height_above_home(self) -> float:
        """Height above home [m]; above the origin while there is no home."""
        return self.estimate.position[2] - (self.home[2] if self.home else 0.0)

    def since(self, time_us: int) -> float:
        """Seconds from `time_us` to now."""
        return (self.time_us - time_us) * 1e-6

    def grip(self, action: GripperAction) -> None:
        """Move the gripper; the vehicle shell takes the request from `gripper_requests`."""
        self.gripper_requests.append(action)

    @abstractmethod
    def gripper(self, action: GripperAction) -> list[tuple[float, Result]] | None:
        """MAV_CMD_DO_GRIPPER: answers as (delay [s], result), or None for no answer at all."""

    def _announce(self, severity: Severity, text: str, event: str = "") -> None:
        self.texts.append((severity, text))
        if event:
            self.events.append(event)

    def _set_armed(self, armed: bool, reason: str) -> None:
        if armed == self.armed:
            return
        self.armed = armed
        if armed:
            self.armed_at_us, self.flown = self.time_us, False
            self.land = land_detector.LandState(True, self.estimate.position[2], 0.0)
            if self.position_ready:
                self.home = self.estimate.position
        self._rates = RateState()
        word = "armed" if armed else "disarmed"
        self._announce(Severity.INFO, f"{word.capitalize()} {reason}".strip(), word)

    def _tilt_compensated(self, vertical_thrust: float) -> float:
        roll, pitch, _ = self.estimate.euler
        return min(1.0, vertical_thrust / max(MIN_TILT_COSINE, math.cos(roll) * math.cos(pitch)))


def inverse_thrust_curve(thrust: float, factor: float) -> float:
    """Command u with (1 - factor) u + factor u^2 = thrust, for a command and a factor of 0..1.

    What an autopilot applies that believes in such a curve (THR_MDL_FAC, MOT_THST_EXPO). This
    simulator's motors have none, so any factor above zero distorts.
    """
    linear = 1.0 - factor
    bounded = min(1.0, max(0.0, thrust))
    return (-linear + math.sqrt(linear * linear + 4.0 * factor * bounded)) / (2.0 * factor)


def _without_rounding(values: Vector3) -> Vector3:
    """Zeros where only floating-point noise is left."""
    x, y, z = (0.0 if abs(value) < 1e-9 else value for value in values)
    return x, y, z
