"""The aircraft: motors, mixing, saturation, sensors, and one step of its physics.

Motors as in Fig 1 and eq 10-14 (+ configuration, seen from above): 1 front, 2 left, 3 rear,
4 right; 1 and 3 turn one way, 2 and 4 the other, so that

    roll torque l (F2 - F4), pitch torque l (F3 - F1), yaw torque k (F1 - F2 + F3 - F4).

Two profiles. ``airframe``: 246 N in all (1.5 times the weight of 16.73 kg), 50 ms motor lag, commands
limited to 0..1, mixing with priorities, rigid-body dynamics. ``paper``: ideal motors (no lag, no
limits, forces may even be negative), so that mixed U1..U4 reach eq 15 unchanged, and the paper's
dynamics. Both run through the same `step`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from sim_vehicle import dynamics, payload
from sim_vehicle.environment import CALM, NOTHING, EnvironmentInputs, Ground, Touching, touch_ground
from sim_vehicle.frames import Array, Row, array_of, limits, rows_of, wrap_angle
from sim_vehicle.proximity import Proximity, thrust_ratio, touch_ceiling


@dataclass(frozen=True, slots=True)
class AirframeParameters:
    """The 10 kg quadrotor of Table 1 with the limits of a real one.

    Attributes
    ----------
    base_mass : kg, without load
    gravity : m/s^2
    arm : m, l0, from the centre to each motor
    inertia : (3,) kg m^2, without load
    drag : K_f; N s/m, and N m s (see `dynamics.derivatives`)
    max_thrust_total : N, of four motors
    motor_time_constant : s; 0 for none
    yaw_moment_per_thrust : m; a propeller's torque over its thrust. Not in the paper. A motor of this
        size (61 N) turns a propeller of 22 inches (0.56 m), the largest that fits between the arms; with
        the usual torque to thrust coefficient ratio of 0.05 to 0.06 that makes 0.03 m
    load_offset, load_size : (3,) m; see `payload.mass_properties`
    profile : "airframe" or "paper"
    ground : None for no ground, as in the paper's own simulations
    proximity : None for no ground effect and no ceiling
    """

    base_mass: float = 10.0
    gravity: float = 9.8
    arm: float = 0.44
    inertia: payload.Vector3 = (0.2906, 0.2906, 0.2906)
    drag: float = 0.15
    max_thrust_total: float = 246.0
    motor_time_constant: float = 0.05
    yaw_moment_per_thrust: float = 0.03
    load_offset: payload.Vector3 = payload.DEFAULT_OFFSET
    load_size: payload.Vector3 = (0.0, 0.0, 0.0)
    profile: payload.Profile = "airframe"
    ground: Ground | None = field(default_factory=Ground)
    proximity: Proximity | None = None

    def __post_init__(self) -> None:
        positive = {
            "base mass": (self.base_mass, "kg"),
            "gravity": (self.gravity, "m/s^2"),
            "arm": (self.arm, "m"),
            "moment of inertia": (min(self.inertia), "kg m^2"),
            "largest thrust": (self.max_thrust_total, "N"),
            "yaw moment per thrust": (self.yaw_moment_per_thrust, "m"),
        }
        for name, (value, unit) in positive.items():
            if not 0.0 < value < math.inf:
                raise ValueError(f"{name} of {value} {unit} is not above zero; give a positive number")
        for name, value, unit in (
            ("drag", self.drag, "N s/m"),
            ("motor time constant", self.motor_time_constant, "s"),
        ):
            if not 0.0 <= value < math.inf:
                raise ValueError(f"{name} of {value} {unit} is below zero; give 0 or more")

    @property
    def body(self) -> payload.VehicleBody:
        """The vehicle without load."""
        return payload.VehicleBody(self.base_mass, self.inertia, self.arm)

    @property
    def motor_max_thrust(self) -> float:
        """Largest thrust of one motor [N]."""
        return 0.25 * self.max_thrust_total

    @property
    def kinematics(self) -> dynamics.Kinematics:
        """Which equations of motion the profile uses."""
        return "paper" if self.profile == "paper" else "rigid-body"

    def hover_thrust(self, load_mass: float = 0.0) -> float:
        """Normalised thrust 0..1 that carries the vehicle and a load [kg] in level flight."""
        return (self.base_mass + load_mass) * self.gravity / self.max_thrust_total


@dataclass(frozen=True, eq=False, slots=True)
class AirframeState:
    """State of one vehicle or of N at once.

    Attributes
    ----------
    rigid : (12[, N]); position, velocity, Euler angles, body rates (see `dynamics`)
    motor_thrust : (4[, N]) N; motors 1 front, 2 left, 3 rear, 4 right; without what a near surface adds
    load_mass : float or (N,) kg; replace it (`with_load`) to pick up or drop
    ground_force : float or (N,) N; mean normal force of the ground in the last step
    on_ground : bool or (N,); the gear touches the ground
    """

    rigid: Array
    motor_thrust: Array
    load_mass: Row = 0.0
    ground_force: Row = 0.0
    on_ground: Touching = True

    @property
    def position(self) -> Array:
        """Position (3[, N]) [m], world."""
        return self.rigid[dynamics.POSITION]

    @property
    def velocity(self) -> Array:
        """Velocity (3[, N]) [m/s], world."""
        return self.rigid[dynamics.VELOCITY]

    @property
    def euler(self) -> Array:
        """Roll, pitch, yaw (3[, N]) [rad]."""
        return self.rigid[dynamics.EULER]

    @property
    def body_rates(self) -> Array:
        """Body rates (3[, N]) [rad/s]."""
        return self.rigid[dynamics.BODY_RATES]

    @property
    def total_thrust(self) -> Array:
        """Sum of the motors' thrust, () or (N,) [N]."""
        return np.asarray(self.motor_thrust.sum(axis=0))


def initial_state(rigid: Array | None = None, load_mass: Row = 0.0) -> AirframeState:
    """Vehicle with motors stopped at `rigid` (12[, N]); level on the ground at the origin if None."""
    state = np.zeros(12) if rigid is None else np.array(rigid, dtype=np.float64)
    touching = state[2] <= 0.0
    if state.ndim == 1:
        return AirframeState(state, np.zeros(4), load_mass, 0.0, bool(touching))
    batch = state.shape[1:]
    loads = np.array(np.broadcast_to(load_mass, batch), dtype=np.float64)
    return AirframeState(state, np.zeros((4, *batch)), loads, np.zeros(batch), touching)


def with_load(state: AirframeState, load_mass: Row) -> AirframeState:
    """State with another load (float or (N,)) [kg] from now on.

    The airframe's centre keeps its velocity: a dropped load leaves with the vehicle's motion, a load
    picked up is taken to move along with it.

    Raises ValueError if a load is negative, not finite or above `payload.LOAD_LIMIT`.
    """
    payload.check_load_mass(load_mass)
    return replace(state, load_mass=load_mass)


# ------------------------------------------------------------------------------------ mixing


def mix(parameters: AirframeParameters, thrust: Row, torque: Array) -> Array:
    """Motor commands (4[, N]) for a thrust and a torque: the inverse of eq 14.

    What does not fit into 0..1 gives way in the order in which PX4 and ArduCopter let it:

    1. thrust first: reduced as far as roll and pitch need it (at most to one half), never raised, so
       a vehicle told to give no thrust gives none;
    2. then roll and pitch, both scaled by the same factor, so that the direction stays;
    3. yaw is mixed last and gets only what the others left.

    Seen from the other end, roll and pitch have priority over thrust and thrust over yaw. The
    ``paper`` profile has ideal motors and nothing gives way.

    Parameters
    ----------
    thrust : () or (N,); 0..1 of `max_thrust_total`
    torque : (3[, N]) N m; about body x, y, z for the arm without load

    Returns
    -------
    (4[, N]) motor commands, 1 for `motor_max_thrust`; thrust is proportional to command
    """
    lift = thrust if isinstance(thrust, float) else np.asarray(thrust, dtype=np.float64)[()]
    torque_x, torque_y, torque_z = rows_of(torque)
    newton = parameters.motor_max_thrust
    roll = torque_x / (2.0 * parameters.arm * newton)
    pitch = torque_y / (2.0 * parameters.arm * newton)
    yaw = torque_z / (4.0 * parameters.yaw_moment_per_thrust * newton)
    if parameters.profile == "airframe":
        lift, roll, pitch, yaw = _desaturate(lift, roll, pitch, yaw)
    return array_of((lift - pitch + yaw, lift + roll - yaw, lift + pitch + yaw, lift - roll - yaw))


def _desaturate(lift: Row, roll: Row, pitch: Row, yaw: Row) -> tuple[Row, Row, Row, Row]:
    """Shares of one motor's command that keep all four within 0..1; see `mix`."""
    at_most, at_least = limits(lift, roll, pitch, yaw)
    lift = at_most(at_least(lift, 0.0), 1.0)
    spread = at_least(at_least(roll, -roll), at_least(pitch, -pitch))
    lift = at_most(lift, at_least(1.0 - spread, 0.5))
    room = at_most(lift, 1.0 - lift)
    scale = at_most(room / at_least(spread, 1e-200), 1.0)
    roll, pitch = roll * scale, pitch * scale
    # Motors 1 and 3 stand at lift -+ pitch and gain from yaw; 2 and 4 at lift +- roll and lose.
    roll_size, pitch_size = at_least(roll, -roll), at_least(pitch, -pitch)
    most = at_least(at_most(1.0 - lift - pitch_size, lift - roll_size), 0.0)
    least = at_least(at_most(lift - pitch_size, 1.0 - lift - roll_size), 0.0)
    return lift, roll, pitch, at_least(at_most(yaw, most), -least)


def wrench(parameters: AirframeParameters, motor_thrust: Array) -> Array:
    """U1..U4 (4[, N]) of eq 14 from the motors' thrust (4[, N]) [N]; U4 is the yaw moment [N m]."""
    return array_of(_wrench_rows(parameters, rows_of(motor_thrust)))


def _wrench_rows(parameters: AirframeParameters, thrust: list[Row]) -> tuple[Row, Row, Row, Row]:
    front, left, rear, right = thrust
    moment = parameters.yaw_moment_per_thrust
    return (
        front + left + rear + right,
        left - right,
        rear - front,
        moment * (front - left + rear - right),
    )


def motor_commands(parameters: AirframeParameters, demanded: Array) -> Array:
    """Motor commands (4[, N]) whose wrench (without limits and lag) is `demanded` (4[, N]), eq 14."""
    u1, u2, u3, u4 = rows_of(demanded)
    u4 = u4 / parameters.yaw_moment_per_thrust
    quarter = 0.25 / parameters.motor_max_thrust
    return array_of(
        (
            quarter * (u1 - 2.0 * u3 + u4),
            quarter * (u1 + 2.0 * u2 - u4),
            quarter * (u1 + 2.0 * u3 + u4),
            quarter * (u1 - 2.0 * u2 - u4),
        )
    )


# -------------------------------------------------------------------------------------- step


def _motors(
    parameters: AirframeParameters, thrust: Array, commands: Array, dt: float
) -> tuple[list[Row], list[Row]]:
    """Thrust of each motor at the end of the step and its mean over the step [N]; exact first-order lag."""
    limit = parameters.motor_max_thrust
    target = [limit * command for command in rows_of(commands)]
    if parameters.profile == "paper":
        return target, target
    at_most, at_least = limits(*target)
    target = [at_most(at_least(wanted, 0.0), limit) for wanted in target]
    if parameters.motor_time_constant == 0.0:
        return target, target
    steps = dt / parameters.motor_time_constant
    keep = math.exp(-steps)
    mean = -math.expm1(-steps) / steps
    missing = [now - wanted for now, wanted in zip(rows_of(thrust), target, strict=True)]
    end = [wanted + keep * gap for wanted, gap in zip(target, missing, strict=True)]
    return end, [wanted + mean * gap for wanted, gap in zip(target, missing, strict=True)]


def step(
    parameters: AirframeParameters,
    state: AirframeState,
    commands: Array,
    environment: EnvironmentInputs = CALM,
    dt: float = 0.0025,
) -> AirframeState:
    """State `dt` seconds later: one Runge-Kutta step with thrust at its mean over it, then the ground.

    `commands` (4[, N]) are those of `mix` or `motor_commands`, held during the step; in the "airframe"
    profile they are limited to 0..1 and followed with the motors' lag. `environment` holds wind and
    disturbances of the step. Raises ValueError if the state's load is negative, not finite or above
    `payload.LOAD_LIMIT`.
    """
    end, mean = _motors(parameters, state.motor_thrust, commands, dt)
    if parameters.proximity is not None:
        ratio = thrust_ratio(parameters.proximity, rows_of(state.rigid)[2])
        mean = [ratio * thrust for thrust in mean]
    properties = payload.mass_properties(
        parameters.body, state.load_mass, parameters.load_offset, parameters.load_size, parameters.profile
    )
    rigid = dynamics.integrate(
        state.rigid,
        array_of(_wrench_rows(parameters, mean)),
        properties,
        parameters.drag,
        parameters.gravity,
        disturbance_force=_force(environment, properties),
        disturbance_torque=environment.torque,
        kinematics=parameters.kinematics,
        dt=dt,
        wind_velocity=environment.wind_velocity,
    )
    if parameters.proximity is not None:
        rigid = touch_ceiling(parameters.proximity, rigid)
    if parameters.ground is None:
        return AirframeState(rigid, array_of(end), state.load_mass, 0.0, False)
    rigid, force, touching = touch_ground(parameters.ground, rigid, properties, dt)
    return AirframeState(rigid, array_of(end), state.load_mass, force, touching)


def _force(environment: EnvironmentInputs, properties: dynamics.MassProperties) -> Array:
    """Disturbance force (3[, N]) [N] through the centre of mass."""
    if environment.acceleration is NOTHING:
        return environment.force
    accelerations = rows_of(environment.acceleration)
    rows = [f + properties.mass * a for f, a in zip(rows_of(environment.force), accelerations, strict=True)]
    return array_of(rows)


# ----------------------------------------------------------------------------------- sensors


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """Standard deviations of the noise on what the autopilot reports (white, Gaussian)."""

    attitude: float = 0.002  # rad
    body_rate: float = 0.01  # rad/s
    altitude: float = 0.01  # m
    climb_rate: float = 0.02  # m/s
    horizontal_position: float = 0.02  # m
    horizontal_velocity: float = 0.02  # m/s


@dataclass(frozen=True, eq=False, slots=True)
class Measurement:
    """What the autopilot's estimator reports; (3[, N]) each, in the frames of `AirframeState`."""

    position: Array
    velocity: Array
    euler: Array
    body_rates: Array


def deviations(noise: SensorNoise) -> Array:
    """Standard deviations (12,) of the rows of `AirframeState.rigid`."""
    h, v = noise.horizontal_position, noise.horizontal_velocity
    attitude, body_rates = 3 * [noise.attitude], 3 * [noise.body_rate]
    return np.array([h, h, noise.altitude, v, v, noise.climb_rate, *attitude, *body_rates])


def measure(noise: SensorNoise, state: AirframeState, generator: np.random.Generator) -> Measurement:
    """State with sensor noise; angles in [-pi, pi). Draws 12[ x N] numbers from `generator`."""
    noisy = with_noise(deviations(noise), state.rigid, generator)
    return Measurement(noisy[0:3], noisy[3:6], wrap_angle(noisy[6:9]), noisy[9:12])


def with_noise(deviation: Array, rigid: Array, generator: np.random.Generator) -> Array:
    """Rows (12[, N]) with white noise of the `deviations` (12,); angles are not wrapped."""
    if rigid.ndim == 1:
        return rigid + deviation * generator.standard_normal(12)
    return rigid + (deviation * generator.standard_normal(rigid.shape).T).T
