"""The flying body without autopilot: airframe, load, wind and the record of what really happened.

Motor commands in, true states out, at a fixed step and without clock or sockets. The bundled firmware
(`vehicle`) and real firmware (`backends`) fly the same plant.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Literal

import numpy as np

from sim_vehicle import airframe, environment, faults
from sim_vehicle.config import SimConfig
from sim_vehicle.config_faults import FaultsSection
from sim_vehicle.frames import Array
from sim_vehicle.payload import check_load_mass
from sim_vehicle.proximity import Proximity
from sim_vehicle.swing import Rope
from sim_vehicle.truth import TruthRecorder

AIRBORNE_HEIGHT = 0.1
"""The airborne clock of the payload schedule starts when the vehicle is first this high [m]."""


class Plant:
    """One vehicle's body.

    Attributes
    ----------
    time_us : simulated time since power-up [us]
    dt : physics step [s]
    state : true state of the airframe; may be replaced before the first `step`
    truth : recorder of true states and events
    """

    def __init__(self, config: SimConfig, wind_generator: np.random.Generator) -> None:
        self.time_us = 0
        self.step_us = round(config.vehicle.physics_dt_s * 1e6)
        self.dt = self.step_us * 1e-6
        self.body = airframe.AirframeParameters(
            profile=config.vehicle.profile,
            drag=config.vehicle.drag_n_s_m,
            load_offset=config.payload.offset_m,
            proximity=_proximity(config),
        )
        self.state = airframe.initial_state()
        self.truth = TruthRecorder()
        self._payload = config.payload
        self._changes = deque((change.time_s, change.mass_kg) for change in config.payload.schedule)
        self._airborne_at_us: int | None = None
        self._wind = _wind(config)
        self._wind_generator = wind_generator
        self._gust = np.zeros(3)
        self._steady = environment.inputs_at(self._wind, self._gust, 0.0) if self._wind.steady else None
        self._faults = config.faults
        self._rope = _rope(config)
        self._winch = deque(config.payload.winch)
        self._faulty = config.faults != FaultsSection()

    def step(self, motor_commands: Array) -> None:
        """One physics step with commands (4,), 0..1, held over it (see `airframe.step`)."""
        self._follow_schedule()
        surroundings = self._steady or self._blow()
        if self._faulty:
            now_s = self.time_us * 1e-6
            motor_commands = faults.motor_commands(self._faults, now_s, motor_commands)
            felt = surroundings.wind_velocity + faults.wind(self._faults, now_s)
            surroundings = replace(surroundings, wind_velocity=felt)
        if self._rope.mass_kg > 0.0:
            force, torque = self._pull()
            surroundings = replace(
                surroundings, force=surroundings.force + force, torque=surroundings.torque + torque
            )
        elif self._rope.length > 0.0:
            self._rope.turn(self.dt)
        self.state = airframe.step(self.body, self.state, motor_commands, surroundings, self.dt)
        self.time_us += self.step_us

    def _pull(self) -> tuple[Array, Array]:
        """Force and torque of the rope, for one step."""
        lifted = self._rope.lifted
        force, torque = self._rope.step(self.body, self.state.rigid, self.dt)
        if self._rope.lifted is not lifted:
            self.truth.event(self.time_us, "load set down" if lifted else "load lifted")
        return force, torque

    def _blow(self) -> environment.EnvironmentInputs:
        """Wind that changes, for one step."""
        self._gust, inputs = environment.advance(
            self._wind, self._gust, self.time_us * 1e-6, self._wind_generator, self.dt
        )
        return inputs

    def set_load(self, mass_kg: float) -> None:
        """Carry a load of `mass_kg` from now on; 0 drops it. ValueError if there can be no such load."""
        before = self.load_kg
        if mass_kg == before:
            return
        if self._rope.length > 0.0:
            check_load_mass(mass_kg)
            ground = self.body.ground is not None
            self._rope.hang(mass_kg, self.state.rigid, self.body.gravity, ground)
        else:
            self.state = airframe.with_load(self.state, mass_kg)
        word = "pick-up" if mass_kg > before else "drop"
        self.truth.event(self.time_us, f"{word} {abs(mass_kg - before):.6g} kg")

    @property
    def load_kg(self) -> float:
        """What is carried, rigidly or on a rope."""
        return float(np.asarray(self.state.load_mass)) + self._rope.mass_kg

    def work_gripper(self, action: Literal["grab", "release"]) -> None:
        """Close the gripper round the configured load, or open it."""
        self.set_load(self._payload.gripper_mass_kg if action == "grab" else 0.0)

    def record(self, armed: bool, mode_name: str) -> None:
        """Append the present state to the truth."""
        self.truth.record(
            self.time_us,
            self.state.rigid.tolist(),
            float(self.state.motor_thrust.sum()),
            self.load_kg,
            armed,
            mode_name,
            self._rope.angle,
        )

    def _follow_schedule(self) -> None:
        if self._airborne_at_us is None and self.state.rigid[2] > AIRBORNE_HEIGHT:
            self._airborne_at_us = self.time_us
        start = 0 if self._payload.clock == "boot" else self._airborne_at_us
        if start is None:
            return
        elapsed_us = self.time_us - start
        while self._changes and elapsed_us >= self._changes[0][0] * 1e6:
            self.set_load(self._changes.popleft()[1])
        while self._winch and elapsed_us >= self._winch[0].time_s * 1e6:
            move = self._winch.popleft()
            self._rope.wind(move.length_m, move.speed_m_s)
            self.truth.event(self.time_us, f"winch to {move.length_m:.6g} m")


def _proximity(config: SimConfig) -> Proximity | None:
    e = config.environment
    return e.proximity() if e.ground_effect or e.ceiling_height_m is not None else None


def _rope(config: SimConfig) -> Rope:
    p = config.payload
    return Rope(p.rope_length_m, p.rope_below_m, p.rope_stiffness_n_m)


def _wind(config: SimConfig) -> environment.Wind:
    w = config.wind
    force = w.sine_amplitude_n != 0.0
    return environment.Wind(
        mean=w.mean_m_s,
        gust_std=w.gust_std_m_s,
        gust_time_constant=w.gust_time_constant_s,
        sine_amplitude=w.sine_amplitude_n if force else w.sine_amplitude_m_s2,
        sine_period=w.sine_period_s,
        sine_direction=w.sine_direction,
        sine_kind="force" if force else "acceleration",
    )
