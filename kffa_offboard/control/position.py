"""The position ring: north and west position by the same law, commanding roll and pitch references.

The paper draws this outer ring (Fig 2) and shows nothing of it. Here x and y are two more channels of
the blocks in `controllers.py`, stacked as ``(2[, N])``: tracking differentiator, Kalman filter, observer,
fuzzy rules and law. The command is a horizontal acceleration. With the altitude channel carrying the weight,
thrust along body z, R e3 of eq 3, gives

    x'' = g (cos roll sin pitch cos yaw + sin roll sin yaw) / (cos roll cos pitch)
    y'' = g (cos roll sin pitch sin yaw - sin roll cos yaw) / (cos roll cos pitch)

(first two lines of eq 15 with U1 from the third), and `attitude_of` solves that for roll and pitch.

Differs from the paper in: acceleration, not the angles, is the command, so that b0 is 1 and the heading is
no coupling; tilt is limited (the direction of the acceleration stays) and the observer told the limited
command; the inner attitude loop is this ring's actuator, with its delay and lag. Where the measured
attitude is known, the observer is told the acceleration that *it* gives, whatever the inner loop made of the
command, and delay and lag only say how the commands under way will act.

A load on a rope is another plant, which this law drives to swing (`pendulum.py`): there a PID goes on
(`going_on`).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from msgspec.structs import replace

from kffa_offboard.control import Array, BoolArray, controllers, design, fuzzy

CHANNELS = ("x", "y")
STANDARD_GRAVITY = 9.80665


def _pair(value: float) -> Array:
    return np.full(2, value)


def _pid_gains(omega_c: float) -> Array:
    """Kp, ki, kd (3, 2) of controller "pid": three poles at omega_c / 4.

    Half of what the other channels get: this ring's actuator is late by a whole attitude loop, and a PID does
    not look ahead; at omega_c / 2 it oscillates.
    """
    w = omega_c / 4.0
    return np.repeat([[3.0 * w**2], [w**3], [3.0 * w]], 2, axis=1)


def answer_of(name: controllers.ControllerName, numbers: PositionDesign) -> tuple[float, float, float] | None:
    """Acceleration against a displacement, kp [1/s^2], ki [1/s^3], kd [1/s]; None for what is no PID."""
    if name == "pid":
        kp, ki, kd = _pid_gains(numbers.omega_c)[:, 0].tolist()
        return kp, ki, kd
    if name == "cascaded-pid":
        p, i, d = numbers.cascade_gains
        return d * p + i, i * p, d
    return None


@dataclass(frozen=True)
class PositionDesign:
    """The numbers of the ring, the same for x and y.

    Attributes
    ----------
    omega_c, omega_o, omega_c_range : rad/s, see `design.DesignSettings`
    tilt_max : rad, of the commanded attitude
    delay, lag : s, of the attitude loop behind its reference
    prediction : s, how far ahead of the estimate the law looks; None does not
    filter_time : s, of the tracking differentiator; its acceleration is what `tilt_max` gives
    error_scale, error_rate_scale : m, m/s; fuzzy scaling
    position_noise, velocity_noise : m, m/s; standard deviations of what is measured (None: not fused)
    disturbance_intensity : (m/s^2)^2/s, how fast the wind's force may change
    cascade_gains : P on position, I and P on velocity of controller "cascaded-pid" (PX4's MPC_XY_P,
        MPC_XY_VEL_I_ACC, MPC_XY_VEL_P_ACC)
    """

    omega_c: float = 2.0
    omega_o: float = 6.0
    omega_c_range: float = 0.4
    tilt_max: float = np.pi / 9.0
    delay: float = 0.1
    lag: float = 0.12
    prediction: float | None = 0.22
    filter_time: float = 0.2
    error_scale: float = 0.5
    error_rate_scale: float = 1.0
    position_noise: float = 0.02
    velocity_noise: float | None = 0.03
    disturbance_intensity: float = 1.0
    rules: fuzzy.RuleBase = "even"
    literal_filter: bool = False
    gravity: float = STANDARD_GRAVITY
    cascade_gains: tuple[float, float, float] = (0.95, 0.4, 1.8)

    @property
    def acceleration_max(self) -> float:
        """Horizontal acceleration [m/s^2] at `tilt_max`."""
        return self.gravity * float(np.tan(self.tilt_max))


@dataclass(frozen=True)
class PositionParameters:
    """The ring: a controller with two channels, and what turns its command into angles.

    Attributes
    ----------
    controller : channels x and y; output m, command m/s^2
    acceleration_max : m/s^2, () or (N,)
    gravity : m/s^2
    """

    controller: controllers.ControllerParameters
    acceleration_max: float | Array
    gravity: float = STANDARD_GRAVITY


@dataclass(frozen=True)
class PositionInput:
    """What one step is told.

    Attributes
    ----------
    reference, measurement : (2[, N]) m, world x and y
    fresh : (2[, N]) of bool
    yaw : () or (N,) rad, measured
    measured_rate : (2[, N]) m/s or None
    acceleration : (2[, N]) m/s^2 or None
        What the measured attitude gives now (`acceleration_of`); None models the attitude loop instead.
    """

    reference: Array
    measurement: Array
    fresh: BoolArray
    yaw: float | Array
    measured_rate: Array | None = None
    acceleration: Array | None = None


@dataclass(frozen=True)
class PositionOutput:
    """What one step says.

    Attributes
    ----------
    attitude : (2[, N]) rad, wanted roll and pitch
    ring : signals of the two channels; `ring.command` is the limited acceleration (2[, N]) m/s^2
    """

    attitude: Array
    ring: controllers.ControllerOutput = field(repr=False)


def design_ring(
    name: controllers.ControllerName, numbers: PositionDesign, *, follows: bool = False
) -> PositionParameters:
    """Compose the ring with the controller `name`; a PID that `follows` keeps up with a moving set point.

    Raises
    ------
    ValueError
        One line naming the number that makes no ring.
    """
    if not 0.0 < numbers.tilt_max < 0.5 * np.pi:
        raise ValueError(f"tilt_max = {numbers.tilt_max:g} rad must lie between 0 and pi/2")
    most = numbers.acceleration_max
    prediction = None if numbers.prediction is None else _pair(max(numbers.prediction, 1e-4))
    noise = numbers.velocity_noise
    settings = design.DesignSettings(
        b0=_pair(1.0),
        omega_c=_pair(numbers.omega_c),
        omega_o=_pair(numbers.omega_o),
        omega_c_range=_pair(numbers.omega_c_range),
        lower=_pair(-most),
        upper=_pair(most),
        damping=_pair(0.0),
        stiffness=_pair(0.0),
        rate=_pair(np.inf),
        delay=_pair(numbers.delay),
        lag=_pair(numbers.lag),
        prediction=prediction,
        trim=_pair(0.0),
        acceleration=_pair(most),
        filter_time=numbers.filter_time,
        error_scale=_pair(numbers.error_scale),
        error_rate_scale=_pair(numbers.error_rate_scale),
        rules=numbers.rules,
        measurement_variance=_pair(numbers.position_noise**2),
        rate_variance=None if noise is None else _pair(noise**2),
        disturbance_intensity=_pair(numbers.disturbance_intensity),
        literal_filter=numbers.literal_filter,
        angular=(False, False),
        pid_gains=_pid_gains(numbers.omega_c),
        pid_follows=follows,
        cascade=(True, True),
        cascade_gains=np.repeat(np.array(numbers.cascade_gains)[:, None], 2, axis=1),
    )
    return PositionParameters(design.design(name, settings), most, numbers.gravity)


def attitude_of(gravity: float, acceleration: Array, yaw: float | Array) -> Array:
    """Roll and pitch (2[, N]) [rad] that accelerate with `acceleration` (2[, N]) [m/s^2] at this `yaw`."""
    x, y = acceleration[0] / gravity, acceleration[1] / gravity
    forward = x * np.cos(yaw) + y * np.sin(yaw)
    left = y * np.cos(yaw) - x * np.sin(yaw)
    pitch = np.arctan(forward)
    return np.stack([-np.arctan(left * np.cos(pitch)), pitch])


def acceleration_of(gravity: float, attitude: Array) -> Array:
    """Acceleration (2[, N]) [m/s^2] of a vehicle that holds its height at roll, pitch, yaw (3[, N]) [rad].

    Finite below 90 degrees; the cosine of the tilt is held above 0.1.
    """
    roll, pitch, yaw = attitude[0], attitude[1], attitude[2]
    forward, left = np.cos(roll) * np.sin(pitch), -np.sin(roll)
    up = np.maximum(np.cos(roll) * np.cos(pitch), 0.1)
    x = forward * np.cos(yaw) - left * np.sin(yaw)
    y = forward * np.sin(yaw) + left * np.cos(yaw)
    return np.asarray(gravity * np.stack([x, y]) / up)


def limit_tilt(parameters: PositionParameters, acceleration: Array) -> Array:
    """The acceleration (2[, N]) shortened to what the largest tilt gives; its direction stays."""
    size = np.hypot(acceleration[0], acceleration[1])
    most = np.asarray(parameters.acceleration_max)
    return np.asarray(acceleration * np.minimum(1.0, most / np.maximum(size, 1e-12)))


def initial_state(
    parameters: PositionParameters, measurement: Array, acceleration: Array
) -> controllers.ControllerState:
    """At rest at `measurement` (2[, N]) [m], where `acceleration` (2[, N]) has balanced the wind."""
    return controllers.initial_state(parameters.controller, measurement, acceleration)


def align_reference(
    parameters: PositionParameters, state: controllers.ControllerState
) -> controllers.ControllerState:
    """Let the reference start from what is estimated: capturing a point makes no bump."""
    return controllers.align_reference(parameters.controller, state)


def with_applied(
    parameters: PositionParameters, state: controllers.ControllerState, acceleration: Array
) -> controllers.ControllerState:
    """Tell the ring that not its own command but `acceleration` (2[, N]) is on its way (shadow flight)."""
    return controllers.with_applied(parameters.controller, state, acceleration)


def step(
    parameters: PositionParameters, state: controllers.ControllerState, inputs: PositionInput, dt: float
) -> tuple[controllers.ControllerState, PositionOutput]:
    """One step of the ring, `dt` s after the last one; raises ValueError as `controllers.step`."""
    told = controllers.ControllerInput(
        inputs.reference, inputs.measurement, inputs.fresh, inputs.measured_rate
    )
    if inputs.acceleration is not None:
        # What acted is known: the model of the attitude loop only bridges this one step.
        state = _reanchored(state, inputs.acceleration)
    state, output = controllers.step(parameters.controller, state, told, dt)
    command = limit_tilt(parameters, output.command)
    state = controllers.with_applied(parameters.controller, state, command)
    shortened = np.asarray(output.saturated | (command != output.command))
    output = replace(output, command=command, saturated=shortened)
    return state, PositionOutput(attitude_of(parameters.gravity, command, inputs.yaw), output)


def going_on(
    parameters: PositionParameters, state: controllers.ControllerState, disturbance: Array
) -> controllers.ControllerState:
    """The state with which a ring by PID goes on from another one.

    `disturbance` (2[, N]) [m/s^2] is what that one has found, and its integral begins with.
    """
    observed, command = state.observer, -disturbance
    fresh = initial_state(parameters, observed.estimate, command)
    return replace(
        fresh,
        differentiator=state.differentiator,
        pid=replace(fresh.pid, integral=command, rate=observed.rate),
    )


def _reanchored(state: controllers.ControllerState, acceleration: Array) -> controllers.ControllerState:
    """Start the model of the attitude loop from the acceleration that was measured."""
    return replace(state, actuator=replace(state.actuator, lagged=acceleration))
