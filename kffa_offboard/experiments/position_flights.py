"""The position ring in the `airframe` profile: hover, step and square in gusty wind, through a drop.

The same records that the daemon makes of demo-px4-position.toml are flown here as a batch: ring
(`control.position`) over the four channels, body rates and thrust to the vehicle of `airframe`.
One telemetry sample each 10 ms arrives `delay_s` late (the height one sample later, as over MAVLink), and so
does the command on its way back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.control import Array, controllers, position
from kffa_offboard.control.controllers import ControllerName
from kffa_offboard.experiments import airframe, inner_loop, plant
from kffa_offboard.experiments.settings import PaperSettings, PositionRing
from kffa_offboard.offboard.profile import profile_altitude
from kffa_offboard.offboard.segments import Move

CONFIGURATION = "demo-px4-position.toml"
CONTROL_S = 0.01
#: The PID is the cascade with PX4's structure and gains. The parallel `pid` is left out: by construction
#: (three equal poles) it overshoots a step by a quarter, which would prove nothing.
CONTROLLERS: tuple[ControllerName, ...] = ("cascaded-pid", "wb-ladrc", "ladrc", "fa-ladrc", "kffa-ladrc")
FLIGHTS = ("hover", "step", "loaded-step", "square")
CORNERS = ((0.0, 0.0), (1.0, 0.0), (1.0, -1.0), (0.0, -1.0), (0.0, 0.0))  # x north, y west; times the side


@dataclass(frozen=True)
class PlannedFlight:
    """Set point (T, 2) [m] from the start and load (T,) [kg] of one flight, a row each `CONTROL_S`."""

    name: str
    target: Array
    load_mass: Array


@dataclass(frozen=True)
class PositionTrace:
    """One flight of one controller, a row each `CONTROL_S`; metres and radians, true.

    `target` (T, 2), `place` (T, 3), `attitude` roll, pitch, yaw (T, 3), `load_mass` (T,) kg. The place counts
    from the set point at the start, its height from the ground.
    """

    time: Array
    target: Array
    place: Array
    attitude: Array
    load_mass: Array


#: By controller, flight's name and seed.
PositionTraces = dict[tuple[str, str, int], PositionTrace]


def times(duration_s: float) -> Array:
    """Times of the control steps, s."""
    return _steps_at(round(duration_s / CONTROL_S))


def _steps_at(count: int) -> Array:
    return np.asarray(CONTROL_S * np.arange(count), dtype=np.float64)


def planned(told: PositionRing) -> list[PlannedFlight]:
    """What is flown, in the order of `FLIGHTS`."""
    hover = times(told.lead_s + 3.0 * told.hover_s)
    nowhere = np.zeros((len(hover), 2))
    carried = (hover >= told.pick_up_s - 1e-9) & (hover < told.drop_s - 1e-9)
    step = times(told.lead_s + told.step_s)
    north = np.zeros((len(step), 2))
    north[step >= told.lead_s - 1e-9, 0] = told.step_m
    return [
        PlannedFlight("hover", nowhere, np.where(carried, told.load_kg, 0.0)),
        PlannedFlight("step", north, np.zeros(len(step))),
        PlannedFlight("loaded-step", north, np.full(len(step), told.load_kg)),
        _square(told),
    ]


def _square(told: PositionRing) -> PlannedFlight:
    """Four moves as the daemon plans them; the load is dropped in the middle of the second side."""
    time = times(told.lead_s + 4.0 * told.side_s)
    corners = told.step_m * np.array(CORNERS)
    target = np.zeros((len(time), 2))
    service = load(bundled(CONFIGURATION)).service
    for k, (start, end) in enumerate(pairwise(corners)):
        move = Move(end[0] - start[0], start[1] - end[1], told.side_s)
        profile = move.profile(service.flight.acceleration_m_s2)
        begins = told.lead_s + k * told.side_s
        shown = time >= begins - 1e-9
        share = np.array([profile_altitude(profile, t - begins) for t in time[shown]]) / told.step_m
        target[shown] = start + share[:, None] * (end - start)
    return PlannedFlight("square", target, np.where(time < told.square_drop_s - 1e-9, told.load_kg, 0.0))


def steps_of(settings: PaperSettings) -> int:
    """Number of control steps that flying takes, for progress."""
    return len(CONTROLLERS) * max(len(flight.target) for flight in planned(settings.position))


def fly_position(
    settings: PaperSettings,
    seeds: int,
    names: tuple[ControllerName, ...] = CONTROLLERS,
    tick: Callable[[str, int], None] = lambda label, steps: None,
) -> PositionTraces:
    """Fly everything with every controller in `names`; `tick` as in `examples.fly_all`."""
    told = settings.position
    flights = [(flight, seed) for flight in planned(told) for seed in range(seeds)]
    surroundings = _Surroundings.drawn(told, [seed for _, seed in flights], _longest(flights))
    traces: PositionTraces = {}
    for name in names:
        places, attitudes = _fly(told, name, flights, surroundings, lambda n, name=name: tick(name, n))  # type: ignore[misc]
        for column, (flight, seed) in enumerate(flights):
            rows = slice(0, len(flight.target))
            traces[name, flight.name, seed] = PositionTrace(
                _steps_at(len(flight.target)),
                flight.target,
                places[rows, :, column],
                attitudes[rows, :, column],
                flight.load_mass,
            )
    return traces


def _longest(flights: list[tuple[PlannedFlight, int]]) -> int:
    return max(len(flight.target) for flight, _ in flights)


@dataclass(frozen=True)
class _Surroundings:
    """Gusts (T, 3, N) [m/s] and sensor noise (T, 12, N), the same whatever flies in a seed."""

    gusts: Array
    noise: Array

    @classmethod
    def drawn(cls, told: PositionRing, seeds: list[int], steps: int) -> _Surroundings:
        """Gauss-Markov gusts that have already begun, white noise on what the autopilot reports."""
        keep = np.exp(-CONTROL_S / told.gust_time_constant_s)
        scale = np.array(
            [*told.position_noise_m, *3 * [told.velocity_noise_m_s], *3 * [told.attitude_noise_rad],
             *3 * [told.body_rate_noise_rad_s]]
        )  # fmt: skip
        gusts, noise = {}, {}
        for seed in dict.fromkeys(seeds):
            random = np.random.default_rng(seed)
            normal = told.gust_std_m_s * random.standard_normal((steps, 3))
            gust = np.empty_like(normal)
            gust[0] = normal[0]
            for k in range(1, steps):
                gust[k] = keep * gust[k - 1] + np.sqrt(1.0 - keep**2) * normal[k]
            gusts[seed], noise[seed] = gust, scale * random.standard_normal((steps, 12))
        return cls(
            np.stack([gusts[seed] for seed in seeds], axis=-1),
            np.stack([noise[seed] for seed in seeds], axis=-1),
        )


def _fly(
    told: PositionRing,
    name: ControllerName,
    flights: list[tuple[PlannedFlight, int]],
    surroundings: _Surroundings,
    tick: Callable[[int], None],
) -> tuple[Array, Array]:
    """True places and attitudes, ``(T, 3, N)`` each, of one controller."""
    target, load_mass = _extended(flights)
    steps, _, count = target.shape
    pilot = _Pilot(told, name, load_mass[0])
    rigid = np.zeros((12, count))
    rigid[2], rigid[8] = told.altitude_m, told.yaw_rad
    motors = np.broadcast_to((plant.MASS + load_mass[0]) * plant.GRAVITY / 4.0, (4, count)).copy()
    wind = np.array(told.wind_m_s)[:, None]
    loop = airframe.RateLoop(*3 * (np.zeros((3, count)),))
    late = round(told.delay_s / CONTROL_S)
    measured = [rigid + surroundings.noise[0]] * (late + 2)
    underway = [(np.zeros((3, count)), 4.0 * motors[0] / airframe.THRUST)] * (late + 1)
    places, attitudes = np.empty((steps, 3, count)), np.empty((steps, 3, count))
    for k in range(steps):
        places[k], attitudes[k] = rigid[0:3], rigid[6:9]
        measured = [*measured[1:], rigid + surroundings.noise[k]]
        # Height and place are one sample older than the attitude that starts the control step.
        underway = [*underway[1:], pilot.step(np.concatenate([measured[0][:6], measured[1][6:]]), target[k])]
        rates, thrust = underway[0]
        whole = airframe.body(load_mass[k], told.drag_n_s_m)
        for _ in range(round(CONTROL_S / airframe.STEP_S)):
            # The gyro of the rate loop: nothing on the way, and its noise is the autopilot's own affair.
            loop, torque = airframe.rate_loop(loop, rates, rigid[9:12])
            commands = airframe.mix(thrust, torque)
            rigid, motors = airframe.step(rigid, motors, commands, whole, wind + surroundings.gusts[k])
        if k % 100 == 99:
            tick(100)
    tick(steps % 100)
    return places, attitudes


def _extended(flights: list[tuple[PlannedFlight, int]]) -> tuple[Array, Array]:
    """Set points ``(T, 2, N)`` and loads ``(T, N)``; shorter flights go on as they end."""
    steps = _longest(flights)

    def extended(values: Array) -> Array:
        return np.concatenate([values, np.repeat(values[-1:], steps - len(values), axis=0)])

    return (
        np.stack([extended(flight.target) for flight, _ in flights], axis=-1),
        np.stack([extended(flight.load_mass) for flight, _ in flights], axis=-1),
    )


class _Pilot:
    """The daemon's control step for a batch: telemetry in, body rates and thrust out."""

    def __init__(self, told: PositionRing, name: ControllerName, load_mass: Array) -> None:
        """In a hover that carries `load_mass` ``(N,)``, in still air."""
        self._told = told
        self._settings = load(bundled(CONFIGURATION), Overrides(controller=name, output="rates")).service
        assert self._settings.position is not None
        self._parameters, self._ring_parameters = self._settings.controller, self._settings.position.ring
        nothing = np.zeros_like(load_mass)
        hover = (plant.MASS + load_mass) * plant.GRAVITY / airframe.THRUST
        outputs = np.stack([nothing, nothing, nothing + told.yaw_rad, nothing + told.altitude_m])
        balance = np.stack([nothing, nothing, nothing, hover])
        # A PID's integral must carry the load, too, hence the alignment.
        self._inner = controllers.align_reference(
            self._parameters, controllers.initial_state(self._parameters, outputs, balance)
        )
        still = np.zeros((2, len(load_mass)))
        self._ring = position.initial_state(self._ring_parameters, still, still)

    def step(self, measured: Array, target: Array) -> tuple[Array, Array]:
        """Body rates ``(3, N)`` [rad/s] and thrust ``(N,)`` of 0..1 for telemetry ``(12, N)``."""
        ring = self._ring_parameters
        attitude, count = measured[6:9], measured.shape[1]
        self._ring, wanted = position.step(
            ring,
            self._ring,
            position.PositionInput(
                reference=target,
                measurement=measured[0:2],
                fresh=np.ones((2, count), dtype=bool),
                yaw=attitude[2],
                measured_rate=measured[3:5],
                acceleration=position.acceleration_of(ring.gravity, attitude),
            ),
            CONTROL_S,
        )
        level = np.ones(count)
        reference = np.stack([*wanted.attitude, self._told.yaw_rad * level, self._told.altitude_m * level])
        self._inner, _, sent = inner_loop.step(
            self._parameters,
            self._inner,
            reference,
            inner_loop.Telemetry(attitude, measured[9:12], measured[2], measured[5]),
            self._settings.limits.tilt_compensation_max_rad,
            CONTROL_S,
        )
        return sent.body_rates, sent.thrust
