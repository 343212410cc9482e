"""Configuration of the simulated vehicle: TOML in, checked values out.

Units are in the names. Every error is one line, `FILE: key.path = value: what is wrong; remedy`.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import Field, ValidationError, field_validator, model_validator

from sim_vehicle import payload
from sim_vehicle.config_backend import PHYSICS_STEP_S, BackendSection
from sim_vehicle.config_base import Noise, NotNegative, Number, Section
from sim_vehicle.config_errors import describe
from sim_vehicle.config_faults import FaultsSection
from sim_vehicle.endpoints import parse_endpoint
from sim_vehicle.errors import SimulatorError
from sim_vehicle.parameter_tables import ARDUPILOT, PX4
from sim_vehicle.parameters import ParameterStore
from sim_vehicle.proximity import Proximity

Personality: TypeAlias = Literal["px4", "ardupilot"]
Delay: TypeAlias = Annotated[float, Field(ge=0.0, le=2.0)]
Vector3: TypeAlias = tuple[Number, Number, Number]
Period: TypeAlias = Annotated[float, Field(ge=0.01, le=1e6)]
Arm: TypeAlias = Annotated[float, Field(ge=-10.0, le=10.0)]

MICROSECOND = 1e-6


class VehicleSection(Section):
    """[vehicle]: what flies, and as which firmware it behaves."""

    personality: Personality = "px4"
    profile: payload.Profile = "airframe"
    seed: Annotated[int, Field(ge=0)] = 0
    system_id: Annotated[int, Field(ge=1, le=255)] = 1
    drag_n_s_m: Annotated[float, Field(ge=0.0, le=10.0)] = 0.15
    """K_f of the paper; a 10 kg quadrotor of this size has rather 0.5 to 1 at 5 m/s."""
    physics_dt_s: Annotated[float, Field(ge=0.0005, le=0.005)] = 0.0025
    attitude_ready_s: NotNegative = 0.5
    """The estimator has an attitude this long after power-up; real ArduCopter in simulation: about 6 s."""
    position_ready_s: NotNegative = 1.0
    """The estimator has a position this long after power-up; real ArduCopter in simulation: about 41 s."""

    @field_validator("physics_dt_s")
    @classmethod
    def _whole_microseconds(cls, value: float) -> float:
        if abs(value / MICROSECOND - round(value / MICROSECOND)) > 1e-6:
            raise ValueError("not a whole number of microseconds; choose for instance 0.0025")
        return value


class LinkSection(Section):
    """[link]: where the vehicle is reached, and how late and unevenly."""

    endpoints: tuple[str, ...] = ("udpout:127.0.0.1:14540",)
    telemetry_delay_s: Delay = 0.02
    command_delay_s: Delay = 0.02
    jitter_s: Delay = 0.0
    """Each datagram is late by up to this much more, evenly distributed; datagrams keep their order."""
    allow_remote: bool = False

    @model_validator(mode="after")
    def _endpoints_are_links(self) -> Self:
        if not self.endpoints:
            raise ValueError("endpoints = []: nobody could connect; give for instance udpout:127.0.0.1:14540")
        for url in self.endpoints:
            try:
                parse_endpoint(url, self.allow_remote)
            except ValueError as problem:
                raise ValueError(f"endpoints = {problem}") from problem
        return self


class SigningSection(Section):
    """[signing]: MAVLink 2 signing with the key in a file, named from the configuration's directory."""

    key_file: str | None = None


class SensorsSection(Section):
    """[sensors]: standard deviations of white noise on what the firmware estimates, flies by and sends."""

    attitude_noise_rad: Noise = 0.002
    body_rate_noise_rad_s: Noise = 0.01
    altitude_noise_m: Noise = 0.01
    climb_rate_noise_m_s: Noise = 0.02
    horizontal_position_noise_m: Noise = 0.02
    horizontal_velocity_noise_m_s: Noise = 0.02


class WindSection(Section):
    """[wind]: steady wind, gusts and the paper's sine (Example 4)."""

    mean_m_s: Vector3 = (0.0, 0.0, 0.0)
    gust_std_m_s: Noise = 0.0
    gust_time_constant_s: Period = 1.0
    sine_amplitude_m_s2: Number = 0.0
    sine_amplitude_n: Number = 0.0
    sine_period_s: Period = 2.0 * math.pi
    sine_direction: Vector3 = (0.0, 0.0, 1.0)

    @model_validator(mode="after")
    def _one_sine(self) -> Self:
        if self.sine_amplitude_m_s2 != 0.0 and self.sine_amplitude_n != 0.0:
            raise ValueError(
                f"sine_amplitude_n = {self.sine_amplitude_n:g}: sine_amplitude_m_s2 is given too; "
                "keep the acceleration or the force"
            )
        return self


class EnvironmentSection(Section):
    """[environment]: surfaces near the rotors (see `proximity`)."""

    ground_effect: bool = False
    ceiling_height_m: float | None = None
    rotor_radius_m: float = 0.28
    rotor_height_m: float = 0.25

    @model_validator(mode="after")
    def _possible(self) -> Self:
        self.proximity()
        return self

    def proximity(self) -> Proximity:
        """The surfaces and rotors. Raises ValueError, for people, if they are not possible."""
        return Proximity(
            rotor_radius=self.rotor_radius_m,
            rotor_height=self.rotor_height_m,
            ground_effect=self.ground_effect,
            ceiling_height=self.ceiling_height_m,
        )


class LoadChange(Section):
    """One entry of payload.schedule: from `time_s` on the load is `mass_kg`."""

    time_s: NotNegative
    mass_kg: float

    @field_validator("mass_kg")
    @classmethod
    def _light_enough(cls, value: float) -> float:
        payload.check_load_mass(value)
        return value


class WinchMove(Section):
    """One entry of payload.winch: from `time_s` on the rope is run to this length, at this speed."""

    time_s: NotNegative
    length_m: Annotated[float, Field(ge=0.1, le=1000.0)]
    speed_m_s: Annotated[float, Field(gt=0.0, le=5.0)] = 0.5


class PayloadSection(Section):
    """[payload]: what the gripper holds, where, and when it comes and goes by itself."""

    offset_m: tuple[Arm, Arm, Arm] = payload.DEFAULT_OFFSET
    rope_length_m: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0
    """The load swings on a rope of this length or lies on the ground; 0: it is held rigidly at offset_m."""
    rope_below_m: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """So far below the centre the rope is fastened."""
    rope_stiffness_n_m: Annotated[float, Field(ge=0.0, le=50_000.0)] = 0.0
    """Of the whole rope; 0: it does not stretch. Three metres of nylon cord of 4 mm have about 4,000."""
    gripper_mass_kg: float = 5.0
    clock: Literal["airborne", "boot"] = "airborne"
    schedule: tuple[LoadChange, ...] = ()
    winch: tuple[WinchMove, ...] = ()
    """A winch changes the length of the rope, by the same clock."""

    @field_validator("gripper_mass_kg")
    @classmethod
    def _light_enough(cls, value: float) -> float:
        payload.check_load_mass(value)
        return value

    @field_validator("schedule")
    @classmethod
    def _in_order(cls, value: tuple[LoadChange, ...]) -> tuple[LoadChange, ...]:
        payload.PayloadSchedule(tuple((change.time_s, change.mass_kg) for change in value))
        return value

    @model_validator(mode="after")
    def _winch_has_a_rope(self) -> Self:
        if self.winch and self.rope_length_m == 0.0:
            raise ValueError(
                "winch: there is no rope; give rope_length_m, its length at the beginning, 0.1 m or more"
            )
        for before, after in pairwise(self.winch):
            if after.time_s <= before.time_s:
                raise ValueError(
                    f"winch at {after.time_s:g} s comes after the one at {before.time_s:g} s; "
                    "list the moves in order of time"
                )
        return self


class LockstepSection(Section):
    """[lockstep]: simulated time waits for the controller."""

    enabled: bool = False
    period_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    answer_timeout_s: Annotated[float, Field(gt=0.0, le=600.0)] = 5.0
    connect_timeout_s: Annotated[float, Field(gt=0.0, le=600.0)] = 20.0


class SimConfig(Section):
    """Everything about one simulated vehicle."""

    vehicle: VehicleSection = VehicleSection()
    link: LinkSection = LinkSection()
    signing: SigningSection = SigningSection()
    sensors: SensorsSection = SensorsSection()
    wind: WindSection = WindSection()
    environment: EnvironmentSection = EnvironmentSection()
    payload: PayloadSection = PayloadSection()
    faults: FaultsSection = FaultsSection()
    lockstep: LockstepSection = LockstepSection()
    backend: BackendSection = BackendSection()
    parameters: dict[str, float | int] = Field(default_factory=dict)
    """Firmware parameters by their own names, changed before power-up."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        steps = self.lockstep.period_s / self.vehicle.physics_dt_s
        if abs(steps - round(steps)) > 1e-6 or round(steps) < 1:
            raise ValueError(
                f"lockstep.period_s = {self.lockstep.period_s:g}: not a multiple of vehicle.physics_dt_s = "
                f"{self.vehicle.physics_dt_s:g}; choose for instance {4 * self.vehicle.physics_dt_s:g}"
            )
        self._check_backend()
        self.make_parameters()
        return self

    @model_validator(mode="before")
    @classmethod
    def _step_for_backend(cls, values: Any) -> Any:
        """Real firmware has its own wish for the physics step, if the file has none."""
        try:
            step = PHYSICS_STEP_S.get(values["backend"]["kind"])
            given = "physics_dt_s" in values.get("vehicle", {})
        except (KeyError, TypeError, AttributeError):  # not there, or not tables: the checks below say so
            return values
        if step is None or given:
            return values
        return {**values, "vehicle": {**values.get("vehicle", {}), "physics_dt_s": step}}

    def _check_backend(self) -> None:
        """Raise ValueError, for people, if real firmware is to fly what only the bundled one can."""
        kind = self.backend.kind
        if kind == "bundled":
            return
        if self.vehicle.profile == "paper":
            raise ValueError(
                f"vehicle.profile = 'paper': backend.kind = '{kind}' needs motors with limits; "
                "choose 'airframe'"
            )
        if self.signing.key_file is not None:
            raise ValueError(
                f"signing.key_file: with backend.kind = '{kind}' the firmware signs by itself; leave it out"
            )
        if self.lockstep.enabled:
            raise ValueError(
                f"lockstep.enabled = true: with backend.kind = '{kind}' controllers connect to the firmware, "
                "which is in lock-step with the physics anyway; leave it out"
            )
        if kind == "ardupilot-json":
            section = self.backend.ardupilot_json
            try:
                parse_endpoint(f"udpin:{section.host}:{section.port}", self.link.allow_remote)
            except ValueError as problem:
                raise ValueError(f"backend.ardupilot_json.host = {problem}") from problem

    def make_parameters(self) -> ParameterStore:
        """A fresh parameter store of this personality with the overrides applied.

        Raises ValueError, for people, if an override is not possible.
        """
        px4 = self.vehicle.personality == "px4"
        store = ParameterStore(PX4, "bytewise") if px4 else ParameterStore(ARDUPILOT, "c-cast")
        store.set("MAV_SYS_ID" if px4 else "SYSID_THISMAV", self.vehicle.system_id)
        for name, value in self.parameters.items():
            try:
                store.set(name, float(value))
            except ValueError as problem:
                detail = str(problem).replace("this personality", self.vehicle.personality)
                raise ValueError(f"parameters.{name} = {value}: {detail}") from problem
        return store


def build(values: Mapping[str, Any], origin: str) -> SimConfig:
    """Check `values`, the tables of a TOML file.

    Raises SimulatorError with one line that starts with `origin`.
    """
    try:
        # Through JSON's rules a TOML array may become a tuple; everything else stays strict.
        return SimConfig.model_validate(_tuples(values))
    except ValidationError as problem:
        raise SimulatorError(f"{origin}: {describe(problem, SimConfig)}") from problem


def load(path: Path, overrides: Mapping[str, Mapping[str, Any]] | None = None) -> SimConfig:
    """Read and check a TOML file; `overrides` are keys of sections, applied on top.

    Raises SimulatorError with one line if the file is missing, is not TOML or holds a bad value.
    """
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as problem:
        raise SimulatorError(f"{path}: no such file; give the path of a TOML file") from problem
    except OSError as problem:
        reason = problem.strerror or str(problem)
        raise SimulatorError(f"{path}: cannot be read: {reason}; give the path of a TOML file") from problem
    except UnicodeDecodeError as problem:
        raise SimulatorError(
            f"{path}: is not UTF-8 text (byte {problem.start}); save it as UTF-8"
        ) from problem
    except tomllib.TOMLDecodeError as problem:
        raise SimulatorError(f"{path}: not valid TOML: {problem}") from problem
    except (ValueError, RecursionError) as problem:  # thousands of digits, thousands of brackets
        raise SimulatorError(f"{path}: holds a number or a nesting that is too long; shorten it") from problem
    if "control" in values:
        raise SimulatorError(
            f"{path}: is a configuration of the daemon; give it to `kffa-offboard run --config`"
        )
    signing = values.get("signing")
    if isinstance(signing, dict) and isinstance(name := signing.get("key_file"), str):
        try:
            signing["key_file"] = str(path.parent / Path(name).expanduser())
        except RuntimeError as problem:
            raise SimulatorError(
                f"{path}: signing.key_file = {name!r}: nobody of that name has a home directory; "
                "write the whole path"
            ) from problem
    for section, changes in (overrides or {}).items():
        table = values.setdefault(section, {})
        if isinstance(table, dict):
            table.update(changes)
    return build(values, str(path))


def _tuples(value: Any) -> Any:
    """Arrays as tuples, all the way down: strict validation takes nothing else for them."""
    if isinstance(value, Mapping):
        return {key: _tuples(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return tuple(_tuples(entry) for entry in value)
    return value
